"""Two runs on the same sequences: the command ``prbench leaderboard compare``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.api.arguments import PathLike, as_path, require_positive
from prbench.api.frames import frame_from_rows, notebook_table
from prbench.api.runs import Run
from prbench.api.scoring import Scores
from prbench.api.tables import Table, table_folders
from prbench.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd

    from prbench.board.comparison import ComparedMetric, RunComparison

_COLUMNS = (
    "dataset", "metric", "title", "unit", "difference", "low", "high", "p_value", "adjusted_p_value", "conclusion",
)  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """The differences of two runs, sequence by sequence, and the support that the data give them."""

    first: Path
    """Folder of the first run."""
    second: Path
    """Folder of the second run."""
    _found: RunComparison

    @property
    def folder(self) -> tuple[Path, Path]:
        """Folders of the two runs."""
        return self.first, self.second

    @property
    def unverified(self) -> tuple[str, ...]:
        """A line for each run and dataset whose scores could not be held against the motions, with the reason."""
        return self._found.unverified

    @property
    def summary(self) -> str:
        """One line a dataset and metric: the mean difference, first minus second, and what may be concluded."""
        return "\n".join(
            f"{row.dataset}, {row.info.title}: {_change(row)} ({self._said(row)})" for row in self._found.metrics
        )

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a dataset and metric.

        Returns:
            Columns ``dataset, metric, title, unit, difference`` (mean of first minus second), ``low, high`` (bounds of
            its 95 % interval), ``p_value, adjusted_p_value`` (after Holm's correction for all rows; None below six
            recordings) and ``conclusion`` (``higher``, ``lower`` or ``not supported by the data``). Rates lie between
            0 and 1, lengths are in metres.
        """
        rows = []
        for row in self._found.metrics:
            difference = row.comparison.difference
            about = (row.dataset, row.info.id, row.info.title, row.info.unit)
            found = (row.comparison.p_value, row.comparison.adjusted_p_value, row.comparison.conclusion)
            rows.append((*about, difference.mean, difference.low, difference.high, *found))
        return frame_from_rows(rows, _COLUMNS)

    def _said(self, row: ComparedMetric) -> str:
        conclusion = row.comparison.conclusion
        return conclusion if conclusion.startswith("not") else f"{self.first.name} is {conclusion}"

    def __repr__(self) -> str:
        return f"<Comparison of {self.first.name} with {self.second.name}>"

    def _repr_html_(self) -> str:
        columns = ("dataset", "metric", "difference", "95 % interval", "p (Holm)", "")
        rows = []
        for row in self._found.metrics:
            difference = row.comparison.difference
            p_value = row.comparison.adjusted_p_value
            interval = "–"
            if "all_equal" in difference.marks:
                interval = "all equal"  # a bootstrap of equal differences would claim certainty
            elif difference.low is not None and difference.high is not None:
                interval = f"[{difference.low * row.info.scale:+.2f}, {difference.high * row.info.scale:+.2f}]"
            shown_p = "–" if p_value is None else f"{p_value:.4f}"
            rows.append((row.dataset, row.info.title, _change(row), interval, shown_p, self._said(row)))
        title = f"{self.first.name} against {self.second.name}, sequence by sequence"
        remarks = [f"unverified: {reason}" for reason in self.unverified]
        return notebook_table(title, frame_from_rows(rows, columns), remarks)


def _change(row: ComparedMetric) -> str:
    from prbench.metrics import printed_unit

    unit = " points" if row.info.unit == "rate" else printed_unit(row.info.unit)
    return f"{row.comparison.difference.mean * row.info.scale:+.2f}{unit}"


def compare(
    first: PathLike | Run | Scores,
    second: PathLike | Run | Scores,
    *,
    data: PathLike | Table | Iterable[PathLike | Table] = (),
    workers: int = 1,
) -> Comparison:
    """Say where two runs on the same sequences differ, and whether the data support it.

    The command is ``prbench leaderboard compare``. Signs are flipped by recording and p-values corrected after Holm
    (docs/specification/protocol.md#comparisons).

    Args:
        first: A finished run, or its folder; scores that were written with ``out`` will do.
        second: Another one, of the same sequences.
        data: The tables of the runs: scores are held against the motions on them, and called unverified without. Those
            of runs that :func:`prbench.run` has just made, and prbench's own table, need not be named.
        workers: Processes to use; changes no result. A script that asks for several needs
            ``if __name__ == "__main__":``.

    Returns:
        The comparison.

    Raises:
        RunError: if a run is unfinished, its scores do not follow from its motions, or the two are not of the same
            protocol, tables and sequences.
        UsageError: if scores were never written.
    """
    from prbench.board import compare_runs
    from prbench.engine import engine_for
    from prbench.harness.first_run import table_finder
    from prbench.harness.verification import RunChecker

    require_positive(workers=workers)
    folders = _folder_of(first), _folder_of(second)
    remembered = [folder for run in (first, second) if isinstance(run, Run) for folder in run.tables]
    tables = table_folders(data) or tuple(dict.fromkeys(remembered))
    checker = RunChecker(table_finder(tables), engine_for(workers))
    return Comparison(*folders, compare_runs(*folders, checker=checker))


def _folder_of(run: PathLike | Run | Scores) -> Path:
    """Return the folder of a run.

    Raises:
        UsageError: if there is none.
    """
    if isinstance(run, Run):
        return run.folder
    if isinstance(run, Scores):
        if run.folder is None:
            raise UsageError("these scores were not written: give score() a folder with out=, and compare that.")
        return run.folder
    return as_path(run)
