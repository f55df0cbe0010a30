"""A first batch of every row, timed; its motions are thrown away."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from prbench.engine import Engine
from prbench.errors import StorageError
from prbench.evaluation.planning import select
from prbench.evaluation.request import RunRequest
from prbench.evaluation.run import run_method
from prbench.runs.cost import read_run_cost
from prbench.sequences import SequenceTable
from prbench.workflows.table_two.budget import RowCost
from prbench.workflows.table_two.plan import PlannedRow

MEASURED_SEQUENCES = 8
"""In the one batch that is timed."""


def measured_name(planned: PlannedRow) -> str:
    """Rows that differ in nothing but their goals cost the same."""
    return planned.name if planned.row is None else planned.row.name


def measure(
    planned: list[PlannedRow],
    known: dict[str, RowCost],
    engine: Engine,
    *,
    measured: Callable[[str, RowCost], None],
    measuring: Callable[[int, int, str], None],
    seconds: float,
) -> bool:
    """Time what is not known yet; a row that fails here will say so when it is run.

    Args:
        planned: Rows that will be run.
        known: Costs by :func:`measured_name`.
        engine: The one that the table will be run with.
        measured: Called with every new cost.
        measuring: Called with finished rows, all rows and the next one's label.
        seconds: After which no further row is timed.

    Returns:
        Whether there was time for all.
    """
    started = time.monotonic()
    missing = {measured_name(row): row for row in reversed(planned) if measured_name(row) not in known}
    ordered = [row for row in planned if missing.get(measured_name(row)) is row]
    for done, row in enumerate(ordered):
        if time.monotonic() - started > seconds:
            return False
        measuring(done, len(ordered), row.label)
        cost = _cost(row, engine)
        if cost is not None:
            measured(measured_name(row), cost)
    measuring(len(ordered), len(ordered), "")
    return True


def _cost(planned: PlannedRow, engine: Engine) -> RowCost | None:
    with tempfile.TemporaryDirectory(prefix="prbench-") as folder:
        first = replace(
            planned.run,
            data=planned.run.data[:1],
            limit=MEASURED_SEQUENCES,
            batch_size=MEASURED_SEQUENCES,
            samples=1,
            control=None,
            out=Path(folder) / "run",
        )
        started = time.perf_counter()
        try:
            report = run_method(first, engine=engine)
        except StorageError:
            raise
        except Exception:
            return None
        elapsed = time.perf_counter() - started
        cost = read_run_cost(report.folder.dataset(report.summaries[0].dataset).cost)
    generating = cost.seconds + cost.warm_up_seconds
    return RowCost(seconds_per_frame=generating / _frames(first), overhead=max(0.0, elapsed - generating))


def _frames(run: RunRequest) -> int:
    """Of the sequences in the batch."""
    selection = select(SequenceTable.open(run.data[0]), split=run.split, limit=run.limit)
    return max(1, int(selection.n_frames.sum()))
