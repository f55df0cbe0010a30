"""``prbench diff``: what changed between two builds, and why."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import command
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.curation.differences import Difference

SHOWN = 40
_DIFFERENT = 1
"""Exit code when the builds hold different events or sequences, as that of ``diff``."""


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "diff",
        summary="say which events and sequences differ between two builds of a dataset, and which stage decided",
        example="prbench diff tables/adt tables/adt-wrist --csv changes.csv",
        execute=_diff,
    )
    parser.add_argument("first", type=Path, metavar="BUILD_A", help="built dataset folder")
    parser.add_argument("second", type=Path, metavar="BUILD_B", help="the one to compare it with")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write every change as a line of CSV")
    parser.add_argument("--all", action="store_true", help=f"print every change, not only the first {SHOWN}")


def _diff(arguments: argparse.Namespace) -> int:
    from prbench.curation.differences import KINDS, compare_builds

    difference = compare_builds(arguments.first, arguments.second)
    if difference.settings:
        print_table("what the builds were made with", ("", "first", "second"), difference.settings)
    counts = Counter(change.kind for change in difference.changes)
    rows = [(kind, str(counts[kind]), meaning) for kind, meaning in KINDS.items() if counts[kind]]
    if rows:
        print_table("changes", ("kind", "events", "meaning"), rows, numbers=(1,))
        _print_changes(difference, everything=arguments.all)
    print(f"unchanged: {difference.unchanged_events} events, {difference.unchanged_sequences} of them sequences")
    if arguments.csv is not None:
        _write_csv(difference, arguments.csv)
        print(f"changes: {arguments.csv}")
    return 0 if difference.equal else _DIFFERENT


def _print_changes(difference: Difference, *, everything: bool) -> None:
    shown = difference.changes if everything else difference.changes[:SHOWN]
    print_table(
        "events",
        ("kind", "recording", "event", "first", "second", "decided by"),
        [(c.kind, c.recording_id, c.event, c.before or "–", c.after or "–", c.decided_by) for c in shown],
    )
    if len(shown) < len(difference.changes):
        print(f"… and {len(difference.changes) - len(shown)} more: --all or --csv FILE")


def _write_csv(difference: Difference, path: Path) -> None:
    import csv

    from prbench.locks import sole_file
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
