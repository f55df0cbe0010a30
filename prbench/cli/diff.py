"""``prbench diff``: what changed between two builds, and why."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import OUT_FILE, PATH
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.curation.differences import Difference

SHOWN = 40
_DIFFERENT = 1
"""Exit code when the builds hold different events or sequences, as that of ``diff``."""


class SettingDifference(msgspec.Struct, frozen=True, kw_only=True):
    """A setting in which two builds differ.

    Attributes:
        name: Name of the entry of ``dataset.json``.
        first: Its value in the first build.
        second: Its value in the second build.
    """

    name: str
    first: str
    second: str


class EventChange(msgspec.Struct, frozen=True, kw_only=True):
    """One event that is not the same in both builds.

    Attributes:
        kind: ``gained``, ``lost``, ``appeared``, ``vanished``, ``moved``, ``outcome`` or ``values``.
        recording_id: Id of the recording.
        event: Name of the object, action and time; empty for a change of the recording itself.
        first: Outcome in the first build; empty where it has no such event.
        second: Outcome in the second build; empty where it has no such event.
        decided_by: The stage that made the difference, with its number and threshold where it has them.
    """

    kind: str
    recording_id: str
    event: str
    first: str
    second: str
    decided_by: str


class DiffReport(msgspec.Struct, frozen=True, kw_only=True):
    """Two builds of a dataset, compared event by event.

    Attributes:
        equal: Whether both hold the same events, sequences and recordings; then the exit code is 0, else 1.
        settings: Settings in which the builds differ.
        counts: Number of changes of each kind.
        changes: All changes, sorted by kind, recording and time.
        unchanged_events: Number of events that are the same in both.
        unchanged_sequences: Number of sequences among them.
        csv: The file of all changes, if one was asked for.
    """

    equal: bool
    settings: list[SettingDifference]
    counts: dict[str, int]
    changes: list[EventChange]
    unchanged_events: int
    unchanged_sequences: int
    csv: Path | None


@command(
    "diff",
    example="prbench diff tables/adt tables/adt-wrist --csv changes.csv",
    report=DiffReport,
    writes_report=True,
)
@click.argument("first", type=PATH, metavar="BUILD_A")
@click.argument("second", type=PATH, metavar="BUILD_B")
@click.option("--csv", type=OUT_FILE, metavar="FILE", help="Write every change as a line of CSV.")
@click.option("--all", "everything", is_flag=True, help=f"Print every change, not only the first {SHOWN}.")
def diff(first: Path, second: Path, csv: Path | None, everything: bool) -> Answer:
    """Say which events and sequences differ between two builds of a dataset, and which stage decided.

    BUILD_A and BUILD_B are built dataset folders. The exit code is 1 where they differ.
    """
    from prbench.curation.differences import compare_builds

    difference = compare_builds(first, second)
    if csv is not None:
        _write_csv(difference, csv)
    report = _report(difference, csv)
    return Answer(report, lambda: _print(report, everything=everything), 0 if report.equal else _DIFFERENT)


def _report(difference: Difference, csv: Path | None) -> DiffReport:
    return DiffReport(
        equal=difference.equal,
        settings=[SettingDifference(name=name, first=a, second=b) for name, a, b in difference.settings],
        counts=dict(Counter(change.kind for change in difference.changes)),
        changes=[
            EventChange(
                kind=change.kind,
                recording_id=change.recording_id,
                event=change.event,
                first=change.before,
                second=change.after,
                decided_by=change.decided_by,
            )
            for change in difference.changes
        ],
        unchanged_events=difference.unchanged_events,
        unchanged_sequences=difference.unchanged_sequences,
        csv=csv,
    )


def _print(report: DiffReport, *, everything: bool) -> None:
    from prbench.curation.differences import KINDS

    if report.settings:
        settings = [(each.name, each.first, each.second) for each in report.settings]
        print_table("what the builds were made with", ("", "first", "second"), settings)
    rows = [(kind, str(report.counts[kind]), meaning) for kind, meaning in KINDS.items() if kind in report.counts]
    if rows:
        print_table("changes", ("kind", "events", "meaning"), rows, numbers=(1,))
        _print_changes(report.changes, everything=everything)
    print(f"unchanged: {report.unchanged_events} events, {report.unchanged_sequences} of them sequences")
    if report.csv is not None:
        print(f"changes: {report.csv}")


def _print_changes(changes: list[EventChange], *, everything: bool) -> None:
    shown = changes if everything else changes[:SHOWN]
    print_table(
        "events",
        ("kind", "recording", "event", "first", "second", "decided by"),
        [(c.kind, c.recording_id, c.event, c.first or "–", c.second or "–", c.decided_by) for c in shown],
    )
    if len(shown) < len(changes):
        print(f"… and {len(changes) - len(shown)} more: --all or --csv FILE")


def _write_csv(difference: Difference, path: Path) -> None:
    import csv

    from prbench.files.locks import sole_file
    from prbench.shown import csv_text

    with sole_file(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("kind", "recording_id", "event", "first", "second", "decided_by"))
        for change in difference.changes:
            cells = (
                change.kind,
                change.recording_id,
                change.event,
                change.before,
                change.after,
                change.decided_by,
            )
            writer.writerow([csv_text(cell) for cell in cells])
