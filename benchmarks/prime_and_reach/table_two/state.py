"""``plan.json``: what a table decided before its first row, so that it goes on the same way after a kill.

It holds the number of sequences, too: where the user named none, as many as fit into the time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec
import numpy as np

from prbench.engine import Engine, capacity
from prbench.errors import RunError, StorageError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import remove_leftovers, write_json
from prbench.harness.planning import select
from prbench.sequences import SequenceTable
from prbench.sequences.table import by_share
from prbench_benchmarks.prime_and_reach.table_two.budget import (
    DatasetSize,
    Measured,
    Pace,
    RowCost,
    forget_timing,
    kind,
    largest_limit,
    measure,
    near_median,
    table_seconds,
)
from prbench_benchmarks.prime_and_reach.table_two.plan import PlannedRow
from prbench_benchmarks.prime_and_reach.table_two.request import TableRequest

FILE_NAME = "plan.json"
_VERSION = 1
TIMING_SHARE = 1 / 3
"""Share of the time after which no further row is timed; an untimed row counts as the slowest timed one."""


class TablePlan(msgspec.Struct, frozen=True, kw_only=True):
    """The whole file."""

    schema_version: int = _VERSION
    asked: dict[str, str]
    """Maps the user's name of everything that decides the rows, tables among it, to its value."""
    limit: int | None
    """Sequences of each dataset; None until it is known."""
    minutes: int | None
    """The time that the limit follows from; None where the user named the limit."""
    expected_seconds: float | None = None
    """Seconds that all of it was expected to take when the limit was found, timing included."""
    costs: dict[str, RowCost] = {}
    """Measured, by kind of row."""

    @property
    def fits(self) -> bool:
        """Return True if the limit follows from a time that is enough for at least one sequence."""
        return self.minutes is not None and (self.expected_seconds or 0.0) <= 60 * self.minutes

    def write(self, folder: Path) -> None:
        """Write ``plan.json``."""
        write_json(folder / FILE_NAME, msgspec.to_builtins(self))


@foreign_input()
def open_plan(folder: Path, asked: Mapping[str, str], *, limit: int | None, minutes: int) -> TablePlan:
    """The plan of a folder, or a new one in a new folder.

    Raises:
        RunError: if the folder belongs to another request, or the file is damaged.
        StorageError: if the folder holds something else.
    """
    path = folder / FILE_NAME
    if folder.is_file():
        raise StorageError(f"{folder}: is a file. Choose an empty or new folder for --out.")
    # A process that was killed while it wrote the plan has left a temporary file, which must not make the folder look
    # used.
    remove_leftovers(path)
    if not path.is_file():
        if folder.is_dir() and any(folder.iterdir()):
            raise StorageError(
                f"{folder}: is not empty and holds no {FILE_NAME}, so it is no folder of a table."
                " Choose an empty or new folder for --out."
            )
        plan = TablePlan(asked=dict(asked), limit=limit, minutes=None if limit is not None else minutes)
        plan.write(folder)
        return plan
    try:
        plan = msgspec.json.decode(read_whole(path), type=TablePlan)
    except (msgspec.ValidationError, msgspec.DecodeError) as error:
        raise RunError(f"{path}: not a valid {FILE_NAME}: {error}. Choose another folder for --out.") from error
    if plan.schema_version != _VERSION:
        raise RunError(f"{path}: expected version {_VERSION}, found {plan.schema_version}. Choose another --out.")
    if plan.asked != asked:
        raise RunError(
            f"{path}: the folder holds another table: {_differences(plan.asked, asked)}. Choose another folder for"
            " --out, or delete this one."
        )
    return plan


def _differences(found: Mapping[str, str], wanted: Mapping[str, str]) -> str:
    return "; ".join(
        _difference(key, found.get(key), wanted.get(key))
        for key in dict.fromkeys([*wanted, *found])
        if found.get(key) != wanted.get(key)
    )


def _difference(key: str, found: str | None, wanted: str | None) -> str:
    if not key.startswith("table "):
        return f"{key} was {found or 'not given'}, now is {wanted or 'not given'}"
    if found is None or wanted is None:
        return f"{key} is new" if found is None else f"{key} is missing"
    return f"{key} has other contents now"


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
    # Timing has to leave most of the time to the rows.
    share = TIMING_SHARE * 60 * request.minutes
    measured = measure(runnable, plan.costs, median, engine, folder=folder, counting=counting, seconds=share)
    costs = [cost for row in runnable if (cost := _cost(row, measured)) is not None]
    sizes = [dataset_size(table, request.split) for table in tables]
    pace = Pace(request.batch_size, capacity(engine), request.samples)
    spent = time.monotonic() - started
    limit = largest_limit(costs, sizes, pace, seconds=60 * request.minutes - spent)
    expected = spent + table_seconds(costs, limit, sizes, pace)
    limited = msgspec.structs.replace(plan, costs=measured.costs, limit=limit, expected_seconds=expected)
    limited.write(folder)
    forget_timing(folder)
    return limited


def _cost(row: PlannedRow, measured: Measured) -> RowCost | None:
    """Return a row's cost; an untimed kind counts as the slowest timed one, a failing row costs nothing (None)."""
    if row.name in measured.failed or not measured.costs:
        return None
    overhead = max(cost.overhead for cost in measured.costs.values())
    slowest = 0.0 if row.row is None else max(cost.seconds_per_frame for cost in measured.costs.values())
    # Pessimistic on purpose: too few sequences are better than a table that is not done in time.
    return measured.costs.get(kind(row), RowCost(seconds_per_frame=slowest, overhead=overhead))


def dataset_size(table: SequenceTable, split: str) -> DatasetSize:
    """The lengths of a split's sequences, in the order in which a limit takes them up.

    Raises:
        TableError: if there are none.
    """
    selection = select(table, split=split, limit=None)
    frames = dict(zip(selection.sequence_ids, selection.n_frames.tolist()))
    # The lengths have to stand in the order in which a growing limit takes the sequences up.
    order = by_share(selection.sequence_ids, selection.recording_ids)
    return DatasetSize(np.array([frames[name] for name in order]))
