"""Runs on the folds of one dataset, merged: every sequence is scored once, by a method that never saw its participant.

Source: docs/specification/protocol.md#participant-folds.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import pyarrow as pa

from prbench.errors import RunError
from prbench.evaluation.results import ScoredSet, summarise
from prbench.runs.folder import RunFolder
from prbench.runs.record import RunRecord
from prbench.runs.scores import read_scores
from prbench.runs.summary import DatasetSummary
from prbench.submitted.verification import RunChecker, recording_key


def merge_folds(paths: Sequence[Path], *, checker: RunChecker | None = None) -> tuple[DatasetSummary, tuple[str, ...]]:
    """Summarise the scores of several runs as if they were one.

    Weights and tables differ between folds; all else has to agree.

    Args:
        paths: Finished runs of one dataset each, one a fold.
        checker: Holds the tables at hand, on which motions are scored again; by default none.

    Returns:
        The summary, and a sentence for each run whose scores could not be verified.

    Raises:
        RunError: if runs are unfinished, of more than one dataset, of different methods, conditions or protocols, or
            score a sequence twice.
    """
    runs = [RunFolder.open(path) for path in paths]
    if len(runs) < 2:
        raise RunError(f"expected a run of each fold, found {len(runs)}.")
    first = runs[0].record
    unverified = []
    summaries = []
    tables = []
    for run in runs:
        _require_alike(runs[0], run)
        checked = (checker or RunChecker()).check(run, run.record.tables[0])
        if checked.unverified:
            unverified.append(f"{run.path}: {checked.unverified}")
        summaries.append(checked.summary)
        tables.append(read_scores(run.dataset(run.record.tables[0].dataset).scores))
    owner: dict[str, Path] = {}
    for run, table in zip(runs, tables):
        for name in set(table["sequence_id"].to_pylist()):
            if name in owner:
                raise RunError(f"{run.path}: sequence {name} is scored in {owner[name]}, too; folds share no sequence.")
            owner[name] = run.path
    merged = summarise(
        pa.concat_tables(tables),
        ScoredSet(
            info=first.tables[0],
            recording_of={name: recording_key(name) for name in owner},
            chosen=sum(summary.sequences for summary in summaries),
            method=first.method.name,
            condition=first.condition,
            control=first.control,
            split=f"{len(runs)} folds",
            samples=first.samples,
            best_of=first.best_of,
        ),
    )
    return merged, tuple(unverified)


def _require_alike(first: RunFolder, other: RunFolder) -> None:
    """Refuse two runs that are no folds of one design.

    Raises:
        RunError: naming what differs.
    """
    if len(other.record.tables) != 1:
        raise RunError(f"{other.path}: expected a run of one dataset, found {len(other.record.tables)}.")
    expected = _design(first.record)
    for name, found in _design(other.record).items():
        if found != expected[name]:
            raise RunError(f"{other.path}: expected {name} {expected[name]} as in {first.path}, found {found}.")


def _design(record: RunRecord) -> dict[str, object]:
    return {
        "dataset": record.tables[0].dataset,
        "protocol": record.protocol_digest,
        "method": record.method.name,
        "kind": record.method.kind,
        "options": msgspec.json.encode(record.method.options).decode(),
        "condition": record.condition,
        "control": record.control,
        "samples": record.samples,
        "best of": record.best_of,
        "split": record.split,
    }
