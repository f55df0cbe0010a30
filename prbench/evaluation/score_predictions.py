"""Score motions that lie on disk: those of a run folder, or a Parquet file that somebody hands in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.engine import Engine, InProcess
from prbench.errors import PredictionsError, RunError, StorageError
from prbench.evaluation.conditions import ConditionSource, derangement, opaque_ids, run_salt
from prbench.evaluation.controls import RECORDED_MOTION, SHUFFLED_GOAL
from prbench.evaluation.planning import Selection, select
from prbench.evaluation.preparation import supported
from prbench.evaluation.progress import Progress, ProgressCallback, silent
from prbench.evaluation.scoring import ScoringRules, score_selection
from prbench.evaluation.summarise import ScoredSet, summarise
from prbench.manifests import load_protocol
from prbench.runs import record as run_record
from prbench.runs.folder import RunFolder
from prbench.runs.predictions import Predictions
from prbench.runs.record import RunRecord
from prbench.runs.scores import write_scores
from prbench.runs.summary import DatasetSummary
from prbench.sequences import SequenceTable

_NAMED = 3  # ids listed in a message
_UNSTATED = "unstated"


@dataclass(frozen=True, kw_only=True)
class ScoreRequest:
    """Which predictions to score on which table."""

    predictions: Path
    """A run folder, its part for one dataset, a Parquet file with the columns sequence_id (or opaque_id), sample
    (0 if absent) and joints, or a folder of such files."""
    data: Path
    """The dataset folder."""
    split: str | None = None
    """By default that of the run, else ``test``."""
    limit: int | None = None
    """By default that of the run, else none."""
    seed: int = 0
    """Behind the opaque ids, if the predictions have those."""
    allow_length_mismatch: bool = False
    out: Path | None = None
    """Folder for ``scores.parquet`` and ``summary.json``; nothing is written without it."""


@dataclass(frozen=True)
class ScoreReport:
    """Scores in long form, and their summary."""

    scores: pa.Table
    summary: DatasetSummary
    folder: Path | None
    motionless: bool = False
    """The run declares that its motions stand still, so that Foot Skating says nothing."""


@dataclass(frozen=True)
class _Submission:
    """Where the motions lie and what is known about them."""

    path: Path
    record: RunRecord | None


def score_predictions(
    request: ScoreRequest,
    *,
    engine: Engine | None = None,
    progress: ProgressCallback = silent,
) -> ScoreReport:
    """Score predictions against a table.

    Args:
        request: What to score.
        engine: Where the work is done; changes no value.
        progress: Called after every scored window.

    Raises:
        PredictionsError: if sequences are missing, repeated or unknown (named), or a motion has a wrong shape, another
            length than the recorded one, or NaN.
        RunError: if a run folder belongs to another table.
        TableError: if the table is missing, empty or of an unknown version.
        StorageError: if the results cannot be written.
    """
    table = SequenceTable.open(request.data)
    submission = _submission(request.predictions, table)
    chosen, selection = _selections(request, submission.record, table)
    predictions = Predictions.open(submission.path)
    samples = _require_complete(predictions, selection, request)
    rules = _rules(request, submission.record, selection)
    windows = score_selection(selection, submission.path, samples=samples, rules=rules, engine=engine or InProcess())
    scores = pa.concat_tables(_reported(windows, selection, progress)).combine_chunks()
    summary = summarise(scores, _scored_set(submission, chosen, selection, len(samples)))
    if request.out is not None:
        _write(request.out, scores, summary)
    motionless = submission.record is not None and submission.record.method.motionless
    return ScoreReport(scores, summary, request.out, motionless)


def _submission(path: Path, table: SequenceTable) -> _Submission:
    """Recognise a run folder by its ``run.json``, at the path itself or above the part of one dataset."""
    for base in (path, path.parent, path.parent.parent):
        if not (base / run_record.FILE_NAME).is_file():
            continue
        run = RunFolder.open(base)
        files = run.dataset(table.info.dataset)
        if path in (base, files.path, files.predictions):
            _require_same_table(run, table)
            return _Submission(files.predictions, run.record)
    return _Submission(path, None)


def _require_same_table(run: RunFolder, table: SequenceTable) -> None:
    recorded = next(item for item in run.record.tables if item.dataset == table.info.dataset)
    for key, found in (("identity_digest", table.identity), ("content_digest", table.content)):
        expected = getattr(recorded, key)
        if expected != found:
            raise RunError(
                f"{run.path / run_record.FILE_NAME}, tables.{recorded.dataset}.{key}: the run is of table"
                f" {expected[:12]}…, but {table.folder} is {found[:12]}…. Score it on the table that it was run on."
            )


def _selections(request: ScoreRequest, record: RunRecord | None, table: SequenceTable) -> tuple[Selection, Selection]:
    """The chosen sequences, and those of them that have to be there."""
    split = request.split or (record.split if record else "test")
    limit = request.limit if request.limit is not None or record is None else record.limit
    chosen = select(table, split=split, limit=limit)
    if record is not None and record.sequences and request.limit is None:
        chosen = chosen.chosen(np.isin(chosen.sequence_ids, record.sequences))
    if record is None:
        return chosen, chosen
    method = record.method
    return chosen, supported(chosen, max_frames=method.max_frames, native_fps=method.native_fps)


def _require_complete(predictions: Predictions, selection: Selection, request: ScoreRequest) -> list[int]:
    """The samples, if every sequence has each of them exactly once."""
    name_of = _names(predictions, selection, request)
    whole_split = select(selection.table, split=selection.split, limit=None)
    known = set(_names(predictions, whole_split, request))
    samples = sorted(set(predictions.samples))
    counts = Counter(zip(predictions.ids, predictions.samples))
    missing = [
        selection.sequence_ids[i]
        for i, name in enumerate(name_of)
        if not all((name, sample) in counts for sample in samples) or not samples
    ]
    repeated = sorted({name for (name, _), count in counts.items() if count > 1})
    unknown = sorted(set(predictions.ids) - known)
    if not missing and not repeated and not unknown:
        return samples
    found = len(set(predictions.ids) & set(name_of)) - len(set(missing) & set(predictions.ids))
    raise PredictionsError(
        f"{request.predictions}: expected the {len(selection)} {selection.split} sequences of"
        f" {selection.table.info.dataset}{_each(samples)}, found {found}: missing {_listed(missing)},"
        f" repeated {_listed(repeated)}, unknown {_listed(unknown)}. {_remedy(predictions, request, unknown)}"
    )


def _names(predictions: Predictions, selection: Selection, request: ScoreRequest) -> Sequence[str]:
    """Ids of the chosen sequences as the predictions call them."""
    if predictions.id_column == "sequence_id":
        return selection.sequence_ids
    return opaque_ids(selection.sequence_ids, run_salt(request.seed, selection.table.identity))


def _each(samples: list[int]) -> str:
    return f", each with samples {', '.join(map(str, samples))}" if len(samples) > 1 else ""


def _listed(names: list[str]) -> str:
    if not names:
        return "0"
    return f"{len(names)} ({', '.join(names[:_NAMED])}{', …' if len(names) > _NAMED else ''})"


def _remedy(predictions: Predictions, request: ScoreRequest, unknown: list[str]) -> str:
    if (request.predictions / run_record.FILE_NAME).is_file():
        return "Run the same command again: it resumes."
    if predictions.id_column == "opaque_id" and len(unknown) == len(set(predictions.ids)):
        return (
            f"Opaque ids hold for one seed and one table: is --seed {request.seed} that of the run,"
            " and --data its table?"
        )
    return "Hand in every sequence exactly once for each sample."


def _rules(request: ScoreRequest, record: RunRecord | None, selection: Selection) -> ScoringRules:
    recorded_motion = record is not None and record.method.name in RECORDED_MOTION
    other_goals = None
    if record is not None and recorded_motion and record.control == SHUFFLED_GOAL:
        order = derangement(selection, seed=record.seed)
        other_goals = ConditionSource.read(selection).goal_location[order]
    return ScoringRules(
        load_protocol().metrics,
        recorded_motion=recorded_motion,
        other_goals=other_goals,
        allow_length_mismatch=request.allow_length_mismatch,
        id_seed=request.seed,
    )


def _reported(windows: Iterator[pa.Table], selection: Selection, progress: ProgressCallback) -> Iterator[pa.Table]:
    done = 0
    for window in windows:
        yield window
        done += len(np.unique(window["sequence_id"].to_numpy()))
        progress(Progress(selection.table.info.dataset, "score", done, len(selection)))


def _scored_set(submission: _Submission, chosen: Selection, selection: Selection, samples: int) -> ScoredSet:
    record = submission.record
    return ScoredSet(
        info=selection.table.info,
        recording_of=dict(zip(selection.sequence_ids, selection.recording_ids)),
        chosen=len(chosen),
        method=record.method.name if record else submission.path.stem,
        condition=record.condition if record else _UNSTATED,
        control=record.control if record else None,
        split=selection.split,
        samples=samples,
    )


def _write(folder: Path, scores: pa.Table, summary: DatasetSummary) -> None:
    if (folder / run_record.FILE_NAME).is_file():
        raise StorageError(f"{folder}: is a run folder with scores of its own. Choose another folder for --out.")
    write_scores(folder / "scores.parquet", [scores])
    summary.write(folder)
