"""Options of the commands that read recordings, their plan, and what they say of recordings left out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING

from prbench.cli.arguments import key_value, positive

if TYPE_CHECKING:
    from prbench.corpora import CorpusPlan
    from prbench.curation import BuildPlan
    from prbench.sequences import RecordingRecord
    from prbench.sequences.corpus import CorpusRecord

NOT_EVERYTHING = 3
"""Exit code of a command that finished, but had to leave out something that could not be read."""


def add_on_error(parser: argparse.ArgumentParser, *, what: str = "a recording", them: str = "it") -> None:
    """Add ``--on-error skip|fail``."""
    parser.add_argument(
        "--on-error",
        choices=["skip", "fail"],
        default="skip",
        help=f"go on without {what} that cannot be read and name {them} (default), or fail at once",
    )


def add_replace(parser: argparse.ArgumentParser, *, what: str = "table") -> None:
    """Add ``--replace``, which loses what an earlier result holds."""
    parser.add_argument(
        "--replace",
        action="store_true",
        help=f"replace an earlier {what} even where the new one lacks recordings that it holds (refused by default)",
    )


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """Add ``--limit N`` recordings; where sequences are counted, see :func:`prbench.cli.arguments.add_limit`."""
    parser.add_argument("--limit", type=positive, metavar="N", help="at most N recordings: the first by name")


def add_reader_options(
    parser: argparse.ArgumentParser, *, whose: str = "dataset's", remark: str = "a wrong name lists them"
) -> None:
    """Add ``--option NAME=VALUE``, repeatable."""
    parser.add_argument(
        "--option",
        type=key_value,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help=f"an option of the {whose} reader; repeatable ({remark})",
    )


def print_plan(plan: BuildPlan | CorpusPlan, workers: int, *, unfit: str) -> None:
    """Say what would be read, what is known to be ``unfit``, and about what it takes."""
    print(f"{len(plan.recordings)} recordings, {plan.input_bytes / 1e6:,.1f} MB to read")
    if plan.skipped:
        shown = ", ".join(plan.skipped[:10]) + (" …" if len(plan.skipped) > 10 else "")
        print(f"{len(plan.skipped)} of them are known to be {unfit} and would be skipped: {shown}")
    seconds = plan.estimated_seconds / workers
    duration = f"{seconds:,.0f} s" if seconds < 120 else f"{seconds / 60:,.0f} minutes"
    print(
        f"estimated: {duration} with {workers} worker{'s' if workers > 1 else ''},"
        f" {plan.estimated_disk_bytes / 1e6:,.1f} MB on disk"
    )


def print_unread(records: Iterable[RecordingRecord | CorpusRecord], *, reused: int) -> None:
    """Name the recordings that are not in the result, and why."""
    if reused:
        print(f"{reused} recordings were taken over from an interrupted build.", file=sys.stderr)
    for record in records:
        if record.status != "read":
            print(f"{record.status}: {record.recording_id}: {record.message}", file=sys.stderr)


def print_cut_short(records: Iterable[RecordingRecord]) -> None:
    """Name the recordings of which a stream ends early: events may be missing, and nothing else would tell."""
    for record in records:
        for shortfall in record.shortfalls:
            print(f"cut short: {record.recording_id}: {shortfall}", file=sys.stderr)


def print_fruitless(records: Iterable[RecordingRecord]) -> None:
    """Name the recordings that were read and gave no sequence, and why; what a reader remarks is seldom the cause."""
    for record in records:
        if record.status == "read" and not record.outcomes.get("sequence"):
            print(f"no sequence: {record.recording_id}: {_why_fruitless(record)}", file=sys.stderr)


def _why_fruitless(record: RecordingRecord) -> str:
    """Name the outcomes of its events, the most frequent first, and what the recording lacks."""
    outcomes = sorted(record.outcomes.items(), key=lambda item: (-item[1], item[0]))
    became = ", ".join(f"{number} {outcome}" for outcome, number in outcomes if number)
    events = f"of {sum(record.outcomes.values())} events {became}" if became else "no candidate event"
    return "; ".join((events, *record.lacks))
