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
    PATH,
    POSITIVE,
    count_option,
    out_folder_option,
    replace_option,
    seed_option,
    workers_option,
)
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.engine import Engine
    from prbench.synthetic.write_tree import WrittenTree
    from prbench.workflows.matching import Verification

_FEWEST_VERIFIED = 4
"""Recordings on which each noise level is verified at least."""
_SCENES_OF_ONE_PRESET = 12
_RECORDINGS_OF_A_HISTOGRAM = 10
_RECORDINGS_OF_PEOPLE = 20


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


class FoundHands(msgspec.Struct, frozen=True, kw_only=True):
    """Which hand curation names for the events that have a place.

    Attributes:
        right: Number of events with the hand that acted.
        wrong: Number of events with the other hand.
        unknown: Number of events without a hand.
    """

    right: int
    wrong: int
    unknown: int


class SensorCheck(msgspec.Struct, frozen=True, kw_only=True):
    """The events that curation finds with sensors of one kind, against those that were acted out.

    Events within the sensors' resolution of a threshold and lost tracks are not counted. Numbers without a sample are
    null.

    Attributes:
        sensors: ``these files``, or a level of noise.
        recordings: Number of recordings.
        events: Number of true events.
        recall: Share of the true events that were found.
        precision: Share of the found events that are true.
        timing_bias: Mean of found minus true event time, in seconds.
        timing_median: Median size of that difference, in seconds.
        timing_p95: 95th percentile of its size, in seconds.
        priming_recall: Share of the primed events that were found primed.
        unprimed: Number of events without a true prime.
        false_primes: Share of those that were found primed all the same.
        prime_median: Median size of found minus true prime time, in seconds.
        prime_p5: 5th percentile of found minus true prime time, in seconds.
        prime_p95: 95th percentile of found minus true prime time, in seconds.
        hands: Hands of all events that have a place.
        expected_sequences: Number of sequences that were acted out.
        missed_sequences: Number of those that were not found.
    """

    sensors: str
    recordings: int
    events: int
    recall: float | None
    precision: float | None
    timing_bias: float | None
    timing_median: float | None
    timing_p95: float | None
    priming_recall: float | None
    unprimed: int
    false_primes: float | None
    prime_median: float | None
    prime_p5: float | None
    prime_p95: float | None
    hands: FoundHands
    expected_sequences: int
    missed_sequences: int


class PeopleCheck(msgspec.Struct, frozen=True, kw_only=True):
    """One number of synthetic people beside the range in which it must lie.

    Attributes:
        preset: The people: a dataset whose people they imitate.
        number: Its name, as on the page of synthetic recordings.
        acted: Of noise-free motion and gaze, null without a sample; of body numbers the worst sequence.
        recorded: Of sequences that curation makes of the sensors' recordings, the worst; null for behaviour.
        low: Smallest value allowed; null without one.
        high: Largest value allowed; null without one.
        holds: True if both lie in the range.
        source: Why the range is there: measured on people, our own limit, or the protocol's.
    """

    preset: str
    number: str
    acted: float | None
    recorded: float | None
    low: float | None
    high: float | None
    holds: bool
    source: str


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
    "--gallery", type=PATH, metavar="FILE", help="Draw sequences of LAYOUT, or of all presets without one, as PNG."
)
@click.option(
    "--histograms", type=PATH, metavar="FILE", help="Draw durations, gaps and movements beside the study's, as PNG."
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
    checked = _check_people(layout, seed=seed, count=count, workers=workers) if people else []
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
            _print_people(checked)

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
        checked = _verify(request, tree.root, len(tree.recordings), engine_for(request.workers))
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
            _print_checks(checked, missed)
        print(f"recordings: {tree.root} (the truth is in {tree.root / 'truth'}; readers never open it)")

    return _Written(
        show,
        folder=tree.root,
        recordings=_recordings(tree, with_objects=True),
        checks=tuple(_check(name, result) for name, result in checked),
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
    from prbench.synthetic.write_tree import planned_recordings
    from prbench.workflows.synthetic_table import LARGE_RECORDINGS, Staging, build_synthetic_table

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


def _verify(request: _Request, root: Path, recordings: int, engine: Engine) -> list[tuple[str, Verification]]:
    """Compare curation with the truth, for the files just written and at each noise level for the same seed."""
    from prbench.workflows.verify_synthetic import LEVELS, verify_level, verify_tree

    with progress("comparing curation with the truth") as tell:
        checked = [("these files", verify_tree(root, dataset=request.layout, engine=engine))]
        for done, level in enumerate(LEVELS, start=1):
            tell(done, len(LEVELS), level.name)
            result = verify_level(
                level,
                preset=request.layout,
                recordings=max(recordings, _FEWEST_VERIFIED),
                seed=request.seed,
                engine=engine,
            )
            checked.append((level.name, result))
    return checked


def _check(sensors: str, result: Verification) -> SensorCheck:
    low, _, high = result.prime_quantiles
    return SensorCheck(
        sensors=sensors,
        recordings=result.recordings,
        events=result.true_events,
        recall=result.recall,
        precision=result.precision,
        timing_bias=result.timing.bias,
        timing_median=result.timing.median,
        timing_p95=result.timing.p95,
        priming_recall=result.priming_recall,
        unprimed=result.unprimed,
        false_primes=result.false_primes,
        prime_median=result.prime.median,
        prime_p5=low,
        prime_p95=high,
        hands=FoundHands(right=result.hands.right, wrong=result.hands.wrong, unknown=result.hands.unknown),
        expected_sequences=result.expected_sequences,
        missed_sequences=len(result.missed_sequences),
    )


def _print_checks(checked: list[tuple[str, Verification]], missed: tuple[str, ...]) -> None:
    print_table(
        "what curation finds, against what was acted out",
        (
            "sensors", "recordings", "events", "recall", "precision", "timing bias", "median", "p95", "priming recall",
            "false primes", "prime median", "p5 … p95", "hands", "sequences",
        ),
        [_check_row(name, result) for name, result in checked],
        numbers=range(1, 14),
    )  # fmt: skip
    print("times in ms; events within the sensors' resolution of a threshold and lost tracks are not counted")
    print("hands: right / wrong / unknown of all located events; sequences: found of those that were acted out")
    for text in missed:
        print(f"no sequence in these files: {text}")


def _check_row(name: str, result: Verification) -> tuple[str, ...]:
    low, _, high = result.prime_quantiles
    return (
        name,
        str(result.recordings),
        str(result.true_events),
        f"{result.recall:.3f}",
        f"{result.precision:.3f}",
        f"{result.timing.bias * 1e3:+.0f}",
        f"{result.timing.median * 1e3:.0f}",
        f"{result.timing.p95 * 1e3:.0f}",
        f"{result.priming_recall:.3f}",
        f"{result.false_primes:.3f} of {result.unprimed}",
        f"{result.prime.median * 1e3:.0f}",
        f"{low * 1e3:+.0f} … {high * 1e3:+.0f}",
        f"{result.hands.right} / {result.hands.wrong} / {result.hands.unknown}",
        f"{result.expected_sequences - len(result.missed_sequences)} of {result.expected_sequences}",
    )


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


def _check_people(layout: str | None, *, seed: int, count: int | None, workers: int) -> list[PeopleCheck]:
    """Measure the people of the preset that was named, or of all presets."""
    import math

    from prbench.engine import engine_for
    from prbench.synthetic.people import PRESETS
    from prbench.workflows.synthetic_people import people_numbers

    presets = tuple(PRESETS) if layout is None else (layout,)
    checked: list[PeopleCheck] = []
    with progress("acting out people") as tell:
        for done, preset in enumerate(presets):
            tell(done, len(presets), preset)
            numbers = people_numbers(
                preset, recordings=count or _RECORDINGS_OF_PEOPLE, seed=seed, engine=engine_for(workers)
            )
            checked += [
                PeopleCheck(
                    preset=preset,
                    number=each.name,
                    acted=None if math.isnan(each.acted) else each.acted,
                    recorded=each.recorded,
                    low=each.range.low if math.isfinite(each.range.low) else None,
                    high=each.range.high if math.isfinite(each.range.high) else None,
                    holds=each.holds,
                    source=each.range.source,
                )
                for each in numbers
            ]
    return checked


def _print_people(checked: list[PeopleCheck]) -> None:
    print_table(
        "how synthetic people act and move",
        ("preset", "number", "acted out", "recorded", "range", "", "why"),
        [_people_row(each) for each in checked],
        numbers=(2, 3),
    )
    print(
        "of bodies the worst sequence; metres, seconds, degrees (docs/specification/synthetic-recordings.md#behaviour)"
    )


def _people_row(each: PeopleCheck) -> tuple[str, ...]:
    low = "" if each.low is None else f"{each.low:.4g}"
    high = "" if each.high is None else f"{each.high:.4g}"
    return (
        each.preset,
        each.number,
        "" if each.acted is None else f"{each.acted:.3g}",
        "" if each.recorded is None else f"{each.recorded:.3g}",
        f"{low} … {high}",
        "" if each.holds else "OUTSIDE",
        each.source,
    )
