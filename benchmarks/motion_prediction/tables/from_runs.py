"""Scores of finished runs (`prbench run --benchmark motion-prediction`) as rows of the tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.errors import RunError
from prbench.harness.run_folder import RunFolder, RunRecord, read_scores
from prbench_benchmarks.motion_prediction.published_numbers import TableRow, load_tables
from prbench_benchmarks.motion_prediction.scoring import Scores
from prbench_benchmarks.motion_prediction.table import WindowsTable

_BENCHMARK = "motion-prediction"


def scores_of_runs(paths: Sequence[Path], table: WindowsTable) -> dict[str, Scores]:
    """Read the scores of runs by the name of the row that each is.

    Args:
        paths: Run folders, or folders that hold some.
        table: The windows that all were made on.

    Raises:
        RunError: for a run of another benchmark or table, one that is not finished, none at all, two of one row, or
            one that no row of the tables is.
    """
    found: dict[str, Scores] = {}
    windows: dict[str, Mapping[str, list]] = {}
    for path in _folders(paths):
        run = RunFolder.open(path, any_benchmark=True)
        files = _files(run, table)
        row = _row_of(path, run.record)
        if row.name in found:
            raise RunError(f"{path}: a second run of the row '{row.label}'. Name one of them.")
        scores = _wide(read_scores(files), table)
        windows[row.name] = {"window_id": sorted(scores.columns["window_id"])}
        found[row.name] = scores
    names = list(found)
    for name in names[1:]:
        if windows[name] != windows[names[0]]:
            raise RunError(
                f"the runs of '{names[0]}' and '{name}' are of different windows. Run both with the same --split and"
                " --limit."
            )
    return found


def _folders(paths: Sequence[Path]) -> list[Path]:
    folders = [
        folder
        for path in paths
        for folder in (
            [path] if (path / "run.json").is_file() else sorted(each.parent for each in path.glob("*/run.json"))
        )
    ]
    if not folders:
        raise RunError(f"{', '.join(map(str, paths))}: expected run folders, found none.")
    return folders


def _files(run: RunFolder, table: WindowsTable) -> Path:
    """The run's scores on this table."""
    if run.record.benchmark != _BENCHMARK:
        raise RunError(f"{run.path}: expected a run of {_BENCHMARK}, found one of {run.record.benchmark}.")
    for each in run.record.tables:
        if each.content_digest == table.info.content_digest:
            return run.dataset(each.dataset).scores
    raise RunError(f"{run.path}: expected a run on {table.folder}, found one on other windows.")


def _row_of(path: Path, record: RunRecord) -> TableRow:
    """The row by method and condition; where ablations have the same ones, by the name of the weights."""
    weights = Path(record.method.weights or "").stem
    rows = [row for row in load_tables().rows if (row.method, row.condition) == (record.method.name, record.condition)]
    named = [row for row in rows if row.weights and row.weights == weights]
    usual = [row for row in rows if not row.is_ablation]
    if not rows:
        raise RunError(f"{path}: {record.method.name} under {record.condition} is no row of the study's tables.")
    return (named or usual)[0]


def _wide(long: pa.Table, table: WindowsTable) -> Scores:
    """One row a window in table order, a column a metric; NaN where a window has no value."""
    window, of_row = np.unique(long["sequence_id"].to_numpy(), return_inverse=True)
    known = table.windows["window_id"].to_pylist()
    place = {name: number for number, name in enumerate(known)}
    order = np.argsort([place[name] for name in window])
    rank = np.empty(len(window), dtype=np.int64)
    rank[order] = np.arange(len(window))
    metric = long["metric"].to_numpy()
    value = long["value"].to_numpy()
    rows = table.windows.take([place[name] for name in window[order]]).to_pylist()
    runs = table.runs.take([row["row"] for row in rows]).to_pylist()
    columns: dict[str, object] = {
        "window_id": window[order].tolist(),
        "recording_id": [run["recording_id"] for run in runs],
        "participant_id": [run["participant_id"] for run in runs],
        "segment": [run["segment"] for run in runs],
        "anchor": [row["anchor"] for row in rows],
    }
    for name in dict.fromkeys(metric.tolist()):
        here = metric == name
        values = np.full(len(window), np.nan)
        values[rank[of_row[here]]] = value[here]
        columns[str(name)] = values
    scores = Scores()
    scores.add(columns)
    return scores
