"""Checkpoints: a folder each, ``safetensors`` and JSON, written whole; the newest ones are kept."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import safetensors.torch
from safetensors import SafetensorError

from prbench.errors import InputFileError, TrainingError
from prbench.files.bounded import foreign_input, require_size
from prbench.files.storage import atomic_folder, read_json, remove_folder, write_json
from prbench.limits import LARGEST_UNPACKED
from prbench_adapters.training.state import Tally, TrainingState

KEPT = 2
_TENSORS = "tensors.safetensors"
_STATE = "state.json"
_TIMING = "timing.json"
_NAME = re.compile(r"step-(\d{9})")


class Checkpoints:
    """The checkpoints of one training folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def steps(self) -> list[int]:
        """Steps that there is a checkpoint of, ascending."""
        names = (_NAME.fullmatch(path.name) for path in self.folder.glob("step-*") if path.is_dir())
        return sorted(int(match[1]) for match in names if match)

    def save(self, state: TrainingState) -> None:
        """Write a checkpoint, then delete the old ones.

        Raises:
            StorageError: if it cannot be written; the earlier ones stay.
        """
        tensors = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in state.tensors().items()}
        with atomic_folder(self._path(state.step)) as temporary:
            safetensors.torch.save_file(tensors, temporary / _TENSORS)
            write_json(temporary / _STATE, _described(state))
            # Apart from the state, so that the states of two equal trainings have equal bytes.
            write_json(temporary / _TIMING, _timing(state))
        self._remove_old()

    def _remove_old(self) -> None:
        for step in self.steps()[:-KEPT]:
            remove_folder(self._path(step))

    @foreign_input()
    def restore(self, state: TrainingState) -> bool:
        """Put the newest checkpoint into ``state``; false if there is none.

        Raises:
            InputFileError: if it is damaged.
            TrainingError: if it is of another network.
        """
        for left in self.folder.glob(".step-*"):
            shutil.rmtree(left, ignore_errors=True)  # half-written by a process that was killed
        self._remove_old()  # one that was killed between its newest checkpoint and this
        steps = self.steps()
        if not steps:
            return False
        folder = self._path(steps[-1])
        try:
            require_size(folder / _TENSORS, largest=LARGEST_UNPACKED)
            tensors = safetensors.torch.load_file(folder / _TENSORS)
        except (SafetensorError, OSError) as error:
            raise InputFileError(
                folder / _TENSORS,
                "",
                expected="a checkpoint",
                found=str(error),
                remedy=f"Delete the folder {folder}; the one before it is used then.",
            ) from error
        described = read_json(folder / _STATE)
        _restore_described(state, described, folder)
        # Up to version 0.5.0 the times stood in the state.
        _restore_timing(state, read_json(folder / _TIMING) if (folder / _TIMING).is_file() else described)
        state.load_tensors(tensors)
        return True

    def _path(self, step: int) -> Path:
        return self.folder / f"step-{step:09d}"


def _described(state: TrainingState) -> dict[str, object]:
    return {
        "step": state.step,
        "tally": {
            "losses": {name: float(total) for name, total in state.tally.losses.items()},
            "batches": state.tally.batches,
        },
        "rows": state.rows,
        "validations": state.validations,
    }


def _timing(state: TrainingState) -> dict[str, object]:
    """Describe what differs between two trainings that are the same in all else."""
    return {"seconds": state.seconds, "waited": state.waited, "timings": state.timings}


def _restore_described(state: TrainingState, described: object, folder: Path) -> None:
    if not isinstance(described, dict) or "step" not in described:
        raise TrainingError(f"{folder / _STATE}: expected the state of a training. Delete the folder {folder}.")
    state.step = described["step"]
    state.tally = Tally(**described["tally"])
    state.rows, state.validations = described["rows"], described["validations"]


def _restore_timing(state: TrainingState, timing: Any) -> None:
    state.seconds = timing["seconds"]
    state.waited = timing["waited"]
    state.timings = timing.get("timings", [])
