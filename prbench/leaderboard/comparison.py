"""Two finished runs on the same sequences: where they differ, and whether the data support it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from prbench.errors import RunError
from prbench.evaluation.comparisons import Comparison, PairedValues, compare
from prbench.metrics import METRICS, MetricInfo
from prbench.runs.folder import RunFolder
from prbench.runs.record import TableRecord
from prbench.runs.scores import read_scores
from prbench.submitted.verification import RunChecker, recording_key


@dataclass(frozen=True)
class ComparedMetric:
    """A metric on one dataset; the difference is first - second."""

    dataset: str
    info: MetricInfo
    comparison: Comparison


@dataclass(frozen=True)
class RunComparison:
    """All metrics of two runs, and what could not be verified of them."""

    metrics: tuple[ComparedMetric, ...]
    left_out: tuple[str, ...]
    """A line for each dataset of which only the sequences that both methods generated are compared."""
    unverified: tuple[str, ...]
    """A line for each run and dataset whose scores could not be held against the motions, with the reason."""


def compare_runs(first: Path | str, second: Path | str, *, checker: RunChecker | None = None) -> RunComparison:
    """Compare two runs sequence by sequence, on all the datasets that both were scored on.

    Signs are flipped by recording, and p-values corrected after Holm for everything compared here
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
    runs = RunFolder.open(first), RunFolder.open(second)
    if runs[0].record.protocol_digest != runs[1].record.protocol_digest:
        raise RunError(f"{first} and {second} follow different protocols, so their numbers cannot be compared.")
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
    infos = {info.id: info for info in METRICS}
    metrics = []
    for key, comparison in found.items():
        dataset, metric = key.split("\n")
        metrics.append(ComparedMetric(dataset, infos[metric], comparison))
    return RunComparison(tuple(metrics), tuple(left_out), tuple(filter(None, unverified)))


def _common_sequences(first: RunFolder, second: RunFolder, dataset: str) -> frozenset[str] | None:
    """Ids that both generated, where both chose the same sequences and one could not generate all; else None.

    Raises:
        RunError: if there is no such sequence.
    """
    tables = [_table_of(run, dataset) for run in (first, second)]
    if not any(table.unsupported for table in tables) or len({table.selection_digest for table in tables}) > 1:
        return None
    scored = [set(read_scores(run.dataset(dataset).scores)["sequence_id"].to_pylist()) for run in (first, second)]
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
    """The main metrics that both runs have, by dataset and metric (``dataset`` and ``metric`` on two lines).

    Args:
        first: A run on the dataset.
        second: Another one, of the same chosen sequences.
        dataset: Name of the dataset.
        only: Ids of the sequences to compare; None for all that were scored.

    Raises:
        RunError: if they were run on different tables, or scored on different sequences.
    """
    tables = [_sequence_means(read_scores(run.dataset(dataset).scores)) for run in (first, second)]
    if only is not None:
        tables = [table.filter(pc.field("sequence_id").isin(sorted(only))) for table in tables]
    if _table_of(first, dataset).content_digest != _table_of(second, dataset).content_digest:
        raise RunError(f"{first.path} and {second.path} were run on different tables of {dataset}.")
    pairs = {}
    for metric in (info.id for info in METRICS if info.main):
        rows = [table.filter(pc.field("metric") == metric).sort_by("sequence_id") for table in tables]
        if not all(row.num_rows for row in rows):
            continue
        if not rows[0]["sequence_id"].equals(rows[1]["sequence_id"]):
            raise RunError(
                f"{first.path} and {second.path} were scored on different sequences of {dataset}"
                f" ({rows[0].num_rows} and {rows[1].num_rows}). Run both with the same --split and --limit."
            )
        values = [np.asarray(row["value_mean"]) for row in rows]
        # Sequences of one recording are not independent, so signs are flipped for a whole recording at once.
        recordings = [recording_key(name) for name in rows[0]["sequence_id"].to_pylist()]
        pairs[f"{dataset}\n{metric}"] = PairedValues(values[0], values[1], recordings)
    return pairs


def _table_of(run: RunFolder, dataset: str) -> TableRecord:
    return next(table for table in run.record.tables if table.dataset == dataset)


def _sequence_means(scores: pa.Table) -> pa.Table:
    # Several samples of a sequence are averaged first: they are no further sequences.
    return scores.group_by(["sequence_id", "metric"]).aggregate([("value", "mean")])
