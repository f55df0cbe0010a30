"""Predicted motions against the table, some sequences at a time."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from prbench.contract import Condition, ConditionBatch, Gaze, Motions
from prbench.engine import Engine, InProcess
from prbench.errors import PredictionsError
from prbench.geometry.shapes import Boxes
from prbench.harness.conditions import SCENE_COLUMNS, boxes_around, opaque_ids, run_salt, solid_boxes
from prbench.harness.methods.motions import (
    at_table_rate,
    coordinate_problem,
    gaze_problem,
    impossible_frames,
    native_frames,
)
from prbench.harness.planning import WINDOW, Selection
from prbench.harness.recorded_motion import is_recorded_motion, length_problem
from prbench.harness.run_folder.predictions import PredictionRows, Predictions
from prbench.harness.run_folder.scores import SCORES
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
from prbench.metrics.registry import MetricValues
from prbench.protocol.manifests import MetricConstants
from prbench.sequences.sequence import SequenceChunk

COLUMNS = ["goal_location", "prime_time", "start_time", "hand", "head_tilt_deg", "fps", "joints"]
_GAZE_COLUMNS = ["gaze_origin", "gaze_direction", "gaze_valid"]
_SIDES = {"left": 0, "right": 1}
_SCORED_TOGETHER = 256
"""Sequences whose motions are in memory together: what metrics make of motions takes several times their memory."""
SAME_LENGTH = "Give every motion the length of the recorded one, or pass --allow-length-mismatch."
"""Remedy for motions of another length."""
_NOT_AS_KEPT = (
    "A run keeps no such motion of a method: the file was changed, or is of an older prbench. Delete it and run the"
    " method again."
)
_CARRIES_COPY_REMARK = frozenset(info.id for info in METRICS if info.carries_copy_remark)


@dataclass(frozen=True)
class ScoringRules:
    """Rules by which the motions of one dataset are scored."""

    constants: MetricConstants
    recorded_motion: bool = False
    """The predictions are the recorded motion itself: recorded gaze is scored too."""
    other_goals: Float[np.ndarray, "n 3"] | None = None
    """Score against these goals, one a chosen sequence, instead of each sequence's own; metrics that compare the
    recorded motion with itself are left out then."""
    run_of: str | None = None
    """The method whose run has kept the predictions; None where somebody handed them in as a file."""
    farthest: float = FARTHEST_COORDINATE
    """Metres from the origin beyond which a coordinate is refused."""
    allow_length_mismatch: bool = False
    id_seed: int = 0
    """Seed behind the opaque ids, where the predictions have those."""
    native_fps: float | None = None
    """Rate of the predictions; None for the table's, to which the others are brought."""


@dataclass(frozen=True)
class _Part:
    """Scoring work for one worker."""

    dataset: str
    recorded: pa.RecordBatch
    goals: Float[np.ndarray, "n 3"]
    names: tuple[str, ...]
    """Ids as the predictions have them."""
    samples: tuple[int, ...]
    predictions: Predictions
    rules: ScoringRules
    scene: Boxes | None

    def some(self, start: int, stop: int) -> _Part:
        """Return the work on some of the sequences, counted from 0."""
        rows = np.arange(len(self.names))[start:stop]
        return replace(
            self,
            recorded=self.recorded.slice(start, stop - start),
            goals=self.goals[start:stop],
            names=self.names[start:stop],
            scene=None if self.scene is None else self.scene.of_rows(rows),
        )


def score_selection(
    selection: Selection,
    predictions: Path | Predictions,
    *,
    samples: Sequence[int],
    rules: ScoringRules,
    engine: Engine,
) -> Iterator[pa.Table]:
    """Score all chosen sequences.

    Args:
        selection: The sequences; every one has a prediction for every sample.
        predictions: Opened, or a file or folder of parts.
        samples: Indices of the samples.
        rules: How to score.
        engine: Where to score; the values are the same for any.

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
    scored = engine.map(_score_part, _parts(selection, opened, tuple(samples), rules, size))
    while tables := list(itertools.islice(scored, WINDOW // size)):
        yield pa.concat_tables(tables)


def score_recorded(
    selection: Selection, constants: MetricConstants, metrics: Collection[str]
) -> tuple[dict[str, Float[np.ndarray, " n"]], Float[np.ndarray, "n 3"]]:
    """Score the recorded motion of each chosen sequence against its own goal.

    Args:
        selection: The sequences.
        constants: Of the protocol.
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
        gaze = _recorded_gaze(chunk) if by_gaze else None
        boxes = boxes_around(chunk, scene) if scene is not None else None
        values = score(recorded, recorded, targets_of(chunk, goals[-1], gaze, boxes), constants, metrics=wanted)
        parts.append({name: column.value for name, column in values.items()})
        for name in by_gaze:
            unknown = values[name].flags.get(INVALID_GAZE)
            if unknown is not None:
                parts[-1][name] = np.where(unknown, np.nan, parts[-1][name])
    return {name: np.concatenate([part[name] for part in parts]) for name in wanted}, np.concatenate(goals)


def _namer(
    selection: Selection, predictions: Predictions, rules: ScoringRules
) -> Callable[[Sequence[str]], Sequence[str]]:
    """Return what turns ids of sequences into those that the predictions have."""
    if predictions.id_column != "opaque_id":
        return lambda names: names
    salt = run_salt(rules.id_seed, selection.table.identity)
    return lambda names: opaque_ids(names, salt)


def _parts(
    selection: Selection, predictions: Predictions, samples: tuple[int, ...], rules: ScoringRules, size: int
) -> Iterator[_Part]:
    names_of = _namer(selection, predictions, rules)
    scene = solid_boxes(selection.table)
    columns = COLUMNS + (_GAZE_COLUMNS if rules.recorded_motion else []) + ([] if scene is None else SCENE_COLUMNS)
    for place, chunk in selection.windows(columns, rows=size):
        names = tuple(names_of(chunk.sequence_ids))
        goals = chunk.vectors("goal_location") if rules.other_goals is None else rules.other_goals[place]
        dataset = selection.table.info.dataset
        boxes = boxes_around(chunk, scene) if scene is not None else None
        # Not the ids of all motions, which would be sent to a worker with every part.
        asked = predictions.only(names, samples)
        yield _Part(dataset, chunk.batch, goals, names, samples, asked, rules, boxes)


def _score_part(part: _Part) -> pa.Table:
    starts = range(0, len(part.names), _SCORED_TOGETHER)
    return pa.concat_tables([_score_together(part.some(start, start + _SCORED_TOGETHER)) for start in starts])


def _score_together(part: _Part) -> pa.Table:
    chunk = SequenceChunk(part.recorded)
    recorded = MotionBatch(chunk.joints, chunk.offsets)
    gaze = _recorded_gaze(chunk) if part.rules.recorded_motion else None
    targets = targets_of(chunk, part.goals, gaze, part.scene)
    by_sample = []
    for sample in part.samples:
        rows = part.predictions.motions(part.names, sample)
        predicted = MotionBatch(rows.values, rows.offsets)
        _check(predicted, recorded, chunk.sequence_ids, sample, part)
        if rows.gaze is not None:
            _check_gaze(rows, chunk.sequence_ids, sample, part)
        if part.rules.native_fps is not None:
            rows = _at_table_rate(rows, recorded, part)
            predicted = MotionBatch(rows.values, rows.offsets)
        shown = targets if rows.gaze is None else replace(targets, gaze=_generated_gaze(rows.gaze))
        rules = part.rules
        metrics = None
        if rules.recorded_motion and rules.other_goals is not None:
            metrics = frozenset(
                info.id
                for info in METRICS
                if not info.compares_with_recorded and (shown.scene is not None or info.id not in SCENE_METRICS)
            )
        values = score(
            predicted,
            recorded,
            shown,
            rules.constants,
            metrics=metrics,
            allow_length_mismatch=rules.allow_length_mismatch,
        )
        values = list(values.values())
        if not part.rules.recorded_motion:
            values = [_with_copies_marked(value, predicted, recorded) for value in values]
        by_sample.append(values)
    return _long_form(part.dataset, chunk.sequence_ids, part.samples, by_sample)


def _recorded_gaze(chunk: SequenceChunk) -> GazeRays:
    return GazeRays(
        chunk.frames("gaze_origin").astype(np.float64),
        chunk.frames("gaze_direction").astype(np.float64),
        chunk.frames("gaze_valid"),
    )


def _generated_gaze(rays: Float[np.ndarray, "frames 2 3"]) -> GazeRays:
    direction = rays[:, 1].astype(np.float64)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return GazeRays(rays[:, 0].astype(np.float64), direction, np.ones(len(rays), dtype=bool))


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


def _with_copies_marked(values: MetricValues, predicted: MotionBatch, recorded: MotionBatch) -> MetricValues:
    """Mark motions that are the recorded ones, in the metric that carries the remark; leave all others as they are."""
    if values.metric not in _CARRIES_COPY_REMARK:
        return values
    copies = is_recorded_motion(predicted, recorded)
    return replace(values, flags={**values.flags, RECORDED_MOTION: copies}) if copies.any() else values


def _check(predicted: MotionBatch, recorded: MotionBatch, ids: list[str], sample: int, part: _Part) -> None:
    """Name the sequence where a motion cannot be scored."""

    def place(row: int) -> str:
        return _place(row, ids, sample, part)

    remedy = SAME_LENGTH if part.rules.run_of is None else _NOT_AS_KEPT
    expected = recorded.n_frames
    fps = _fps(part)
    native_fps = part.rules.native_fps
    if native_fps is not None:
        expected = native_frames(expected, fps=fps, native_fps=native_fps)
        fps = native_fps
    if not part.rules.allow_length_mismatch:
        wrong = length_problem(place, expected, predicted.n_frames, fps=fps)
        if wrong is not None:
            raise PredictionsError(f"{wrong} {remedy}")
    short = np.flatnonzero(predicted.n_frames < 2)
    if short.size:
        raise PredictionsError(f"{place(int(short[0]))}: expected 2 frames or more, found 1.")
    # Checked before resampling: an interpolated NaN would name the wrong frame.
    impossible = np.flatnonzero(impossible_frames(predicted.values, part.rules.farthest))
    if impossible.size:
        row = int(predicted.sequence_of_row[impossible[0]])
        motion = predicted.values[predicted.offsets[row] : predicted.offsets[row + 1]]
        kept = "" if part.rules.run_of is None else f" {_NOT_AS_KEPT}"
        raise PredictionsError(f"{place(row)}, {coordinate_problem(motion, part.rules.farthest)}{kept}")


def _place(row: int, ids: list[str], sample: int, part: _Part) -> str:
    where = part.predictions.where(part.names[row], sample)
    method = part.rules.run_of
    return f"{where}, {ids[row]}" if method is None else f"method '{method}', sequence {ids[row]} in {where}"


def _check_gaze(rows: PredictionRows, ids: list[str], sample: int, part: _Part) -> None:
    """Name the sequence whose gaze cannot be scored."""
    assert rows.gaze is not None
    for row in range(len(ids)):
        frames = slice(rows.offsets[row], rows.offsets[row + 1])
        problem = gaze_problem(rows.values[frames], rows.gaze[frames, 0], rows.gaze[frames, 1])
        if problem:
            raise PredictionsError(f"{_place(row, ids, sample, part)}, gaze, {problem}")


def _at_table_rate(predicted: PredictionRows, recorded: MotionBatch, part: _Part) -> PredictionRows:
    """Motions at their own rate as a run resamples them before it keeps them."""
    assert part.rules.native_fps is not None
    n_frames = np.diff(predicted.offsets)
    valid = np.arange(int(n_frames.max())) < n_frames[:, None]

    def padded(values: np.ndarray) -> np.ndarray:
        whole = np.zeros((*valid.shape, *values.shape[1:]), np.float32)
        whole[valid] = values
        return whole

    gaze = None
    if predicted.gaze is not None:
        gaze = Gaze(padded(predicted.gaze[:, 0]), padded(predicted.gaze[:, 1]))
    asked = ConditionBatch(
        condition=Condition.NONE,
        n_frames=recorded.n_frames,
        fps=_fps(part),
        opaque_id=part.names,
        noise_seed=(0,) * len(part.names),
    )
    motions = Motions(padded(predicted.values), n_frames, gaze=gaze)
    resampled = at_table_rate(motions, asked, native_fps=part.rules.native_fps)
    rays = None
    if resampled.gaze is not None:
        rays = np.stack((resampled.gaze.origin, resampled.gaze.direction), axis=2)
    return PredictionRows.from_padded(resampled.joints, resampled.n_frames, gaze=rays)


def _fps(part: _Part) -> float:
    """Return the frame rate of the table; a selection has one rate."""
    return float(SequenceChunk(part.recorded).numbers("fps")[0])


def _long_form(dataset: str, ids: list[str], samples: Sequence[int], by_sample: list[list[MetricValues]]) -> pa.Table:
    metrics = [values.metric for values in by_sample[0]]
    repeats = len(samples) * len(metrics)
    value = np.stack([[column.value for column in values] for values in by_sample])  # (samples, metrics, sequences)
    flags = [[column.flag for column in values] for values in by_sample]
    columns = [
        pa.array(np.repeat(np.array(ids, dtype=object), repeats), pa.string()),
        pa.array([dataset] * (len(ids) * repeats), pa.string()),
        pa.array(np.tile(np.repeat(np.array(samples, dtype=np.int32), len(metrics)), len(ids))),
        pa.array(metrics * (len(ids) * len(samples)), pa.string()),
        pa.array(np.moveaxis(value, 2, 0).reshape(-1)),
        pa.array([flag[i] for i in range(len(ids)) for columns in flags for flag in columns], pa.string()),
    ]
    return pa.Table.from_arrays(columns, schema=SCORES)
