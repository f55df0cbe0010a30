"""Conditions files, commands and descriptions of programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from prbench.contract import Condition
from prbench.harness.methods.programs import read_description
from prbench.harness.offline import ExportRequest, export_conditions, read_conditions_file
from tests.fakes import fake_dataset
from tests.laws.cases import SameBytes, bad_files
from tests.shared import made_once


def _tables() -> list[Path]:
    sizes = {"synthetic-adt": 60, "synthetic-gimo": 24}
    return [
        made_once(f"methods-{name}", lambda folder, name=name, n=n: fake_dataset(folder, n, dataset=name))
        for name, n in sizes.items()
    ]


def _exported(folder: Path, *, reverse: bool = False, **changes: Any) -> Path:
    tables = _tables()[:: -1 if reverse else 1]
    out = folder / "c.npz"
    export_conditions(ExportRequest(data=tuple(tables), condition=Condition.GOAL_LOCATION, out=out, **changes))
    return out


def _changed(**arrays: Any) -> Callable[[Path], None]:
    """Return a damage that puts other arrays into a file; None takes one out."""

    def damage(path: Path) -> None:
        with np.load(path) as file:
            kept = {name: file[name] for name in file.files} | arrays
        np.savez(path, **{name: values for name, values in kept.items() if values is not None})

    return damage


def _described(folder: Path) -> Path:
    path = folder / "glide.toml"
    path.write_text('[method]\ncommand = ["python", "glide.py"]\n')
    return path


def _written(text: str, *, behind: bool = False) -> Callable[[Path], None]:
    return lambda path: path.write_text(path.read_text() * behind + text) and None


SAME_BYTES = [
    SameBytes(
        "a conditions file",
        {
            "of two tables": lambda folder: _exported(folder, samples=2) and None,
            "of the same in another order": lambda folder: _exported(folder, samples=2, reverse=True) and None,
        },
        differs={"another seed": lambda folder: _exported(folder, samples=2, seed=1) and None},
    )
]
BAD_INPUT = [
    *bad_files("a conditions file", _exported, read_conditions_file, {
        "no information": (_changed(prbench_conditions=None), ["with an array 'prbench_conditions'"]),
        "a newer version": (_changed(prbench_conditions=np.array('{"format_version": 2}')), ["version 1, found 2"]),
        "no JSON": (_changed(prbench_conditions=np.array("{")), ["expected what prbench wrote"]),
        "a missing array": (_changed(noise_seed=None), ["expected the arrays opaque_id, sample, noise_seed"]),
        "another array": (_changed(secret=np.zeros(3)), ["found ", "secret"]),
        "decimals": (_changed(n_frames=np.zeros(21)), ["'n_frames': expected shape (21,) of int32", "of float64"]),
        "2-D goals": (_changed(goal_location=np.zeros((21, 2))), ["'goal_location': expected shape (21, 3)"]),
        "objects": (_changed(opaque_id=np.array([{}] * 21, dtype=object)), ["'opaque_id'", "found Python objects"]),
        "no file": (Path.unlink, ["c.npz: expected an .npz file, found no file"]),
        "other bytes": (lambda path: path.write_bytes(b"nothing of the kind"), ["expected a readable"]),
    }),
    *bad_files("a method's TOML file", _described, read_description, {
        "empty": (_written(""), ["glide.toml: ", "missing required field `method`"]),
        "no command": (_written("[method]\n"), ["glide.toml, method: ", "missing required field `command`"]),
        "another table": (_written("[metod]\n", behind=True), ["unknown field `metod`", "Did you mean 'method'?"]),
        "another key": (_written('[method]\ncomand = "x"\n'), ["method: ", "unknown field `comand`"]),
        "another limit": (_written("[limits]\nbatch = 3\n", behind=True), ["limits: ", "unknown field `batch`"]),
        "no time": (_written("[limits]\nbatch_s = 0\n", behind=True), ["limits.batch_s: ", "> 0"]),
        "words for a time": (_written('[limits]\nstart_s = "long"\n', behind=True), ["limits.start_s: ", "got `str`"]),
        "a misspelt place": (
            _written('[environment]\nvirtual_environment = "v"\n', behind=True), ["unknown field `virtual_environment`"]
        ),
        "two places": (
            _written('[environment]\nconda = "a"\ncontainer = "b"\n', behind=True),
            ["environment.container: ", "found conda and container"],
        ),
        "GPUs of nothing": (
            _written("[environment]\ngpus = true\n", behind=True), ["environment.gpus: ", "beside 'container' only"]
        ),
        "another engine": (_written('[environment]\nengine = "lxc"\n', behind=True), ["environment.engine: ", "'lxc'"]),
        "our variable": (
            _written('[environment]\nvariables = { PRBENCH_CACHE = "x" }\n', behind=True),
            ["variables.PRBENCH_CACHE: ", "never get"],
        ),
        "our name": (_written('[method]\nname = "Ground-Truth"\ncommand = "x"\n'), ["method.name: ", "own, found"]),
        "a name with a bar": (_written('[method]\nname = "a|b"\ncommand = "x"\n'), ["method.name: ", "own, found"]),
        "no TOML": (_written("[method\n"), ["glide.toml: expected a TOML file"]),
        "gone": (lambda path: path.rename(path.with_name("glide2.toml")), ["Did you mean 'glide2.toml'?"]),
    }),
]  # fmt: skip
