"""``prbench synthesize``: synthetic recordings in a dataset's native files, with the truth beside them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click
import msgspec

from prbench.cli.builds import BuiltTable, Stage, built_table
from prbench.cli.commands import Answer, command
from prbench.cli.options import (
    OUT_FILE,
    POSITIVE,
    count_option,
    out_folder_option,
    replace_option,
    seed_option,
    workers_option,
)
from prbench.cli.progress import progress
from prbench.cli.sensor_checks import SensorCheck, compare_with_truth, print_checks, sensor_check
from prbench.cli.synthetic_people import PeopleCheck, check_people, print_people
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.checking.matching import Verification
    from prbench.synthetic.write_tree import WrittenTree

_SCENES_OF_ONE_PRESET = 12
_RECORDINGS_OF_A_HISTOGRAM = 10


class SyntheticRecording(msgspec.Struct, frozen=True, kw_only=True):
    """One recording that was written.

    Attributes:
        recording: Its id.
        split: ``train``, ``validation`` or ``test``.
        duration: Its length, in seconds.
        events: Number of picks and puts; in a text-motion layout the number of texts.
        objects: Number of objects; null in a text-motion layout, which has none.
    """

    recording: str
    split: str
    duration: float
    events: int
    objects: int | None


class SynthesizeReport(msgspec.Struct, frozen=True, kw_only=True):
    """The recordings and pictures that were written.

    Attributes:
        folder: The native files; null if none were asked for.
        recordings: The recordings in them.
        checks: What curation finds in these files and at each level of noise; empty with ``--no-verify``,
            ``--defect`` and text-motion layouts.
        missed: Sequences that were acted out in these files and not found, and why.
        table: The table, with ``--table``.
        gallery: The picture of sequences, if one was asked for.
        histograms: The picture of durations, gaps and movements, if one was asked for.
        people: How the people act and what their bodies keep, with ``--people``; else empty.
    """

    folder: Path | None
    recordings: list[SyntheticRecording]
    checks: list[SensorCheck]
    missed: list[str]
    table: BuiltTable | None
    gallery: Path | None
    histograms: Path | None
    people: list[PeopleCheck]


@dataclass(frozen=True)
class _Request:
    """The recordings that are to be written."""

    layout: str
    out: Path | None
    count: int | None
    seed: int
    size: Literal["tiny", "default", "large"]
    events: int | None
    bystander_objects: int | None
    defects: tuple[str, ...]
    egoallo: bool
    verify: bool
    replace: bool
    workers: int


@dataclass(frozen=True)
class _Written:
    """The recordings that were written, and how they are printed."""

    show: Callable[[], None]
    folder: Path | None = None
    recordings: tuple[SyntheticRecording, ...] = ()
    checks: tuple[SensorCheck, ...] = ()
    missed: tuple[str, ...] = ()
    table: BuiltTable | None = None


_NOTHING = _Written(lambda: None)


@command(
    "synthesize",
    example="prbench synthesize adt --count 4 --seed 1 --out synthetic/adt",
    report=SynthesizeReport,
)
@click.argument("layout", required=False)
@out_folder_option("Folder of the recordings.")
@click.option(
    "--table",
    is_flag=True,
    help="Write the finished table of sequences instead of native files (the only way for size large).",
)
@replace_option()
@count_option("Number of recordings to make (default: the size's number).")
@seed_option("of everything")
@click.option(
    "--size", type=click.Choice(["tiny", "default", "large"]), default="tiny", help="How much (default tiny)."
)
@click.option("--events", type=POSITIVE, metavar="N", help="Picks and puts of each recording.")
@click.option("--bystander-objects", type=int, metavar="N", help="Objects that never move.")
@click.option(
    "--defect",
    "defects",
    multiple=True,
    metavar="NAME",
    help="Damage the first recording as real copies are; repeatable (a wrong name lists them).",
)
@click.option(
    "--egoallo",
    is_flag=True,
    help="Also write bodies as EgoAllo would estimate them (adt; hd-epic and hot3d have no others).",
)
@click.option("--no-verify", is_flag=True, help="Do not compare what curation finds in the files with the truth.")
@click.option(
    "--gallery", type=OUT_FILE, metavar="FILE", help="Draw sequences of LAYOUT, or of all presets without one, as PNG."
)
@click.option(
    "--histograms", type=OUT_FILE, metavar="FILE", help="Draw durations, gaps and movements beside the study's, as PNG."
)
@click.option(
    "--people",
    is_flag=True,
    help="Print how the people of LAYOUT, or of all presets, act and move beside the ranges asked of them.",
)
@workers_option()
def synthesize(
    *,
    layout: str | None,
    out: Path | None,
    table: bool,
    replace: bool,
    count: int | None,
    seed: int,
    size: Literal["tiny", "default", "large"],
    events: int | None,
    bystander_objects: int | None,
    defects: tuple[str, ...],
    egoallo: bool,
    no_verify: bool,
    gallery: Path | None,
    histograms: Path | None,
    people: bool,
    workers: int,
) -> Answer:
    """Write synthetic recordings in a dataset's native layout, with the truth beside them.

    LAYOUT is the native layout to write: any dataset of `prbench datasets`. For --gallery alone it is any preset.
    --people acts out 20 recordings of six events a preset, or --count.
    """
    from prbench.errors import UsageError

    draws = gallery is not None or histograms is not None or people
    written = _NOTHING
    if layout is None:
        if not draws:
            raise UsageError(
                "name a layout to write (for example: prbench synthesize adt --out DIR), --gallery FILE or --people."
            )
    elif out is not None or not draws:
        request = _Request(
            layout=layout,
            out=out,
            count=count,
            seed=seed,
            size=size,
            events=events,
            bystander_objects=bystander_objects,
            defects=defects,
            egoallo=egoallo,
            verify=not no_verify,
            replace=replace,
            workers=workers,
        )
        written = _write_table(request) if table else _write_tree(request)
    if gallery is not None:
        _draw_gallery(gallery, layout=layout, seed=seed)
    if histograms is not None:
        _draw_histograms(histograms, layout=layout, seed=seed, count=count)
    checked = check_people(layout, seed=seed, count=count, workers=workers) if people else []
    report = SynthesizeReport(
        folder=written.folder,
        recordings=list(written.recordings),
        checks=list(written.checks),
        missed=list(written.missed),
        table=written.table,
        gallery=gallery,
        histograms=histograms,
        people=checked,
    )

    def show() -> None:
        written.show()
        if gallery is not None:
            print(f"gallery: {gallery}")
        if histograms is not None:
            print(f"histograms: {histograms}")
        if checked:
            print_people(checked)

    return Answer(report, show)


def _write_tree(request: _Request) -> _Written:
    from prbench.engine import engine_for
    from prbench.errors import UsageError
    from prbench.synthetic.corpus import CORPUS_LAYOUTS
    from prbench.synthetic.write_tree import planned_recordings, synthesize_tree

    if request.out is None:
        raise UsageError("--out DIR is needed: the folder of the recordings.")
    if request.layout in CORPUS_LAYOUTS:
        return _write_corpus_tree(request, request.out)
    done = itertools.count(1)
    planned = planned_recordings(request.size, request.count)
    with progress(f"writing {request.layout}") as tell:
        tree = synthesize_tree(
            request.layout,
            request.out,
            recordings=request.count,
            seed=request.seed,
            size=request.size,
            workers=request.workers,
            n_events=request.events,
            bystander_objects=request.bystander_objects,
            defects=request.defects,
            estimates=request.egoallo,
            on_written=lambda written: tell(next(done), planned, written.recording_id),
        )
    checked: list[tuple[str, Verification]] = []
    if request.verify and not request.defects:
        checked = compare_with_truth(
            tree.root,
            layout=request.layout,
            recordings=len(tree.recordings),
            seed=request.seed,
            engine=engine_for(request.workers),
        )
    missed = tuple(miss.text for miss in checked[0][1].missed_sequences) if checked else ()

    def show() -> None:
        print_table(
            "synthetic recordings",
            ("recording", "split", "seconds", "events", "objects"),
            [
                (r.recording_id, r.split, f"{r.duration:.1f}", str(r.n_events), str(r.n_objects))
                for r in tree.recordings
            ],
            numbers=(2, 3, 4),
        )
        if checked:
            print_checks(checked, missed)
        print(f"recordings: {tree.root} (the truth is in {tree.root / 'truth'}; readers never open it)")

    return _Written(
        show,
        folder=tree.root,
        recordings=_recordings(tree, with_objects=True),
        checks=tuple(sensor_check(name, result) for name, result in checked),
        missed=missed,
    )


def _recordings(tree: WrittenTree, *, with_objects: bool) -> tuple[SyntheticRecording, ...]:
    return tuple(
        SyntheticRecording(
            recording=each.recording_id,
            split=each.split,
            duration=float(each.duration),
            events=each.n_events,
            objects=each.n_objects if with_objects else None,
        )
        for each in tree.recordings
    )


def _write_table(request: _Request) -> _Written:
    """Act out, sense and curate recordings in memory: training data without native files."""
    from prbench.curation import BuildOptions
    from prbench.curation.provenance import funnel_rows
    from prbench.engine import engine_for
    from prbench.errors import UsageError
    from prbench.synthetic.synthetic_table import LARGE_RECORDINGS, Staging, build_synthetic_table
    from prbench.synthetic.write_tree import planned_recordings

    if request.out is None:
        raise UsageError("--out DIR is needed: the folder of the table.")
    if request.defects or request.egoallo or request.bystander_objects is not None:
        raise UsageError("--table writes no native files; leave --defect, --egoallo and --bystander-objects out.")
    large = request.size == "large"
    recordings = request.count or (LARGE_RECORDINGS if large else planned_recordings(request.size, None))
    with progress(f"acting out {request.layout}") as tell:
        report = build_synthetic_table(
            request.layout,
            recordings,
            request.seed,
            request.out,
            engine=engine_for(request.workers),
            world="large" if large else "default",
            n_events=Staging.n_events if request.events is None else request.events,
            options=BuildOptions(replace=request.replace),
            progress=tell,
        )
    rows = funnel_rows(report.info)
    stages = [Stage(stage=row.stage, kept=row.kept, dropped=row.dropped, why=row.reason) for row in rows]
    said = f"table: {request.out} ({report.info.counts.sequences} sequences of {recordings} recordings)"
    return _Written(lambda: print(said), table=built_table(report, stages))


def _write_corpus_tree(request: _Request, out: Path) -> _Written:
    """Write synthetic people in the layout of a text-motion dataset."""
    from prbench.synthetic.corpus import DEFAULT_RECORDINGS, synthesize_corpus_tree

    done = itertools.count(1)
    planned = request.count or DEFAULT_RECORDINGS
    with progress(f"writing {request.layout}") as tell:
        tree = synthesize_corpus_tree(
            request.layout,
            out,
            recordings=planned,
            seed=request.seed,
            workers=request.workers,
            defects=request.defects,
            on_written=lambda written: tell(next(done), planned, written.recording_id),
        )

    def show() -> None:
        print_table(
            "synthetic recordings",
            ("recording", "split", "seconds", "texts"),
            [(r.recording_id, r.split, f"{r.duration:.1f}", str(r.n_events)) for r in tree.recordings],
            numbers=(2, 3),
        )
        print(f"recordings: {tree.root} (build them with `prbench build-corpus {request.layout} --root {tree.root}`)")

    return _Written(show, folder=tree.root, recordings=_recordings(tree, with_objects=False))


def _draw_gallery(file: Path, *, layout: str | None, seed: int) -> None:
    """Draw twelve sequences of all presets, or of the one that was named."""
    from prbench.synthetic.corpus import CORPUS_LAYOUTS
    from prbench.synthetic.people import perform
    from prbench.viewing.clip_strips import render_strips, strips_of_activities
    from prbench.viewing.gallery import render_contact_sheet, render_gallery, sequences_of

    if layout in CORPUS_LAYOUTS:
        render_strips(strips_of_activities(seed), file)
    elif layout is None:
        render_contact_sheet(file, seed=seed)
    else:
        performances = [perform(layout, seed=seed, index=index, n_events=6) for index in range(4)]
        render_gallery(sequences_of(performances)[:_SCENES_OF_ONE_PRESET], file)


def _draw_histograms(file: Path, *, layout: str | None, seed: int, count: int | None) -> None:
    """Draw statistics of some recordings of the preset that was named, or of all presets."""
    from prbench.synthetic.people import PRESETS, perform
    from prbench.viewing.distributions import render_histograms

    presets = tuple(PRESETS) if layout is None else (layout,)
    acted = {
        preset: [
            perform(preset, seed=seed, index=index, provocations={})
            for index in range(count or _RECORDINGS_OF_A_HISTOGRAM)
        ]
        for preset in presets
    }
    render_histograms(acted, file)
