"""The reports of the commands that build tables, their plan, and their remarks on recordings left out."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from prbench.cli.commands import note
from prbench.cli.shards import MadeShard
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.corpora import CorpusPlan, CorpusReport
    from prbench.curation import BuildPlan, BuildReport
    from prbench.curation.provenance import FunnelRow
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


def planned(plan: BuildPlan | CorpusPlan, workers: int, *, dataset: str, root: Path | None) -> Plan:
    """Put the plan of one dataset into its documented shape.

    Args:
        plan: What would be read.
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


def built_table(report: BuildReport | CorpusReport, stages: Iterable[FunnelRow]) -> BuiltTable:
    """Put the report of one build into its documented shape.

    Args:
        report: Of the build.
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
