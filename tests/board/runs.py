"""Run folders with given means, boards of them, and what an export shows."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any

import msgspec

from prbench.board import collect_runs, export, make_leaderboard
from prbench.board.tables import Leaderboard
from prbench.harness.results import CheckedSummary
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import RunCost, RunRecord, TableRecord
from prbench.harness.run_folder.scores import write_scores
from prbench.harness.run_folder.summary import DatasetSummary, MetricSummary
from prbench.metrics import METRICS
from tests.harness.run_folder.test_record import METHOD, RECORD, SUMMARY, TABLE


def metrics(**means: float) -> tuple[MetricSummary, ...]:
    values = {info.id: 0.5 for info in METRICS if info.main} | means
    rest = {"level": 0.95, "interval": "bootstrap", "sequences": 80, "recordings": 12, "marks": (), "flags": {}}
    return tuple(
        MetricSummary(
            metric=info.id, title=info.title, unit=info.unit, mean=values[info.id], low=values[info.id] * 0.9,
            high=values[info.id] * 1.1, **rest,
        )
        for info in METRICS
        if info.id in values
    )  # fmt: skip


def write_run(
    folder: Path,
    method: str = "pr",
    *,
    datasets: tuple[str, ...] = ("synthetic-adt",),
    sequences: int = 80,
    record: dict | None = None,
    table: dict | None = None,
    summary: dict | None = None,
    about: dict | None = None,
    **means: float,
) -> Path:
    """A finished run with the given means; ``about`` changes the record of the method."""
    usual = {"name": method, "kind": "adapter", "motionless": False, "options": {}}
    made = msgspec.structs.replace(METHOD, **(usual | (about or {})))
    tables = tuple(
        msgspec.structs.replace(TABLE, **{"dataset": name, "sequences": sequences, **(table or {})})
        for name in datasets
    )
    run: RunRecord = msgspec.structs.replace(RECORD, **{"method": made, "tables": tables, **(record or {})})
    run.write(folder)
    for name in datasets:
        given = {
            "dataset": name, "title": f"{name} title (synthetic)", "method": method, "sequences": sequences,
            "recordings": 12, "metrics": metrics(**means), **(summary or {}),
        }  # fmt: skip
        result: DatasetSummary = msgspec.structs.replace(SUMMARY, **given)
        path = folder / name
        result.write(path)
        write_scores(path / "scores.parquet", ())
        RunCost().write(path / "cost.json")
    return folder


def leaderboard(*folders: Path) -> Leaderboard:
    """A board of summaries without scores, as if the data supported every difference of means."""
    return make_leaderboard(collect_runs(folders, check=as_stored), separate=by_means)


def board_of(folder: Path, **runs: dict[str, Any]) -> Leaderboard:
    """A board of runs, each described by what :func:`write_run` is given; folders and methods have the names."""
    for name, given in runs.items():
        write_run(folder / name, **{"method": name, **given})
    return leaderboard(folder)


def by_means(rows, metrics):
    beaten = {}
    for i, row in enumerate(rows):
        for info in metrics:
            sign = 1 if info.higher_is_better else -1
            own = row.summary.metric(info.id)
            others = {j: other.summary.metric(info.id) for j, other in enumerate(rows)}
            if own is None:
                continue
            beaten[i, info.id] = frozenset(
                j for j, found in others.items() if found is not None and sign * found.mean > sign * own.mean
            )
    return beaten


def as_stored(run: RunFolder, table: TableRecord) -> CheckedSummary:
    """Summaries that follow from no scores are taken as they are."""
    return CheckedSummary(DatasetSummary.read(run.dataset(table.dataset).path), "")


def only(items):
    (item,) = items
    return item


def by_method(board: Leaderboard) -> dict:
    """The rows of the board's only table."""
    return {row.entry.method: row for row in only(board.tables).rows}


def csv_rows(board: Leaderboard) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(export(board, "csv"))))


def cells(markdown: str, heading: str = "synthetic-adt title") -> list[list[str]]:
    block = markdown.split(f"## {heading}")[1].split("\n## ")[0]
    lines = [line for line in block.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def printed(board: Leaderboard, heading: str = "synthetic-adt title") -> dict[str, list[str]]:
    """The printed rows of a table, by their method."""
    return {row[1]: row for row in cells(export(board, "md"), heading)[2:]}
