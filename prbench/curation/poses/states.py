"""Find out which recordings have a whole body from EgoAllo, and which lack one or a part of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

import numpy as np

from prbench.curation.poses.prepare import head_poses, source_trajectory
from prbench.errors import InputFileError, PrbenchError, UsageError
from prbench.geometry.timelines import nearest_index
from prbench.protocol.manifests import load_manifest
from prbench.readers import SYNTHETIC_PREFIX, AriaGlasses, RecordingFiles, reader_for
from prbench.readers.discover import discover, usable_readers
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.bodies import check_output
from prbench.readers.egoallo.files import OUTPUT_ROLE, EgoalloInputs, poses_folder
from prbench.recording import PoseStream

_STEP = 0.033  # seconds between the instants that are asked about
_MISSING_ALLOWED = 0.5  # seconds, share of a short recording: first frame, last part of a window
_MISSING_SHARE = 0.1
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


@dataclass(frozen=True)
class Coverage:
    """The part of a recording that some outputs cover."""

    seconds: float
    """Length of the recording."""
    missing: float
    """Time without a body within 0.1 s, seconds."""
    first_missing: float | None
    """The first instant without a body, seconds from the start; None if there is none."""

    @property
    def complete(self) -> bool:
        """Return True if nothing but the ends of windows is missing."""
        return self.missing <= min(_MISSING_ALLOWED, _MISSING_SHARE * self.seconds) + 1e-9

    def __str__(self) -> str:
        if self.first_missing is None:
            return f"all {self.seconds:.1f} s"
        return (
            f"{self.seconds - self.missing:.1f} of {self.seconds:.1f} s,"
            f" missing first at {self.first_missing:.1f} s from the start"
        )


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
    datasets = tuple(reader.dataset for reader in usable_readers()[0] if isinstance(reader, AriaGlasses))
    dataset = selection.dataset
    if dataset is None:
        try:
            held = sorted({each.dataset for each in discover(root).found if each.root == root} & set(datasets))
        except PrbenchError as error:
            raise UsageError(f"{error} Name the dataset with --dataset.") from error
        if len(held) != 1:
            names = " and ".join(held) or "no dataset of Aria glasses"
            raise UsageError(f"{root} holds {names}; give the folder of one dataset, or name it with --dataset.")
        dataset = held[0]
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
    # Synthetic recordings imitate a dataset and share its manifest.
    manifest = load_manifest(found.dataset.removeprefix(SYNTHETIC_PREFIX))
    # Making a body for a recording that every build skips would waste GPU hours.
    bad = found.skip_reason or manifest.why_bad(found.recording_id)
    if bad:
        return PoseState(found, "skipped", bad, target, None)
    try:
        reader = reader_for(found.dataset)
        assert isinstance(reader, AriaGlasses), "select() takes recordings of such datasets alone"
        inputs = reader.egoallo_inputs(root, found)
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


def coverage(outputs: Sequence[Path], cpf: PoseStream) -> Coverage:
    """Check some outputs and say how much of the recording they cover.

    Args:
        outputs: Files of one recording.
        cpf: The recording's central pupil frame in the world of the outputs, device seconds.

    Raises:
        InputFileError: for the first output that is damaged or belongs to another recording.
    """
    times = np.unique(np.concatenate([check_output(path, cpf) for path in outputs])) if outputs else np.zeros(0)
    seconds = float(cpf.times[-1] - cpf.times[0])
    # Asked at a regular step, so that a dense part of the trajectory weighs no more than a sparse one. Instants
    # without a head pose count for nobody: EgoAllo cannot fill them.
    regular = cpf.times[0] + np.arange(int(seconds / _STEP) + 1) * _STEP
    posed = np.abs(cpf.times[nearest_index(cpf.times, regular)] - regular) <= ego.LONGEST_STEP / 2
    asked = regular[posed]
    if len(times) == 0:
        return Coverage(seconds, seconds, 0.0)
    found = times / 1e9
    missing = asked[np.abs(found[nearest_index(found, asked)] - asked) > ego.LONGEST_STEP]
    first = float(missing[0] - cpf.times[0]) if len(missing) else None
    return Coverage(seconds, len(missing) * _STEP, first)
