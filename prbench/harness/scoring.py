"""Predicted motions against the table, some sequences at a time."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from prbench.checking.doctor.examinations import OF_THE_CONVERSION, diagnose
from prbench.checking.doctor.motion_set import Diagnosis, Expected
from prbench.contract import GIVEN, Condition, Gaze, Motions
from prbench.engine import Engine, InProcess
from prbench.errors import PredictionsError
from prbench.geometry.shapes import Boxes
from prbench.harness.conditions import SCENE_COLUMNS, boxes_around, opaque_ids, run_salt, solid_boxes
from prbench.harness.methods import motions
from prbench.harness.planning import WINDOW, Selection
from prbench.harness.recorded_motion import is_recorded_motion, length_problem
from prbench.harness.run_folder import SCORES, PredictionRows, Predictions
from prbench.harness.run_folder.summary import RECORDED_MOTION
from prbench.limits import FARTHEST_COORDINATE
from prbench.metrics import (
    GAZE_METRICS,
    METRICS,
    SCENE_METRICS,
    UNKNOWN_HAND,
    GazeRays,
    MotionBatch,
    ScoringTargets,
    score,
)
from prbench.metrics.prime_success_gaze import INVALID as INVALID_GAZE
from prbench.protocol.manifests import MetricConstants
from prbench.sequences.sequence import SequenceChunk

COLUMNS = ["goal_location", "prime_time", "start_time", "hand", "head_tilt_deg", "fps", "joints"]
_GAZE_COLUMNS = ["gaze_origin", "gaze_direction", "gaze_valid"]
_SIDES = {"left": 0, "right": 1}
# Sequences whose motions are in memory together: what metrics make of motions takes several times their memory.
_SCORED_TOGETHER = 256
# Remedy for motions of another length.
SAME_LENGTH = "Give every motion the length of the recorded one, or pass --allow-length-mismatch."
_NOT_AS_KEPT = (
    "A run keeps no such motion of a method: the file was changed, or is of an older prbench. Delete it and run the"
    " method again."
)
_CARRIES_COPY_REMARK = frozenset(info.id for info in METRICS if info.carries_copy_remark)
Stored = Path | Predictions  # motions, or where they lie


@dataclass(frozen=True)
class ScoringRules:
    """Rules by which the motions of one dataset are scored.

    Attributes:
        recorded_motion: The predictions are the recorded motion itself: recorded gaze is scored too.
        other_goals: Score against these goals, one a chosen sequence, instead of each sequence's own; metrics that
            compare the recorded motion with itself are left out then.
        pose_given: The method was given the first pose: Plausible compares its bones and first frame with it.
        run_of: The method whose run has kept the predictions; None where somebody handed them in as a file.
        farthest: Metres from the origin beyond which a coordinate is refused.
        id_seed: Seed behind the opaque ids, where the predictions have those.
        native_fps: Rate of the predictions; None for the table's, to which the others are brought.
    """

    constants: MetricConstants
    recorded_motion: bool = False
    other_goals: Float[np.ndarray, "n 3"] | None = None
    pose_given: bool = True
    run_of: str | None = None
    farthest: float = FARTHEST_COORDINATE
    allow_length_mismatch: bool = False
    id_seed: int = 0
    native_fps: float | None = None


@dataclass(frozen=True)
class _Part:
    """Scoring work for one worker.

    Attributes:
        names: Ids as the predictions have them.
    """

    dataset: str
    recorded: pa.RecordBatch
    goals: Float[np.ndarray, "n 3"]
    names: tuple[str, ...]
    samples: tuple[int, ...]
    predictions: Predictions
    rules: ScoringRules
    scene: Boxes | None


def score_selection(
    selection: Selection, predictions: Stored, *, samples: Sequence[int], rules: ScoringRules, engine: Engine
) -> Iterator[pa.Table]:
    """Score all chosen sequences.

    Args:
        selection: The sequences; every one has a prediction for every sample.
        predictions: Opened, or a file or folder of parts.
        samples: Indices of the samples.
        rules: How to score.
        engine: Processes or cluster that scores; changes no value.

    Yields:
        Rows of ``scores.parquet``, those of :data:`~prbench.harness.planning.WINDOW` sequences at a time: by
        sequence, then sample, then metric in printed order.

    Raises:
        PredictionsError: if a motion has another length than the recorded one, or NaN; names sequence and frame.
    """
    opened = Predictions.open(predictions) if isinstance(predictions, Path) else predictions
    if len(selection) <= WINDOW:
        # Workers gain nothing: their start takes longer than a few hundred sequences.
        engine = InProcess()
    # A worker gets a whole window, because batches of a run hold motions from all over one.
    size = _SCORED_TOGETHER if isinstance(engine, InProcess) else WINDOW
    salt = run_salt(rules.id_seed, selection.table.identity)
    scene = solid_boxes(selection.table)
    columns = COLUMNS + (_GAZE_COLUMNS if rules.recorded_motion else []) + ([] if scene is None else SCENE_COLUMNS)

    def parts() -> Iterator[_Part]:
        for place, chunk in selection.windows(columns, rows=size):
            ids = chunk.sequence_ids
            names = tuple(ids if opened.id_column != "opaque_id" else opaque_ids(ids, salt))
            goals = chunk.vectors("goal_location") if rules.other_goals is None else rules.other_goals[place]
            boxes = None if scene is None else boxes_around(chunk, scene)
            # Not the ids of all motions, which would be sent to a worker with every part.
            asked = opened.only(names, samples)
            yield _Part(selection.table.info.dataset, chunk.batch, goals, names, tuple(samples), asked, rules, boxes)

    scored = engine.map(_score_part, parts())
    while tables := list(itertools.islice(scored, WINDOW // size)):
        yield pa.concat_tables(tables)


def score_recorded(
    selection: Selection, constants: MetricConstants, metrics: Collection[str]
) -> tuple[dict[str, Float[np.ndarray, " n"]], Float[np.ndarray, "n 3"]]:
    """Score the recorded motion of each chosen sequence against its own goal.

    Args:
        selection: The sequences.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
        metrics: Ids of the wanted metrics; those of the scene are left out where no boxes are known.

    Returns:
        The values by metric id, and the goals (canonical frame, metres), both in the order of the selection. Metrics of
        gaze are NaN where a frame that decides has no recorded gaze.
    """
    scene = solid_boxes(selection.table)
    by_gaze = GAZE_METRICS & set(metrics)
    computed = {info.id for info in METRICS if scene is not None or info.id not in SCENE_METRICS}
    wanted = [info.id for info in METRICS if info.id in metrics and info.id in computed]
    parts: list[dict[str, np.ndarray]] = []
    goals: list[np.ndarray] = []
    columns = COLUMNS + (_GAZE_COLUMNS if by_gaze else []) + ([] if scene is None else SCENE_COLUMNS)
    for _, chunk in selection.windows(columns, rows=_SCORED_TOGETHER):
        recorded = MotionBatch(chunk.joints, chunk.offsets)
        goals.append(chunk.vectors("goal_location"))
        gaze = recorded_gaze(chunk) if by_gaze else None
        boxes = boxes_around(chunk, scene) if scene is not None else None
        values = score(recorded, recorded, targets_of(chunk, goals[-1], gaze, boxes), constants, metrics=wanted)
        parts.append({name: column.value for name, column in values.items()})
        for name in by_gaze:
            unknown = values[name].flags.get(INVALID_GAZE)
            if unknown is not None:
                parts[-1][name] = np.where(unknown, np.nan, parts[-1][name])
    return {name: np.concatenate([part[name] for part in parts]) for name in wanted}, np.concatenate(goals)


def _score_part(part: _Part) -> pa.Table:
    tables = []
    for start in range(0, len(part.names), _SCORED_TOGETHER):
        rows = np.arange(len(part.names))[start : start + _SCORED_TOGETHER]
        names = tuple(part.names[row] for row in rows)
        scene = None if part.scene is None else part.scene.of_rows(rows)
        recorded = part.recorded.slice(start, len(rows))
        some = replace(part, recorded=recorded, goals=part.goals[rows], names=names, scene=scene)
        tables.append(_score_together(some))
    return pa.concat_tables(tables)


def _score_together(part: _Part) -> pa.Table:
    rules = part.rules
    chunk = SequenceChunk(part.recorded)
    recorded = MotionBatch(chunk.joints, chunk.offsets)
    gaze = recorded_gaze(chunk) if rules.recorded_motion else None
    targets = replace(targets_of(chunk, part.goals, gaze, part.scene), pose_given=rules.pose_given)
    metrics = None
    if rules.recorded_motion and rules.other_goals is not None:
        metrics = frozenset(
            info.id
            for info in METRICS
            if not info.compares_with_recorded and (part.scene is not None or info.id not in SCENE_METRICS)
        )
    by_sample = []
    for sample in part.samples:
        rows = part.predictions.motions(part.names, sample)
        _check(rows, recorded, chunk, sample, part)
        if rules.native_fps is not None:
            rows = at_table_rate(rows, recorded.n_frames, step=rules.native_fps / float(chunk.numbers("fps")[0]))
        predicted = MotionBatch(rows.values, rows.offsets)
        shown = targets
        if rows.gaze is not None:
            direction = rows.gaze[:, 1].astype(np.float64)
            direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
            rays = GazeRays(rows.gaze[:, 0].astype(np.float64), direction, np.ones(len(direction), dtype=bool))
            shown = replace(targets, gaze=rays)
        about: dict[str, Any] = {"metrics": metrics, "allow_length_mismatch": rules.allow_length_mismatch}
        values = list(score(predicted, recorded, shown, rules.constants, **about).values())
        if not rules.recorded_motion:
            # Motions that are the recorded ones are marked in the metrics that carry the remark.
            copies = is_recorded_motion(predicted, recorded)
            values = [
                replace(value, flags={**value.flags, RECORDED_MOTION: copies})
                if copies.any() and value.metric in _CARRIES_COPY_REMARK
                else value
                for value in values
            ]
        by_sample.append(values)
    # One row a sequence, sample and metric.
    ids = chunk.sequence_ids
    names = [values.metric for values in by_sample[0]]
    repeats = len(part.samples) * len(names)
    value = np.stack([[column.value for column in values] for values in by_sample])  # (samples, metrics, sequences)
    flags = [[column.flag for column in values] for values in by_sample]
    columns = [
        pa.array(np.repeat(np.array(ids, dtype=object), repeats), pa.string()),
        pa.array([part.dataset] * (len(ids) * repeats), pa.string()),
        pa.array(np.tile(np.repeat(np.array(part.samples, dtype=np.int32), len(names)), len(ids))),
        pa.array(names * (len(ids) * len(part.samples)), pa.string()),
        pa.array(np.moveaxis(value, 2, 0).reshape(-1)),
        pa.array([flag[i] for i in range(len(ids)) for columns in flags for flag in columns], pa.string()),
    ]
    return pa.Table.from_arrays(columns, schema=SCORES)


def recorded_gaze(chunk: SequenceChunk) -> GazeRays:
    """Return the recorded gaze of the sequences of a chunk."""
    origin, direction = (chunk.frames(name).astype(np.float64) for name in ("gaze_origin", "gaze_direction"))
    return GazeRays(origin, direction, chunk.frames("gaze_valid"))


def targets_of(
    chunk: SequenceChunk, goals: Float[np.ndarray, "n 3"], gaze: GazeRays | None, scene: Boxes | None = None
) -> ScoringTargets:
    """Return what metrics need of the sequences of a chunk, read with :data:`COLUMNS`."""
    return ScoringTargets(
        goal_location=goals.astype(np.float64),
        prime_time=chunk.numbers("prime_time") - chunk.numbers("start_time"),
        hand=np.array([_SIDES.get(side, UNKNOWN_HAND) for side in chunk.strings("hand")]),
        head_tilt_deg=chunk.numbers("head_tilt_deg"),
        fps=chunk.numbers("fps"),
        gaze=gaze,
        scene=scene,
    )


def _check(rows: PredictionRows, recorded: MotionBatch, chunk: SequenceChunk, sample: int, part: _Part) -> None:
    """Name the sequence where a motion or its gaze cannot be scored."""
    rules = part.rules
    ids = chunk.sequence_ids

    def place(row: int) -> str:
        where = part.predictions.where(part.names[row], sample)
        if rules.run_of is None:
            return f"{where}, {ids[row]}"
        return f"method '{rules.run_of}', sequence {ids[row]} in {where}"

    predicted = MotionBatch(rows.values, rows.offsets)
    expected = recorded.n_frames
    fps = float(chunk.numbers("fps")[0])  # a selection has one rate
    if rules.native_fps is not None:
        expected = motions.native_frames(expected, fps=fps, native_fps=rules.native_fps)
        fps = rules.native_fps
    wrong = None if rules.allow_length_mismatch else length_problem(place, expected, predicted.n_frames, fps=fps)
    if wrong is not None:
        raise PredictionsError(f"{wrong} {SAME_LENGTH if rules.run_of is None else _NOT_AS_KEPT}")
    short = np.flatnonzero(predicted.n_frames < 2)
    if short.size:
        raise PredictionsError(f"{place(int(short[0]))}: expected 2 frames or more, found 1.")
    # Checked before resampling: an interpolated NaN would name the wrong frame.
    impossible = np.flatnonzero(motions.impossible_frames(predicted.values, rules.farthest))
    if impossible.size:
        row = int(predicted.sequence_of_row[impossible[0]])
        motion = predicted.values[predicted.offsets[row] : predicted.offsets[row + 1]]
        kept = "" if rules.run_of is None else f" {_NOT_AS_KEPT}"
        raise PredictionsError(f"{place(row)}, {motions.coordinate_problem(motion, rules.farthest)}{kept}")
    if rows.gaze is None:
        return
    for row in range(len(ids)):
        frames = slice(rows.offsets[row], rows.offsets[row + 1])
        problem = motions.gaze_problem(rows.values[frames], rows.gaze[frames, 0], rows.gaze[frames, 1])
        if problem:
            raise PredictionsError(f"{place(row)}, gaze, {problem}")


def at_table_rate(predicted: PredictionRows, asked: Int[np.ndarray, " n"], *, step: float) -> PredictionRows:
    """Return motions at their own rate as a run resamples them before it keeps them.

    Args:
        predicted: Motions at their own rate.
        asked: Frames that each shall have.
        step: Frames of ``predicted`` from one new frame to the next.
    """
    n_frames = np.diff(predicted.offsets)
    valid = np.arange(int(n_frames.max())) < n_frames[:, None]

    def padded(values: np.ndarray) -> np.ndarray:
        whole = np.zeros((*valid.shape, *values.shape[1:]), np.float32)
        whole[valid] = values
        return whole

    gaze = None
    if predicted.gaze is not None:
        gaze = Gaze(padded(predicted.gaze[:, 0]), padded(predicted.gaze[:, 1]))
    found = motions.resampled(Motions(padded(predicted.values), n_frames, gaze=gaze), asked, step=step)
    rays = None if found.gaze is None else np.stack((found.gaze.origin, found.gaze.direction), axis=2)
    return PredictionRows.from_padded(found.joints, found.n_frames, gaze=rays)


# Motions of a dataset that are looked at: a fault of the conversion is in all of them, and more would cost as much
# time as the scores themselves.
_LOOKED_AT = 32
# A motion that begins so near to the recorded pose, in metres, was given it, whatever its condition is said to be.
_BEGINS_THERE = 0.05


def certain_faults(
    selection: Selection, predictions: Predictions, *, condition: str, id_seed: int = 0, native_fps: float | None = None
) -> tuple[Diagnosis, ...]:
    """Return what is certainly wrong with the first sample of motions: axes, unit, frame, rate, joints, left and right.

    Args:
        selection: The sequences that are scored.
        predictions: Holds a motion for each of them.
        condition: What the method was given; a motion is compared with the initial pose where that is part of it.
        id_seed: Seed behind the opaque ids, where the predictions have those.
        native_fps: Rate of the predictions; None for the table's.
    """
    # Evenly spread over the table, so that every recording has its share.
    places = np.linspace(0, len(selection) - 1, min(len(selection), _LOOKED_AT)).round().astype(int)
    chosen = selection.chosen(np.isin(np.arange(len(selection)), places))
    salt = run_salt(id_seed, selection.table.identity)
    known = {each.value for each in Condition if "initial_joints" in GIVEN[each]}
    motions = []
    expected = []
    for place, chunk in chosen.windows(["joints", "previous_joints"]):
        ids = chunk.sequence_ids
        rows = predictions.motions(ids if predictions.id_column != "opaque_id" else opaque_ids(ids, salt), 0)
        if native_fps is not None:
            rows = at_table_rate(rows, chosen.n_frames[place], step=native_fps / selection.fps)
        for row, asked in enumerate(chosen.n_frames[place].tolist()):
            motion = rows.values[rows.offsets[row] : rows.offsets[row + 1]].astype(np.float64)
            initial = chunk.joints[chunk.offsets[row]].astype(np.float64)
            previous = chunk.poses("previous_joints")[row].astype(np.float64)
            motions.append(motion)
            if condition in known or np.abs(motion[0] - initial).max() < _BEGINS_THERE:
                expected.append(Expected(initial, previous, asked, selection.fps))
            else:
                expected.append(Expected(None, None, asked, selection.fps))
    found = diagnose(motions, expected, fps=selection.fps, examinations=OF_THE_CONVERSION)
    # Scoring itself refuses another length, unless the user allows it.
    return tuple(each for each in found if each.certain and each.kind != "length")
