"""Input folders for whoever runs EgoAllo by hand or on another machine."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from prbench.errors import InputFileError, StorageError
from prbench.locks import sole_writer
from prbench.readers.aria_mps import format as mps
from prbench.readers.egoallo.places import poses_folder
from prbench.workflows.poses.prepare import guidance_mode, prepare
from prbench.workflows.poses.states import PoseState

_MARK = "prepared-by-prbench.txt"


def prepare_by_hand(
    lacking: Sequence[PoseState], root: Path, poses_root: Path | None = None
) -> Iterator[tuple[str, str, bool]]:
    """Write the input folder of each recording where its outputs belong, so that EgoAllo writes them there.

    Yields:
        Name of the recording; the command to run, or what is wrong; whether it went well.

    Raises:
        StorageError: if a folder cannot be written, or holds files that prbench did not put there.
    """
    for state in lacking:
        name = state.found.recording_id
        if state.inputs is None:
            yield name, state.message, False
            continue
        lacks = state.inputs.lacking(frozenset(("vrs", "points")))
        folder = poses_folder(root.expanduser().resolve(), name, poses_root).parent
        try:
            with sole_writer(folder):
                _clear(folder)
                prepared = prepare(state.inputs, folder)
        except InputFileError as error:
            yield name, str(error), False
            continue
        arguments = f"--traj-length {prepared.frames} --guidance-mode {guidance_mode(prepared)}"
        run = f"python 3_aria_inference.py --traj-root {folder} {arguments}"
        yield name, f"{run}   ({lacks})" if lacks else run, not lacks


def _clear(folder: Path) -> None:
    """Remove what an earlier call wrote into a folder, and nothing else."""
    mark = folder / _MARK
    parts = [folder / mps.SLAM_FOLDER, folder / mps.HAND_FOLDER, *folder.glob("*.vrs")]
    if not mark.is_file() and any(part.exists() for part in parts):
        raise StorageError(f"{folder} holds files that prbench did not put there; choose another --poses-root.")
    for part in parts:
        if part.is_dir() and not part.is_symlink():
            shutil.rmtree(part)
        else:
            part.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    mark.write_text("Inputs for EgoAllo, made by `prbench poses egoallo --prepare`; its outputs belong beside them.\n")
