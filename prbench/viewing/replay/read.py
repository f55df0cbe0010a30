"""Scenes out of a table and the runs that were made on it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Sequence

import numpy as np
from jaxtyping import Float

from prbench.manifests import MetricConstants, load_protocol
from prbench.metrics import UNKNOWN_HAND, GazeRays, MotionBatch, ScoringTargets, score
from prbench.sequences import DatasetInfo, SequenceChunk, SequenceTable
from prbench.sequences.redistribution import may_pass_on, notice, require_may_pass_on
from prbench.skeleton import invert_rigid, transform_points
from prbench.viewing.replay import palette
from prbench.viewing.replay.run_motions import RunMotions
from prbench.viewing.replay.scene import RECORDED, Gaze, Goal, Scene, ShownMotion, Thresholds

_SIDES = {"left": 0, "right": 1}

Around = Callable[[SequenceChunk], Float[np.ndarray, "k 3"]]
"""Tells what stood around one sequence (:attr:`Scene.surroundings`)."""


def read_scenes(
    table: SequenceTable,
    sequence_ids: Sequence[str],
    runs: Sequence[RunMotions] = (),
    *,
    permitted: Collection[str] = (),
    around: Around | None = None,
) -> Iterator[Scene]:
    """Read sequences with what each run made of them, in the order given.

    Where the dataset's licence keeps recorded motion (``redistribution``), the recorded motion, its gaze and its goal
    are left out; generated motions stay.

    Args:
        table: Where the sequences are.
        sequence_ids: Of the table, and of every run.
        runs: Made on that very table.
        permitted: Datasets for which the user has permission to pass recorded motion on.
        around: Tells what stood around a sequence; None draws the motions alone.

    Raises:
        RedistributionError: if nothing is left that may be shown.
        PredictionsError: if a motion does not fit its sequence.
    """
    require_something_to_show(table.info, runs, permitted)
    scores = [run.scores(sequence_ids) for run in runs]
    chunks = {chunk.sequence_ids[0]: chunk for chunk in table.chunks(ids=frozenset(sequence_ids), rows=1)}
    for name in sequence_ids:
        motions = [
            ShownMotion(run.label, colour, run.joints(name, int(chunks[name].n_frames[0])), values[name])
            for run, colour, values in zip(runs, palette.METHODS, scores, strict=False)
        ]
        yield scene_of(chunks[name], table.info, motions, permitted=permitted, around=around)


def require_something_to_show(info: DatasetInfo, runs: Sequence[RunMotions], permitted: Collection[str]) -> None:
    """Refuse a view in which only recorded motion would stand, or a control's, which is made of it, if that is kept.

    Raises:
        RedistributionError: naming the dataset and how permission is stated.
    """
    if not runs:
        require_may_pass_on(info, "the view", permitted)
    for run in runs:
        if run.run.record.method.kind == "control":
            require_may_pass_on(info, f"the motions of '{run.label}'", permitted)


def scene_of(
    chunk: SequenceChunk,
    info: DatasetInfo,
    motions: Sequence[ShownMotion] = (),
    *,
    permitted: Collection[str] = (),
    around: Around | None = None,
) -> Scene:
    """One row of a table with generated motions beside it.

    Args:
        chunk: The row, with all columns.
        info: Of its dataset.
        motions: What methods made of it.
        permitted: See :func:`read_scenes`.
        around: See :func:`read_scenes`.
    """
    constants = load_protocol().metrics
    shown = may_pass_on(info, permitted)
    gaze = _gaze(chunk)
    placed = info.why_not_scored is None  # else nobody knows where the goal is, so that no distance means anything
    scores = _own_scores(chunk, constants) if placed else {}
    recorded = ShownMotion(RECORDED, palette.RECORDED, chunk.joints.astype(np.float64), scores)
    return Scene(
        sequence_id=chunk.sequence_ids[0],
        dataset=info.dataset,
        title=_title(chunk),
        action=chunk.strings("action")[0],
        fps=float(chunk.numbers("fps")[0]),
        n_frames=int(chunk.n_frames[0]),
        prime_time=float(chunk.numbers("prime_time")[0] - chunk.numbers("start_time")[0]),
        head_tilt_deg=float(chunk.numbers("head_tilt_deg")[0]),
        motions=(recorded, *motions) if shown else tuple(motions),
        thresholds=Thresholds(constants.prime_distance, constants.prime_window, constants.reach_distance),
        goal=_goal(chunk) if shown and placed else None,
        gaze=gaze if shown and gaze.valid.any() else None,
        notice=notice(info, permitted),
        surroundings=around(chunk) if shown and around is not None else None,
    )


def _title(chunk: SequenceChunk) -> str:
    action, name, hand, split = (chunk.strings(column)[0] for column in ("action", "object_name", "hand", "split"))
    return f"{action} of {name}, {f'{hand} hand' if hand else 'hand unknown'} ({split})"


def _goal(chunk: SequenceChunk) -> Goal:
    low, high = chunk.vectors("goal_box_world_min")[0], chunk.vectors("goal_box_world_max")[0]
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))), dtype=np.float64)
    canonical_from_world = invert_rigid(chunk.vectors("world_from_canonical").reshape(4, 4))
    return Goal(chunk.vectors("goal_location")[0].astype(np.float64), transform_points(canonical_from_world, corners))


def _gaze(chunk: SequenceChunk) -> Gaze:
    return Gaze(
        chunk.frames("gaze_origin").astype(np.float64),
        chunk.frames("gaze_direction").astype(np.float64),
        np.asarray(chunk.frames("gaze_valid"), dtype=bool),
    )


def _own_scores(chunk: SequenceChunk, constants: MetricConstants) -> dict[str, float]:
    """What the recorded motion itself scores: the ceiling that a method is compared with."""
    recorded = MotionBatch(chunk.joints, chunk.offsets)
    gaze = _gaze(chunk)
    values = score(recorded, recorded, _targets(chunk, gaze), constants)
    return {metric: float(column.value[0]) for metric, column in values.items()}


def _targets(chunk: SequenceChunk, gaze: Gaze) -> ScoringTargets:
    return ScoringTargets(
        goal_location=chunk.vectors("goal_location").astype(np.float64),
        prime_time=chunk.numbers("prime_time") - chunk.numbers("start_time"),
        hand=np.array([_SIDES.get(side, UNKNOWN_HAND) for side in chunk.strings("hand")]),
        head_tilt_deg=chunk.numbers("head_tilt_deg"),
        fps=chunk.numbers("fps"),
        gaze=GazeRays(gaze.origin, gaze.direction, gaze.valid),
    )
