"""``table_2.toml``: the rows of the study's Table 2 as triples method, weights, condition."""

from __future__ import annotations

from functools import cache
from typing import Literal

import msgspec

from prbench.contract import Condition
from prbench.errors import UsageError, did_you_mean
from prbench.manifests import read_toml

_PACKAGE, _FILE = "prbench_benchmarks.prime_and_reach", "table_2.toml"


class Block(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Rows under one condition."""

    condition: Condition
    title: str
    """As printed."""


class RowWeights(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the weights of a row are in the study."""

    state: Literal["none", "pretrained", "finetuned"]
    """Pre-trained ones were never shown a prime-and-reach sequence: zero-shot."""
    trained_on: str
    """``all`` training sequences, or the corpus."""
    variant: str
    """The row's variant in the published tables in long form."""


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One printed row."""

    label: str
    """As printed."""
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
