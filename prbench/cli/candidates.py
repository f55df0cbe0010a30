"""``prbench candidates``: propose events for a person to confirm."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.builds import NOT_EVERYTHING
from prbench.cli.commands import Answer, command, note
from prbench.cli.options import out_file_option, reader_options, root_option, workers_option
from prbench.cli.progress import progress

if TYPE_CHECKING:
    from prbench.workflows.candidates import Proposal


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


class CandidatesReport(msgspec.Struct, frozen=True, kw_only=True):
    """The proposals that were written.

    Attributes:
        file: The CSV file, in which a person confirms lines.
        segments: One entry for each segment.
    """

    file: Path
    segments: list[ProposedPick]


@command(
    "candidates",
    example="prbench candidates gimo --root /data/GIMO --out candidates.csv",
    report=CandidatesReport,
)
@click.argument("dataset")
@root_option()
@out_file_option("New CSV file; never overwritten.", required=True)
@reader_options()
@workers_option()
def candidates(*, dataset: str, root: Path, out: Path, options: tuple[tuple[str, str], ...], workers: int) -> Answer:
    """Propose pick events where a dataset has none, for a person to confirm.

    DATASET is one whose events are annotated by hand, such as gimo.
    """
    from prbench.engine import engine_for
    from prbench.workflows.candidates import write_candidates

    with progress(f"looking for reaches in {dataset}") as show:
        proposals = write_candidates(
            dataset, root, out, options=dict(options), engine=engine_for(workers), progress=show
        )
    for proposal in proposals:
        if proposal.problem:
            note(f"{proposal.line.recording_id}: {proposal.problem}")
    report = CandidatesReport(file=out, segments=[_proposed(proposal) for proposal in proposals])
    unread = sum(bool(each.problem) for each in report.segments)
    return Answer(report, lambda: _print(report, unread=unread), NOT_EVERYTHING if unread else 0)


def _proposed(proposal: Proposal) -> ProposedPick:
    found = proposal.candidate
    return ProposedPick(
        recording=proposal.line.recording_id,
        time=None if found is None else float(found.time),
        hand=None if found is None else found.hand,
        confidence=None if found is None else float(found.confidence),
        reason=str(proposal.row()["reason"]),
        problem=proposal.problem,
    )


def _print(report: CandidatesReport, *, unread: int) -> None:
    proposed = sum(each.time is not None for each in report.segments)
    print(f"{proposed} proposals for {len(report.segments)} segments, {unread} not read")
    print(f"look at the videos, write yes or no into the column 'confirmed', and build with it: {report.file}")
