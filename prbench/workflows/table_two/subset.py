"""The number of sequences of a table whose user named none: as many as fit into a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from prbench.engine import Engine, ProcessPool
from prbench.evaluation.planning import select
from prbench.sequences import SequenceTable
from prbench.workflows.table_two.budget import DatasetSize, Pace, RowCost, largest_limit
from prbench.workflows.table_two.measuring import measure, measured_name
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
    measuring: Callable[[int, int, str], None],
    folder: Path,
) -> TablePlan:
    """The plan with its limit, found by timing a batch of every row; every timing is kept at once.

    Args:
        plan: With what an earlier call has timed.
        request: What is asked for.
        tables: In printed order.
        planned: Its lines; the skipped ones cost nothing.
        engine: The one that the rows will be run with.
        measuring: Called with timed rows, all rows, and the next one's label.
        folder: Of the table, where the plan is written.
    """
    started = time.monotonic()
    runnable = [row for row in planned if row.skipped is None]
    costs = dict(plan.costs)

    def keep(name: str, cost: RowCost) -> None:
        costs[name] = cost
        msgspec.structs.replace(plan, costs=costs).write(folder)

    share = TIMING_SHARE * 60 * request.minutes
    all_timed = measure(runnable, plan.costs, engine, measured=keep, measuring=measuring, seconds=share)
    known = [costs[measured_name(row)] for row in runnable if measured_name(row) in costs]
    if not all_timed and known:
        known += [_dearest(known, row) for row in runnable if measured_name(row) not in costs]
    sizes = [dataset_size(table, request.split) for table in tables]
    pace = Pace(request.batch_size, engine.workers if isinstance(engine, ProcessPool) else 1, request.samples)
    seconds = 60 * request.minutes - (time.monotonic() - started)
    limited = msgspec.structs.replace(plan, costs=costs, limit=largest_limit(known, sizes, pace, seconds=seconds))
    limited.write(folder)
    return limited


def _dearest(costs: list[RowCost], row: PlannedRow) -> RowCost:
    """As slow as any that was timed, in every respect; a control generates nothing."""
    slowest = 0.0 if row.row is None else max(cost.seconds_per_frame for cost in costs)
    return RowCost(seconds_per_frame=slowest, overhead=max(cost.overhead for cost in costs))


def dataset_size(table: SequenceTable, split: str) -> DatasetSize:
    """Number and length of the sequences of a split.

    Raises:
        TableError: if there are none.
    """
    selection = select(table, split=split, limit=None)
    return DatasetSize(len(selection), float(selection.n_frames.mean()))
