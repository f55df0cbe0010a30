"""The printed numbers of the study of motion prediction (*GazeMoDiff*), typed again, and the rows of its tables.

Source: ``benchmarks/motion_prediction/published`` and ``benchmarks/motion_prediction/tables.toml``.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

import msgspec

from prbench.protocol.manifests import read_toml
from prbench_benchmarks.motion_prediction.batch import Condition

_PACKAGE = "prbench_benchmarks.motion_prediction"
TABLES = ("1", "2", "3")
"""Numbers of the study's tables of scores."""
PUBLISHED_METRICS = ("ade", "fde", "mmade", "mmfde")
"""Ids of the metrics in them, metres, less is better."""
PUBLISHED_DATASETS = ("mogaze", "gimo")


@dataclass(frozen=True)
class PublishedScore:
    """One printed number."""

    table: str
    """``1``, ``2``, ``3``, or ``text`` for the diversities of the running text."""
    dataset: str
    method: str
    variant: str
    """What tells two rows of one method apart, in words."""
    metric: str
    printed: str
    """The digits as printed, metres."""
    note: str = ""
    """What is known to be odd about it."""

    @property
    def value(self) -> float:
        """The number, metres."""
        return float(self.printed)


class TableRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A row of one or several tables."""

    label: str
    method: str
    condition: Condition
    variant: str
    """The row's variant among the published numbers; empty for a row that the study does not have."""
    weights: str
    """Name of the configuration and of the weights; empty for what needs none."""
    tables: tuple[str, ...]

    @property
    def name(self) -> str:
        """Unique, and fit to be a file's name."""
        return f"{self.weights or self.method}-{self.condition.value.replace('+', '-')}"

    @property
    def is_ablation(self) -> bool:
        """Stands among the ablations alone: its weights are never those that come with the method."""
        return self.tables == ("3",)


class PredictionTables(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file."""

    titles: Mapping[str, str]
    sections: Mapping[str, str]
    rows: tuple[TableRow, ...]

    def of(self, table: str) -> tuple[TableRow, ...]:
        """The rows of one table in the printed order."""
        return tuple(row for row in self.rows if table in row.tables)


@cache
def load_tables() -> PredictionTables:
    """The rows of Tables 1, 2 and 3, and what stands beside them."""
    return read_toml(_PACKAGE, "tables.toml", PredictionTables)


@cache
def load_published_scores(table: str) -> tuple[PublishedScore, ...]:
    """Read the numbers of a table in printed order.

    Args:
        table: ``1``, ``2`` or ``3``; ``text`` for the diversities (APD) of the running text.

    Raises:
        ValueError: for another table.
    """
    if table not in (*TABLES, "text"):
        raise ValueError(f"no table '{table}' of scores; those of the study are: {', '.join(TABLES)}, text")
    name = "apd.csv" if table == "text" else f"table_{table}.csv"
    text = (resources.files(f"{_PACKAGE}.published") / name).read_text(encoding="utf-8")
    return tuple(
        PublishedScore(
            table=table,
            dataset=row["dataset"],
            method=row["method"],
            variant=row["variant"],
            metric=row["metric"],
            printed=row["value"],
            note=row["note"],
        )
        for row in csv.DictReader(text.splitlines())
    )


def published_scores(table: str, row: TableRow, dataset: str) -> Mapping[str, PublishedScore]:
    """The printed numbers of one row on one dataset by metric; none for a row that the study does not have."""
    return {
        each.metric: each
        for each in load_published_scores(table)
        if (each.dataset, each.method, each.variant) == (dataset, row.method, row.variant)
    }
