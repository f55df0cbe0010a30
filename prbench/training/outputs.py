"""The files that a training writes: checkpoints, the averaged weights with their card, logs and curves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from prbench.storage import remove_leftovers, write_json
from prbench.training.card import training_times
from prbench.training.checkpoints import Checkpoints
from prbench.training.log import CURVES, TrainingLog
from prbench.training.state import Row, TrainingState
from prbench.training.weights import write_weights

WEIGHTS = "weights.safetensors"
CARD = "weights.json"
TIMES = "timing.json"

Describe = Callable[[TrainingState], dict[str, Any]]
"""Maps a state to its card."""


class Outputs:
    """The files of a training folder; only the first of several processes has one.

    Args:
        out: The training folder.
        checkpoints: Of that folder.
        describe: The card for a state.
        dtype: Of the matrices in the weights file.
        resumed_at: Steps that were done before this session.
    """

    def __init__(
        self,
        out: Path,
        checkpoints: Checkpoints,
        describe: Describe,
        *,
        dtype: Literal["float32", "float16"],
        resumed_at: int,
    ) -> None:
        for name in (WEIGHTS, CARD, TIMES, CURVES):
            remove_leftovers(out / name)
        self.out, self.checkpoints, self.describe = out, checkpoints, describe
        self.dtype: Literal["float32", "float16"] = dtype
        self.log = TrainingLog(out, resumed_at=resumed_at)

    def save(self, state: TrainingState) -> None:
        """Write everything: first the checkpoint, from which all the rest can be made again.

        Raises:
            StorageError: if a file cannot be written.
        """
        self.checkpoints.save(state)
        self.write_results(state)

    def write_results(self, state: TrainingState) -> None:
        """Write the averaged weights with their card, the times, and now and then the curves.

        Raises:
            StorageError: if a file cannot be written.
        """
        with state.average.applied():
            tensors, metadata = state.module.weights()
            write_weights(self.out / WEIGHTS, tensors, metadata, self.describe(state), dtype=self.dtype)
        write_json(self.out / TIMES, training_times(state))
        self.log.draw_now_and_then(state)

    def close(self, state: TrainingState) -> None:
        """Draw the curves and finish the log."""
        self.log.close(state)

    def add(self, row: Row, *, group: str) -> None:
        """Log what was measured."""
        self.log.add(row, group=group)
