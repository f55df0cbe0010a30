"""``prbench synthesize``: synthetic recordings in a dataset's native files, with the truth beside them."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.builds import BuiltTable, built_table
from prbench.cli.commands import Answer, command, progress
from prbench.cli.terminal import print_table
from prbench.entry_points import CORPORA, load_built_in
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.checking.verify_synthetic import Verification
    from prbench.synthetic.write_tree import WrittenRecording, WrittenTree

_SCENES_OF_ONE_PRESET = 12
_FEWEST_VERIFIED = 4
"""Recordings on which each noise level is verified at least."""
_FILES = "these files"
_CORPUS_LAYOUTS = ("nymeria", "humanml3d")
"""Layouts of text and motion, which stand with their corpora."""
_CORPUS_RECORDINGS = 4
"""Recordings of such a layout if no number is named."""


class SynthesizeReport(msgspec.Struct, kw_only=True):
    """The recordings and pictures that were written.

    Attributes:
        folder: The native files; null if none were asked for.
        recordings: The recordings in them.
        checks: What curation finds in these files (``these files``) and at each level of noise, by its name; empty with
            ``--no-verify``, ``--defect`` and text-motion layouts. Numbers without a sample are null.
        table: The table, with ``--table``.
        gallery: The picture of sequences, if one was asked for.
    """

    folder: Path | None = None
    recordings: tuple[WrittenRecording, ...] = ()
    checks: dict[str, Verification] = {}
    table: BuiltTable | None = None
    gallery: Path | None = None


@command(
    "synthesize",
    example="prbench synthesize adt --count 4 --seed 1 --out synthetic/adt",
    report=SynthesizeReport,
)
@click.argument("layout", required=False)
@opt.out_folder_option("Folder of the recordings.")
@click.option(
    "--table",
    is_flag=True,
    help="Write the finished table of sequences instead of native files (the only way for size large).",
)
@opt.replace_option()
@opt.count_option("Number of recordings to make (default: the size's number).")
@opt.seed_option("of everything")
@click.option(
    "--size", type=click.Choice(["tiny", "default", "large"]), default="tiny", help="How much (default tiny)."
)
@click.option("--events", type=opt.POSITIVE, metavar="N", help="Picks and puts of each recording.")
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
    "--gallery",
    type=opt.OUT_FILE,
    metavar="FILE",
    help="Draw sequences of LAYOUT, or of all presets without one, as PNG.",
)
@opt.workers_option()
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
    workers: int,
) -> Answer:
    """Write synthetic recordings in a dataset's native layout, with the truth beside them.

    LAYOUT is the native layout to write: any dataset of `prbench datasets`. For --gallery alone it is any preset.
    """
    report = SynthesizeReport(gallery=gallery)
    if layout is None and gallery is None:
        raise UsageError("name a layout to write (for example: prbench synthesize adt --out DIR) or --gallery FILE.")
    if layout is not None and (out is not None or gallery is None):
        if out is None:
            raise UsageError(f"--out DIR is needed: the folder of the {'table' if table else 'recordings'}.")
        if table:
            if defects or egoallo or bystander_objects is not None:
                raise UsageError(
                    "--table writes no native files; leave --defect, --egoallo and --bystander-objects out."
                )
            _write_table(report, layout, out, size, count, seed=seed, events=events, replace=replace, workers=workers)
        else:
            asked: dict[str, Any] = {"recordings": count, "seed": seed, "workers": workers, "defects": defects}
            native = {"size": size, "n_events": events, "bystander_objects": bystander_objects, "estimates": egoallo}
            tree = _write_tree(layout, out, asked, native)
            report.folder = tree.root
            report.recordings = tree.recordings
            if not (no_verify or defects or layout in _CORPUS_LAYOUTS):
                report.checks = _compare_with_truth(tree, layout, seed, workers)
    if gallery is not None:
        # Draw twelve sequences of all presets, or of the one that was named.
        from prbench.synthetic.people import perform
        from prbench.viewing.gallery import (
            render_contact_sheet,
            render_gallery,
            render_strips,
            sequences_of,
            strips_of_activities,
        )

        if layout in _CORPUS_LAYOUTS:
            render_strips(strips_of_activities(seed), gallery)
        elif layout is None:
            render_contact_sheet(gallery, seed=seed)
        else:
            performances = [perform(layout, seed=seed, index=index, n_events=6) for index in range(4)]
            render_gallery(sequences_of(performances)[:_SCENES_OF_ONE_PRESET], gallery)
    return Answer(report, lambda: _print(report, layout))


def _write_tree(layout: str, out: Path, asked: dict[str, Any], native: dict[str, Any]) -> WrittenTree:
    """Write synthetic people in the layout of a dataset, or of text and motion, which has no ``native`` options."""
    from prbench.synthetic.write_tree import planned_recordings, synthesize_tree

    done = itertools.count(1)
    if layout in _CORPUS_LAYOUTS:
        planned = asked["recordings"] or _CORPUS_RECORDINGS
    else:
        planned = planned_recordings(native["size"], asked["recordings"])
    with progress(f"writing {layout}") as tell:

        def tell_written(written: WrittenRecording) -> None:
            tell(next(done), planned, written.recording_id)

        if layout in _CORPUS_LAYOUTS:
            write = load_built_in(CORPORA, "synthesize")
            return write(layout, out, **{**asked, "recordings": planned}, on_written=tell_written)
        return synthesize_tree(layout, out, **asked, **native, on_written=tell_written)


def _compare_with_truth(tree: WrittenTree, layout: str, seed: int, workers: int) -> dict[str, Verification]:
    """Compare curation with the truth, for written files and at each noise level for the same seed."""
    from prbench.checking.verify_synthetic import LEVELS, verify_level, verify_tree
    from prbench.engine import engine_for

    engine = engine_for(workers)
    recordings = max(len(tree.recordings), _FEWEST_VERIFIED)
    with progress("comparing curation with the truth") as tell:
        checked = {_FILES: verify_tree(tree.root, dataset=layout, engine=engine)}
        for done, level in enumerate(LEVELS, start=1):
            tell(done, len(LEVELS), level.name)
            checked[level.name] = verify_level(level, preset=layout, recordings=recordings, seed=seed, engine=engine)
    return checked


def _write_table(
    report: SynthesizeReport,
    layout: str,
    out: Path,
    size: str,
    count: int | None,
    *,
    seed: int,
    events: int | None,
    replace: bool,
    workers: int,
) -> None:
    """Act out, sense and curate recordings in memory: training data without native files."""
    from prbench.curation import BuildOptions
    from prbench.curation.job import funnel_rows
    from prbench.engine import engine_for
    from prbench.harness.synthetic_table import LARGE_RECORDINGS, Staging, build_synthetic_table
    from prbench.synthetic.write_tree import planned_recordings

    large = size == "large"
    recordings = count or (LARGE_RECORDINGS if large else planned_recordings(size, None))
    with progress(f"acting out {layout}") as tell:
        made = build_synthetic_table(
            layout,
            recordings,
            seed,
            out,
            engine=engine_for(workers),
            world="large" if large else "default",
            n_events=Staging.n_events if events is None else events,
            options=BuildOptions(replace=replace),
            progress=tell,
        )
    report.table = built_table(made, funnel_rows(made.info), recordings=made.records)


def _print(report: SynthesizeReport, layout: str | None) -> None:
    if report.recordings:
        of_corpus = layout in _CORPUS_LAYOUTS
        counted = ("texts",) if of_corpus else ("events", "objects")
        rows = []
        for each in report.recordings:
            counts = (each.n_events,) if of_corpus else (each.n_events, each.n_objects)
            rows.append((each.recording_id, each.split, f"{each.duration:.1f}", *map(str, counts)))
        print_table("synthetic recordings", ("recording", "split", "seconds", *counted), rows, numbers=(2, 3, 4))
        if report.checks:
            _print_checks(report.checks)
        then = f"the truth is in {report.folder}/truth; readers never open it"
        if of_corpus:
            then = f"build them with `prbench build-corpus {layout} --root {report.folder}`"
        print(f"recordings: {report.folder} ({then})")
    if report.table is not None:
        found = f"{report.table.counts['sequences']} sequences of {len(report.table.recordings)} recordings"
        print(f"table: {report.table.folder} ({found})")
    if report.gallery is not None:
        print(f"gallery: {report.gallery}")


def _print_checks(checks: dict[str, Verification]) -> None:
    """Print a row for each kind of sensors, and the sequences that were missed in the files."""
    rows = []
    for name, found in checks.items():
        low, _, high = found.prime_quantiles
        cells = (
            f"{found.recall:.3f}",
            f"{found.precision:.3f}",
            f"{found.timing.bias * 1e3:+.0f}",
            f"{found.timing.median * 1e3:.0f}",
            f"{found.timing.p95 * 1e3:.0f}",
            f"{found.priming_recall:.3f}",
            f"{found.false_primes:.3f} of {found.unprimed}",
            f"{found.prime.median * 1e3:.0f}",
            f"{low * 1e3:+.0f} … {high * 1e3:+.0f}",
            f"{found.hands.right} / {found.hands.wrong} / {found.hands.unknown}",
            f"{found.expected_sequences - len(found.missed_sequences)} of {found.expected_sequences}",
        )
        rows.append((name, str(found.recordings), str(found.true_events), *cells))
    print_table(
        "what curation finds, against what was acted out",
        (
            "sensors", "recordings", "events", "recall", "precision", "timing bias", "median", "p95", "priming recall",
            "false primes", "prime median", "p5 … p95", "hands", "sequences",
        ),
        rows,
        numbers=range(1, 14),
    )  # fmt: skip
    print("times in ms; events within the sensors' resolution of a threshold and lost tracks are not counted")
    print("hands: right / wrong / unknown of all located events; sequences: found of those that were acted out")
    for miss in checks[_FILES].missed_sequences:
        print(f"no sequence in these files: {miss.text}")
