"""Table 2's layout: a part for each dataset, a block for each condition, the metrics in the study's order.

Rows that were not run show dashes. Ranks are those of the leaderboard: within a block, from 50 sequences on, never for
controls.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

from prbench.board import collect_runs, make_leaderboard
from prbench.board.comparison import paired_scores
from prbench.board.tables import FEWEST_RANKED, DatasetTable, TableRow, hides, of_all_methods, undecided_lines
from prbench.harness.intervals import Comparison, compare
from prbench.harness.planning import Selection, select
from prbench.harness.run_folder.cost import RunCost
from prbench.harness.run_folder.folder import RunFolder
from prbench.metrics import METRICS, STUDY_METRICS, MetricInfo
from prbench.sequences import SequenceTable
from prbench_benchmarks.prime_and_reach.table_two.plan import PlannedRow
from prbench_benchmarks.prime_and_reach.table_two.request import load_table_two

DECIDING = STUDY_METRICS[0]
"""The metric that orders a block: the study's first, Prime Success, which is what the benchmark is about."""
ARRIVAL = next(info for info in METRICS if info.id == "prime_success_arrival")
"""Orders a block a second time: a body that stares at the goal from the start is first by :data:`DECIDING`."""
_CONTROLS_TITLE = "Controls"
CONTROL = "control"
_MEBIBYTE = 2**20


@dataclass(frozen=True)
class RowOutcome:
    """The outcome of one line."""

    planned: PlannedRow
    state: Literal["run", "skipped", "failed"]
    reason: str = ""
    """The reason why it has no numbers."""
    folder: Path | None = None
    """Folder of its run."""


@dataclass(frozen=True)
class Cell:
    """One number, as printed: rates in %."""

    mean: float
    low: float | None
    high: float | None
    rank: int | None
    """One more than the number of methods that are better by a supported difference; None where nothing is ranked."""
    leads: bool = False
    """It is better than every other method, each by a supported difference."""

    @property
    def interval(self) -> str:
        """``[low, high]``, or empty where too few recordings allow none."""
        return "" if self.low is None or self.high is None else f"[{self.low:.2f}, {self.high:.2f}]"


@dataclass(frozen=True)
class LineCost:
    """The cost of generating one motion; None where it says nothing, as for a control."""

    seconds: float | None
    network_passes: float | None
    memory_mebibytes: float | None
    """Largest, of a process that ran the method."""


@dataclass(frozen=True)
class Line:
    """One row on one dataset."""

    name: str
    label: str
    method: str
    weights: str
    """The study's, by their name in ``table_2.toml``; empty for a control."""
    weights_used: str
    """File that was run."""
    variant: str
    """Variant in the words of the published tables."""
    trained_on: str
    stands_in: bool
    state: Literal["run", "skipped", "failed"]
    reason: str
    cells: dict[str, Cell | None]
    """Maps each of the study's metrics to its cell; None is a dash."""
    arrival: Cell | None
    """The cell of :data:`ARRIVAL`, which is no column of the study's table."""
    gaze: bool
    """The motions bring gaze; such a line is marked and never ranked."""
    obstacles: bool
    """The method was given the scene's boxes; such a line is marked and never ranked."""
    unsupported: int
    """Sequences that are longer than the method can generate, and were left out."""
    cost: LineCost


@dataclass(frozen=True)
class Step:
    """The step from one method to the next worse one; differences in the unit that is printed."""

    better: str
    """Name of the line."""
    worse: str
    difference: float
    low: float | None
    high: float | None
    p: float | None
    """p-value, after Holm's correction for the steps of the block."""
    supported: bool


@dataclass(frozen=True)
class BlockLayout:
    """The lines under one condition, or the controls."""

    title: str
    condition: str
    """``control`` for the controls."""
    lines: tuple[Line, ...]
    order: tuple[Step, ...] = ()
    """Steps from the best to the worst by :data:`DECIDING`; empty where nothing is ranked."""
    arrival_order: tuple[Step, ...] = ()
    """The same by :data:`ARRIVAL`; empty, too, where runs were scored before it was known."""


@dataclass(frozen=True)
class DatasetLayout:
    """One dataset's part of the table."""

    dataset: str
    title: str
    synthetic: bool
    redistribution: str
    sequences: int
    """n of every line: the chosen ones, or those of them that every method can generate."""
    chosen: int
    """Number of sequences that were asked for."""
    recordings: int
    blocks: tuple[BlockLayout, ...]
    undecided: tuple[str, ...] = ()
    """Sentences on what the data cannot decide, and the smallest differences that they can."""
    edge_arrivals: tuple[str, ...] = ()
    """Sentences on arrivals that a ray trembling on the border of the target earns."""

    @property
    def is_ranked(self) -> bool:
        """Return True if there are sequences enough to rank anything."""
        return self.sequences >= FEWEST_RANKED


@dataclass(frozen=True)
class TableLayout:
    """The whole table."""

    split: str
    limit: int
    minutes: int | None
    """The time that ``limit`` follows from; None where the user named it."""
    datasets: tuple[DatasetLayout, ...]

    @property
    def without_numbers(self) -> tuple[Line, ...]:
        """Lines that show dashes because they were not run, or failed."""
        return tuple(line for block in self.datasets[0].blocks for line in block.lines if line.state != "run")


def metric_title(info: MetricInfo) -> str:
    """Return the title as the study's table prints it, with its direction."""
    return f"{info.title_in_study or info.title}{info.arrow}"


def lay_out(
    outcomes: Sequence[RowOutcome],
    *,
    tables: Sequence[SequenceTable],
    split: str,
    limit: int,
    minutes: int | None,
) -> TableLayout:
    """Read the finished runs and put every line in its place.

    Args:
        outcomes: All lines in printed order.
        tables: In printed order.
        split: Of the runs.
        limit: Sequences of each dataset that were asked for.
        minutes: The time that it follows from.

    Raises:
        RunError: if a run's files are damaged.
    """
    folders = [outcome.folder for outcome in outcomes if outcome.folder is not None]
    found = make_leaderboard(collect_runs(folders)).tables if folders else ()
    # A table of the common sequences takes the place of that of all: one line, one set of sequences.
    parts: dict[str, DatasetTable] = {}
    for part in of_all_methods(found):
        parts.setdefault(part.dataset, part)
    datasets = tuple(
        _dataset(outcomes, select(table, split=split, limit=limit), parts.get(table.info.dataset)) for table in tables
    )
    return TableLayout(split, limit, minutes, datasets)


def _dataset(outcomes: Sequence[RowOutcome], chosen: Selection, part: DatasetTable | None) -> DatasetLayout:
    info = chosen.table.info
    rows = {} if part is None else {row.entry.run: row for row in part.rows}
    common = None if part is None else part.common
    folders = {outcome.planned.name: outcome.folder for outcome in outcomes if outcome.folder is not None}
    lines = [(outcome.planned, _line(outcome, rows.get(outcome.planned.name))) for outcome in outcomes]
    under: dict[str, list[Line]] = defaultdict(list)
    for planned, line in lines:
        under[CONTROL if planned.is_control else planned.condition.value].append(line)
    titles = {block.condition.value: block.title for block in load_table_two().blocks} | {CONTROL: _CONTROLS_TITLE}
    # Recordings of the chosen sequences, or of the common ones among them.
    pairs = zip(chosen.sequence_ids, chosen.recording_ids)
    return DatasetLayout(
        dataset=info.dataset,
        title=info.title,
        synthetic=info.synthetic,
        redistribution=info.redistribution,
        sequences=len(chosen) if common is None else len(common),
        chosen=len(chosen),
        recordings=len({recording for name, recording in pairs if common is None or name in common}),
        blocks=tuple(
            BlockLayout(title, name, tuple(under[name]), *_orders(under[name], folders, info.dataset, common))
            for name, title in titles.items()
            if name in under
        ),
        undecided=() if part is None else undecided_lines(part),
        edge_arrivals=tuple(
            f"{line.label} ({line.name}): {rows[line.name].entry.summary.edge_arrivals}."
            for _, line in lines
            if line.name in rows and rows[line.name].entry.summary.edge_arrivals
        ),
    )


def _line(outcome: RowOutcome, row: TableRow | None) -> Line:
    planned = outcome.planned
    weights = load_table_two().weights[planned.row.weights] if planned.row is not None else None
    return Line(
        name=planned.name,
        label=planned.label,
        method=planned.run.method,
        weights=planned.row.weights if planned.row is not None else "",
        weights_used=(row.entry.record.method.weights or "") if row is not None else "",
        variant=weights.variant if weights is not None else "",
        trained_on=weights.trained_on if weights is not None else "",
        stands_in=planned.stands_in,
        state=outcome.state,
        reason=outcome.reason,
        cells={info.id: _cell(row, info) for info in STUDY_METRICS},
        arrival=_cell(row, ARRIVAL),
        gaze=row is not None and row.entry.record.method.gaze,
        obstacles=row is not None and row.entry.summary.obstacles,
        unsupported=row.entry.table.unsupported if row is not None else 0,
        cost=_line_cost(outcome.folder, row),
    )


def _cell(row: TableRow | None, info: MetricInfo) -> Cell | None:
    metric = row.entry.metric(info.id) if row is not None else None
    if row is None or metric is None or hides(row.entry, info):
        return None
    # Stored values are fractions and metres; cells are as printed.
    low, high = (None if bound is None else info.scale * bound for bound in (metric.low, metric.high))
    return Cell(info.scale * metric.mean, low, high, row.ranks.get(info.id), info.id in row.leads)


def _line_cost(folder: Path | None, row: TableRow | None) -> LineCost:
    # A control reads motions or copies poses: its seconds would look like a method's.
    if folder is None or row is None or row.entry.record.method.kind == "control":
        return LineCost(None, None, None)
    cost = RunCost.read(RunFolder.open(folder).dataset(row.entry.summary.dataset).cost)
    return LineCost(_seconds(cost), _passes(cost), cost.peak_process_bytes / _MEBIBYTE)


def _seconds(cost: RunCost) -> float | None:
    """Return the seconds of one motion; loading on first use counts only where nothing else was timed."""
    if cost.seconds_per_motion is not None:
        return cost.seconds_per_motion
    return cost.warm_up_seconds / cost.warm_up_motions if cost.warm_up_motions else None


def _passes(cost: RunCost) -> float | None:
    motions = cost.motions + cost.warm_up_motions
    return cost.network_passes_declared / motions if cost.network_passes_declared and motions else None


def _orders(
    lines: Sequence[Line], folders: Mapping[str, Path], dataset: str, common: frozenset[str] | None
) -> tuple[tuple[Step, ...], tuple[Step, ...]]:
    """Both orders of a block: by :data:`DECIDING` and by :data:`ARRIVAL`."""
    return (
        _order({line.name: line.cells[DECIDING.id] for line in lines}, DECIDING, folders, dataset, common),
        _order({line.name: line.arrival for line in lines}, ARRIVAL, folders, dataset, common),
    )


def _order(
    cells: Mapping[str, Cell | None],
    deciding: MetricInfo,
    folders: Mapping[str, Path],
    dataset: str,
    common: frozenset[str] | None,
) -> tuple[Step, ...]:
    """Compare each ranked method of a block with the next worse one, sequence by sequence.

    Args:
        cells: Maps the lines of a block to their cells; lines with the same number keep their order.
        deciding: The metric of the cells.
        folders: Run folders of these lines, all scored on the same sequences.
        dataset: Of the runs.
        common: Ids of the sequences that every method generated; None where all generated all.

    Raises:
        RunError: if runs are damaged or do not belong together.
    """
    means = {name: cell.mean for name, cell in cells.items() if cell is not None and cell.rank is not None}
    ordered = sorted(means, key=lambda name: -means[name])
    runs = {name: RunFolder.open(folders[name]) for name in ordered}
    pairs = {
        (better, worse): paired_scores(runs[better], runs[worse], dataset, only=common)[f"{dataset}\n{deciding.id}"]
        for better, worse in pairwise(ordered)
    }
    # All steps of a block go through one comparison, so that Holm's correction counts them together.
    found = compare({"\n".join(names): pair for names, pair in pairs.items()})
    return tuple(
        _step(names, comparison, deciding.scale) for names, comparison in zip(pairs, found.values(), strict=True)
    )


def _step(names: Sequence[str], comparison: Comparison, scale: float) -> Step:
    better, worse = names
    estimate = comparison.difference
    bounds = (estimate.low, estimate.high)
    low, high = (None if bound is None else scale * bound for bound in bounds)
    supported = comparison.conclusion == "higher"
    return Step(better, worse, scale * estimate.mean, low, high, comparison.adjusted_p_value, supported)
