"""``prbench diff``: what changed between two builds, and why."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from prbench.cli.commands import Answer, command
from prbench.cli.options import OUT_FILE, PATH
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.curation.differences import Difference

SHOWN = 40
_COLUMNS = ("kind", "recording_id", "event", "first", "second", "decided_by")


@command(
    "diff",
    example="prbench diff tables/adt tables/adt-wrist --csv changes.csv",
    report="prbench.curation.differences:Difference",
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
        from prbench.files.locks import sole_file
        from prbench.tables import csv_lines

        with sole_file(csv) as temporary:
            temporary.write_text(csv_lines(_COLUMNS, map(vars, difference.changes)), encoding="utf-8", newline="\n")

    def show() -> None:
        _print(difference, everything=everything)
        if csv is not None:
            print(f"changes: {csv}")

    return Answer(difference, show, 0 if difference.equal else 1)


def _print(difference: Difference, *, everything: bool) -> None:
    from prbench.curation.differences import KINDS

    if difference.settings:
        print_table("what the builds were made with", ("", "first", "second"), difference.settings)
    changes = difference.changes
    counts = Counter(change.kind for change in changes)
    if changes:
        rows = [(kind, str(counts[kind]), meaning) for kind, meaning in KINDS.items() if kind in counts]
        print_table("changes", ("kind", "events", "meaning"), rows, numbers=(1,))
        shown = changes if everything else changes[:SHOWN]
        print_table(
            "events",
            ("kind", "recording", "event", "first", "second", "decided by"),
            [(c.kind, c.recording_id, c.event, c.first or "–", c.second or "–", c.decided_by) for c in shown],
        )
        if len(shown) < len(changes):
            print(f"… and {len(changes) - len(shown)} more: --all or --csv FILE")
    print(f"unchanged: {difference.unchanged_events} events, {difference.unchanged_sequences} of them sequences")
