"""What a training says of itself: ``training.json``, the card beside the weights, logs and curves.

``training.json`` says what decides the result, so that a folder never mixes two trainings. The card says what the
weights are, what they were made from, and how far the training came.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec
import torch

import prbench
from prbench.errors import MissingExtraError, StorageError, TrainingError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import atomic_path, read_json, remove_leftovers, write_json
from prbench.harness.preparation import package_versions
from prbench.sequences import CorpusTable, SequenceTable
from prbench.sequences.folds import OPTION
from prbench.shown import figure_text
from prbench_adapters.training.batches import WindowsDataset
from prbench_adapters.training.configuration import TrainingConfiguration
from prbench_adapters.training.state import Checkpoints, Row, TrainingState
from prbench_adapters.training.store import parts_of
from prbench_adapters.training.weights import write_weights

RECORD = "training.json"
SCHEMA_VERSION = 1
_MAY_CHANGE = frozenset({"configuration.training.save_every", "configuration.training.log_every"})
_CARD_VERSION = 2
"""2: times stand in ``timing.json``, so that the same training has the same card."""
_CURVE_POINTS = 100
_PACKAGES = ("numpy", "pyarrow", "torch", "lightning-fabric", "safetensors", "transformers")


class TableRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One table that was learnt from."""

    dataset: str
    title: str
    synthetic: bool
    licence: str
    identity_digest: str
    content_digest: str
    sequences: int
    """Number of sequences in the split that is trained on."""
    fold: str | None = None
    """The fold of participants that was not learnt from, such as ``2/6``; absent for a table that is no fold."""


class TrainingRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that decides the result, except code and machine."""

    schema_version: int = SCHEMA_VERSION
    method: str
    stage: str
    configuration: TrainingConfiguration
    data: tuple[TableRecord, ...]
    initial_weights_sha256: str | None
    devices: int
    refit: bool = False
    """The validation split was learnt from, too, so that scores on it say nothing."""


def table_records(tables: Iterable[SequenceTable | CorpusTable], *, split: str) -> tuple[TableRecord, ...]:
    """Describe each table for the card, in the order given (the order decides what a seed draws)."""
    return tuple(
        TableRecord(
            dataset=table.info.dataset,
            title=table.info.title,
            synthetic=table.info.synthetic,
            licence=table.info.licence,
            identity_digest=table.info.identity_digest,
            content_digest=table.info.content_digest,
            sequences=sum(table.scalars(split=part, columns=["split"]).num_rows for part in parts_of(split)),
            fold=table.info.options.get(OPTION) if isinstance(table, SequenceTable) else None,
        )
        for table in tables
    )


def window_records(data: WindowsDataset) -> tuple[TableRecord, ...]:
    """Describe each table of windows for the card; its sequences are the stretches that windows are drawn from."""
    return tuple(
        TableRecord(
            dataset=table.info.dataset,
            title=table.info.title,
            synthetic=table.info.synthetic,
            licence=table.info.licence,
            identity_digest=table.info.identity_digest,
            content_digest=table.info.content_digest,
            sequences=count,
        )
        for table, count in zip(data.tables, data.counts, strict=True)
    )


def require_same_training(out: Path, record: TrainingRecord) -> None:
    """Refuse a folder that belongs to something else, before hours of work.

    Raises:
        TrainingError: if it belongs to another training; names the first key that differs.
        StorageError: if it holds something else.
    """
    path = out / RECORD
    remove_leftovers(path)  # of a process that was killed before the file stood there
    if not path.is_file():
        if out.is_file() or (out.is_dir() and any(out.iterdir())):
            raise StorageError(
                f"{out}: is not empty and holds no {RECORD}, so it is no training that could go on."
                " Choose an empty or new folder for --out."
            )
        return
    found = read_json(path)
    if not isinstance(found, Mapping):
        raise TrainingError(f"{path}: expected the record of a training. Choose another folder for --out.")
    difference = _first_difference(
        _flat(msgspec.to_builtins(record)), _flat({"refit": False, **found})
    )  # no key up to 0.7.0
    if difference is not None:
        key, now, then = difference
        raise TrainingError(
            f"{out}: holds another training: '{key}' is {then} there, but {now} was asked for."
            " Repeat the command of that training to go on with it, or choose another folder for --out."
        )


def write_record(out: Path, record: TrainingRecord) -> None:
    """Mark a folder as that of a training.

    Raises:
        StorageError: if it cannot be written.
    """
    write_json(out / RECORD, msgspec.to_builtins(record))


@foreign_input()
def read_record(out: Path) -> TrainingRecord:
    """Read what decides a training that stands in a folder.

    Raises:
        TrainingError: if the folder holds none, or it is damaged.
    """
    path = out / RECORD
    try:
        return msgspec.json.decode(read_whole(path), type=TrainingRecord)
    except FileNotFoundError as error:
        raise TrainingError(f"{path}: expected the record of a training, found no file.") from error
    except (msgspec.ValidationError, msgspec.DecodeError) as error:
        raise TrainingError(f"{path}: not a valid {RECORD}: {error}. Train again in another folder.") from error


def _first_difference(asked: Mapping[str, str], found: Mapping[str, str]) -> tuple[str, str, str] | None:
    """The first key, as asked and as found, whose value differs; None if all agree."""
    for key in dict.fromkeys((*asked, *found)):
        now = asked.get(key, "nothing")
        then = found.get(key, "nothing")
        if now != then and key not in _MAY_CHANGE:
            return key, now, then
    return None


def _flat(value: Any, prefix: str = "") -> dict[str, str]:
    """Nested tables and lists as one level of dotted keys, values as JSON."""
    if isinstance(value, Mapping):
        parts = [_flat(item, f"{prefix}{key}.") for key, item in value.items()]
    elif isinstance(value, list | tuple):
        parts = [_flat(item, f"{prefix}{place}.") for place, item in enumerate(value)]
    else:
        return {prefix.rstrip("."): msgspec.json.encode(value).decode()}
    return {key: text for part in parts for key, text in part.items()}


def training_card(record: TrainingRecord, state: TrainingState, device: torch.device, threads: int) -> dict[str, Any]:
    """The card of a state.

    Args:
        record: What decides the result.
        state: Its steps, learning curve and validations.
        device: Where it was trained.
        threads: Torch's threads, on which the last bits depend on a CPU.
    """
    steps = record.configuration.training.steps
    return {
        "card_version": _CARD_VERSION,
        "prbench": prbench.__version__,
        "method": record.method,
        "stage": record.stage,
        "finished": state.step >= steps,
        "steps": state.step,
        "parameters": sum(parameter.numel() for parameter in state.average.parameters.values()),
        "averaged": record.configuration.training.ema > 0,
        "device": _device_in_words(device),
        "devices": record.devices,
        "threads": threads,
        "packages": package_versions(_PACKAGES),
        "configuration": msgspec.to_builtins(record.configuration),
        "data": msgspec.to_builtins(record.data),
        "refit": record.refit,
        "initial_weights_sha256": record.initial_weights_sha256,
        "learned_from": list(state.module.learned_from()),
        "learning_curve": thinned(state.rows, _CURVE_POINTS),
        "validation": state.validations,
    }


def training_times(state: TrainingState) -> dict[str, Any]:
    """Return how long a training took, which no two trainings have in common."""
    return {
        "steps": state.step,
        "seconds": round(state.seconds, 1),
        "waiting_fraction": round(state.waiting, 4),
        "timings": thinned(state.timings, _CURVE_POINTS),
    }


def thinned(rows: list[Row], points: int) -> list[Row]:
    """Select at most ``points`` rows, spread evenly, the last among them."""
    if len(rows) <= points:
        return rows
    # Counted from the end of each stretch, so that the last row is always kept.
    places = sorted({round((place + 1) * len(rows) / points) - 1 for place in range(points)})
    return [rows[place] for place in places]


def _device_in_words(device: torch.device) -> str:
    """``cpu (x86_64)``, or the name of the GPU."""
    if device.type == "cuda":
        return f"cuda ({torch.cuda.get_device_name(device)})"
    return f"{device.type} ({platform.machine()})"


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
        folder = out / "tensorboard"
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ModuleNotFoundError as error:
            raise MissingExtraError("tensorboard", "train", "the log of a training") from error
        self._writer = SummaryWriter(str(folder), purge_step=resumed_at + 1 if resumed_at else None)
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
