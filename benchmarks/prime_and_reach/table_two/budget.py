"""``plan.json``: how many sequences a table has, so that it goes on the same way after a kill.

Where the user named no number, a first batch of every kind of row is timed while the other workers work, too, and the
number of sequences that fit into a time is reckoned from it. The motions of that batch are thrown away.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Int

from prbench.engine import Engine, capacity
from prbench.errors import PrbenchError, RunError, StorageError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import remove_leftovers, write_json
from prbench.harness.controls import GROUND_TRUTH
from prbench.harness.planning import select
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.cost import RunCost, total_cost
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import FILE_NAME as RECORD
from prbench.sequences import SequenceTable
from prbench.sequences.table import by_share
from prbench_benchmarks.prime_and_reach.table_two.request import GOALS, PlannedRow, TableRequest
from prbench_benchmarks.prime_and_reach.table_two.side_by_side import Counting, generate_side_by_side

RESERVE = 0.1
"""Share of the time that is left free: the last batch of all is made alone, and machines have other work."""
TIMING_SHARE = 1 / 3
"""Share of the time after which no further row is timed; an untimed row counts as the slowest timed one."""
_LARGEST_BATCH = 16
"""Sequences; as many as the slowest methods generate side by side."""
_SHARES = 2
"""Batches of equal size for as many workers; a fixed number, so that ``--workers`` changes no result."""
_MEASURED_SEQUENCES = 8
"""Sequences in the one batch that is timed."""
FILE_NAME = "plan.json"
_VERSION = 1


class RowCost(msgspec.Struct, frozen=True, kw_only=True):
    """The cost of a first batch of one row."""

    seconds_per_frame: float
    """Seconds of ``generate`` a frame, in one worker while the others work, too; padding counts as frames."""
    overhead: float
    """Seconds of everything else for one dataset: loading, reading, scoring."""


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
    except msgspec.DecodeError as error:
        raise RunError(f"{path}: not a valid {FILE_NAME}: {error}. Choose another folder for --out.") from error
    if plan.schema_version != _VERSION:
        raise RunError(f"{path}: expected version {_VERSION}, found {plan.schema_version}. Choose another --out.")
    differences = []
    for key in dict.fromkeys([*asked, *plan.asked]):
        was = plan.asked.get(key)
        now = asked.get(key)
        if was == now:
            continue
        if not key.startswith("table "):
            differences.append(f"{key} was {was or 'not given'}, now is {now or 'not given'}")
        elif was is not None and now is not None:
            differences.append(f"{key} has other contents now")
        else:
            differences.append(f"{key} is {'new' if was is None else 'missing'}")
    if differences:
        raise RunError(
            f"{path}: the folder holds another table: {'; '.join(differences)}. Choose another folder for --out, or"
            " delete this one."
        )
    return plan


@dataclass(frozen=True)
class Work:
    """The sequences of a table and how its work is spread, which is all that an estimate needs."""

    lengths: Sequence[Int[np.ndarray, " sequences"]]
    """Frames of each sequence of each dataset's split, in the order in which a growing limit takes them up."""
    batch_size: int | None
    """Sequences of a batch; None for :func:`even_batch_size`."""
    workers: int
    samples: int


def split_lengths(table: SequenceTable, split: str) -> Int[np.ndarray, " sequences"]:
    """The lengths of a split's sequences in frames, in the order in which a limit takes them up.

    Raises:
        TableError: if there are none.
    """
    selection = select(table, split=split, limit=None)
    frames = dict(zip(selection.sequence_ids, selection.n_frames.tolist()))
    return np.array([frames[name] for name in by_share(selection.sequence_ids, selection.recording_ids)])


def even_batch_size(limit: int, lengths: Sequence[Int[np.ndarray, " sequences"]]) -> int:
    """The largest batches, up to :data:`_LARGEST_BATCH`, that leave none of two workers without one."""
    most = max(min(limit, len(each)) for each in lengths)
    # Batches of equal size, a multiple of the workers': with 17 sequences two of 9 and 8 end sooner than 16 and 1.
    rounds = math.ceil(most / (_SHARES * _LARGEST_BATCH))
    return math.ceil(most / (_SHARES * rounds))


def table_seconds(costs: Collection[RowCost], limit: int, work: Work) -> float:
    """Seconds that all rows take on ``limit`` sequences of each dataset, batches of one row beside those of others."""
    batch_size = work.batch_size or even_batch_size(limit, work.lengths)
    batches = []
    for n_frames in work.lengths:
        # Sequences of similar length go together; padding counts.
        ordered = np.sort(n_frames[:limit])
        for start in range(0, len(ordered), batch_size):
            batch = ordered[start : start + batch_size]
            batches.append(work.samples * len(batch) * int(batch[-1]))
    # The work spreads over the workers, but no worker can share the last and longest batch of the slowest row.
    generating = sum(cost.seconds_per_frame for cost in costs) * sum(batches) / work.workers
    alone = max((cost.seconds_per_frame for cost in costs), default=0.0) * max(batches)
    return max(generating, alone) + len(work.lengths) * sum(cost.overhead for cost in costs)


def largest_limit(costs: Collection[RowCost], work: Work, *, seconds: float) -> int:
    """The most sequences of each dataset with which all rows fit into ``seconds``, a reserve kept; at least 1.

    Args:
        costs: Of the rows that will be run.
        work: The sequences, and how the work is spread.
        seconds: That are left.
    """
    low = 1
    high = max(map(len, work.lengths))
    # Bisection: the time grows with the limit, if not smoothly.
    while low < high:
        middle = math.ceil((low + high) / 2)
        if table_seconds(costs, middle, work) <= (1 - RESERVE) * seconds:
            low = middle
        else:
            high = middle - 1
    return low


def kind(planned: PlannedRow) -> str:
    """Rows of one kind cost the same: those of a method, with or without a goal, with weights of one size."""
    run = planned.run
    condition = "goal" if planned.condition in GOALS else planned.condition.value
    weights = "bundled"
    if run.weights is not None and run.weights.exists():
        files = run.weights.rglob("*") if run.weights.is_dir() else [run.weights]
        weights = f"{sum(file.stat().st_size for file in files if file.is_file()):.1e} bytes"
    return f"{run.method}, {condition}, {weights}"


def with_limit(
    plan: TablePlan,
    request: TableRequest,
    tables: list[SequenceTable],
    planned: list[PlannedRow],
    *,
    engine: Engine,
    counting: Counting,
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

    Raises:
        PrbenchError: if workers were killed before a single row was timed.
    """
    started = time.monotonic()
    runnable = [row for row in planned if row.skipped is None]
    # In the table's own folder, so that a table that is killed meanwhile goes on with what it has timed.
    timing = folder / ".timing"
    # The sequences whose length is nearest to the median, so that hardly anything is padded.
    whole = select(tables[0], split=request.split, limit=None)
    distance = np.abs(whole.n_frames - np.median(whole.n_frames))
    keep = np.zeros(len(whole), dtype=bool)
    keep[np.argsort(distance, kind="stable")[:_MEASURED_SEQUENCES]] = True
    median = whole.chosen(keep)

    def first_batch(run: RunRequest, name: str) -> RunRequest:
        data = (median.table.folder,)
        size = _MEASURED_SEQUENCES
        out = timing / name
        return replace(run, data=data, sequences=median.sequence_ids, batch_size=size, samples=1, control=None, out=out)

    # Reversed, so that the first printed row of each kind is the one that is timed.
    firsts = {kind(row): row for row in reversed(runnable) if not row.is_control and kind(row) not in plan.costs}
    rows = [row for row in runnable if firsts.get(kind(row)) is row]
    requests = {row.name: first_batch(row.run, row.name) for row in rows}
    # Timing has to leave most of the time to the rows.
    share = TIMING_SHARE * 60 * request.minutes
    failed, broken = generate_side_by_side(requests, engine, counting=counting, seconds=share)
    # A run that generates nothing takes the seconds that are spent beside generating: preparation and scoring.
    control = replace(first_batch(runnable[0].run, "overhead"), method=GROUND_TRUTH, weights=None, options={})
    begun = time.perf_counter()
    overhead = 0.0
    try:
        run_method(control, engine=engine)
        overhead = time.perf_counter() - begun
    except StorageError:
        raise
    except Exception:
        overhead = 0.0
    costs = dict(plan.costs)
    for row in rows:
        out = timing / row.name
        if row.name in failed or not (out / RECORD).is_file():
            continue
        run = RunFolder.open(out)
        files = [run.dataset(table.dataset) for table in run.record.tables]
        spent_on = total_cost([RunCost.read(path) for each in files for path in each.batch_costs()])
        frames = spent_on.frames + spent_on.warm_up_frames
        if frames:
            seconds_per_frame = (spent_on.seconds + spent_on.warm_up_seconds) / frames
            costs[kind(row)] = RowCost(seconds_per_frame=seconds_per_frame, overhead=overhead)
    if broken is not None and not costs:
        raise PrbenchError(broken)

    # A failing row costs nothing. An untimed kind counts as the slowest timed one, pessimistic on purpose: too few
    # sequences are better than a table that is not done in time.
    expected_costs = []
    for row in runnable if costs else []:
        if row.name not in failed:
            slowest = 0.0 if row.is_control else max(cost.seconds_per_frame for cost in costs.values())
            most = max(cost.overhead for cost in costs.values())
            expected_costs.append(costs.get(kind(row), RowCost(seconds_per_frame=slowest, overhead=most)))
    lengths = [split_lengths(table, request.split) for table in tables]
    work = Work(lengths, request.batch_size, capacity(engine), request.samples)
    spent = time.monotonic() - started
    limit = largest_limit(expected_costs, work, seconds=60 * request.minutes - spent)
    expected = spent + table_seconds(expected_costs, limit, work)
    limited = msgspec.structs.replace(plan, costs=costs, limit=limit, expected_seconds=expected)
    limited.write(folder)
    shutil.rmtree(timing, ignore_errors=True)
    return limited
