"""The rows of the study's Table 2 (``table_2.toml``: method, weights, condition), and what a user asks of them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal

import msgspec

import prbench
from prbench.contract import Condition
from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import UsageError, did_you_mean
from prbench.files.storage import text_digest
from prbench.harness.controls import GROUND_TRUTH, GROUND_TRUTH_RESAMPLED, SCRIPTED, SHUFFLED_GOAL
from prbench.harness.methods.installed import NEAREST_NEIGHBOUR
from prbench.harness.preparation import DEFAULT_PARENT
from prbench.harness.scripted import CHEATS
from prbench.protocol.manifests import read_toml
from prbench.protocol.own_protocol import read_protocol
from prbench.protocol.published import load_table_one
from prbench.sequences import SequenceTable

_PACKAGE = "prbench_benchmarks.prime_and_reach"
_FILE = "table_2.toml"
DEFAULT_MINUTES = 30
CONTROLS = (GROUND_TRUTH, GROUND_TRUTH_RESAMPLED, SCRIPTED)
"""Controls that always stand beside the rows."""
MORE_CONTROLS = (*CHEATS, NEAREST_NEIGHBOUR)
"""Controls that stand there if asked for: what the metrics give a body that cheats, and a training motion."""


class Block(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Rows under one condition."""

    condition: Condition
    title: str
    """Title as printed."""


class RowWeights(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The weights of a row in the study."""

    state: Literal["none", "pretrained", "finetuned"]
    """Pre-trained ones were never shown a prime-and-reach sequence: zero-shot."""
    trained_on: str
    """``all`` training sequences, or the corpus."""
    variant: str
    """The row's variant in the published tables in long form."""


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One printed row."""

    label: str
    """Label as printed."""
    method: str
    weights: str
    """Key in :attr:`TableTwo.weights`, and the name under which a user's own are found."""
    condition: Condition
    bundled: str = ""
    """Name of the weights that come with prbench for it; empty if there are none, or the method needs none."""

    @property
    def name(self) -> str:
        """Unique, and fit to be a folder's name."""
        return f"{self.condition.value}-{self.method}-{self.weights.removeprefix(f'{self.method}-')}"


class TableTwo(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file.

    Raises:
        ValueError: if a row repeats, its weights are not listed, or its condition has no block.
    """

    table: str
    blocks: tuple[Block, ...]
    weights: dict[str, RowWeights]
    rows: tuple[Row, ...]

    def __post_init__(self) -> None:
        names = [row.name for row in self.rows]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"rows: '{name}' stands there {names.count(name)} times")
        conditions = [block.condition for block in self.blocks]
        if len(set(conditions)) < len(conditions):
            raise ValueError("blocks: a condition has more than one")
        for row in self.rows:
            if row.weights not in self.weights:
                hint = did_you_mean(row.weights, self.weights)
                raise ValueError(f"rows: '{row.label}' names the weights '{row.weights}', which are not listed.{hint}")
            if row.condition not in conditions:
                raise ValueError(f"rows: '{row.label}' is under '{row.condition.value}', which has no block")
        unused = sorted(set(self.weights) - {row.weights for row in self.rows})
        if unused:
            raise ValueError(f"weights: no row has '{unused[0]}'")

    @property
    def methods(self) -> tuple[str, ...]:
        """Ids, in order of appearance."""
        return tuple(dict.fromkeys(row.method for row in self.rows))

    def chosen(self, method: str | None, condition: Condition | None) -> tuple[Row, ...]:
        """The rows of one method or all, under one condition or all.

        Raises:
            UsageError: if there is none.
        """
        if method is not None and method not in self.methods:
            raise UsageError(
                f"--condition all: Table 2 has no rows of '{method}'; its methods are: {', '.join(self.methods)}."
                f"{did_you_mean(method, self.methods)} Name one condition to run another method."
            )
        rows = tuple(
            row
            for row in self.rows
            if (method is None or row.method == method) and (condition is None or row.condition == condition)
        )
        if not rows:
            raise UsageError(f"Table 2 has no rows of '{method or 'all'}' under '{condition or 'all'}'.")
        return rows


@cache
def load_table_two() -> TableTwo:
    """The rows as they come with prbench.

    Raises:
        InputFileError: if the file does not fit the data class (naming the key).
    """
    return read_toml(_PACKAGE, _FILE, TableTwo)


@dataclass(frozen=True, kw_only=True)
class TableRequest:
    """Table 2, or the rows of one method or one condition, on one or several tables.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    data: tuple[Path, ...]
    """Dataset folders."""
    method: str | None = None
    """The method; None for all."""
    condition: Condition | None = None
    """The condition; None for all."""
    weights: Path | None = None
    """Folder with weights by the names of ``table_2.toml``; those that come with prbench take the place of others."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Maps ``method.key`` to a value; a table of one method takes plain keys too."""
    split: str = "test"
    limit: int | None = None
    """Sequences of each dataset; None for as many as fit in ``minutes``."""
    minutes: int = DEFAULT_MINUTES
    seed: int = 0
    samples: int = 1
    batch_size: int | None = None
    """Sequences of a batch; None for a number that follows from the number of sequences."""
    device: str = "cpu"
    threads: int = 1
    protocol: Path | None = None
    """The user's own protocol; None for prbench's."""
    shuffled_goal: bool = False
    """True if every goal row stands there with other sequences' goals, too."""
    more_controls: bool = False
    """True if :data:`MORE_CONTROLS` stand beside the rows, too."""
    out: Path | None = None
    """Folder of the table; by default one under ``runs`` whose name says what was asked."""

    def __post_init__(self) -> None:
        if not self.data:
            raise UsageError("a table needs one dataset folder or more (--data DIR).")
        load_table_two().chosen(self.method, self.condition)
        if self.weights is not None and not any(self._weights_named(name) for name in load_table_two().weights):
            found = "a folder without any" if self.weights.is_dir() else "no folder"
            raise UsageError(
                f"--weights {self.weights}: expected a folder of weights for a table, found {found}. It holds NAME or"
                f" NAME.safetensors for one or more of: {', '.join(load_table_two().weights)}."
            )
        for key in self.options:
            method = key.partition(".")[0] if "." in key else self.method
            if method is None or method not in load_table_two().methods:
                raise UsageError(
                    f"--option {key}=…: expected METHOD.{key.rpartition('.')[2]}=… for a table of several methods;"
                    f" these are: {', '.join(load_table_two().methods)}."
                )

    @property
    def rows(self) -> tuple[Row, ...]:
        """The rows that are asked for, in printed order."""
        return load_table_two().chosen(self.method, self.condition)

    def options_of(self, method: str) -> dict[str, str]:
        """The options of one method."""
        # A key with a method's name in front wins over a plain one.
        plain = {key: value for key, value in self.options.items() if "." not in key}
        own = {key.partition(".")[2]: value for key, value in self.options.items() if key.startswith(f"{method}.")}
        return plain | own

    def user_weights(self, row: Row) -> Path | None:
        """The user's own weights of a row: a file, or a folder such as ``prbench train`` leaves."""
        return self._weights_named(row.weights)

    def _weights_named(self, name: str) -> Path | None:
        if self.weights is None:
            return None
        paths = (self.weights / name, self.weights / f"{name}.safetensors")
        return next((path for path in paths if path.exists()), None)

    def tables(self) -> list[SequenceTable]:
        """The tables, in the study's order, others behind by name.

        Raises:
            TableError: if one is missing, empty or of an unknown version.
            UsageError: if datasets repeat.
        """
        tables = [SequenceTable.open(folder).with_sequences() for folder in self.data]
        names = [table.info.dataset for table in tables]
        for name in names:
            if names.count(name) > 1:
                raise UsageError(f"--data: expected different datasets, found {name} more than once.")
        return sorted(tables, key=lambda table: _place(table.info.dataset))

    def folder(self) -> Path:
        """Return the folder of the table; the same request finds its folder again."""
        if self.out is not None:
            return self.out
        tables = self.tables()
        datasets = "+".join(table.info.dataset for table in tables)
        weights = "" if self.weights is None else os.path.realpath(self.weights)
        # The digest makes the folder's name the same for the same request and another one for any other, so that a
        # repeated command resumes and nothing is mixed.
        decided = (part for pair in self.deciding(tables).items() for part in pair)
        name = f"table-2-{datasets}-{text_digest(weights, *decided)[:8]}"
        return DEFAULT_PARENT / re.sub(r"[^\w.+-]", "_", name)

    def deciding(self, tables: list[SequenceTable]) -> dict[str, str]:
        """Map the user's name of everything that decides the rows to its value; empty where it was left to prbench.

        The weights do not stand here: the run folder of each row records its own.
        """
        settings = {
            "version of prbench": prbench.__version__,
            "--method": self.method or "all",
            "--condition": self.condition.value if self.condition is not None else "all",
            "--option": " ".join(f"{key}={value}" for key, value in sorted(self.options.items())),
            "--split": self.split,
            "--limit": "" if self.limit is None else str(self.limit),
            "--minutes": str(self.minutes) if self.limit is None else "",
            "--seed": str(self.seed),
            "--samples": str(self.samples),
            "--batch-size": "" if self.batch_size is None else str(self.batch_size),
            "--device": self.device,
            "--threads": str(self.threads),
            "--control": SHUFFLED_GOAL if self.shuffled_goal else "",
        }
        if self.more_controls:
            settings["--with-controls"] = "yes"
        if self.protocol is not None:
            settings["--protocol"] = read_protocol(self.protocol).digest
        return settings | {f"table {table.info.dataset}": f"{table.identity} {table.content}" for table in tables}


def _place(dataset: str) -> tuple[int, str]:
    printed = tuple(load_table_one())
    plain = dataset.removeprefix(SYNTHETIC_PREFIX)
    return (printed.index(plain) if plain in printed else len(printed), dataset)
