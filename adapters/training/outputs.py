"""The files that a training writes: checkpoints, the averaged weights with their card, logs and curves."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from prbench.errors import MissingExtraError
from prbench.files.storage import atomic_path, remove_leftovers, write_json
from prbench.shown import figure_text
from prbench_adapters.training.checkpoints import Checkpoints
from prbench_adapters.training.record import training_times
from prbench_adapters.training.state import Row, TrainingState
from prbench_adapters.training.weights import write_weights

_CURVES = "curves.png"
_SECONDS_BETWEEN_PICTURES = 120.0  # drawing takes a second
_NOT_DRAWN = ("step", "seconds", "waiting")  # times differ between equal trainings; TensorBoard shows them
_LINEAR = ("learning_rate",)
_Curve = tuple[list[float | int], list[float | int]]
WEIGHTS = "weights.safetensors"
_CARD = "weights.json"
TIMES = "timing.json"
Describe = Callable[[TrainingState], dict[str, Any]]
"""Maps a state to its card."""


class TrainingLog:
    """Writes the rows of a training as they come.

    Args:
        out: The training folder.
        resumed_at: Steps that were done before; what an earlier session logged after them is dropped.

    Raises:
        MissingExtraError: if TensorBoard is not installed.
    """

    def __init__(self, out: Path, *, resumed_at: int) -> None:
        self.out = out
        self._writer = _summary_writer(out / "tensorboard", resumed_at)
        self._drawn_at = time.monotonic()

    def add(self, row: Row, *, group: str) -> None:
        """Log one row; ``group`` comes before the names, as in ``train/loss``."""
        step = int(row["step"])
        for name, value in row.items():
            if name != "step":
                self._writer.add_scalar(f"{group}/{name}", value, step)

    def draw(self, state: TrainingState) -> None:
        """Write the curves so far as ``curves.png``."""
        self._drawn_at = time.monotonic()
        if state.rows:
            draw_curves(self.out / _CURVES, state.rows, state.validations)

    def draw_now_and_then(self, state: TrainingState) -> None:
        """Flush the log; draw the curves if that was long ago."""
        self._writer.flush()
        if time.monotonic() - self._drawn_at > _SECONDS_BETWEEN_PICTURES:
            self.draw(state)

    def close(self, state: TrainingState) -> None:
        """Draw the curves a last time and finish the files."""
        self._writer.close()
        self.draw(state)


def draw_curves(path: Path, rows: list[Row], validations: list[Row]) -> None:
    """One small plot for each thing measured, against steps; losses on a logarithmic scale where they allow it.

    Raises:
        StorageError: if the picture cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullLocator

    plots = _plots(rows, validations)
    losses = set(rows[0]).difference(_NOT_DRAWN, _LINEAR) if rows else set()
    columns = min(3, len(plots))
    lines = -(-len(plots) // columns)
    figure = Figure(figsize=(4.2 * columns, 2.8 * lines))
    edge = 0.55 / (2.8 * lines)  # fixed margins: computed ones take most of the drawing
    figure.subplots_adjust(left=0.16 / columns, right=0.985, bottom=edge, top=1 - edge / 2, wspace=0.25, hspace=0.45)
    FigureCanvasAgg(figure)
    for place, (name, curves) in enumerate(plots.items()):
        axes = figure.add_subplot(lines, columns, place + 1)
        for label, (steps, values) in curves.items():
            axes.plot(steps, values, label=figure_text(label), linewidth=1, marker="." if len(steps) < 30 else None)
        if name in losses and all(value > 0 for _, values in curves.values() for value in values):
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_locator(NullLocator())
        axes.set_title(figure_text(name), fontsize=9)
        axes.set_xlabel("step", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
        if len(curves) > 1:
            axes.legend(fontsize=7)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")


def _plots(rows: list[Row], validations: list[Row]) -> dict[str, dict[str, _Curve]]:
    """Name of the measurement → who measured it → steps and values; training and validation share their plots."""
    plots: dict[str, dict[str, _Curve]] = {}
    for label, source in (("training", rows), ("validation", validations)):
        for row in source:
            for name in row:
                if name not in _NOT_DRAWN:
                    steps, values = plots.setdefault(name, {}).setdefault(label, ([], []))
                    steps.append(row["step"])
                    values.append(row[name])
    # The loss first, the others by name: rows of a checkpoint have their names in another order than new ones.
    return dict(sorted(plots.items(), key=lambda plot: (plot[0] != "loss", plot[0])))


def _summary_writer(folder: Path, resumed_at: int) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError as error:
        raise MissingExtraError("tensorboard", "train", "the log of a training") from error
    return SummaryWriter(str(folder), purge_step=resumed_at + 1 if resumed_at else None)


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
        for name in (WEIGHTS, _CARD, TIMES, _CURVES):
            remove_leftovers(out / name)
        self.out, self.checkpoints, self.describe = out, checkpoints, describe
        self.dtype: Literal["float32", "float16"] = dtype
        self.log = TrainingLog(out, resumed_at=resumed_at)

    def save(self, state: TrainingState) -> None:
        """Write everything: first the checkpoint, from which all the rest can be made again.

        Raises:
            StorageError: if a file cannot be written.
        """
        # If the process dies here, the next one writes the results again from the checkpoint.
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
