"""Figure 4, scores by what a sequence asks for, and Figure S3, Prime Success over its limits, with their numbers.

Runs are finished ones whose scores were held against their motions. Each interval of Figure 4 is that of the protocol,
over the recordings of its sequences. Groups are other sequences, so neither their means nor their intervals are a
comparison of methods. Figure S3 is made from saved motions, without generating again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow.compute as pc
from jaxtyping import Float

from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.engine import Engine
from prbench.errors import RunError, UsageError
from prbench.harness.clusters import FEWEST_FOR_BOARD
from prbench.harness.first_run import tables_of_runs
from prbench.harness.intervals import metric_interval
from prbench.harness.planning import Selection, select
from prbench.harness.results import RunChecker
from prbench.harness.run_folder import CONTROL, Predictions, RunFolder, TableRecord, read_scores
from prbench.metrics import MAIN_METRICS, MotionBatch
from prbench.metrics.prime_success import primed
from prbench.metrics.ray_track import candidate_frames, head_track
from prbench.protocol.manifests import BenchmarkProtocol, MetricConstants, load_protocol
from prbench.sequences import SequenceTable
from prbench.shown import clean, figure_text
from prbench.tables import Block, Cell, Column, Row, Table, metric_cell, metric_column
from prbench.viewing.figures import grid_shape, legend_below, new_figure, styled, write_figure
from prbench.viewing.replay.read import run_labels
from prbench.viewing.replay.scene import GAZE_COLOUR, GOAL_COLOUR, METHOD_COLOURS
from prbench_benchmarks.prime_and_reach.study.methods import METRIC_COLUMNS
from prbench_benchmarks.prime_and_reach.study.sizes import origin_of


@dataclass(frozen=True, eq=False)
class GenuineRun:
    """One run on one table, whose scores follow from its motions.

    Attributes:
        label: Method and condition, with the folder's name where several runs share them.
    """

    label: str
    run: RunFolder
    record: TableRecord
    table: SequenceTable

    @property
    def title(self) -> str:
        """Run and dataset in words, with the name of a user's own protocol."""
        own = f", own protocol {self.protocol.label}" if self.protocol.is_own else ""
        return f"{self.label}, {clean(self.record.dataset)}{own}"

    @property
    def protocol(self) -> BenchmarkProtocol:
        """Rules by which it was scored."""
        return self.run.protocol or load_protocol()


def genuine_runs(paths: Sequence[Path], data: Sequence[Path], engine: Engine) -> list[GenuineRun]:
    """Open runs and their tables, and score every motion again.

    Raises:
        UsageError: without runs, or if two of them have no dataset in common.
        TableError: if a table was not named and is not the embedded one.
        RunError: if a run is unfinished, its scores are not those of its motions, or runs follow different protocols.
    """
    if not paths:
        raise UsageError("name a run folder or more.")
    runs = [RunFolder.open(path) for path in paths]
    for run in runs[1:]:
        if run.record.protocol_digest != runs[0].record.protocol_digest:
            raise RunError(f"{run.path} and {runs[0].path} follow different protocols. Draw them one by one.")
    labels = [clean(label) for label in run_labels(paths, [run.record for run in runs])]
    found = []
    for table in tables_of_runs(runs, data):
        for run, label in zip(runs, labels, strict=True):
            record = next(each for each in run.record.tables if each.dataset == table.info.dataset)
            if not run.dataset(record.dataset).finished:
                raise RunError(f"{run.path}: is not finished on {record.dataset}. Run it again, it resumes.")
            unverified = RunChecker(lambda _, own=table: own, engine).check(run, record).unverified
            if unverified:
                raise RunError(f"{run.path}: cannot be drawn, because {unverified}.")
            found.append(GenuineRun(label, run, record, table))
    return found


# What sequences can be grouped by, and the column of the table that says it.
GROUPINGS = {"action": "action", "hand": "hand", "kind": "prime_kind"}


def breakdown_table(runs: Sequence[GenuineRun], by: str) -> Table:
    """Score each group of sequences of each run: a row for each group, a block for each run.

    Args:
        runs: Whose scores were held against their motions.
        by: One of :data:`GROUPINGS`.

    Raises:
        UsageError: for an unknown grouping.
    """
    if by not in GROUPINGS:
        raise UsageError(f"--by: unknown '{by}'; the groupings are: {', '.join(GROUPINGS)}.")
    blocks = []
    few: dict[str, None] = {}
    for run in runs:
        rows = []
        for group, cells in _scored_groups(run, by).items():
            if (cells[0].recordings or 0) < FEWEST_FOR_BOARD:
                few[group] = None
            words = {"group": group, "counts": f"{cells[0].sequences} ({cells[0].recordings})"}
            rows.append(Row(text=words, cells=tuple(cells)))
        word = ", measured on synthetic data" if run.record.synthetic else ""
        blocks.append(Block(title=f"{run.title}{word}", rows=tuple(rows)))
    notes = ["Rates in %, lengths in m; 95 % intervals over the recordings of each group in brackets."]
    if few:
        notes.append(f"Cannot be decided, with fewer than {FEWEST_FOR_BOARD} recordings: {', '.join(few)}.")
    notes.append("The study prints no numbers for its Figure 4, so that nothing published stands beside.")
    if any(run.record.synthetic for run in runs):
        notes.append(ON_SYNTHETIC_DATA)
    counts = Column(key="counts", title="Sequences (recordings)")
    columns = (Column(key="group", title=by, text=True), counts, *METRIC_COLUMNS)
    about = {"number": "of Figure 4", "title": f"scores by {by}"}
    return Table(**about, columns=columns, blocks=tuple(blocks), notes=tuple(notes))


def _scored_groups(run: GenuineRun, by: str) -> dict[str, list[Cell]]:
    """Map each group of sequences that a run has, by name, to its metrics."""
    rows = run.table.scalars()
    ids = rows["sequence_id"].to_pylist()
    words = [value or "unknown" for value in rows[GROUPINGS[by]].to_pylist()]
    group_of = dict(zip(ids, words, strict=True))
    names = sorted(set(words))
    recording_of = dict(zip(ids, rows["recording_id"].to_pylist(), strict=True))
    scores = read_scores(run.run.dataset(run.record.dataset).scores)
    method = run.run.record.method
    about: dict[str, Any] = {"dataset": run.record.dataset, "condition": run.run.record.condition}
    about |= {"method": method.name, "origin": origin_of(synthetic=run.record.synthetic)}
    found: dict[str, list[Cell]] = {name: [] for name in names}
    for info in MAIN_METRICS:
        if method.motionless and info.irrelevant_if_motionless:
            continue
        part = scores.filter(pc.field("metric") == info.id)
        ids = np.array(part["sequence_id"].to_pylist(), dtype=object)
        values = part["value"].to_numpy()
        groups = np.array([group_of[name] for name in ids], dtype=object)
        recordings = np.array([recording_of[name] for name in ids], dtype=object)
        for name in names:
            chosen = groups == name
            if not chosen.any():
                continue
            estimate = metric_interval(info, values[chosen], recordings[chosen].tolist(), ids[chosen].tolist())
            bounds = (estimate.mean, estimate.low, estimate.high)
            about |= {"sequences": estimate.n_sequences, "recordings": estimate.n_recordings}
            about |= {"variant": f"{by}: {name}", "note": "; ".join(estimate.marks)}
            found[name].append(metric_cell(info.id, info.unit, *bounds, **about))
    return {name: cells for name, cells in found.items() if cells}


_COLUMNS = ["goal_location", "prime_time", "start_time", "head_tilt_deg", "fps", "joints"]
_METRIC = "prime_success"
# How Figure S3 is drawn; nothing here decides a score. From the paper, section E, but for the step, a choice of ours.
WINDOWS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)  # seconds, one curve each
LARGEST_DISTANCE = 1.0  # metres, end of the axis
DISTANCE_STEP = 0.025  # metres: 41 points, among them the protocol's 0.25 m
_DISTANCES = tuple(round(k * DISTANCE_STEP, 6) for k in range(round(LARGEST_DISTANCE / DISTANCE_STEP) + 1))
_PRINTED_DISTANCES = (0.1, 0.25, 0.5, 1.0)  # metres, columns of the printed table; the CSV has all


@dataclass(frozen=True)
class Sweep:
    """Prime Success of one run over both limits.

    Attributes:
        windows: σ, seconds.
        distances: δ, metres.
        rates: Means over sequences (of the mean over samples), from 0 to 1.
    """

    run: GenuineRun
    windows: tuple[float, ...]
    distances: tuple[float, ...]
    rates: Float[np.ndarray, "windows distances"]
    sequences: int


def sweep(run: GenuineRun, *, engine: Engine) -> Sweep:
    """Compute Prime Success for every pair of limits.

    Args:
        run: Run whose scores were held against its motions.
        engine: Engine that works on the windows of sequences.

    Raises:
        RunError: if the value at the protocol's own limits is not the stored one.
    """
    # Recorded motion is scored against other goals there, which a sweep over its own goals does not repeat.
    if run.run.record.control is not None and run.run.record.method.kind == CONTROL:
        raise RunError(f"{run.run.path}: was made with --control; its sweep would be of other goals than its scores.")
    # The sequences of a run that have motions.
    record = run.run.record
    chosen = select(run.table, split=record.split, limit=record.limit)
    scores = read_scores(run.run.dataset(run.record.dataset).scores)
    scored = set(scores["sequence_id"].to_pylist())
    selection = chosen.chosen(np.array([name in scored for name in chosen.sequence_ids]))
    constants = run.protocol.metrics
    sums = np.zeros((len(WINDOWS), len(_DISTANCES)))
    motions = 0
    for successes in engine.map(partial(_swept, constants=constants), list(_motions(run, selection))):
        sums += successes.sum(axis=-1)
        motions += successes.shape[-1]
    rates = sums / motions
    # Where both have the same limits, the sweep has to give the stored scores.
    if constants.prime_window in WINDOWS and constants.prime_distance in _DISTANCES:
        found = rates[WINDOWS.index(constants.prime_window), _DISTANCES.index(constants.prime_distance)]
        stored = scores["value"].to_numpy()[np.array(scores["metric"].to_pylist()) == _METRIC].mean()
        if abs(stored - found) > 1e-9:
            raise RunError(
                f"{run.run.path}: expected a Prime Success of {stored:.6f} at the protocol's limits, as its scores"
                f" say, found {found:.6f}. One of its files was edited. Run the method again."
            )
    return Sweep(run, WINDOWS, _DISTANCES, rates, len(selection))


def _motions(run: GenuineRun, selection: Selection) -> Iterator[tuple[MotionBatch, dict[str, np.ndarray]]]:
    """Yield the motions of each window of sequences and each sample, with what they are judged by."""
    predictions = Predictions.open(run.run.dataset(run.record.dataset).predictions)
    for _, chunk in selection.windows(_COLUMNS):
        judged_by = {
            "prime_time": chunk.numbers("prime_time") - chunk.numbers("start_time"),
            "goal": chunk.vectors("goal_location").astype(np.float64),
            "tilt": chunk.numbers("head_tilt_deg"),
            "fps": chunk.numbers("fps"),
        }
        for sample in range(run.run.record.samples):
            rows = predictions.motions(chunk.sequence_ids, sample)
            yield MotionBatch(rows.values, rows.offsets), judged_by


def _swept(
    work: tuple[MotionBatch, dict[str, np.ndarray]], *, constants: MetricConstants
) -> Float[np.ndarray, "windows distances n"]:
    """Success of each motion for each pair of limits."""
    motion, judged_by = work
    fps = judged_by["fps"]
    found = np.zeros((len(WINDOWS), len(_DISTANCES), motion.n_sequences))
    for i, window in enumerate(WINDOWS):
        within = msgspec.structs.replace(constants, prime_window=window)
        prime_time = judged_by["prime_time"]
        if window == 0.0:  # no frame lies exactly at the prime time, so the nearest one is meant
            prime_time = np.round(prime_time * fps) / fps
        candidates = candidate_frames(motion.n_frames, prime_time, fps, within)
        track = head_track(motion, candidates, judged_by["goal"], judged_by["tilt"], fps, within)
        for j, distance in enumerate(_DISTANCES):
            limits = msgspec.structs.replace(within, prime_distance=distance)
            found[i, j] = primed(track, candidates, limits, "equation")
    return found


def sweep_table(sweeps: Sequence[Sweep]) -> Table:
    """Make the curves a table; the CSV has every point."""
    blocks = []
    for one in sweeps:
        record = one.run.run.record
        about: dict[str, Any] = {"condition": record.condition, "method": record.method.name}
        about |= {"dataset": one.run.record.dataset, "origin": origin_of(synthetic=one.run.record.synthetic)}
        about |= {"unit": "%", "sequences": one.sequences}
        rows = []
        for window, rates in zip(one.windows, one.rates, strict=True):
            words = {"window": f"{window:g} s"}
            cells = []
            for distance, rate in zip(one.distances, rates, strict=True):
                if distance in _PRINTED_DISTANCES:
                    words[f"{distance:g}"] = f"{100 * rate:.2f}"
                variant = f"sigma {window:g} s; delta {distance:g} m"
                value = float(100 * rate)
                cells.append(Cell(metric=_METRIC, variant=variant, value=value, **about))
            rows.append(Row(text=words, cells=tuple(cells)))
        word = ", measured on synthetic data" if one.run.record.synthetic else ""
        blocks.append(Block(title=f"{one.run.title}{word}, {one.sequences} sequences", rows=tuple(rows)))
    columns = [Column(key=f"{distance:g}", title=f"δ = {distance:g} m") for distance in _PRINTED_DISTANCES]
    return Table(
        number="of Figure S3",
        title="Prime Success in % over δ (columns) and σ (rows)",
        columns=(Column(key="window", title="σ", text=True), *columns),
        blocks=tuple(blocks),
        notes=(
            "The study prints its curves in a figure only, so that nothing published stands beside.",
            "σ = 0 s: the frame nearest to the prime time alone.",
            "Intervals stand with the protocol's limits on the leaderboard; points of a curve share their sequences.",
            *([ON_SYNTHETIC_DATA] if any(one.run.record.synthetic for one in sweeps) else []),
        ),
    )


_COLOURS = (*METHOD_COLOURS, GOAL_COLOUR, GAZE_COLOUR)


@styled
def draw_breakdown(table: Table, path: Path) -> str:
    """Draw Figure 4, a panel for each metric and a colour for each run, with intervals, and return the caption.

    Args:
        table: Result of :func:`prbench_benchmarks.prime_and_reach.study.charts.breakdown_table`.
        path: PNG, SVG or PDF; replaced when it exists.

    Raises:
        UsageError: for another kind of file, or more runs than there are colours.
        StorageError: if the file cannot be written.
    """
    runs = len(table.blocks)
    if runs > len(_COLOURS):
        raise UsageError(f"expected at most {len(_COLOURS)} runs in one figure, found {runs}.")
    shown = {cell.metric for cell in table.cells}
    metrics = [metric_column(info) for info in MAIN_METRICS if info.id in shown]
    groups: dict[str, str] = {}
    for block in table.blocks:
        groups |= {row.text["group"]: f"{row.text['group']}\n{row.text['counts']}" for row in block.rows}
    names = list(groups)
    rows, columns = grid_shape(len(metrics), 3)
    figure = new_figure(2.35 * columns, 1.7 * rows + 0.7, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    width = 0.8 / runs
    for column, place in zip(metrics, axes):
        for number, (block, colour) in enumerate(zip(table.blocks, _COLOURS)):
            bars = {
                names.index(row.text["group"]): cell
                for row in block.rows
                for cell in row.cells
                if cell.metric == column.key
            }
            at = np.array(list(bars)) + (number - (runs - 1) / 2) * width
            means = [cell.value for cell in bars.values()]
            place.bar(at, means, width=0.92 * width, color=colour, alpha=0.75, label=figure_text(block.title))
            for x, cell in zip(at, bars.values()):
                if cell.low is not None and cell.high is not None:
                    place.plot([x, x], [cell.low, cell.high], color="0.15", linewidth=0.8)
        place.set_xticks(range(len(names)), [figure_text(label) for label in groups.values()], fontsize=6)
        place.set_ylim(bottom=0.0)
        place.set_title(figure_text(column.heading))
    for place in axes[len(metrics) :]:
        place.set_axis_off()
    foot = (
        "Lines: 95 % intervals over the recordings (in parentheses) of each group. Groups hold other sequences: overlap"
        " of intervals is no comparison."
    )
    legend_below(figure, axes[0], foot, columns=3)
    figure.suptitle(figure_text(table.title.capitalize()), x=0.01, ha="left")
    caption = f"{table.title.capitalize()}. {foot}"
    write_figure(figure, path, caption)
    return caption


@styled
def draw_sweep(sweeps: Sequence[Sweep], path: Path) -> str:
    """Draw Figure S3, Prime Success over the distance with a curve for each window, and return the caption.

    Args:
        sweeps: One a run.
        path: PNG, SVG or PDF; replaced when it exists.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    from matplotlib import colormaps

    constants = sweeps[0].run.protocol.metrics
    delta = constants.prime_distance
    rows, columns = grid_shape(len(sweeps), 3)
    figure = new_figure(max(2.35 * columns, 3.5), 1.9 * rows + 0.4, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    for one, place in zip(sweeps, axes):
        shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(one.windows)))
        for window, rates, shade in zip(one.windows, one.rates, shades, strict=True):
            chosen = window == constants.prime_window
            label = f"σ = {window:g} s{' (protocol)' if chosen else ''}"
            place.plot(one.distances, 100 * rates, color=shade, linewidth=1.8 if chosen else 0.9, label=label)
        place.axvline(delta, color="0.5", linewidth=0.9, linestyle="--")
        place.annotate(f"δ = {delta:g} m", (delta, 100.0), xytext=(3, -2), textcoords="offset points", va="top")
        place.set_xlim(one.distances[0], one.distances[-1])
        place.set_ylim(0.0, 102.0)
        place.set_xlabel("δ (m)")
        place.set_ylabel("Prime Success (%)")
        place.set_title(figure_text(f"{one.run.title}, {one.sequences} sequences"))
        place.grid(visible=True)
    for place in axes[len(sweeps) :]:
        place.set_axis_off()
    axes[0].legend(loc="lower right")
    caption = "Prime Success over distance δ and window σ."
    if any(one.run.record.synthetic for one in sweeps):
        note = "Synthetic people: says nothing about real ones."
        figure.supxlabel(figure_text(note), color="0.35")
        caption = f"{caption} {note}"
    write_figure(figure, path, caption)
    return caption
