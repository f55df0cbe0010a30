"""The number of sequences of a table whose user named none: as many as fit into a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from prbench.engine import Engine, ProcessPool
from prbench.evaluation.planning import select
from prbench.sequences import SequenceTable
from prbench.sequences.table import by_hash
from prbench.workflows.table_two.budget import DatasetSize, Pace, RowCost, largest_limit, table_seconds
from prbench.workflows.table_two.measuring import Measured, forget_timing, kind, measure, near_median
from prbench.workflows.table_two.plan import PlannedRow
from prbench.workflows.table_two.request import TableRequest
from prbench.workflows.table_two.state import TablePlan

TIMING_SHARE = 1 / 3
"""Of the time, after which no further row is timed; what is not counts as the slowest that was."""


def with_limit(
    plan: TablePlan,
    request: TableRequest,
    tables: list[SequenceTable],
    planned: list[PlannedRow],
    *,
    engine: Engine,
    counting: Callable[[int, int, str], None],
    folder: Path,
) -> TablePlan:
    """The plan with its limit, found by timing a batch of every kind of row.

    Args:
        plan: With what an earlier call has timed.
        request: What is asked for.
        tables: In printed order.
        planned: Its lines; the skipped ones cost nothing.
        engine: The one that the rows will be run with.
        counting: Called with timed rows, all rows, and a row's name.
        folder: Of the table, where the plan is written.
    """
    started = time.monotonic()
    runnable = [row for row in planned if row.skipped is None]
    median = near_median(select(tables[0], split=request.split, limit=None))
    share = TIMING_SHARE * 60 * request.minutes
    measured = measure(runnable, plan.costs, median, engine, folder=folder, counting=counting, seconds=share)
    costs = [cost for row in runnable if (cost := _cost(row, measured)) is not None]
    sizes = [dataset_size(table, request.split) for table in tables]
    pace = Pace(request.batch_size, engine.workers if isinstance(engine, ProcessPool) else 1, request.samples)
    spent = time.monotonic() - started
    limit = largest_limit(costs, sizes, pace, seconds=60 * request.minutes - spent)
    expected = spent + table_seconds(costs, limit, sizes, pace)
    limited = msgspec.structs.replace(plan, costs=measured.costs, limit=limit, expected_seconds=expected)
    limited.write(folder)
    forget_timing(folder)
    return limited


def _cost(row: PlannedRow, measured: Measured) -> RowCost | None:
    """As slow as any that was timed, if this one's kind was not; None if it fails. A control generates nothing."""
    if row.name in measured.failed or not measured.costs:
        return None
    overhead = max(cost.overhead for cost in measured.costs.values())
    slowest = 0.0 if row.row is None else max(cost.seconds_per_frame for cost in measured.costs.values())
    return measured.costs.get(kind(row), RowCost(seconds_per_frame=slowest, overhead=overhead))


def dataset_size(table: SequenceTable, split: str) -> DatasetSize:
    """The lengths of a split's sequences, in the order in which a limit takes them up.

    Raises:
        TableError: if there are none.
    """
    selection = select(table, split=split, limit=None)
    frames = dict(zip(selection.sequence_ids, selection.n_frames.tolist()))
    return DatasetSize(np.array([frames[name] for name in by_hash(list(frames))]))
