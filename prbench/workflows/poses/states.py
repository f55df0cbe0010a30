"""Find out which recordings have a body from EgoAllo, and which lack one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

from prbench.errors import InputFileError, PrbenchError, UsageError
from prbench.manifests import load_manifest
from prbench.readers import SYNTHETIC_PREFIX, AriaGlasses, RecordingFiles, reader_for
from prbench.readers.discover import discover, usable_readers
from prbench.readers.egoallo.inputs import EgoalloInputs
from prbench.readers.egoallo.places import OUTPUT_ROLE, poses_folder
from prbench.workflows.poses.coverage import coverage
from prbench.workflows.poses.prepare import head_poses, source_trajectory

State = Literal["complete", "partial", "refused", "missing", "unreadable", "skipped"]


@dataclass(frozen=True)
class PoseState:
    """One recording and what there is of its body."""

    found: RecordingFiles
    state: State
    """Outputs that are whole, cover a part, or are of another recording or damaged; none; no trajectory to make any
    from; or a recording that is known to be bad."""
    message: str
    """Details for the user."""
    target: Path
    """The folder in which readers look for outputs."""
    inputs: EgoalloInputs | None
    """The inputs; None where there is no trajectory to start from."""

    @property
    def lacking(self) -> bool:
        """Return True if a body is still to be made."""
        return self.state in ("partial", "refused", "missing", "unreadable")


@dataclass(frozen=True)
class Selection:
    """The choice of recordings."""

    dataset: str | None = None
    """A dataset of Aria glasses; found out from the folder if None."""
    recordings: str = "*"
    """Pattern of names."""
    limit: int | None = None
    poses_root: Path | None = None
    """Folder of outputs by recording; ``root/egoallo`` if None."""


EVERYTHING = Selection()


def pose_states(root: Path, selection: Selection = EVERYTHING) -> Iterator[PoseState]:
    """Look at the recordings below a folder, one by one.

    Raises:
        InputFileError: if there are none.
        UsageError: for a dataset that is none of Aria glasses, or a folder of several.
    """
    root = root.expanduser().resolve()
    for found in select(root, selection):
        yield _pose_state(root, found, selection.poses_root)


def select(root: Path, selection: Selection) -> tuple[RecordingFiles, ...]:
    """The recordings that are meant, with their outputs among their files (see :func:`pose_states`)."""
    datasets = _datasets_of_aria_glasses()
    dataset = selection.dataset or _dataset_at(root, datasets)
    if dataset not in datasets:
        raise UsageError(
            f"EgoAllo needs Aria glasses: --dataset must be one of {', '.join(datasets)}, not '{dataset}'."
        )
    options = {"poses": "egoallo"}
    if selection.poses_root is not None:
        options["poses_root"] = str(selection.poses_root)
    found = reader_for(dataset, options).find(root)
    chosen = [each for each in found if fnmatchcase(each.recording_id, selection.recordings)]
    if not chosen:
        raise UsageError(f"no recording matches '{selection.recordings}'; there are {len(found)} others.")
    return tuple(chosen[: selection.limit])


def _pose_state(root: Path, found: RecordingFiles, poses_root: Path | None = None) -> PoseState:
    """Look at one recording's outputs and inputs."""
    outputs = [file.path for file in found.files if file.role.startswith(OUTPUT_ROLE)]
    target = outputs[0].parent if outputs else poses_folder(root, found.recording_id, poses_root)
    manifest = load_manifest(found.dataset.removeprefix(SYNTHETIC_PREFIX))
    bad = found.skip_reason or manifest.why_bad(found.recording_id)
    if bad:
        return PoseState(found, "skipped", bad, target, None)
    try:
        inputs = _reader(found.dataset).egoallo_inputs(root, found)
        if not outputs:
            return PoseState(found, "missing", "no outputs", target, inputs)
        cpf = head_poses(inputs, source_trajectory(inputs))
    except InputFileError as error:
        return PoseState(found, "unreadable", str(error), target, None)
    try:
        covered = coverage(outputs, cpf)
    except InputFileError as error:
        return PoseState(found, "refused", str(error), target, inputs)
    state: State = "complete" if covered.complete else "partial"
    return PoseState(found, state, f"{len(outputs)} outputs cover {covered}", target, inputs)


def _reader(dataset: str) -> AriaGlasses:
    reader = reader_for(dataset)
    assert isinstance(reader, AriaGlasses), "select() takes recordings of such datasets alone"
    return reader


def _datasets_of_aria_glasses() -> tuple[str, ...]:
    """Datasets from which EgoAllo can estimate bodies."""
    return tuple(reader.dataset for reader in usable_readers()[0] if isinstance(reader, AriaGlasses))


def _dataset_at(root: Path, datasets: tuple[str, ...]) -> str:
    try:
        found = sorted({each.dataset for each in discover(root).found if each.root == root} & set(datasets))
    except PrbenchError as error:
        raise UsageError(f"{error} Name the dataset with --dataset.") from error
    if len(found) != 1:
        held = " and ".join(found) or "no dataset of Aria glasses"
        raise UsageError(f"{root} holds {held}; give the folder of one dataset, or name it with --dataset.")
    return found[0]
