"""What a training leaves to look at: a TensorBoard log and a picture of the curves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from prbench.errors import MissingExtraError
from prbench.storage import atomic_path
from prbench.training.state import Row, TrainingState

CURVES = "curves.png"
_NOT_DRAWN = ("step", "seconds")


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

    def add(self, row: Row, *, group: str) -> None:
        """Log one row; ``group`` comes before the names, as in ``train/loss``."""
        step = int(row["step"])
        for name, value in row.items():
            if name != "step":
                self._writer.add_scalar(f"{group}/{name}", value, step)

    def draw(self, state: TrainingState) -> None:
        """Write the curves so far as ``curves.png``, and flush."""
        self._writer.flush()
        if state.rows:
            draw_curves(self.out / CURVES, state.rows, state.validations)

    def close(self) -> None:
        """Finish the files."""
        self._writer.close()


def draw_curves(path: Path, rows: list[Row], validations: list[Row]) -> None:
    """One small plot for each thing measured, against steps; losses on a logarithmic scale where they allow it.

    Raises:
        StorageError: if the picture cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    plots = _plots(rows, validations)
    columns = min(3, len(plots))
    lines = -(-len(plots) // columns)
    figure = Figure(figsize=(4.2 * columns, 2.8 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    for place, (name, curves) in enumerate(plots.items()):
        axes = figure.add_subplot(lines, columns, place + 1)
        for label, (steps, values) in curves.items():
            axes.plot(steps, values, label=label, linewidth=1, marker="." if len(steps) < 30 else None)
        if name != "waiting" and all(value > 0 for _, values in curves.values() for value in values):
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_title(name, fontsize=9)
        axes.set_xlabel("step", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
        if len(curves) > 1:
            axes.legend(fontsize=7)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")


_Curve = tuple[list[float | int], list[float | int]]


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
    return plots


def _summary_writer(folder: Path, resumed_at: int) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError as error:
        raise MissingExtraError("tensorboard", "train", "the log of a training") from error
    return SummaryWriter(str(folder), purge_step=resumed_at + 1 if resumed_at else None)
