"""The reports of the commands that build tables, their plan, and their remarks on recordings left out.

``prbench build-dataset``: native recordings into a table.

``prbench split-dataset``: a table split anew, by participants.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import msgspec

from prbench.cli.commands import Answer, command, note, progress
from prbench.cli.options import (
    OUT_FILE,
    PATH,
    MadeShard,
    chosen_shard,
    engine_options,
    on_error_option,
    opened,
    out_folder_option,
    protocol_option,
    reader_options,
    recordings_options,
    replace_option,
    root_option,
    shard_answer,
    shard_option,
)
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.curation import BuildPlan, BuildReport
    from prbench.curation.options import BuildOptions
    from prbench.curation.provenance import FunnelRow
    from prbench.engine import Engine
    from prbench.engine.choice import EngineChoice
    from prbench.engine.shards import Shard
    from prbench.readers.discover import BrokenDataset
    from prbench.sequences import Recording
    from prbench.sequences.corpus import CorpusRecord
    from prbench.sequences.shard_parts import ShardReport


NOT_EVERYTHING = 3
"""Exit code of a command that finished, but had to leave out something that could not be read."""
_SKIPPED_SHOWN = 10
"""Known-bad recordings that a printed plan names."""


class BuiltRecording(msgspec.Struct, frozen=True, kw_only=True):
    """One recording of a built table.

    Attributes:
        recording: Its id.
        status: ``read``, ``failed`` or ``skipped``.
        message: What the reader said about it; empty if there is nothing to say.
        outcomes: Number of its events (in a corpus: of its texts) by what became of them.
        cut_short: One message for each of its streams that ends early, so that events may be missing.
    """

    recording: str
    status: str
    message: str
    outcomes: dict[str, int]
    cut_short: list[str]


class BuiltTable(msgspec.Struct, frozen=True, kw_only=True):
    """One table that was written.

    Attributes:
        dataset: Name of the dataset; ``synthetic-`` stands before that of synthetic people.
        title: Its title.
        folder: The table.
        counts: How much of everything it holds, as in its ``dataset.json`` or ``corpus.json``.
        stages: From files to sequences, or to clips.
        recordings: Every recording that was found, also those that could not be read.
        taken_over: Number of recordings that an interrupted build had already finished.
    """

    dataset: str
    title: str
    folder: Path
    counts: dict[str, int]
    stages: list[FunnelRow]
    recordings: list[BuiltRecording]
    taken_over: int


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
    recordings: list[str]
    skipped: list[str]
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

    built: list[BuiltTable]
    not_built: list[BrokenDataset]
    planned: list[Plan]
    shard: MadeShard | None = None
    proposed: list[ProposedPick] = []


def planned(plan: BuildPlan | Any, workers: int, *, dataset: str, root: Path | None) -> Plan:
    """Put the plan of one dataset into its documented shape.

    Args:
        plan: What would be read; a corpus' plan has the same fields.
        workers: Processes to use.
        dataset: Name of the dataset.
        root: Its folder.
    """
    return Plan(
        dataset=dataset,
        root=root,
        recordings=list(plan.recordings),
        skipped=list(plan.skipped),
        input_bytes=plan.input_bytes,
        workers=workers,
        estimated_seconds=plan.estimated_seconds / workers,
        estimated_disk_bytes=plan.estimated_disk_bytes,
    )


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


def made_shard(report: ShardReport[Any], *, made_of: int) -> MadeShard:
    """Put the report of one shard of a build into its documented shape.

    Args:
        report: Of the shard.
        made_of: Number of its items.
    """
    return MadeShard(
        shard=str(report.shard),
        folder=report.folder,
        made_of=made_of,
        planned=report.planned,
        taken_over=report.reused,
    )


def built_table(report: BuildReport | Any, stages: Iterable[FunnelRow]) -> BuiltTable:
    """Put the report of one build into its documented shape.

    Args:
        report: Of the build; a corpus' report has the same fields.
        stages: From its files to its rows.
    """
    return BuiltTable(
        dataset=report.info.dataset,
        title=report.info.title,
        folder=report.folder,
        counts=msgspec.to_builtins(report.info.counts),
        stages=list(stages),
        recordings=[_built_recording(record) for record in report.records],
        taken_over=report.reused,
    )


def _built_recording(record: Recording | CorpusRecord) -> BuiltRecording:
    return BuiltRecording(
        recording=record.recording_id,
        status=record.status,
        message=record.message,
        outcomes=dict(record.outcomes),
        cut_short=list(getattr(record, "shortfalls", ())),
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
@root_option()
@out_folder_option("Folder of the table; an earlier one is replaced once the new one is ready, if that lacks nothing.")
@replace_option()
@recordings_options
@click.option("--dry-run", is_flag=True, help="Say what would be read, and write nothing.")
@click.option(
    "--propose-events",
    type=OUT_FILE,
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
@protocol_option("every number of the curation, stamped into the table (docs/protocol-choices.md).")
@on_error_option()
@click.option(
    "--poses",
    metavar="SOURCE",
    help="Where bodies come from, for example egoallo in place of ADT's suit; short for --option poses=SOURCE.",
)
@reader_options()
@engine_options()
@shard_option("the dataset's recordings")
def build_dataset(
    *,
    dataset: str,
    root: Path,
    out: Path | None,
    replace: bool,
    recordings: str,
    max_recordings: int | None,
    dry_run: bool,
    propose_events: Path | None,
    in_hand: str | None,
    ray_origin: str | None,
    priming: Literal["rule", "published"],
    occlusion: Literal["off", "mark", "require"],
    minimum_movement: str,
    minimum_prime: float | None,
    protocol: Path | None,
    on_error: Literal["skip", "fail"],
    poses: str | None,
    options: tuple[tuple[str, str], ...],
    engine: EngineChoice,
    shard: str | None,
) -> Answer:
    """Turn a dataset's recordings into a table of prime-and-reach sequences.

    DATASET is its name, for example adt (`prbench datasets` lists them), or 'all' for whatever lies below --root.
    """
    from prbench.curation.options import BuildOptions, CurationOptions, mesh_options
    from prbench.protocol.own_protocol import read_protocol

    part = chosen_shard(shard, replace=replace, dry_run=dry_run, everything=dataset == EVERYTHING)
    named = None if dataset == EVERYTHING else dataset
    source = mesh_options(named, in_hand=in_hand, occlusion=occlusion) | dict(options)
    if poses is not None:
        source["poses"] = poses
    chosen = BuildOptions(
        curation=CurationOptions(
            in_hand=in_hand,
            ray_origin=ray_origin,
            minimum_movement=minimum_movement,
            priming=priming,
            occlusion=occlusion,
            minimum_prime=minimum_prime,
        ),
        protocol=read_protocol(protocol) if protocol is not None else None,
        recordings=recordings,
        limit=max_recordings,
        reader=tuple(sorted(source.items())),
        on_error=on_error,
        replace=replace,
    )
    if propose_events is not None:
        return _propose(dataset, root, propose_events, source, opened(engine, reads=(root,)))
    if dry_run:
        return _plan(dataset, root, chosen, engine if isinstance(engine, int) else 1)
    if out is None:
        from prbench.errors import UsageError

        raise UsageError("--out DIR is needed: the folder of the table. (--dry-run and --propose-events do without.)")
    where = opened(engine, reads=(root,), writes=(out,), packages=chosen.packages)
    if part is not None:
        return _build_shard(dataset, root, out, part, chosen, where)
    if dataset == EVERYTHING:
        return _build_all(root, out, chosen, where)
    return _build_one(dataset, root, out, chosen, where)


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

    report = BuildsReport(built=[], not_built=[], planned=[], proposed=proposed)
    return Answer(report, show_proposals, NOT_EVERYTHING if unread else 0)


def _plan(dataset: str, root: Path, options: BuildOptions, workers: int) -> Answer:
    """Say what would be read, of one dataset or of all that are found."""
    if dataset == EVERYTHING:
        from prbench.curation.build_all import plan_all

        plans = [planned(plan, workers, dataset=name, root=place) for name, place, plan in plan_all(root, options)]
    else:
        from prbench.curation import plan_build

        plans = [planned(plan_build(dataset, root, options), workers, dataset=dataset, root=root)]

    def show() -> None:
        for plan in plans:
            if dataset == EVERYTHING:
                print(f"{plan.dataset} in {plan.root}:")
            print_plan(plan, unfit="bad")

    return Answer(BuildsReport(built=[], not_built=[], planned=plans), show)


def _build_one(dataset: str, root: Path, out: Path, options: BuildOptions, engine: Engine) -> Answer:
    from prbench.curation import build_dataset as build

    with progress(f"building {dataset}") as tell:
        report = build(
            dataset,
            root,
            out,
            options=options,
            engine=engine,
            progress=lambda step: tell(step.done, step.total, step.record.recording_id),
        )
    return table_answer(report)


def _build_shard(dataset: str, root: Path, out: Path, shard: Shard, options: BuildOptions, engine: Engine) -> Answer:
    from prbench.curation.build import build_dataset_shard

    with progress(f"building shard {shard} of {dataset}") as tell:
        report = build_dataset_shard(
            dataset,
            root,
            out,
            shard,
            options=options,
            engine=engine,
            progress=lambda step: tell(step.done, step.total, step.record.recording_id),
        )
    note_recordings(report.records, reused=report.reused)
    made = made_shard(report, made_of=len(report.records))
    complete = all(record.status != "failed" and not record.shortfalls for record in report.records)
    answer = BuildsReport(built=[], not_built=[], planned=[], shard=made)
    return shard_answer(answer, made, unit="recordings", exit_code=0 if complete else NOT_EVERYTHING)


def table_answer(report: BuildReport) -> Answer:
    """Answer a command that has written one table."""
    table = _built(report)
    counts = report.info.counts
    complete = not counts.recordings_failed and not counts.recordings_cut_short
    return Answer(
        BuildsReport(built=[table], not_built=[], planned=[]),
        lambda: _print_table(table),
        0 if complete else NOT_EVERYTHING,
    )


def _build_all(root: Path, out: Path, options: BuildOptions, engine: Engine) -> Answer:
    from prbench.curation.build_all import build_all
    from prbench.readers.discover import BrokenDataset

    with progress("building") as tell:
        outcomes = build_all(
            root,
            out,
            options=options,
            engine=engine,
            progress=lambda name, step: tell(step.done, step.total, f"{name} {step.record.recording_id}"),
        )
    built = [_built(outcome.report) for outcome in outcomes if outcome.report is not None]
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
    return Answer(BuildsReport(built=built, not_built=not_built, planned=[]), show, 0 if complete else NOT_EVERYTHING)


def _built(report: BuildReport) -> BuiltTable:
    """Report one table, and note what of its recordings is missing from it."""
    from prbench.curation.provenance import funnel_rows

    note_recordings(report.records, reused=report.reused)
    return built_table(report, funnel_rows(report.info))


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
@click.argument("data", type=PATH, metavar="DIR")
@click.option("--split", type=click.Choice(["participants"]), default="participants", help="What is kept together.")
@click.option("--fold", required=True, metavar="K/N", help="The fold to test on, such as 2/6.")
@out_folder_option("Folder of the new table; the old one stays as it is.", required=True)
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
