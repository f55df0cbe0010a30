"""From a submission and tables to scores."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.engine import Engine, InProcess
from prbench.errors import RunError, UsageError
from prbench.evaluation.conditions import ConditionSource, derangement
from prbench.evaluation.controls import RECORDED_MOTION, SHUFFLED_GOAL
from prbench.evaluation.offline.export import open_tables
from prbench.evaluation.offline.read import read_conditions_file
from prbench.evaluation.planning import Selection, select
from prbench.evaluation.preparation import supported
from prbench.evaluation.progress import Progress, ProgressCallback, silent
from prbench.evaluation.score_predictions.board import (
    OFFLINE,
    UNSTATED,
    Scored,
    offline_record,
    write_plain,
    write_submission,
)
from prbench.evaluation.score_predictions.complete import Wanted, require_complete, require_lengths
from prbench.evaluation.score_predictions.request import ScoreReport, ScoreRequest
from prbench.evaluation.score_predictions.stated import Stated, stated_by_conditions, stated_by_request
from prbench.evaluation.scoring import ScoringRules, score_selection
from prbench.evaluation.summarise import ScoredSet, summarise
from prbench.manifests import load_protocol
from prbench.runs import record as run_record
from prbench.runs.folder import RunFolder
from prbench.runs.predictions import Numbering, Predictions
from prbench.runs.record import RunRecord
from prbench.sequences import SequenceTable


def score_predictions(
    request: ScoreRequest,
    *,
    engine: Engine | None = None,
    progress: ProgressCallback = silent,
) -> tuple[ScoreReport, ...]:
    """Score predictions against tables.

    Args:
        request: What to score.
        engine: Where the work is done; changes no value.
        progress: Called after every scored window.

    Returns:
        One report a table, in the order of the tables.

    Raises:
        PredictionsError: if sequences are missing, repeated or unknown (named), or a motion has a wrong shape, another
            length than the recorded one, or NaN; or if the conditions file is not of these tables.
        RunError: if a run folder belongs to another table.
        TableError: if a table is missing, empty or of an unknown version.
        UsageError: if the request contradicts its conditions file.
        StorageError: if the results cannot be written.
    """
    tables, engine = open_tables(request.data), engine or InProcess()
    run = _run_of(request.predictions)
    if run is not None:
        return _score_run(run, tables, request, engine, progress)
    return _score_submission(tables, request, engine, progress)


def _score_run(
    run: RunFolder, tables: list[SequenceTable], request: ScoreRequest, engine: Engine, progress: ProgressCallback
) -> tuple[ScoreReport, ...]:
    """Score a run again, on the tables that it was made on."""
    _require_plain(request)
    scored = []
    for table in tables:
        _require_same_table(run, table)
        chosen, selection = _selections_of_run(request, run.record, table)
        predictions = Predictions.open(run.dataset(table.info.dataset).predictions)
        wanted = Wanted(
            path=request.predictions,
            selections=(selection,),
            seed=run.record.seed,
            samples=None,
            native_fps=None,
            conditions=None,
        )
        samples = require_complete(predictions, wanted)
        rules = _rules_of_run(request, run.record, selection)
        scores = _scores(selection, predictions, samples, rules, engine, progress)
        about = _about_run(run.record, chosen, selection, len(samples))
        scored.append(Scored(chosen, selection, scores, summarise(scores, about)))
    folders = (None,) * len(scored) if request.out is None else write_plain(request.out, tuple(scored))
    motionless = run.record.method.motionless
    return tuple(ScoreReport(one.scores, one.summary, at, motionless) for one, at in zip(scored, folders))


def _score_submission(
    tables: list[SequenceTable], request: ScoreRequest, engine: Engine, progress: ProgressCallback
) -> tuple[ScoreReport, ...]:
    """Score motions that came as a file, of all tables together."""
    stated, numbering = stated_by_request(request), None
    if request.conditions is not None:
        conditions = read_conditions_file(request.conditions)
        stated = stated_by_conditions(conditions, tables, request)
        numbering = Numbering(request.conditions, conditions.opaque_id, tuple(conditions.sample.tolist()))
    if stated.native_fps is not None and request.allow_length_mismatch:
        raise UsageError("--allow-length-mismatch: motions that have to be resampled need the length of --native-fps.")
    chosen = [select(table, split=stated.split, limit=stated.limit) for table in tables]
    selections = [supported(one, max_frames=stated.max_frames, native_fps=stated.native_fps) for one in chosen]
    predictions = Predictions.open(request.predictions, numbering=numbering)
    wanted = Wanted(
        path=request.predictions,
        selections=tuple(selections),
        seed=stated.seed,
        samples=stated.samples,
        native_fps=stated.native_fps,
        conditions=request.conditions,
    )
    samples = require_complete(predictions, wanted)
    if not request.allow_length_mismatch:
        require_lengths(predictions, wanted, samples)
    rules = ScoringRules(
        load_protocol().metrics,
        allow_length_mismatch=request.allow_length_mismatch,
        id_seed=stated.seed,
        native_fps=stated.native_fps,
    )
    name, scored = request.name or _name_of(request.predictions), []
    for each, selection in zip(chosen, selections):
        scores = _scores(selection, predictions, samples, rules, engine, progress)
        summary = summarise(scores, _about_submission(name, stated, each, selection, len(samples)))
        scored.append(Scored(each, selection, scores, summary))
    folders: tuple[Path | None, ...] = (None,) * len(scored)
    if request.out is not None:
        record = offline_record(request.predictions, name, stated, tuple(scored))
        folders = write_submission(request.out, record, tuple(scored))
    return tuple(ScoreReport(one.scores, one.summary, at) for one, at in zip(scored, folders))


def _run_of(path: Path) -> RunFolder | None:
    """The run that a path belongs to: its folder, its part for a dataset, or the predictions in there.

    Raises:
        RunError: if the folder holds the scores of a submission, without motions.
    """
    for base in (path, path.parent, path.parent.parent):
        if not (base / run_record.FILE_NAME).is_file():
            continue
        run = RunFolder.open(base)
        parts = [run.dataset(table.dataset) for table in run.record.tables]
        if path == base or any(path in (part.path, part.predictions) for part in parts):
            if run.record.method.kind == OFFLINE:
                raise RunError(
                    f"{base}: holds the scores of {run.record.method.package}, not its motions. Score that file again."
                )
            return run
    return None


def _require_plain(request: ScoreRequest) -> None:
    """A run says itself how its motions were made."""
    for name in ("conditions", "condition", "control", "max_frames", "native_fps", "name"):
        if getattr(request, name) is not None:
            raise UsageError(
                f"--{name.replace('_', '-')}: {request.predictions} is a run, whose run.json says how its motions were"
                " made. Leave the option out."
            )


def _require_same_table(run: RunFolder, table: SequenceTable) -> None:
    run.dataset(table.info.dataset)
    recorded = next(item for item in run.record.tables if item.dataset == table.info.dataset)
    for key, found in (("identity_digest", table.identity), ("content_digest", table.content)):
        expected = getattr(recorded, key)
        if expected != found:
            raise RunError(
                f"{run.path / run_record.FILE_NAME}, tables.{recorded.dataset}.{key}: the run is of table"
                f" {expected[:12]}…, but {table.folder} is {found[:12]}…. Score it on the table that it was run on."
            )


def _selections_of_run(request: ScoreRequest, record: RunRecord, table: SequenceTable) -> tuple[Selection, Selection]:
    """The chosen sequences, and those of them that have to be there."""
    limit = record.limit if request.limit is None else request.limit
    chosen = select(table, split=request.split or record.split, limit=limit)
    if record.sequences and request.limit is None:
        chosen = chosen.chosen(np.isin(chosen.sequence_ids, record.sequences))
    return chosen, supported(chosen, max_frames=record.method.max_frames, native_fps=record.method.native_fps)


def _rules_of_run(request: ScoreRequest, record: RunRecord, selection: Selection) -> ScoringRules:
    recorded_motion = record.method.name in RECORDED_MOTION
    other_goals = None
    if recorded_motion and record.control == SHUFFLED_GOAL:
        order = derangement(selection, seed=record.seed)
        other_goals = ConditionSource.read(selection).goal_location[order]
    return ScoringRules(
        load_protocol().metrics,
        recorded_motion=recorded_motion,
        other_goals=other_goals,
        allow_length_mismatch=request.allow_length_mismatch,
    )


def _scores(
    selection: Selection,
    predictions: Predictions,
    samples: list[int],
    rules: ScoringRules,
    engine: Engine,
    progress: ProgressCallback,
) -> pa.Table:
    windows = score_selection(selection, predictions, samples=samples, rules=rules, engine=engine)
    return pa.concat_tables(_reported(windows, selection, progress)).combine_chunks()


def _reported(windows: Iterator[pa.Table], selection: Selection, progress: ProgressCallback) -> Iterator[pa.Table]:
    done = 0
    for window in windows:
        yield window
        done += len(np.unique(window["sequence_id"].to_numpy()))
        progress(Progress(selection.table.info.dataset, "score", done, len(selection)))


def _about_run(record: RunRecord, chosen: Selection, selection: Selection, samples: int) -> ScoredSet:
    return ScoredSet(
        info=selection.table.info,
        recording_of=dict(zip(selection.sequence_ids, selection.recording_ids)),
        chosen=len(chosen),
        method=record.method.name,
        condition=record.condition,
        control=record.control,
        split=selection.split,
        samples=samples,
    )


def _about_submission(name: str, stated: Stated, chosen: Selection, selection: Selection, samples: int) -> ScoredSet:
    return ScoredSet(
        info=selection.table.info,
        recording_of=dict(zip(selection.sequence_ids, selection.recording_ids)),
        chosen=len(chosen),
        method=name,
        condition=stated.condition.value if stated.condition else UNSTATED,
        control=stated.control,
        split=selection.split,
        samples=samples,
    )


def _name_of(path: Path) -> str:
    """Of the file; a folder ``motions`` is named by the one that it stands in."""
    path = path.resolve()
    return path.parent.name if path.is_dir() and path.name == "motions" else path.stem
