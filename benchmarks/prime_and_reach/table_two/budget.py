"""Time a first batch of every kind of row, and reckon from it how many sequences fit into a time.

The batch is timed while the other workers work, too; its motions are thrown away.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Int

from prbench.engine import Engine
from prbench.errors import PrbenchError, StorageError
from prbench.harness.controls import GROUND_TRUTH
from prbench.harness.planning import Selection
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.cost import read_batch_costs
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import FILE_NAME as RECORD
from prbench_benchmarks.prime_and_reach.table_two.plan import GOALS, PlannedRow
from prbench_benchmarks.prime_and_reach.table_two.side_by_side import generate_side_by_side

RESERVE = 0.1
"""Share of the time that is left free: the last batch of all is made alone, and machines have other work."""
_LARGEST_BATCH = 16
"""Sequences; as many as the slowest methods generate side by side."""
_SHARES = 2
"""Batches of equal size for as many workers; a fixed number, so that ``--workers`` changes no result."""
FOLDER = ".timing"
"""Folder in the table's own one, so that a table that is killed meanwhile goes on with what it has timed."""
_MEASURED_SEQUENCES = 8
"""Sequences in the one batch that is timed."""


class RowCost(msgspec.Struct, frozen=True, kw_only=True):
    """The cost of a first batch of one row."""

    seconds_per_frame: float
    """Seconds of ``generate`` a frame, in one worker while the others work, too; padding counts as frames."""
    overhead: float
    """Seconds of everything else for one dataset: loading, reading, scoring."""


@dataclass(frozen=True)
class DatasetSize:
    """The lengths of a table's sequences, which is all that an estimate needs."""

    n_frames: Int[np.ndarray, " sequences"]
    """Frames of each sequence of the split, in the order in which a growing limit takes them up."""

    @property
    def sequences(self) -> int:
        """Number of sequences in the split."""
        return len(self.n_frames)


@dataclass(frozen=True)
class Pace:
    """The way in which work is spread."""

    batch_size: int | None
    """Sequences of a batch; None for :func:`even_batch_size`."""
    workers: int
    samples: int


def even_batch_size(limit: int, sizes: Sequence[DatasetSize]) -> int:
    """The largest batches, up to :data:`_LARGEST_BATCH`, that leave none of two workers without one."""
    most = max(min(limit, size.sequences) for size in sizes)
    # Batches of equal size, a multiple of the workers': with 17 sequences two of 9 and 8 end sooner than 16 and 1.
    rounds = math.ceil(most / (_SHARES * _LARGEST_BATCH))
    return math.ceil(most / (_SHARES * rounds))


def table_seconds(costs: Collection[RowCost], limit: int, sizes: Sequence[DatasetSize], pace: Pace) -> float:
    """Seconds that all rows take on ``limit`` sequences of each dataset, batches of one row beside those of others."""
    batch_size = pace.batch_size or even_batch_size(limit, sizes)
    batches = [frames * pace.samples for size in sizes for frames in _padded_frames(size.n_frames[:limit], batch_size)]
    frames = sum(batches)
    longest = max(batches)
    # The work spreads over the workers, but no worker can share the last and longest batch of the slowest row.
    generating = sum(cost.seconds_per_frame for cost in costs) * frames / pace.workers
    alone = max((cost.seconds_per_frame for cost in costs), default=0.0) * longest
    return max(generating, alone) + len(sizes) * sum(cost.overhead for cost in costs)


def _padded_frames(n_frames: Int[np.ndarray, " sequences"], batch_size: int) -> list[int]:
    """Return the frames of each batch with its padding; sequences of similar length go together."""
    ordered = np.sort(n_frames)
    batches = (ordered[i : i + batch_size] for i in range(0, len(ordered), batch_size))
    return [len(batch) * int(batch[-1]) for batch in batches]


def largest_limit(costs: Collection[RowCost], sizes: Sequence[DatasetSize], pace: Pace, *, seconds: float) -> int:
    """The most sequences of each dataset with which all rows fit into ``seconds``, a reserve kept; at least 1.

    Args:
        costs: Of the rows that will be run.
        sizes: Of the datasets.
        pace: How the work is spread.
        seconds: That are left.
    """
    low = 1
    high = max(size.sequences for size in sizes)
    # Bisection: the time grows with the limit, if not smoothly.
    while low < high:
        middle = math.ceil((low + high) / 2)
        fits = table_seconds(costs, middle, sizes, pace) <= (1 - RESERVE) * seconds
        low, high = (middle, high) if fits else (low, middle - 1)
    return low


@dataclass(frozen=True)
class Measured:
    """The costs of the rows as far as they are known."""

    costs: dict[str, RowCost]
    """Maps each :func:`kind` of row to its cost."""
    failed: frozenset[str]
    """Names of rows whose batch could not be made; each will say so when it is run."""


def kind(planned: PlannedRow) -> str:
    """Rows of one kind cost the same: those of a method, with or without a goal, with weights of one size."""
    run = planned.run
    condition = "goal" if planned.condition in GOALS else planned.condition.value
    size = _size(run.weights) if run.weights is not None and run.weights.exists() else None
    weights = "bundled" if size is None else f"{size:.1e} bytes"
    return f"{run.method}, {condition}, {weights}"


def measure(
    planned: list[PlannedRow],
    known: dict[str, RowCost],
    median: Selection,
    engine: Engine,
    *,
    folder: Path,
    counting: Callable[[int, int, str], None],
    seconds: float,
) -> Measured:
    """Time what is not known yet.

    Args:
        planned: Rows that will be run.
        known: Costs by :func:`kind`.
        median: The sequences of the batch, of about the same length.
        engine: The one that the table will be run with.
        folder: Of the table.
        counting: Called with timed rows, all rows and a row's name.
        seconds: After which no further row is timed.

    Raises:
        PrbenchError: if workers were killed before a single row was timed.
    """
    # Reversed, so that the first printed row of each kind is the one that is timed.
    firsts = {kind(row): row for row in reversed(planned) if row.row is not None and kind(row) not in known}
    rows = {row.name: row for row in planned if firsts.get(kind(row)) is row}
    requests = {name: _first_batch(row.run, median, folder / FOLDER / name) for name, row in rows.items()}
    made = generate_side_by_side(requests, engine, counting=counting, seconds=seconds)
    overhead = _overhead(planned[0].run, median, folder / FOLDER / "overhead", engine)
    spent = {name: _seconds_per_frame(request) for name, request in requests.items() if name not in made.failed}
    costs = {
        kind(rows[name]): RowCost(seconds_per_frame=seconds_per_frame, overhead=overhead)
        for name, seconds_per_frame in spent.items()
        if seconds_per_frame is not None
    }
    if made.broken is not None and not known | costs:
        raise PrbenchError(made.broken)
    return Measured(known | costs, frozenset(made.failed))


def forget_timing(folder: Path) -> None:
    """Remove the motions that were made for their time."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)


def near_median(selection: Selection) -> Selection:
    """The sequences whose length is nearest to the median, so that hardly anything is padded."""
    distance = np.abs(selection.n_frames - np.median(selection.n_frames))
    keep = np.zeros(len(selection), dtype=bool)
    keep[np.argsort(distance, kind="stable")[:_MEASURED_SEQUENCES]] = True
    return selection.chosen(keep)


def _first_batch(run: RunRequest, median: Selection, out: Path) -> RunRequest:
    return replace(
        run,
        data=(median.table.folder,),
        sequences=median.sequence_ids,
        batch_size=_MEASURED_SEQUENCES,
        samples=1,
        control=None,
        out=out,
    )


def _seconds_per_frame(request: RunRequest) -> float | None:
    """Return the seconds a frame, or None if nothing was generated: there was no time, or a worker was killed."""
    if request.out is None or not (request.out / RECORD).is_file():
        return None
    folder = RunFolder.open(request.out)
    costs = [
        cost for table in folder.record.tables for cost in read_batch_costs(folder.dataset(table.dataset).batch_costs())
    ]
    frames = sum(cost.frames for cost in costs)
    return sum(cost.seconds for cost in costs) / frames if frames else None


def _overhead(run: RunRequest, median: Selection, out: Path, engine: Engine) -> float:
    """Return the seconds of a run that generates nothing: it is prepared beside others and again for scoring."""
    control = replace(_first_batch(run, median, out), method=GROUND_TRUTH, weights=None, options={})
    started = time.perf_counter()
    try:
        run_method(control, engine=engine)
    except StorageError:
        raise
    except Exception:
        return 0.0
    return time.perf_counter() - started


def _size(weights: Path) -> int:
    files = weights.rglob("*") if weights.is_dir() else (weights,)
    return sum(file.stat().st_size for file in files if file.is_file())
