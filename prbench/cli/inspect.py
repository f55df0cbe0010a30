"""``prbench inspect``: what is this folder, and is it all there?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command
from prbench.cli.options import NATIVE
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.checking.inspection import Inspection

_SHOWN = 30
"""Recordings of a dataset that are listed without ``--all``."""
_NOT_COMPLETE = 3
"""Exit code when something is missing, damaged, cut short or unreadable."""


class RecordingState(msgspec.Struct, frozen=True, kw_only=True):
    """One recording, and what is wrong with it.

    Attributes:
        recording: Its id.
        state: ``complete``, ``cut short``, ``incomplete``, ``damaged``, ``left out`` or ``unreadable``.
        size: Size of all files that reading it depends on, in bytes.
        remarks: Missing and damaged files, streams that end early, or what reading said.
    """

    recording: str
    state: str
    size: int
    remarks: list[str]


class InspectedCopy(msgspec.Struct, frozen=True, kw_only=True):
    """One dataset below the folder.

    Attributes:
        dataset: Name of the dataset; ``synthetic-`` stands before that of synthetic people.
        title: Its title.
        root: Its folder.
        recordings: All of its recordings.
    """

    dataset: str
    title: str
    root: Path
    recordings: list[RecordingState]


class UnlistedFolder(msgspec.Struct, frozen=True, kw_only=True):
    """One folder that a reader recognises as its own and cannot list.

    Attributes:
        dataset: Name of the dataset that it looks like.
        root: The folder.
        message: What is wrong.
    """

    dataset: str
    root: Path
    message: str


class InspectReport(msgspec.Struct, frozen=True, kw_only=True):
    """The content of a folder.

    Attributes:
        datasets: Datasets that were found.
        broken: Folders that look like a dataset and cannot be listed.
        all_complete: Whether nothing is missing, damaged, cut short or unreadable, apart from what is left out.
    """

    datasets: list[InspectedCopy]
    broken: list[UnlistedFolder]
    all_complete: bool


@command("inspect", example="prbench inspect /data", report=InspectReport, writes_report=True)
@click.argument("root", type=NATIVE)
@click.option("--thorough", is_flag=True, help="Read every recording as a build would; takes as long.")
@click.option("--all", "everything", is_flag=True, help="List complete recordings too, and every incomplete one.")
def inspect(*, root: Path, thorough: bool, everything: bool) -> Answer:
    """Say what a folder holds, and which recordings are complete, cut short, incomplete or damaged.

    ROOT is a dataset's folder, or one that holds several.
    """
    from prbench.checking.inspection import inspect_folder

    with progress("inspecting") as show:
        report = _report(inspect_folder(root, thorough=thorough, progress=show))
    return Answer(report, lambda: _print(report, everything=everything), 0 if report.all_complete else _NOT_COMPLETE)


def _report(inspection: Inspection) -> InspectReport:
    datasets = []
    for dataset in inspection.datasets:
        recordings = [
            RecordingState(
                recording=each.recording_id, state=each.state, size=int(each.size), remarks=list(each.remarks)
            )
            for each in dataset.recordings
        ]
        datasets.append(
            InspectedCopy(dataset=dataset.name, title=dataset.title, root=dataset.root, recordings=recordings)
        )
    return InspectReport(
        datasets=datasets,
        broken=[
            UnlistedFolder(dataset=each.dataset, root=each.root, message=each.message) for each in inspection.broken
        ],
        all_complete=inspection.all_complete,
    )


def _print(report: InspectReport, *, everything: bool) -> None:
    for dataset in report.datasets:
        size = sum(each.size for each in dataset.recordings)
        counted = _counted(dataset.recordings)
        print(f"{dataset.root}: {dataset.title} ({dataset.dataset}), {counted}, {size / 1e6:,.1f} MB")
        listed = [each for each in dataset.recordings if everything or each.state != "complete" or each.remarks]
        shown = listed if everything else listed[:_SHOWN]
        if shown:
            rows = [(each.recording, each.state, f"{each.size / 1e6:,.1f}", "; ".join(each.remarks)) for each in shown]
            print_table(dataset.dataset, ("recording", "state", "MB", "what"), rows, numbers=(2,))
        if len(shown) < len(listed):
            print(f"… and {len(listed) - len(shown)} more: --all")
    for broken in report.broken:
        print(f"{broken.root}: looks like {broken.dataset}, but: {broken.message}")


def _counted(recordings: Sequence[RecordingState]) -> str:
    counts = Counter(recording.state for recording in recordings)
    parts = ", ".join(f"{count} {state}" for state, count in sorted(counts.items()))
    return f"{len(recordings)} recording{'s' if len(recordings) != 1 else ''} ({parts})"
