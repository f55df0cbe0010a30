"""The study's printed numbers (*Prime and Reach*), typed again, with their tables and notes.

The files stand in ``benchmarks/prime_and_reach/published``; ``notes.toml`` there says which table each comes from, and
what the study leaves open that could explain a difference to a measured number.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

# The five datasets in the study's order.
DATASETS = ("hd-epic", "mogaze", "hot3d", "adt", "gimo")
_PACKAGE = "prbench_benchmarks.prime_and_reach.published"
_ABLATED_METRICS = ("prime_success", "reach_success", "location_error", "mpjpe")


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation over sequences.

    Attributes:
        mean: Their mean.
        sd: Their standard deviation.
    """

    mean: float
    sd: float


@cache
def printed_rows(package: str, name: str) -> tuple[dict[str, str], ...]:
    """Read a CSV of printed numbers of a benchmark's package, in printed order; one mapping a row, texts as printed."""
    text = (resources.files(package) / f"{name}.csv").read_text(encoding="utf-8")
    return tuple(csv.DictReader(text.splitlines()))


# The four quantities of Table 1 and their units.
QUANTITIES = {"duration": "s", "prime_gap": "s", "body_movement": "m", "hand_movement": "m"}


@dataclass(frozen=True)
class PublishedRow:
    """One dataset in Table 1 and Table S2; seconds and metres."""

    sequences: int
    train: int
    test: int
    duration: Spread
    prime_gap: Spread
    body_movement: Spread
    hand_movement: Spread


@dataclass(frozen=True)
class PublishedNumber:
    """One cell of a table of the study.

    Attributes:
        table: Number of the table, such as ``S3``.
        condition: A condition of the protocol or, in Table 3, the study's words for what the model is given.
        method: Id of the method; ``real`` for recorded motion in Table S8.
        variant: What tells two rows of one method apart, in words.
        metric: Id of the metric.
        printed: The digits as printed: rates in %, lengths in metres; empty for a dash.
        plus_minus: The number after ±, in Table S8 only.
        note: What is known to be odd about the cell.
    """

    table: str
    dataset: str
    condition: str
    method: str
    variant: str
    metric: str
    printed: str
    plus_minus: str = ""
    note: str = ""

    @property
    def value(self) -> float | None:
        """The number in the printed unit; None for a dash."""
        return float(self.printed) if self.printed else None

    @property
    def source(self) -> str:
        """Name the place where the number is printed, such as a table and its section."""
        return f"published: {cite(self.table)}"


@dataclass(frozen=True)
class PublishedTable:
    """What is known of one table of the study."""

    number: str
    title: str
    section: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Assumption:
    """A choice that the study leaves open, which could explain a difference to a published number."""

    id: str
    metrics: tuple[str, ...]
    text: str


@cache
def load_table_one() -> dict[str, PublishedRow]:
    """Return the published rows by dataset."""
    rows = {}
    for row in _csv_rows("table_1_and_s2.csv"):
        spreads = {name: Spread(float(row[f"{name}_mean"]), float(row[f"{name}_sd"])) for name in QUANTITIES}
        rows[row["dataset"]] = PublishedRow(int(row["sequences"]), int(row["train"]), int(row["test"]), **spreads)
    return rows


@cache
def load_published(table: str) -> tuple[PublishedNumber, ...]:
    """Read the numbers of a table of scores in printed order.

    Args:
        table: ``2``, ``3``, ``4``, ``S1`` or ``S3`` to ``S8``; Tables 1 and S2 are :func:`load_table_one`.

    Raises:
        ValueError: for a table that holds no scores, or that the study does not have.
    """
    known = _notes()["tables"]
    if table not in known or table in ("1", "S2"):
        scores = [name for name in known if name not in ("1", "S2")]
        raise ValueError(f"no table of scores '{table}'; those of the study are: {', '.join(scores)}")
    file = known[table]["file"]
    numbers = []
    for row in _csv_rows(file):
        if file == "ablations.csv":  # a column a metric, several tables in one file
            cells = {metric: row.pop(metric) for metric in _ABLATED_METRICS}
            if row.pop("table") == table:
                numbers += [
                    PublishedNumber(table=table, method="pr", metric=metric, printed=printed, **row)
                    for metric, printed in cells.items()
                ]
        else:
            numbers.append(PublishedNumber(table=table, printed=row.pop("value"), **row))
    return tuple(numbers)


def published_table(table: str) -> PublishedTable:
    """Return title, section and notes of a table of the study."""
    entry = _notes()["tables"][table]
    return PublishedTable(table, entry["title"], entry["section"], tuple(entry["notes"]))


def cite(table: str) -> str:
    """Return the reference of a table in words."""
    return f"Prime and Reach, Table {table} (section {published_table(table).section})"


@cache
def load_assumptions() -> tuple[Assumption, ...]:
    """Read what the study leaves open, in the order of the file."""
    return tuple(Assumption(row["id"], tuple(row["metrics"]), row["text"]) for row in _notes()["assumptions"])


def assumptions_for(metrics: Iterable[str]) -> tuple[Assumption, ...]:
    """Return the open choices that concern one of these metrics."""
    wanted = set(metrics)
    return tuple(each for each in load_assumptions() if wanted & set(each.metrics))


def _csv_rows(name: str) -> list[dict[str, str]]:
    return list(csv.DictReader(_read(name).splitlines()))


@cache
def _notes() -> dict[str, Any]:
    return tomllib.loads(_read("notes.toml"))


def _read(name: str) -> str:
    return (resources.files(_PACKAGE) / name).read_text(encoding="utf-8")
