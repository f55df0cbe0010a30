"""What a training says of itself: ``training.json``, the card beside the weights, and the log.

``training.json`` says what decides the result, so that a folder never mixes two trainings. The card says what the
weights are, what they were made from, and how far the training came.
"""

from __future__ import annotations

import platform
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec
import torch

import prbench
from prbench.errors import MissingExtraError, StorageError, TrainingError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import read_json, remove_leftovers, write_json
from prbench.harness.preparation import package_versions
from prbench.sequences import SequenceTable
from prbench.sequences.folds import OPTION
from prbench.sequences.table import BuiltTable
from prbench_adapters.training.configuration import TrainingConfiguration
from prbench_adapters.training.state import Row, TrainingState, save_checkpoint
from prbench_adapters.training.weights import write_weights

RECORD = "training.json"
SCHEMA_VERSION = 1
_MAY_CHANGE = frozenset({"configuration.training.save_every", "configuration.training.log_every"})
# 2: without times, so that the same training has the same card.
_CARD_VERSION = 2
_CURVE_POINTS = 100
_PACKAGES = ("numpy", "pyarrow", "torch", "lightning-fabric", "safetensors", "transformers")


class TableRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One table that was learnt from.

    Attributes:
        sequences: Number of sequences in the split that is trained on.
        fold: The fold of participants that was not learnt from, such as ``2/6``; absent for a table that is no fold.
    """

    dataset: str
    title: str
    synthetic: bool
    licence: str
    identity_digest: str
    content_digest: str
    sequences: int
    fold: str | None = None


class TrainingRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that decides the result, except code and machine.

    Attributes:
        refit: The validation split was learnt from, too, so that scores on it say nothing.
    """

    schema_version: int = SCHEMA_VERSION
    method: str
    stage: str
    configuration: TrainingConfiguration
    data: tuple[TableRecord, ...]
    initial_weights_sha256: str | None
    devices: int
    refit: bool = False


def table_record(table: BuiltTable[Any], sequences: int) -> TableRecord:
    """Describe a table for the card.

    Args:
        table: That is learnt from.
        sequences: Rows of the split, or stretches that windows are drawn from.
    """
    fold = table.info.options.get(OPTION) if isinstance(table, SequenceTable) else None
    own: dict[str, Any] = {name: getattr(table.info, name) for name in TableRecord.__struct_fields__[:-2]}
    return TableRecord(sequences=sequences, fold=fold, **own)


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
            why = "so it is no training that could go on. Choose an empty or new folder for --out."
            raise StorageError(f"{out}: is not empty and holds no {RECORD}, {why}")
        return
    found = read_json(path)
    if not isinstance(found, Mapping):
        raise TrainingError(f"{path}: expected the record of a training. Choose another folder for --out.")
    asked = _flat(msgspec.to_builtins(record))
    there = _flat({"refit": False, **found})  # trainings up to 0.7.0 lack the key
    for key in dict.fromkeys((*asked, *there)):
        now = asked.get(key, "nothing")
        then = there.get(key, "nothing")
        if now != then and key not in _MAY_CHANGE:
            reason = f"holds another training: '{key}' is {then} there, but {now} was asked for."
            remedy = "Repeat the command of that training to go on with it, or choose another folder for --out."
            raise TrainingError(f"{out}: {reason} {remedy}")


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
    """Return the card of a state.

    Args:
        record: What decides the result.
        state: Its steps, learning curve and validations.
        device: Device of the training.
        threads: Torch's threads, on which the last bits depend on a CPU.
    """
    settings = record.configuration.training
    best = state.best_validation()
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.machine()
    made = ("method", "stage", "configuration", "data", "refit", "initial_weights_sha256", "devices")
    return {
        **{name: msgspec.to_builtins(getattr(record, name)) for name in made},
        "card_version": _CARD_VERSION,
        "prbench": prbench.__version__,
        "finished": state.step >= settings.steps or state.exhausted(record.configuration.validation.patience),
        "steps": state.step,
        "best_step": None if best is None else best["step"],
        "parameters": sum(parameter.numel() for parameter in state.average.parameters.values()),
        "averaged": settings.ema > 0,
        "device": f"{device.type} ({name})",
        "threads": threads,
        "packages": package_versions(_PACKAGES),
        "learned_from": list(state.module.origin),
        "learning_curve": thinned(state.rows, _CURVE_POINTS),
        "validation": state.validations,
    }


def thinned(rows: list[Row], points: int) -> list[Row]:
    """Select at most ``points`` rows, spread evenly, the last among them."""
    if len(rows) <= points:
        return rows
    # Counted from the end of each stretch, so that the last row is always kept.
    places = sorted({round((place + 1) * len(rows) / points) - 1 for place in range(points)})
    return [rows[place] for place in places]


WEIGHTS = "weights.safetensors"
_CARD = "weights.json"
# Maps a state to its card.
Describe = Callable[[TrainingState], dict[str, Any]]
# Takes what was measured, with the names as TensorBoard shows them, and the step.
Log = Callable[[dict[str, float], int], None]


def wandb_run(out: Path, project: str, record: TrainingRecord) -> Any:
    """Open the run of a training folder at Weights & Biases, the same one after an interruption.

    Args:
        out: The training folder; holds the run's files and its id.
        project: Name of the project.
        record: Shown as the run's configuration.
    """
    import wandb  # pyright: ignore[reportMissingImports]

    kept = out / "wandb.json"
    if not kept.is_file():
        write_json(kept, {"id": uuid.uuid4().hex[:8]})
    return wandb.init(
        project=project,
        id=msgspec.convert(read_json(kept), dict[str, str])["id"],
        resume="allow",
        name=out.resolve().name,
        dir=str(out),
        config=msgspec.to_builtins(record),
        settings=wandb.Settings(console="off"),
    )


class Outputs:
    """The files of a training folder; only the first of several processes has one.

    Args:
        out: The training folder.
        checkpoints: Folder of the checkpoints.
        describe: The card for a state.
        log: Called with every line that TensorBoard is given.
        dtype: Type of the matrices in the weights file.
        resumed_at: Steps that were done before this session; what an earlier one logged after them is dropped.

    Raises:
        MissingExtraError: if TensorBoard is not installed.
    """

    def __init__(
        self,
        out: Path,
        checkpoints: Path,
        describe: Describe,
        log: Log | None = None,
        *,
        dtype: Literal["float32", "float16"],
        resumed_at: int,
    ) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ModuleNotFoundError as error:
            raise MissingExtraError("tensorboard", "train", "the log of a training") from error
        for name in (WEIGHTS, _CARD):
            remove_leftovers(out / name)
        self.out, self.checkpoints, self.describe, self.log = out, checkpoints, describe, log
        self.dtype: Literal["float32", "float16"] = dtype
        self.tensorboard = SummaryWriter(str(out / "tensorboard"), purge_step=resumed_at + 1 if resumed_at else None)

    def save(self, state: TrainingState) -> None:
        """Write everything: first the checkpoint, from which all the rest can be made again.

        Raises:
            StorageError: if a file cannot be written.
        """
        # If the process dies here, the next one writes the results again from the checkpoint.
        save_checkpoint(self.checkpoints, state)
        self.write_results(state)

    def write_results(self, state: TrainingState) -> None:
        """Write the averaged weights with their card: those of the best validation, where there was one.

        Raises:
            StorageError: if a file cannot be written.
        """
        with state.average.applied(state.best):
            tensors, metadata = state.module.weights()
            write_weights(self.out / WEIGHTS, tensors, metadata, self.describe(state), dtype=self.dtype)
        self.tensorboard.flush()

    def add(self, row: Row, *, group: str) -> None:
        """Log what was measured; ``group`` comes before the names, as in ``train/loss``."""
        values = {f"{group}/{name}": value for name, value in row.items() if name != "step"}
        for name, value in values.items():
            self.tensorboard.add_scalar(name, value, int(row["step"]))
        if self.log is not None:
            self.log(values, int(row["step"]))
