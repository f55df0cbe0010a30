"""The chosen windows of one table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Int

from prbench.errors import RunError, UsageError
from prbench.files.storage import text_digest
from prbench.harness.run_folder import DatasetFolder, RunFolder
from prbench.sequences.table import by_share, find_sequence_id
from prbench_benchmarks.motion_prediction.table import WindowsTable

PUBLISHED = "published"  # Value of ``--split`` that means the test split of the published evaluation.


@dataclass(frozen=True)
class WindowCases:
    """See :class:`prbench.harness.benchmark.Cases`; a window is a case.

    Attributes:
        places: Places of the windows in the table, ascending.
        pool: Places of all windows of the split, among which similar pasts are looked for, whatever the limit.
    """

    table: WindowsTable
    split: str
    places: Int[np.ndarray, " n"]
    pool: Int[np.ndarray, " all"]

    @classmethod
    def of(cls, table: WindowsTable, *, split: str, limit: int | None) -> WindowCases:
        """Choose the windows of a split; with ``limit`` every recording's share.

        Args:
            table: The table.
            split: A split of the dataset, or ``published``.
            limit: Number of windows at most; None for all.

        Raises:
            UsageError: if there is none.
        """
        places = table.chosen(published_split="test") if split == PUBLISHED else table.chosen(split=split)
        everything = cls(table, split, places, places)
        if limit is None:
            return everything
        kept = set(by_share(everything.sequence_ids, everything.recording_ids)[:limit])
        return everything.chosen(np.array([name in kept for name in everything.sequence_ids]))

    def chosen(self, keep: np.ndarray) -> WindowCases:
        """See :meth:`prbench.harness.benchmark.Cases.chosen`."""
        return replace(self, places=self.places[keep])

    @cached_property
    def sequence_ids(self) -> tuple[str, ...]:
        """Ids of the windows."""
        return tuple(self.table.windows["window_id"].take(self.places).to_pylist())

    @cached_property
    def recording_ids(self) -> tuple[str, ...]:
        """The recording of each window."""
        return tuple(self.table.runs["recording_id"].take(self.table.windows["row"].take(self.places)).to_pylist())

    @property
    def digest(self) -> str:
        """Digest of the ids."""
        return text_digest(*self.sequence_ids)

    def __len__(self) -> int:
        return len(self.places)


def single_windows(tables: Sequence[WindowsTable], wanted: Sequence[str], *, split: str) -> list[WindowCases]:
    """Choose single windows; tables that hold none of them are left out.

    Args:
        tables: The tables to look in.
        wanted: Ids, or parts of ids that fit one window of the split only.
        split: The run's split.

    Raises:
        UsageError: if none or several fit.
    """
    cases = [WindowCases.of(table, split=split, limit=None) for table in tables]
    known = [name for each in cases for name in each.sequence_ids]
    among = ", ".join(table.info.dataset for table in tables)
    ids = [find_sequence_id(name, known, among=f"split '{split}' of {among}") for name in wanted]
    chosen = [each.chosen(np.isin(each.sequence_ids, ids)) for each in cases]
    return [each for each in chosen if len(each)]


def open_windows(folders: Sequence, *, benchmark: str) -> list[WindowsTable]:
    """Open tables of windows.

    Args:
        folders: Their folders.
        benchmark: Name of the benchmark, for messages.

    Raises:
        TableError: if one is missing, edited or of an unknown version.
        UsageError: if two are of one dataset, or there is none.
    """
    if not folders:
        raise UsageError(f"--data DIR: {benchmark} needs a table of windows; `prbench build-windows` makes one.")
    tables = [WindowsTable.open(folder) for folder in folders]
    names = [table.info.dataset for table in tables]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise UsageError(f"--data: expected different datasets, found {repeated[0]} more than once.")
    return tables


def run_on(path: Path, table: WindowsTable) -> tuple[RunFolder, DatasetFolder]:
    """Open a run, and its files of a table of windows.

    Raises:
        RunError: for a run of another benchmark, or on other windows.
    """
    run = RunFolder.open(path, any_benchmark=True)
    if run.record.benchmark != "motion-prediction":
        raise RunError(f"{path}: expected a run of motion-prediction, found one of {run.record.benchmark}.")
    for each in run.record.tables:
        if each.content_digest == table.info.content_digest:
            return run, run.dataset(each.dataset)
    raise RunError(f"{path}: expected a run on {table.folder}, found one on other windows.")
