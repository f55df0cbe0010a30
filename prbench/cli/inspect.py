"""``prbench inspect``: what is this folder, and is it all there?"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import command
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.workflows.inspection import InspectedRecording

SHOWN = 30
_NOT_COMPLETE = 3
"""Exit code when something is missing, damaged, cut short or unreadable."""


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "inspect",
        summary="say what a folder holds, and which recordings are complete, cut short, incomplete or damaged",
        example="prbench inspect /data",
        execute=_inspect,
    )
    parser.add_argument("root", type=Path, metavar="ROOT", help="a dataset's folder, or one that holds several")
    parser.add_argument("--thorough", action="store_true", help="read every recording as a build would; takes as long")
    parser.add_argument("--all", action="store_true", help="list complete recordings too, and every incomplete one")


def _inspect(arguments: argparse.Namespace) -> int:
    from prbench.workflows.inspection import inspect_folder

    with progress("inspecting") as show:
        inspection = inspect_folder(arguments.root, thorough=arguments.thorough, progress=show)
    for dataset in inspection.datasets:
        size = sum(recording.size for recording in dataset.recordings)
        print(f"{dataset.root}: {dataset.title} ({dataset.name}), {_counted(dataset.recordings)}, {size / 1e6:,.1f} MB")
        listed = [r for r in dataset.recordings if arguments.all or r.state != "complete" or r.remarks]
        shown = listed if arguments.all else listed[:SHOWN]
        if shown:
            rows = [(r.recording_id, r.state, f"{r.size / 1e6:,.1f}", "; ".join(r.remarks)) for r in shown]
            print_table(dataset.name, ("recording", "state", "MB", "what"), rows, numbers=(2,))
        if len(shown) < len(listed):
            print(f"… and {len(listed) - len(shown)} more: --all")
    for broken in inspection.broken:
        print(f"{broken.root}: looks like {broken.dataset}, but: {broken.message}")
    return 0 if inspection.all_complete else _NOT_COMPLETE


def _counted(recordings: Sequence[InspectedRecording]) -> str:
    counts = Counter(recording.state for recording in recordings)
    parts = ", ".join(f"{count} {state}" for state, count in sorted(counts.items()))
    return f"{len(recordings)} recording{'s' if len(recordings) != 1 else ''} ({parts})"
