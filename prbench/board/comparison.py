"""Two finished runs on the same sequences: where they differ, and whether the data support it.

Which methods the data separate, so that ranks and bold print claim no more than a comparison supports.

Source: docs/specification/protocol.md#comparisons.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from prbench.board.collect import LeaderboardRow
from prbench.errors import RunError
from prbench.harness.benchmark import Benchmark, load_benchmark
from prbench.harness.claims import DECLARED, origin_of
from prbench.harness.clusters import FEWEST_FOR_BOARD
from prbench.harness.intervals import ClusteredValues, Comparison, clustered, compare
from prbench.harness.results import RunChecker
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import TableRecord
from prbench.harness.run_folder.scores import CodedScores
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.metrics import MetricInfo, printed_unit


@dataclass(frozen=True)
class ComparedMetric:
    """A metric on one dataset, over the same sequences; the difference is first - second.

    Attributes:
        dataset: Name of the dataset.
        info: The metric; differences of rates lie between -1 and 1.
        comparison: The difference, and whether the data support one.
        conclusion: ``higher``, ``lower``, ``not supported by the data`` or ``cannot be tested``: of the first run.
    """

    dataset: str
    info: MetricInfo
    comparison: Comparison
    conclusion: str


@dataclass(frozen=True)
class ComparedRun:
    """One of two runs.

    Attributes:
        path: Its folder.
        method: Name of the method.
        origin: Whose method it is, in words.
        marks: Maps datasets to remarks about the motions that readers must know.
    """

    path: Path
    method: str
    origin: str
    marks: dict[str, str]


@dataclass(frozen=True)
class RunComparison:
    """Two runs, compared sequence by sequence.

    Attributes:
        first: The first run.
        second: The second run.
        metrics: One entry for each metric and dataset.
        left_out: A line for each dataset of which only the sequences that both methods generated are compared.
        unverified: A line for each run and dataset whose scores could not be held against the motions, with the reason.
        declared: What the runs say and scores do not show, method and origin among it.
    """

    first: ComparedRun
    second: ComparedRun
    metrics: tuple[ComparedMetric, ...]
    left_out: tuple[str, ...]
    unverified: tuple[str, ...]
    declared: tuple[str, ...] = DECLARED


def compare_runs(first: Path | str, second: Path | str, *, checker: RunChecker | None = None) -> RunComparison:
    """Compare two runs sequence by sequence, on all the datasets that both were scored on.

    Recordings are the independent units, and p-values are corrected after Holm for everything compared here
    (docs/specification/protocol.md#comparisons).

    Args:
        first: A finished run folder.
        second: Another one, of the same sequences under the same protocol.
        checker: Holds the tables that are at hand, on which the motions of both are scored again; by default none.

    Raises:
        RunError: if a run is unfinished, its scores do not follow from its motions, or the two are not of the same
            protocol, tables and sequences.
    """
    runs = [RunFolder.open(Path(each), any_benchmark=True) for each in (first, second)]
    if runs[0].record.benchmark != runs[1].record.benchmark:
        found = f"{first} is a run of the benchmark {runs[0].record.benchmark}, {second} of {runs[1].record.benchmark}"
        raise RunError(f"{found}: their numbers measure different things and cannot be compared.")
    benchmark = load_benchmark(runs[0].record.benchmark)
    if runs[0].record.protocol_digest != runs[1].record.protocol_digest:
        found = f"{first} and {second} follow different protocols, so their numbers cannot be compared"
        raise RunError(f"{found}. Run the method of the older one again, into another folder.")
    tables = [{table.dataset: table for table in run.record.tables} for run in runs]
    # In the order of the second run; every dataset of both is compared, and all p-values are corrected together.
    shared = [name for name in tables[1] if name in tables[0]]
    if not shared:
        raise RunError(f"{first} and {second} have no dataset in common.")
    checker = checker or RunChecker()
    checked = [(run, checker.check(run, own[name]).unverified) for run, own in zip(runs, tables) for name in shared]
    scores: dict[tuple[str, MetricInfo], ClusteredValues] = {}
    left_out = []
    for name in shared:
        pair = tables[0][name], tables[1][name]
        paths = [run.dataset(name).scores for run in runs]
        # Where both chose the same sequences and one could not generate all, those that both generated are compared.
        common = None
        if any(table.unsupported for table in pair) and pair[0].selection_digest == pair[1].selection_digest:
            ids = [set(CodedScores.read(path).sequence_ids) for path in paths]
            common = frozenset(ids[0] & ids[1])
            if not common:
                raise RunError(f"{first} and {second}: there is no sequence of {name} that both generated.")
            counts = f"{len(common)} of {pair[0].sequences} sequences"
            left_out.append(f"{name}: compared on the {counts} that both methods generated")
        values = [sequence_scores(path, benchmark, pair[0], only=common) for path in paths]
        if pair[0].content_digest != pair[1].content_digest:
            raise RunError(f"{first} and {second} were run on different tables of {name}.")
        for info in benchmark.compared_metrics:
            try:
                paired = paired_differences(values[0], values[1], info)
            except ValueError as error:
                problem = f"{first} and {second} were scored on different sequences of {name} ({error})"
                raise RunError(f"{problem}. Run both with the same --split and --limit.") from error
            if paired is not None:
                scores[name, info] = paired
    metrics = [ComparedMetric(*key, found, found.conclusion) for key, found in compare(scores).items()]
    compared = []
    for run in runs:
        marks = ((name, DatasetSummary.read(run.dataset(name).path).mark) for name in shared)
        shown = {name: mark for name, mark in marks if mark}
        compared.append(ComparedRun(run.path, run.record.method.name, origin_of(run.record), shown))
    unverified = tuple(f"{run.path}: {why}" for run, why in checked if why)
    return RunComparison(compared[0], compared[1], tuple(metrics), tuple(left_out), unverified)


def difference_texts(row: ComparedMetric) -> tuple[str, str, str, str]:
    """Return difference, 95 % interval, corrected p-value and smallest detectable difference as printed."""
    found = row.comparison
    difference = found.difference
    scale = row.info.scale
    unit = " points" if row.info.unit == "rate" else printed_unit(row.info.unit)
    bounds = "all equal" if "all_equal" in difference.marks else "cannot be given"
    if difference.low is not None and difference.high is not None:
        bounds = f"[{difference.low * scale:+.2f}, {difference.high * scale:+.2f}]"
    detectable = "–" if found.detectable is None else f"{found.detectable * scale:.2f}{unit}"
    if found.detectable is not None and row.info.unit == "rate" and found.detectable > 1:
        detectable = "none"  # no difference of two rates is larger than 100 points
    p_value = "–" if found.adjusted_p_value is None else f"{found.adjusted_p_value:.4f}"
    return f"{difference.mean * scale:+.2f}{unit}", bounds, p_value, detectable


def sentence(row: ComparedMetric, first: str, second: str) -> str:
    """Say how two runs differ in one metric, and whether the data support it."""
    difference, bounds, p_value, _ = difference_texts(row)
    if row.conclusion not in ("higher", "lower"):
        return f"{row.info.title}: {first} against {second} {difference} {bounds}: {row.conclusion}."
    merit = "better" if (row.conclusion == "higher") == row.info.higher_is_better else "worse"
    by = difference.lstrip("+-")
    said = f"{first} is {row.conclusion} than {second} by {by} {bounds}, which is {merit}"
    return f"{row.info.title}: {said}; supported by the data (p = {p_value})."


# Maps each metric to the sequences that have it, sorted, to the unit of each (recording, or participant of merged
# folds), and to the mean over the samples of each.
SequenceScores = dict[str, tuple[list[str], np.ndarray, np.ndarray]]


def sequence_scores(
    path: Path, benchmark: Benchmark, table: TableRecord, *, only: frozenset[str] | None = None
) -> SequenceScores:
    """Read the main metrics of ``scores.parquet``.

    Args:
        path: The file.
        benchmark: The benchmark of the run.
        table: The run's entry for the dataset.
        only: Ids of the sequences to read; None for all.

    Raises:
        RunError: if the file is missing or damaged.
    """
    scores = CodedScores.read(path)
    if only is not None:
        scores = scores.only(only)
    everything = sorted(scores.sequence_ids)
    units = np.array([table.unit_of(benchmark.recording_key(name)) for name in everything])
    place_of = {name: place for place, name in enumerate(everything)}
    places = np.array([place_of[name] for name in scores.sequence_ids], dtype=np.int64)
    found: SequenceScores = {}
    for metric in (info.id for info in benchmark.main_metrics):
        rows = scores.rows_of(metric)
        if rows.size:
            # Several samples of a sequence are averaged first: they are no further sequences.
            place = places[scores.sequence[rows]]
            counts = np.bincount(place, minlength=len(everything))
            sums = np.bincount(place, weights=scores.value[rows], minlength=len(everything))
            there = np.flatnonzero(counts)
            # One list for all metrics that all sequences have.
            names = everything if len(there) == len(everything) else [everything[i] for i in there]
            found[metric] = names, units[there], sums[there] / counts[there]
    return found


def paired_differences(first: SequenceScores, second: SequenceScores, info: MetricInfo) -> ClusteredValues | None:
    """Return the differences of two runs on one table, sequence by sequence; None where one lacks the metric.

    Raises:
        ValueError: if they were scored on different sequences, with the numbers of both.
    """
    if info.id not in first or info.id not in second:
        return None
    names, units, values = first[info.id]
    others, _, other_values = second[info.id]
    if names != others:
        raise ValueError(f"{len(names)} and {len(others)}")
    # Sequences of one recording are not independent, so their spread is that between recordings (or participants).
    return clustered(values - other_values, units, rate=info.unit == "rate")


# Maps a row (by its position) and a metric to the rows that are better there, by a supported difference.
Beaten = Mapping[tuple[int, str], frozenset[int]]
# Finds out which of several rows, ranked together, are better than which.
Separate = Callable[[Sequence[LeaderboardRow], Sequence[MetricInfo]], Beaten]


def separate_by_comparison(rows: Sequence[LeaderboardRow], metrics: Sequence[MetricInfo]) -> Beaten:
    """Compare every pair of rows sequence by sequence, on all metrics, corrected together after Holm.

    Args:
        rows: Rows on the same sequences of one dataset; where a row has ``only``, its other sequences do not count.
        metrics: The compared metrics; those without a better direction are left out.

    Raises:
        RunError: if a row's scores cannot be read.
    """
    if len(rows) < 2:
        return {}
    scores = []
    for row in rows:
        if row.scores is None:
            expected = "the run's scores beside its summary"
            raise RunError(f"{row.run}: expected {expected}, found none. Run it again: it resumes.")
        scores.append(sequence_scores(row.scores, row.benchmark, row.table, only=row.only))
    directed = [info for info in metrics if info.higher_is_better is not None]
    pairs: dict[tuple[int, int, MetricInfo], ClusteredValues] = {}
    for (i, first), (j, second) in combinations(enumerate(scores), 2):
        for info in directed:
            pair = paired_differences(first, second, info)
            if pair is not None:
                pairs[i, j, info] = pair
    better: dict[tuple[int, str], frozenset[int]] = {}
    for (i, j, info), comparison in compare(pairs).items():
        few = comparison.difference.n_recordings < FEWEST_FOR_BOARD
        if few or comparison.conclusion not in ("higher", "lower"):
            continue
        first_is_better = (comparison.conclusion == "higher") == info.higher_is_better
        winner, loser = (i, j) if first_is_better else (j, i)
        better[loser, info.id] = better.get((loser, info.id), frozenset()) | {winner}
    return better
