"""``prbench inspect``: what is this folder, and is it all there?"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from prbench.cli.commands import Answer, command
from prbench.cli.options import NATIVE
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.checking.inspection import InspectedDataset, InspectedTable

_SHOWN = 30
"""Recordings of a dataset that are listed without ``--all``."""
_NOT_COMPLETE = 3
"""Exit code when something is missing, damaged, cut short or unreadable."""


@command(
    "inspect",
    example="prbench inspect /data tables/adt",
    report="prbench.checking.inspection:Inspection",
    writes_report=True,
)
@click.argument("places", type=NATIVE, nargs=-1, required=True, metavar="DIR...")
@click.option("--thorough", is_flag=True, help="Read every recording as a build would; takes as long.")
@click.option("--all", "everything", is_flag=True, help="List complete recordings too, and every incomplete one.")
def inspect(*, places: tuple[Path, ...], thorough: bool, everything: bool) -> Answer:
    """Say what folders hold, and which recordings are complete, cut short, incomplete or damaged.

    DIR is a dataset's folder, one that holds several, or a built table, of which sizes and means are printed; `prbench
    study table-1` prints those beside the study's.
    """
    from prbench.checking.inspection import inspect_folders

    with progress("inspecting") as show:
        found = inspect_folders(places, thorough=thorough, progress=show)

    def show_all() -> None:
        for dataset in found.datasets:
            _print_dataset(dataset, everything=everything)
        for broken in found.broken:
            print(f"{broken.root}: looks like {broken.dataset}, but: {broken.message}")
        if found.tables:
            _print_tables(found.tables)

    return Answer(found, show_all, 0 if found.all_complete else _NOT_COMPLETE)


def _print_dataset(dataset: InspectedDataset, *, everything: bool) -> None:
    recordings = dataset.recordings
    size = sum(each.size for each in recordings)
    states = Counter(recording.state for recording in recordings)
    counted = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
    plural = "s" if len(recordings) != 1 else ""
    print(f"{dataset.root}: {dataset.title} ({dataset.name}), {len(recordings)} recording{plural} ({counted}),"
          f" {size / 1e6:,.1f} MB")  # fmt: skip
    listed = [each for each in recordings if everything or each.state != "complete" or each.remarks]
    shown = listed if everything else listed[:_SHOWN]
    if shown:
        rows = [(each.recording_id, each.state, f"{each.size / 1e6:,.1f}", "; ".join(each.remarks)) for each in shown]
        print_table(dataset.name, ("recording", "state", "MB", "what"), rows, numbers=(2,))
    if len(shown) < len(listed):
        print(f"… and {len(listed) - len(shown)} more: --all")


def _print_tables(tables: tuple[InspectedTable, ...]) -> None:
    rows = []
    for table in tables:
        means = [f"{each.mean:.2f} ± {each.sd:.2f}" if table.sequences else "–" for each in table.quantities.values()]
        counts = [str(number) for number in (table.sequences, *table.by_split.values())]
        rows.append((table.dataset, *counts, *means, ", ".join(table.pose_sources)))
    print_table(
        "prime-and-reach sequences (mean ± standard deviation over sequences)",
        (
            "dataset", "sequences", "train", "validation", "test", "duration s", "prime gap s", "body m", "hand m",
            "body",
        ),
        rows,
        numbers=range(1, 9),
    )  # fmt: skip
    for table in tables:
        if table.participants_in_two_splits:
            print(
                f"{table.dataset}: {table.participants_in_two_splits} participants have sequences in both train and"
                " test; the protocol splits by recording, as the study does."
            )
        for remark in table.remarks:
            print(f"{table.dataset}: {remark}")
