"""Records of a training: ``training.json``, and the card beside the weights.

``training.json`` says what decides the result, so that a folder never mixes two trainings. The card says what the
weights are, what they were made from, and how far the training came.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import torch

import prbench
from prbench.errors import StorageError, TrainingError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import read_json, remove_leftovers, write_json
from prbench.harness.preparation import package_versions
from prbench.sequences import CorpusTable, SequenceTable
from prbench.sequences.folds import OPTION
from prbench_adapters.training.configuration import TrainingConfiguration
from prbench_adapters.training.motions import parts_of
from prbench_adapters.training.state import Row, TrainingState
from prbench_adapters.training.windows import WindowsDataset

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
