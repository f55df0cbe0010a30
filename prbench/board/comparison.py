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
from prbench.harness.intervals import Comparison, PairedValues, compare
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import TableRecord
from prbench.harness.run_folder.scores import CodedScores
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.harness.verification import RunChecker
from prbench.metrics import MetricInfo


@dataclass(frozen=True)
class ComparedMetric:
    """A metric on one dataset, over the same sequences; the difference is first - second."""

    dataset: str
    """Name of the dataset."""
    info: MetricInfo
    """The metric; differences of rates lie between -1 and 1."""
    comparison: Comparison
    """The difference, and whether the data support one."""
    conclusion: str
    """``higher``, ``lower``, ``not supported by the data`` or ``cannot be tested``: of the first run."""


@dataclass(frozen=True)
class ComparedRun:
    """One of two runs."""

    path: Path
    """Its folder."""
    method: str
    """Name of the method."""
    origin: str
    """Whose method it is, in words."""
    marks: dict[str, str]
    """Maps datasets to remarks about the motions that readers must know."""


@dataclass(frozen=True)
class RunComparison:
    """Two runs, compared sequence by sequence."""

    first: ComparedRun
    """The first run."""
    second: ComparedRun
    """The second run."""
    metrics: tuple[ComparedMetric, ...]
    """One entry for each metric and dataset."""
    left_out: tuple[str, ...]
    """A line for each dataset of which only the sequences that both methods generated are compared."""
    unverified: tuple[str, ...]
    """A line for each run and dataset whose scores could not be held against the motions, with the reason."""


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
    first = Path(first)
    second = Path(second)
    runs = RunFolder.open(first, any_benchmark=True), RunFolder.open(second, any_benchmark=True)
    if runs[0].record.benchmark != runs[1].record.benchmark:
        raise RunError(
            f"{first} is a run of the benchmark {runs[0].record.benchmark}, {second} of {runs[1].record.benchmark}:"
            " their numbers measure different things and cannot be compared."
        )
    benchmark = load_benchmark(runs[0].record.benchmark)
    if runs[0].record.protocol_digest != runs[1].record.protocol_digest:
        raise RunError(
            f"{first} and {second} follow different protocols, so their numbers cannot be compared. Run the method of"
            " the older one again, into another folder."
        )
    names = [table.dataset for table in runs[0].record.tables]
    # In the order of the second run; every dataset of both is compared, and all p-values are corrected together.
    shared = [table.dataset for table in runs[1].record.tables if table.dataset in names]
    if not shared:
        raise RunError(f"{first} and {second} have no dataset in common.")
    unverified = tuple(_unverified(run, name, checker or RunChecker()) for run in runs for name in shared)
    scores: dict[str, PairedValues] = {}
    left_out = []
    for name in shared:
        common = _common_sequences(*runs, name)
        scores |= paired_scores(*runs, name, only=common)
        if common is not None:
            chosen = _table_of(runs[0], name).sequences
            left_out.append(f"{name}: compared on the {len(common)} of {chosen} sequences that both methods generated")
    found = compare(scores)
    infos = {info.id: info for info in benchmark.metrics}
    metrics = []
    for key, comparison in found.items():
        dataset, metric = key.split("\n")
        metrics.append(ComparedMetric(dataset, infos[metric], comparison, comparison.conclusion))
    compared = []
    for run in runs:
        marks = {name: DatasetSummary.read(run.dataset(name).path).mark for name in shared}
        method = run.record.method
        compared.append(
            ComparedRun(run.path, method.name, method.origin, {name: mark for name, mark in marks.items() if mark})
        )
    one, other = compared
    return RunComparison(one, other, tuple(metrics), tuple(left_out), tuple(filter(None, unverified)))


def _common_sequences(first: RunFolder, second: RunFolder, dataset: str) -> frozenset[str] | None:
    """Ids that both generated, where both chose the same sequences and one could not generate all; else None.

    Raises:
        RunError: if there is no such sequence.
    """
    tables = [_table_of(run, dataset) for run in (first, second)]
    if not any(table.unsupported for table in tables) or len({table.selection_digest for table in tables}) > 1:
        return None
    scored = [set(CodedScores.read(run.dataset(dataset).scores).sequence_ids) for run in (first, second)]
    common = frozenset(scored[0] & scored[1])
    if not common:
        raise RunError(f"{first.path} and {second.path}: there is no sequence of {dataset} that both generated.")
    return common


def _unverified(run: RunFolder, dataset: str, checker: RunChecker) -> str:
    """Return why the scores of a run are unverified, or an empty text."""
    why = checker.check(run, _table_of(run, dataset)).unverified
    return f"{run.path}: {why}" if why else ""


def paired_scores(
    first: RunFolder, second: RunFolder, dataset: str, *, only: frozenset[str] | None = None
) -> dict[str, PairedValues]:
    """The ranked metrics that both runs have, by dataset and metric (``dataset`` and ``metric`` on two lines).

    Args:
        first: A run on the dataset.
        second: Another one, of the same chosen sequences.
        dataset: Name of the dataset.
        only: Ids of the sequences to compare; None for all that were scored.

    Raises:
        RunError: if they were run on different tables, or scored on different sequences.
    """
    benchmark = load_benchmark(first.record.benchmark)
    scores = [sequence_scores(run.dataset(dataset).scores, benchmark, only=only) for run in (first, second)]
    if _table_of(first, dataset).content_digest != _table_of(second, dataset).content_digest:
        raise RunError(f"{first.path} and {second.path} were run on different tables of {dataset}.")
    pairs = {}
    for info in benchmark.ranked_metrics:
        try:
            pair = paired_values(scores[0], scores[1], info, benchmark)
        except ValueError as error:
            raise RunError(
                f"{first.path} and {second.path} were scored on different sequences of {dataset}"
                f" ({error}). Run both with the same --split and --limit."
            ) from error
        if pair is not None:
            pairs[f"{dataset}\n{info.id}"] = pair
    return pairs


@dataclass(frozen=True, eq=False)
class SequenceScores:
    """Scores of one run on one dataset: each metric's mean over the samples of every sequence."""

    sequence_ids: dict[str, list[str]]
    """Maps a metric to the sequences that have it, sorted."""
    values: dict[str, np.ndarray]


def sequence_scores(path: Path, benchmark: Benchmark, *, only: frozenset[str] | None = None) -> SequenceScores:
    """Read the main metrics of ``scores.parquet``.

    Args:
        path: The file.
        benchmark: The benchmark of the run.
        only: Ids of the sequences to read; None for all.

    Raises:
        RunError: if the file is missing or damaged.
    """
    scores = CodedScores.read(path)
    if only is not None:
        scores = scores.only(only)
    everything = sorted(scores.sequence_ids)
    place_of = {name: place for place, name in enumerate(everything)}
    places = np.array([place_of[name] for name in scores.sequence_ids], dtype=np.int64)
    names: dict[str, list[str]] = {}
    values: dict[str, np.ndarray] = {}
    for metric in (info.id for info in benchmark.main_metrics):
        rows = scores.rows_of(metric)
        if rows.size:
            # Several samples of a sequence are averaged first: they are no further sequences.
            place = places[scores.sequence[rows]]
            counts = np.bincount(place, minlength=len(everything))
            sums = np.bincount(place, weights=scores.value[rows], minlength=len(everything))
            there = np.flatnonzero(counts)
            # One list for all metrics that all sequences have.
            names[metric] = everything if len(there) == len(everything) else [everything[i] for i in there]
            values[metric] = sums[there] / counts[there]
    return SequenceScores(names, values)


def paired_values(
    first: SequenceScores, second: SequenceScores, info: MetricInfo, benchmark: Benchmark
) -> PairedValues | None:
    """Put the values of two runs side by side; None where one of them lacks the metric.

    Raises:
        ValueError: if they were scored on different sequences, with the numbers of both.
    """
    if info.id not in first.values or info.id not in second.values:
        return None
    names = first.sequence_ids[info.id]
    others = second.sequence_ids[info.id]
    if names != others:
        raise ValueError(f"{len(names)} and {len(others)}")
    # Sequences of one recording are not independent, so their spread is that between recordings.
    recordings = [benchmark.recording_key(name) for name in names]
    return PairedValues(first.values[info.id], second.values[info.id], recordings, rate=info.unit == "rate")


def _table_of(run: RunFolder, dataset: str) -> TableRecord:
    return next(table for table in run.record.tables if table.dataset == dataset)


Beaten = Mapping[tuple[int, str], frozenset[int]]
"""Maps a row (by its position) and a metric to the rows that are better there, by a supported difference."""
Separate = Callable[[Sequence[LeaderboardRow], Sequence[MetricInfo]], Beaten]
"""Finds out which of several rows, ranked together, are better than which."""


def separate_by_comparison(rows: Sequence[LeaderboardRow], metrics: Sequence[MetricInfo]) -> Beaten:
    """Compare every pair of rows sequence by sequence, on all metrics, corrected together after Holm.

    Args:
        rows: On the same sequences of one dataset; where a row has ``only``, its other sequences do not count.
        metrics: The metrics that are ranked; those without a better direction are left out.

    Raises:
        RunError: if a row's scores cannot be read.
    """
    if len(rows) < 2:
        return {}
    scores = [_scores(row) for row in rows]
    directed = [info for info in metrics if info.higher_is_better is not None]
    pairs: dict[str, PairedValues] = {}
    for (i, first), (j, second) in combinations(enumerate(scores), 2):
        for info in directed:
            pair = paired_values(first, second, info, rows[0].benchmark)
            if pair is not None:
                pairs[f"{i} {j} {info.id}"] = pair
    directions = {info.id: info.higher_is_better for info in directed}
    better: dict[tuple[int, str], frozenset[int]] = {}
    for name, comparison in compare(pairs).items():
        i, j, metric = name.split(" ")
        if comparison.conclusion not in ("higher", "lower"):
            continue
        first_is_better = (comparison.conclusion == "higher") == directions[metric]
        winner, loser = (int(i), int(j)) if first_is_better else (int(j), int(i))
        better[loser, metric] = better.get((loser, metric), frozenset()) | {winner}
    return better


def _scores(row: LeaderboardRow) -> SequenceScores:
    if row.scores is None:
        raise RunError(
            f"{row.run}: expected the run's scores beside its summary, found none. Run it again: it resumes."
        )
    return sequence_scores(row.scores, row.benchmark, only=row.only)
