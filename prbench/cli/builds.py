"""The reports of the commands that build tables, their plan, and their remarks on recordings left out.

``prbench build-dataset``: native recordings into a table.

``prbench split-dataset``: a table split anew, by participants.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, note, progress
from prbench.cli.terminal import print_table
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.curation import BuildPlan, BuildReport
    from prbench.curation.job import FunnelRow
    from prbench.curation.options import BuildOptions
    from prbench.engine import Engine
    from prbench.engine.choice import EngineChoice
    from prbench.readers.discover import BrokenDataset
    from prbench.sequences import Recording
    from prbench.sequences.corpus import CorpusRecord
    from prbench.sequences.parts import ShardReport


NOT_EVERYTHING = 3
"""Exit code of a command that finished, but had to leave out something that could not be read."""
_SKIPPED_SHOWN = 10
"""Known-bad recordings that a printed plan names."""


class BuiltTable(msgspec.Struct, frozen=True, kw_only=True):
    """One table that was written.

    Attributes:
        dataset: Name of the dataset; ``synthetic-`` stands before that of synthetic people.
        title: Its title.
        folder: The table.
        counts: How much of everything it holds, as in its ``dataset.json`` or ``corpus.json``.
        stages: From files to sequences, or to clips.
        recordings: Of a table of sequences: every recording that was found, also those that could not be read.
        corpus_recordings: Of a corpus: likewise.
        taken_over: Number of recordings that an interrupted build had already finished.
    """

    dataset: str
    title: str
    folder: Path
    counts: dict[str, int]
    stages: list[FunnelRow]
    taken_over: int
    recordings: tuple[Recording, ...] = ()
    corpus_recordings: tuple[CorpusRecord, ...] = ()


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """The recordings that a build would read, from ``--dry-run``.

    Attributes:
        dataset: Name of the dataset.
        root: The folder that would be read; null for a synthetic corpus.
        recordings: Names of the recordings.
        skipped: Those among them that are known to be bad and would be skipped.
        input_bytes: Size of the files to read, in bytes.
        workers: Processes for which the time is estimated.
        estimated_seconds: Time that the build would take, in seconds.
        estimated_disk_bytes: Space that the build would need, in bytes.
    """

    dataset: str
    root: Path | None
    recordings: tuple[str, ...]
    skipped: tuple[str, ...]
    input_bytes: int
    workers: int
    estimated_seconds: float
    estimated_disk_bytes: int


class ProposedPick(msgspec.Struct, frozen=True, kw_only=True):
    """The proposal for one segment of a recording.

    Attributes:
        recording: Its id.
        time: When the object is picked up, in seconds on the recording's clock; null without a proposal.
        hand: ``left`` or ``right``; null without a proposal.
        confidence: From 0 to 1; it ranks proposals and is no probability; null without a proposal.
        reason: What speaks for the proposal, or why there is none; it stands in the file, too.
        problem: Why the segment could not be read; empty for those that were.
    """

    recording: str
    time: float | None
    hand: str | None
    confidence: float | None
    reason: str
    problem: str


class BuildsReport(msgspec.Struct, frozen=True, kw_only=True):
    """The work of a command that builds tables, done or planned.

    Attributes:
        built: One entry for each table that was written.
        not_built: Datasets that were found and gave no table; only of ``build-dataset all``.
        planned: One entry for each table that would be written, with ``--dry-run``.
        shard: The shard that was made, with ``--shard``; else null.
        proposed: One entry for each segment, with ``--propose-events``.
    """

    built: list[BuiltTable] = []
    not_built: list[BrokenDataset] = []
    planned: list[Plan] = []
    shard: opt.MadeShard | None = None
    proposed: list[ProposedPick] = []


def planned(plan: BuildPlan, workers: int, *, dataset: str, root: Path | None) -> Plan:
    """Return a plan with its place, and with the time that it takes so many workers."""
    shared: dict[str, Any] = vars(plan) | {"estimated_seconds": plan.estimated_seconds / workers}
    return Plan(dataset=dataset, root=root, workers=workers, **shared)


def print_plan(plan: Plan, *, unfit: str) -> None:
    """Say what would be read, what is known to be ``unfit``, and about what it takes."""
    print(f"{len(plan.recordings)} recordings, {plan.input_bytes / 1e6:,.1f} MB to read")
    if plan.skipped:
        shown = ", ".join(plan.skipped[:_SKIPPED_SHOWN]) + (" …" if len(plan.skipped) > _SKIPPED_SHOWN else "")
        print(f"{len(plan.skipped)} of them are known to be {unfit} and would be skipped: {shown}")
    seconds = plan.estimated_seconds
    duration = f"{seconds:,.0f} s" if seconds < 120 else f"{seconds / 60:,.0f} minutes"
    print(
        f"estimated: {duration} with {plan.workers} worker{'s' if plan.workers > 1 else ''},"
        f" {plan.estimated_disk_bytes / 1e6:,.1f} MB on disk"
    )


def built_table(report: BuildReport[Any, Any], stages: Iterable[FunnelRow], **records: Any) -> BuiltTable:
    """Return the report of one build with the stages from its files to its rows, and its recordings."""
    return BuiltTable(
        dataset=report.info.dataset,
        title=report.info.title,
        folder=report.folder,
        counts=msgspec.to_builtins(report.info.counts),
        stages=list(stages),
        taken_over=report.reused,
        **records,
    )


def print_stages(title: str, stages: Iterable[FunnelRow]) -> None:
    """Print how much of the files each stage left."""
    rows = [(each.stage, str(each.kept), str(each.dropped or ""), each.reason) for each in stages]
    print_table(title, ("stage", "kept", "dropped", "why"), rows, numbers=(1, 2))


def note_unread(records: Iterable[Recording | CorpusRecord], *, reused: int) -> None:
    """Name the recordings that are not in the result, and why."""
    if reused:
        note(f"{reused} recordings were taken over from an interrupted build.")
    for record in records:
        if record.status != "read":
            note(f"{record.status}: {record.recording_id}: {record.message}")


def note_recordings(records: Iterable[Recording], *, reused: int) -> None:
    """Name the recordings that are missing from a table, cut short, so that events may be missing, or without sequence.

    What a reader remarks of a recording without sequences is seldom the cause, so the outcomes of its events are told.
    """
    records = list(records)
    note_unread(records, reused=reused)
    for record in records:
        for shortfall in record.shortfalls:
            note(f"cut short: {record.recording_id}: {shortfall}")
    for record in records:
        if record.status == "read" and not record.outcomes.get("sequence"):
            note(f"no sequence: {record.recording_id}: {record.why_fruitless}")


EVERYTHING = "all"
"""Stands in place of a dataset's name for whatever is found."""


@command(
    "build-dataset",
    example="prbench build-dataset adt --root /data/ADT --out tables/adt --workers 4",
    resumes=True,
    report=BuildsReport,
)
@click.argument("dataset")
@opt.root_option()
@opt.out_folder_option(
    "Folder of the table; an earlier one is replaced once the new one is ready, if that lacks nothing."
)
@opt.replace_option()
@opt.recordings_options
@click.option("--dry-run", is_flag=True, help="Say what would be read, and write nothing.")
@click.option(
    "--propose-events",
    type=opt.OUT_FILE,
    metavar="FILE",
    help="Write picks for a person to confirm into this new CSV file, and no table (gimo: docs/gimo-events.md).",
)
@click.option("--in-hand", metavar="RULE", help="Another in-hand rule of the manifest, for example wrist.")
@click.option("--ray-origin", type=click.Choice(["eye", "camera"]), help="Where gaze rays start (default: eye).")
@click.option(
    "--priming",
    type=click.Choice(["rule", "published"]),
    default="rule",
    help="Prime times by the equations (default), or taken over from the dataset where it publishes them (hd-epic).",
)
@click.option(
    "--occlusion",
    type=click.Choice(["off", "mark", "require"]),
    default="off",
    help="Where a dataset has meshes: mark events primed through one, or let unobstructed looks alone prime"
    " (needs the extra open3d).",
)
@click.option(
    "--minimum-movement",
    default="wrist_to_goal",
    metavar="MEASURE",
    help="What must be at least 20 cm: wrist_to_goal (default), pelvis or object displacement.",
)
@click.option(
    "--minimum-prime",
    type=float,
    metavar="SECONDS",
    help="How long a look must last to prime (default 0: a single gaze sample primes, as in the study).",
)
@opt.protocol_option("every number of the curation, stamped into the table (docs/protocol-choices.md).")
@opt.on_error_option()
@click.option(
    "--poses",
    metavar="SOURCE",
    help="Where bodies come from, for example egoallo in place of ADT's suit; short for --option poses=SOURCE.",
)
@opt.reader_options()
@opt.engine_options()
@opt.shard_option("the dataset's recordings")
def build_dataset(
    *,
    dataset: str,
    root: Path,
    out: Path | None,
    dry_run: bool,
    propose_events: Path | None,
    protocol: Path | None,
    poses: str | None,
    options: tuple[tuple[str, str], ...],
    engine: EngineChoice,
    shard: str | None,
    **given: Any,
) -> Answer:
    """Turn a dataset's recordings into a table of prime-and-reach sequences.

    DATASET is its name, for example adt (`prbench datasets` lists them), or 'all' for whatever lies below --root.
    """
    from prbench.curation.options import BuildOptions, CurationOptions, mesh_options
    from prbench.protocol.own_protocol import read_protocol

    part = opt.chosen_shard(shard, replace=given["replace"], dry_run=dry_run, everything=dataset == EVERYTHING)
    named = None if dataset == EVERYTHING else dataset
    source = mesh_options(named, in_hand=given["in_hand"], occlusion=given["occlusion"]) | dict(options)
    if poses is not None:
        source["poses"] = poses
    chosen = BuildOptions(
        curation=CurationOptions(**{each.name: given[each.name] for each in fields(CurationOptions)}),
        protocol=read_protocol(protocol) if protocol is not None else None,
        recordings=given["recordings"],
        limit=given["max_recordings"],
        reader=tuple(sorted(source.items())),
        on_error=given["on_error"],
        replace=given["replace"],
    )
    if propose_events is not None:
        return _propose(dataset, root, propose_events, source, opt.opened(engine, reads=(root,)))
    if dry_run:
        return _plan(dataset, root, chosen, engine if isinstance(engine, int) else 1)
    if out is None:
        raise UsageError("--out DIR is needed: the folder of the table. (--dry-run and --propose-events do without.)")
    where = opt.opened(engine, reads=(root,), writes=(out,), packages=chosen.packages)
    if dataset == EVERYTHING:
        return _build_all(root, out, chosen, where)
    with progress(f"building {f'shard {part} of ' if part else ''}{dataset}") as tell:
        more = {
            "options": chosen,
            "engine": where,
            "progress": lambda step: tell(step.done, step.total, step.record.recording_id),
        }
        if part is None:
            from prbench.curation import build_dataset as build

            return table_answer(build(dataset, root, out, **more))
        from prbench.curation.build import build_dataset_shard

        report = build_dataset_shard(dataset, root, out, part, **more)
    note_recordings(report.records, reused=report.reused)
    complete = all(record.status != "failed" and not record.shortfalls for record in report.records)
    return shard_answer(report, len(report.records), unit="recordings", complete=complete)


def made_shard(report: ShardReport[Any], made_of: int) -> opt.MadeShard:
    """Return the report of one shard of a build that is made of so many items."""
    return opt.MadeShard(
        shard=str(report.shard), folder=report.folder, made_of=made_of, planned=report.planned, taken_over=report.reused
    )


def shard_answer(report: ShardReport[Any], made_of: int, *, unit: str, complete: bool) -> Answer:
    """Answer a command that has made one shard of a build."""
    made = made_shard(report, made_of)
    return opt.shard_answer(BuildsReport(shard=made), made, unit=unit, exit_code=0 if complete else NOT_EVERYTHING)


def _propose(dataset: str, root: Path, out: Path, options: dict[str, str], engine: Engine) -> Answer:
    """Propose pick events where a dataset has none, for a person to confirm."""
    from prbench.curation.propose_events import write_candidates

    with progress(f"looking for reaches in {dataset}") as show:
        proposals = write_candidates(dataset, root, out, options=options, engine=engine, progress=show)
    proposed = []
    for proposal in proposals:
        found = proposal.candidate
        pick = ProposedPick(
            recording=proposal.line.recording_id,
            time=None if found is None else float(found.time),
            hand=None if found is None else found.hand,
            confidence=None if found is None else float(found.confidence),
            reason=str(proposal.row()["reason"]),
            problem=proposal.problem,
        )
        proposed.append(pick)
        if pick.problem:
            note(f"{pick.recording}: {pick.problem}")
    unread = sum(bool(pick.problem) for pick in proposed)

    def show_proposals() -> None:
        found = sum(pick.time is not None for pick in proposed)
        print(f"{found} proposals for {len(proposed)} segments, {unread} not read")
        print(f"look at the videos, write yes or no into the column 'confirmed', and build with it: {out}")

    report = BuildsReport(proposed=proposed)
    return Answer(report, show_proposals, NOT_EVERYTHING if unread else 0)


def _plan(dataset: str, root: Path, options: BuildOptions, workers: int) -> Answer:
    """Say what would be read, of one dataset or of all that are found."""
    if dataset == EVERYTHING:
        from prbench.curation.build import plan_all

        plans = [planned(plan, workers, dataset=name, root=place) for name, place, plan in plan_all(root, options)]
    else:
        from prbench.curation import plan_build

        plans = [planned(plan_build(dataset, root, options), workers, dataset=dataset, root=root)]

    def show() -> None:
        for plan in plans:
            if dataset == EVERYTHING:
                print(f"{plan.dataset} in {plan.root}:")
            print_plan(plan, unfit="bad")

    return Answer(BuildsReport(planned=plans), show)


def table_answer(report: BuildReport) -> Answer:
    """Answer a command that has written one table."""
    from prbench.curation.job import funnel_rows

    note_recordings(report.records, reused=report.reused)
    table = built_table(report, funnel_rows(report.info), recordings=report.records)
    counts = report.info.counts
    complete = not counts.recordings_failed and not counts.recordings_cut_short
    return Answer(
        BuildsReport(built=[table]),
        lambda: _print_table(table),
        0 if complete else NOT_EVERYTHING,
    )


def _build_all(root: Path, out: Path, options: BuildOptions, engine: Engine) -> Answer:
    from prbench.curation.build import build_all
    from prbench.readers.discover import BrokenDataset

    with progress("building") as tell:
        outcomes = build_all(
            root,
            out,
            options=options,
            engine=engine,
            progress=lambda name, step: tell(step.done, step.total, f"{name} {step.record.recording_id}"),
        )
    built = [table_answer(outcome.report).report.built[0] for outcome in outcomes if outcome.report is not None]
    not_built = [
        BrokenDataset(outcome.dataset, outcome.root, outcome.message) for outcome in outcomes if outcome.report is None
    ]
    rows = []
    for each in outcomes:
        sizes = ["–"] * 3
        if each.report is not None:
            counts = each.report.info.counts
            not_read = counts.recordings_failed + counts.recordings_skipped
            sizes = [str(count) for count in (counts.recordings_read, not_read, counts.sequences)]
        rows.append((each.dataset, *sizes, each.message))

    def show() -> None:
        for table in built:
            _print_table(table)
        print_table("datasets", ("dataset", "recordings", "not read", "sequences", "problem"), rows, numbers=(1, 2, 3))

    complete = all(outcome.complete for outcome in outcomes)
    return Answer(BuildsReport(built=built, not_built=not_built), show, 0 if complete else NOT_EVERYTHING)


def _print_table(table: BuiltTable) -> None:
    print_stages(f"{table.title}: from files to sequences", table.stages)
    print(f"table: {table.folder}")


class SplitReport(msgspec.Struct, frozen=True, kw_only=True):
    """A table that was split anew.

    Attributes:
        out: Its folder.
        dataset: Name of the dataset.
        fold: The fold that is tested on, from 1.
        folds: Number of folds.
        tested: Participants of the split ``test``.
        sequences: Maps the splits to their numbers of sequences.
    """

    out: Path
    dataset: str
    fold: int
    folds: int
    tested: list[str]
    sequences: dict[str, int]


@command(
    "split-dataset",
    example="prbench split-dataset tables/mogaze --split participants --fold 2/6 --out tables/mogaze-2",
    report=SplitReport,
)
@click.argument("data", type=opt.PATH, metavar="DIR")
@click.option("--split", type=click.Choice(["participants"]), default="participants", help="What is kept together.")
@click.option("--fold", required=True, metavar="K/N", help="The fold to test on, such as 2/6.")
@opt.out_folder_option("Folder of the new table; the old one stays as it is.", required=True)
def split_dataset(data: Path, split: str, fold: str, out: Path) -> Answer:
    """Write a copy of a table in which nobody is both learnt from and tested on.

    One run on each fold, put together by `prbench merge`, scores every sequence once.
    """
    from prbench.sequences import SequenceTable
    from prbench.sequences.folds import parse_fold, participant_folds, write_fold

    del split  # the only one so far
    number, count = parse_fold(fold)
    table = SequenceTable.open(data).with_sequences()
    write_fold(table, out, fold=number, folds=count)
    rows = SequenceTable.open(out).scalars()["split"].to_pylist()
    report = SplitReport(
        out=out,
        dataset=table.info.dataset,
        fold=number,
        folds=count,
        tested=sorted(name for name, place in participant_folds(table, count).items() if place == number),
        sequences={name: rows.count(name) for name in ("train", "validation", "test")},
    )
    return Answer(report, lambda: _print(report))


def _print(report: SplitReport) -> None:
    counts = ", ".join(f"{name} {number}" for name, number in report.sequences.items())
    print(f"{report.dataset}, fold {report.fold}/{report.folds}: {counts}")
    print(f"tested on: {', '.join(report.tested)}")
    print(f"table: {report.out}")
