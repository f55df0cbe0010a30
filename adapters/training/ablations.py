"""The rows of the study's ablations as configurations (*Prime and Reach*, tables 3, 4 and S4 to S7).

``prbench study table-3 --train`` trains and runs the rows of a table.
"""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

from prbench.metrics import METRICS

_Pretraining = Literal["none", "nymeria", "humanml3d"]

_ONLY_IN_FINE_TUNING = frozenset({"goal", "dropped", "injection", "joint_loss_weight"})


@dataclass(frozen=True)
class Ablation:
    """One row of a table: what is changed in the full model.

    Attributes:
        model: Keys of ``[model]`` for fine-tuning.
        options: Options of ``prbench run --method pr``.
    """

    table: str
    condition: str
    variant: str
    model: Mapping[str, Any]
    options: Mapping[str, str]
    pretraining: _Pretraining

    @property
    def name(self) -> str:
        """Name for folders: letters, digits and hyphens."""
        return _slug(f"table {self.table} {self.condition} {self.variant}")

    @property
    def prior_name(self) -> str:
        """Folder name of the pre-training; rows with the same one share it. Empty without pre-training."""
        return "" if self.pretraining == "none" else _folder_name("mdm", self.pretraining, self.pretrained_model)

    @property
    def training_name(self) -> str:
        """Folder name of the fine-tuning; rows with the same one share it."""
        return _folder_name("pr", self.pretraining, self.model)

    @property
    def run_name(self) -> str:
        """Folder name of the run: rows that change the same share one, as the full model does in every table."""
        return _slug(" ".join([self.training_name, *(f"{key} {value}" for key, value in sorted(self.options.items()))]))

    @property
    def pretrained_model(self) -> dict[str, Any]:
        """Keys of ``[model]`` that pre-training shares, because fine-tuning cannot change them."""
        # Rows that differ only in fine-tuning share one pre-training, which is most of the time.
        shared = {key: value for key, value in self.model.items() if key not in _ONLY_IN_FINE_TUNING}
        return shared | ({"uniform_skeleton": True} if self.pretraining == "humanml3d" else {})

    def published(self) -> dict[str, dict[str, float]]:
        """Return the study's numbers by dataset and metric; rates from 0 to 1, metres."""
        return _published()[self.table, self.condition, self.variant]


def load_ablations() -> tuple[Ablation, ...]:
    """All rows, in the order of the study's tables."""
    content = tomllib.loads(_read("prbench_benchmarks.prime_and_reach", "ablations.toml"))
    full = content["full"]
    rows = []
    for row in content["row"]:
        rows.append(Ablation(**full | row | {key: full[key] | row.get(key, {}) for key in ("model", "options")}))
    return tuple(rows)


@cache
def _published() -> dict[tuple[str, str, str], dict[str, dict[str, float]]]:
    found: dict[tuple[str, str, str], dict[str, dict[str, float]]] = {}
    for row in csv.DictReader(_read("prbench_benchmarks.prime_and_reach.published", "ablations.csv").splitlines()):
        numbers = {info.id: float(row[info.id]) / info.scale for info in METRICS if info.id in row}
        found.setdefault((row["table"], row["condition"], row["variant"]), {})[row["dataset"]] = numbers
    return found


def _read(package: str, name: str) -> str:
    return resources.files(package).joinpath(name).read_text(encoding="utf-8")


def overrides(model: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Return keys of ``[model]`` as ``prbench train --set`` takes them."""
    return tuple((f"model.{key}", _toml(value)) for key, value in model.items())


def _folder_name(method: str, pretraining: _Pretraining, model: Mapping[str, Any]) -> str:
    return _slug(" ".join([method, pretraining, *(f"{key} {_toml(value)}" for key, value in sorted(model.items()))]))


def _slug(words: str) -> str:
    return "-".join(re.findall(r"[a-z0-9]+", words.lower()))


def _toml(value: Any) -> str:
    """Write a value as ``--set`` takes it; plain words need no quotes."""
    return value if isinstance(value, str) else json.dumps(value)
