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

_CORPUS_LAYOUTS = ("nymeria", "humanml3d")
"""Layouts of text and motion, which stand with their corpora."""
_CORPUS_RECORDINGS = 4
"""Recordings of such a layout if no number is named."""


class SynthesizeReport(msgspec.Struct, kw_only=True):
    """The recordings that were written.

    Attributes:
        folder: The native files; null if none were asked for.
        recordings: The recordings in them.
        check: What curation finds in these files; null with ``--no-verify``, ``--defect`` and text-motion layouts.
            Numbers without a sample are null.
        table: The table, with ``--table``.
    """

    folder: Path | None = None
    recordings: tuple[WrittenRecording, ...] = ()
    check: Verification | None = None
    table: BuiltTable | None = None


@command(
    "synthesize",
    example="prbench synthesize adt --count 4 --seed 1 --out synthetic/adt",
    report=SynthesizeReport,
)
@click.argument("layout")
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
@opt.workers_option()
def synthesize(
    *,
    layout: str,
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
    workers: int,
) -> Answer:
    """Write synthetic recordings in a dataset's native layout, with the truth beside them.

    LAYOUT is the native layout to write: any dataset of `prbench datasets`.
    """
    report = SynthesizeReport()
    if out is None:
        raise UsageError(f"--out DIR is needed: the folder of the {'table' if table else 'recordings'}.")
    if table:
        if defects or egoallo or bystander_objects is not None:
            raise UsageError("--table writes no native files; leave --defect, --egoallo and --bystander-objects out.")
        _write_table(report, layout, out, size, count, seed=seed, events=events, replace=replace, workers=workers)
    else:
        asked: dict[str, Any] = {"recordings": count, "seed": seed, "workers": workers, "defects": defects}
        native = {"size": size, "n_events": events, "bystander_objects": bystander_objects, "estimates": egoallo}
        tree = _write_tree(layout, out, asked, native)
        report.folder = tree.root
        report.recordings = tree.recordings
        if not (no_verify or defects or layout in _CORPUS_LAYOUTS):
            from prbench.checking.verify_synthetic import verify_tree
            from prbench.engine import engine_for

            with progress("comparing curation with the truth"):
                report.check = verify_tree(tree.root, dataset=layout, engine=engine_for(workers))
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


def _print(report: SynthesizeReport, layout: str) -> None:
    if report.recordings:
        of_corpus = layout in _CORPUS_LAYOUTS
        counted = ("texts",) if of_corpus else ("events", "objects")
        rows = []
        for each in report.recordings:
            counts = (each.n_events,) if of_corpus else (each.n_events, each.n_objects)
            rows.append((each.recording_id, each.split, f"{each.duration:.1f}", *map(str, counts)))
        print_table("synthetic recordings", ("recording", "split", "seconds", *counted), rows, numbers=(2, 3, 4))
        if report.check is not None:
            _print_check(report.check)
        then = f"the truth is in {report.folder}/truth; readers never open it"
        if of_corpus:
            then = f"build them with `prbench build-corpus {layout} --root {report.folder}`"
        print(f"recordings: {report.folder} ({then})")
    if report.table is not None:
        found = f"{report.table.counts['sequences']} sequences of {len(report.table.recordings)} recordings"
        print(f"table: {report.table.folder} ({found})")


def _print_check(found: Verification) -> None:
    """Print how curation compares with the truth, and the sequences that were missed."""
    rows = (
        ("recall of events", f"{found.recall:.3f} of {found.true_events}"),
        ("precision of events", f"{found.precision:.3f}"),
        ("timing of events, median", f"{found.timing.median * 1e3:.0f} ms"),
        ("priming recall", f"{found.priming_recall:.3f}"),
        ("false primes", f"{found.false_primes:.3f}"),
        ("timing of primes, median", f"{found.prime.median * 1e3:.0f} ms"),
        ("hands right, wrong, unknown", " / ".join(map(str, found.hands.values()))),
        ("sequences", f"{found.expected_sequences - len(found.missed_sequences)} of {found.expected_sequences}"),
    )
    print_table("what curation finds, against what was acted out", ("", "found"), rows)
    print("events within the sensors' resolution of a threshold and lost tracks are not counted")
    for line in found.missed_sequences:
        print(f"no sequence in these files: {line}")
