"""Weights, features and batches that methods are trained with."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import msgspec
import torch
from safetensors.torch import save_file

from prbench.cli import main
from prbench_adapters.gmd.public_weights import import_public
from prbench_adapters.training import LengthBatches
from prbench_adapters.training.batches import load_batches
from prbench_adapters.training.configuration import load_configuration
from prbench_adapters.training.weights import read_weights, write_weights
from tests.adapters import trained
from tests.adapters.gmd import tiny as gmd
from tests.laws.cases import SameBytes, bad_files

_HEADER = {"kind": "toy", "configuration": "{}"}
_TENSORS = {"a": torch.arange(300.0).reshape(10, 30), "b": torch.ones(3)}


def _trained(folder: Path) -> None:
    words = ["train", "--method", "pr", "--config", "smoke", "--data", str(trained.table())]
    assert main([*words, "--set", "validation.every=0", "--out", str(folder)]) == 0
    shutil.rmtree(folder / "tensorboard")  # which has the time of day in its name


def _imported(folder: Path) -> bytes:
    import_public(gmd.write_released(folder), folder / "gmd.safetensors")
    return (folder / "gmd.safetensors").read_bytes()


def _written(header: dict[str, str]) -> Callable[[Path], None]:
    return lambda folder: write_weights(folder / "w.safetensors", _TENSORS, header, {"steps": 3})


def _loaded(workers: int, seed: int = 1) -> Callable[[Path], object]:
    def batches(_: Path) -> object:
        data = trained.sequences(max_frames=40)
        plan = LengthBatches(data, 4, seed=seed, start_step=2)
        taken = islice(load_batches(data, plan, workers=workers), 5)
        return tuple((batch.features.numpy(), batch.joints.numpy(), batch.text, batch.sequence_id) for batch in taken)

    return batches


SAME_BYTES = [
    SameBytes("a training of pr", {"once": _trained, "again": _trained}),
    SameBytes("GMD's public weights", {"imported": _imported, "again": _imported}),
    SameBytes(
        "weights",
        {"as given": _written(_HEADER), "with the header in another order": _written(dict(reversed(_HEADER.items())))},
    ),
    SameBytes(
        "batches for training",
        {"without workers": _loaded(0), "with two": _loaded(2)},
        differs={"another seed": _loaded(0, seed=2)},
    ),
]


def _weights(folder: Path) -> Path:
    _written(_HEADER)(folder)
    return folder / "w.safetensors"


def _replaced(by: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(by)


def _a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _of_version_9(path: Path) -> None:
    save_file({"a": torch.zeros(2)}, path, metadata={**_HEADER, "format": "prbench-weights", "format_version": "9"})


def _of_another_network(path: Path) -> None:
    write_weights(path, _TENSORS, {**_HEADER, "configuration": json.dumps({"depth": 3})}, {})


class _Network(msgspec.Struct, forbid_unknown_fields=True):
    width: int = 3


def _configured(folder: Path) -> Path:
    path = folder / "own.toml"
    path.write_text("[model]\n[training]\nsteps = 3\n")
    return path


def _configuration(path: Path) -> object:
    return load_configuration(str(path), package="prbench_adapters.pr", task="pr", stage="pretrain")


BAD_INPUT = [
    *bad_files(
        "weights",
        _weights,
        lambda path: read_weights(path, kind="toy").configuration(_Network),
        {
            "a checkpoint of PyTorch": (lambda path: torch.save({"a": torch.zeros(2)}, path), ["found a pickle"]),
            "a pickle": (_replaced(pickle.dumps({"a": 1})), ["found a pickle"]),
            "a page": (_replaced(b"<html>not found</html>"), ["expected a safetensors file"]),
            "three bytes": (_replaced(b"abc"), ["w.safetensors", "found 3 bytes"]),
            "a folder": (_a_folder, ["found a folder"]),
            "nothing": (Path.unlink, ["found no such file"]),
            "a part": (lambda path: path.write_bytes(path.read_bytes()[:-100]), ["It may be truncated"]),
            "another program's": (
                lambda path: save_file({"a": torch.zeros(2)}, path),
                ["expected 'prbench-weights', found nothing"],
            ),
            "a later version's": (_of_version_9, ["expected '1', found '9'"]),
            "another network's": (_of_another_network, ["expected a _Network as JSON"]),
        },
    ),
    *bad_files(
        "configuration",
        _configured,
        _configuration,
        {
            "no TOML": (_replaced(b"[model]\nwidth = "), ["own.toml", "expected a TOML file"]),
            "an unknown table": (_replaced(b"[model]\n[traning]\nsteps = 3"), ["unknown field `traning`"]),
            "a missing table": (_replaced(b"[model]\n"), ["missing required field `training`"]),
            "a stage that is a value": (_replaced(b"stages = 3\n[model]\n"), ["[stages]: expected tables"]),
            "no file": (Path.unlink, ["own.toml: expected a TOML file"]),
        },
    ),
]
