"""Controls belong to the harness, not to adapters: they know what no method may know.

As ``--method``, under any condition: ``ground-truth`` (the recorded motion through the same code: the ceiling),
``ground-truth-resampled`` (the same after a round trip through the features that models learn from: what the
representation alone costs), ``ground-truth-20fps`` and ``ground-truth-30fps`` (the same through another frame rate and
back, as the motions of a method with a rate of its own go), ``scripted`` (constant timing: the least that a method
has to beat), the cheats of :mod:`prbench.harness.scripted` (what a metric is worth, ``docs/audit.md``) and
``nearest-neighbour`` (the most similar training motion).

As ``--control shuffled-goal`` beside any method: it gets another sequence's goal and is scored on its own, so that a
method whose score does not drop ignores its goal; the recorded motion, which gets no goal, is scored against another
sequence's goal instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.contract import Motions
from prbench.errors import TableError
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.conditions import ConditionSource, ConditionStream
from prbench.harness.methods.installed import (
    GROUND_TRUTH,
    GROUND_TRUTH_20_FPS,
    GROUND_TRUTH_30_FPS,
    GROUND_TRUTH_RESAMPLED,
    NEAREST_NEIGHBOUR,
    SCRIPTED,
    SHUFFLED_GOAL,
    SWAY,
)
from prbench.harness.methods.motions import native_frames, resampled
from prbench.harness.planning import WINDOW, Selection, select
from prbench.harness.scripted import SCRIPTED_CONTROLS, SWAYING, ScriptedStart, altered_joints
from prbench.metrics import MotionBatch
from prbench.representation import decode, encode
from prbench.sequences import SequenceTable
from prbench.synthetic.people.kinematics import turn

Plan = list[Int[np.ndarray, "_"]]
Motion = Float[np.ndarray, "frames 22 3"]

# Metres between two goals that count like one second between two lengths; our choice.
LENGTH_WEIGHT = 0.5
_NO_DIRECTION = 1e-6  # m; a goal above the first pelvis lies in no direction


@dataclass(frozen=True)
class Tasks:
    """All sequences of a table as tasks, one row each; canonical frame, metres, seconds."""

    sequence_ids: tuple[str, ...]
    recording_ids: np.ndarray
    goal_location: Float[np.ndarray, "n 3"]
    seconds: Float[np.ndarray, " n"]

    @classmethod
    def read(cls, table: SequenceTable) -> Tasks:
        """Read the tasks of all splits: nothing is learnt from them."""
        chunks = list(table.chunks(columns=["recording_id", "goal_location", "fps"]))
        ids = tuple(name for chunk in chunks for name in chunk.sequence_ids)
        recordings = np.array([name for chunk in chunks for name in chunk.strings("recording_id")], dtype=object)
        goals = np.concatenate([chunk.vectors("goal_location").astype(np.float64) for chunk in chunks])
        return cls(ids, recordings, goals, np.concatenate([chunk.n_frames / chunk.numbers("fps") for chunk in chunks]))

    def most_similar(self, row: int, count: int) -> Int[np.ndarray, " found"]:
        """Rows of the most similar tasks of other recordings, the most similar first; fewer where there are fewer.

        The canonical frame makes the goal's place one of bearing, distance and height.
        """
        goals = np.linalg.norm(self.goal_location - self.goal_location[row], axis=-1)
        distance = np.hypot(goals, LENGTH_WEIGHT * (self.seconds - self.seconds[row]))
        others = np.flatnonzero(self.recording_ids != self.recording_ids[row])
        return others[np.argsort(distance[others], kind="stable")[:count]]


def read_motions(
    table: SequenceTable, ids: frozenset[str], *, split: str | None = None
) -> dict[str, Float[np.ndarray, "_ 22 3"]]:
    """Map some sequences to their recorded joints; canonical frame, metres."""
    motions = {}
    for chunk in table.chunks(split=split, columns=["joints"], ids=ids):
        motions |= dict(zip(chunk.sequence_ids, np.split(chunk.joints, chunk.offsets[1:-1]), strict=True))
    return motions


def at_length(motion: Motion, n_frames: int) -> Float[np.ndarray, "n_frames 22 3"]:
    """Return the whole motion in another number of frames, interpolated linearly."""
    place = np.linspace(0.0, len(motion) - 1, n_frames)
    left = np.minimum(place.astype(np.int64), len(motion) - 2)
    share = (place - left)[:, None, None]
    return motion[left].astype(np.float64) * (1 - share) + motion[left + 1] * share


def laid_on_goal(motion: Motion, its_goal: Float[np.ndarray, "3"], goal: Float[np.ndarray, "3"]) -> Motion:
    """Return the motion turned about the vertical through the origin, and moved over the ground, until the goals agree.

    In a canonical frame the first pelvis stands over the origin, so this keeps the distance to the goal's direction.
    """
    its_goal = its_goal.astype(np.float64)
    angle = 0.0
    if min(np.hypot(its_goal[0], its_goal[2]), np.hypot(goal[0], goal[2])) > _NO_DIRECTION:
        angle = float(np.arctan2(goal[0], goal[2]) - np.arctan2(its_goal[0], its_goal[2]))
    moved = turn(angle, 0.0, motion)
    step = goal - turn(angle, 0.0, its_goal)
    step[1] = 0.0
    return moved + step


# Controls that take recorded motion through another frame rate, and that rate.
ROUND_TRIP_FPS = {GROUND_TRUTH_20_FPS: 20.0, GROUND_TRUTH_30_FPS: 30.0}
# Controls whose motion is the recorded one: it gets no goal, has gaze, and stands under the data's own terms.
RECORDED_MOTION = frozenset({GROUND_TRUTH, GROUND_TRUTH_RESAMPLED, *ROUND_TRIP_FPS})
# Controls whose motions are people's, those of training sequences too: they stand under the data's own terms.
HOLDS_RECORDINGS = RECORDED_MOTION | {NEAREST_NEIGHBOUR, SWAY}


@dataclass(frozen=True)
class ControlInfo:
    """One control, for lists and messages.

    Attributes:
        name: The value of the option that asks for it.
        use: That option: ``--method`` or ``--control``.
        summary: What it does.
    """

    name: str
    use: str
    summary: str


CONTROLS = (
    ControlInfo(GROUND_TRUTH, "--method", "the recorded motion itself: the ceiling of every metric"),
    ControlInfo(GROUND_TRUTH_RESAMPLED, "--method", "the recorded motion through the features that models learn from"),
    ControlInfo(GROUND_TRUTH_20_FPS, "--method", "the recorded motion at 20 frames per second and back"),
    ControlInfo(GROUND_TRUTH_30_FPS, "--method", "the recorded motion at 30 frames per second and back"),
    ControlInfo(SCRIPTED, "--method", "constant timing: faces the goal at 2.0 s, then glides there and reaches"),
    ControlInfo("stare", "--method", "cheat: faces the goal from the first frame on and never moves"),
    ControlInfo("stare-late", "--method", "cheat: turns to the goal just before 2.0 s and stares, without a step"),
    ControlInfo("tremor", "--method", "cheat: stare, with a head that trembles by 0.1 mm"),
    ControlInfo("teleport", "--method", "cheat: is at the goal from one frame to the next"),
    ControlInfo("float", "--method", "cheat: scripted, 10 cm above the floor"),
    ControlInfo("heel-skater", "--method", "cheat: glides and bends, with its toes higher than its ankles"),
    ControlInfo("hover", "--method", "cheat: glides and bends, with its toes at 5 cm, where no slide is seen"),
    ControlInfo("long-arms", "--method", "cheat: scripted, with arms of twice their length from frame 0 on"),
    ControlInfo("doll", "--method", "cheat: scripted, at a quarter of the body's size from frame 0 on"),
    ControlInfo("nodder", "--method", "cheat: stare, with a nod off the goal and back just before 2.0 s"),
    ControlInfo("stepper", "--method", "cheat: turns with steps, bends and reaches for what is near"),
    ControlInfo(SWAY, "--method", "cheat: the recorded motion, swaying sideways by 3 cm"),
    ControlInfo(NEAREST_NEIGHBOUR, "--method", "the training motion of the most similar task, laid on the goal"),
    ControlInfo(SHUFFLED_GOAL, "--control", "gives a method another sequence's goal and scores it on its own"),
)


def control_motions(
    name: str, selection: Selection, source: ConditionSource | ConditionStream, plan: Plan
) -> Iterator[Motions]:
    """Yield the motions of a control for each planned batch, in order.

    Args:
        name: One of :data:`~prbench.harness.methods.installed.METHOD_CONTROLS`.
        selection: The chosen sequences.
        source: Their conditions, for ``nearest-neighbour`` those of all; ``scripted`` takes its goals from here.
        plan: Batches of :func:`prbench.harness.planning.plan_batches`.
    """
    if name in ROUND_TRIP_FPS:
        # To another rate and back, both by linear interpolation, as motions of ``native_fps`` go.
        step = selection.fps / ROUND_TRIP_FPS[name]
        for motions in _recorded(selection, plan, through_features=False):
            n_frames = native_frames(motions.n_frames, fps=selection.fps, native_fps=ROUND_TRIP_FPS[name])
            there = resampled(motions, n_frames, step=step)
            yield resampled(there, motions.n_frames, step=ROUND_TRIP_FPS[name] / selection.fps)
        return
    if name in RECORDED_MOTION:
        yield from _recorded(selection, plan, through_features=name == GROUND_TRUTH_RESAMPLED)
        return
    if name == SWAY:
        for motions in _recorded(selection, plan, through_features=False):
            recorded = MotionBatch.from_padded(motions.joints, motions.n_frames)
            valid = np.arange(motions.joints.shape[1]) < motions.n_frames[:, None]
            motions.joints[valid] = altered_joints(recorded, selection.fps, SWAYING)
            yield motions
        return
    if name == NEAREST_NEIGHBOUR:
        assert isinstance(source, ConditionSource), "the task of any sequence is compared"
        yield from retrieved_motions(selection, source, plan)
        return
    for rows in plan:
        own, places = source.around(rows)
        start = ScriptedStart(own.initial_joints[places], own.goal_location[places], own.head_tilt_deg[places])
        joints = SCRIPTED_CONTROLS[name](start, own.n_frames[places], own.fps)
        yield Motions(joints.astype(np.float32), own.n_frames[places])


def _recorded(selection: Selection, plan: Plan, *, through_features: bool) -> Iterator[Motions]:
    """Yield recorded joints; a batch never crosses a window, so one window at a time is in memory."""
    # plan_batches forms batches within windows, so no batch ever needs two of them.
    waiting = iter(plan)
    for place, chunk in selection.windows(["joints", "next_joints"]):
        recorded = np.split(chunk.joints, chunk.offsets[1:-1])
        if through_features:  # as many frames as recorded: the last step is led by the true next one
            places = zip(chunk.sequence_ids, recorded, chunk.poses("next_joints"))
            recorded = [decode(encode(own, next_joints=n, source=name, upright=False)) for name, own, n in places]
        n_frames = chunk.n_frames
        taken = 0
        while taken < len(chunk):
            rows = next(waiting) - place.start
            assert rows.min() >= 0
            assert rows.max() < len(chunk)
            padded = np.zeros((len(rows), int(n_frames[rows].max()), N_JOINTS, 3), dtype=np.float32)
            for i, row in enumerate(rows):
                padded[i, : n_frames[row]] = recorded[row]
            yield Motions(padded, n_frames[rows])
            taken += len(rows)


_TRAINING = "train"


def retrieved_motions(selection: Selection, source: ConditionSource, plan: Plan) -> Iterator[Motions]:
    """Yield the motions of each planned batch, in order.

    Args:
        selection: The chosen sequences.
        source: Their conditions.
        plan: Batches of :func:`prbench.harness.planning.plan_batches`; a batch never crosses a window.

    Raises:
        TableError: if the table has no training sequences, or none of another recording.
    """
    table = selection.table
    if not table.scalars(split=_TRAINING, columns=["split"]).num_rows:
        expected = "expected training sequences, which nearest-neighbour retrieves from"
        found = f"found none in split '{_TRAINING}'. Build more recordings, or leave this control out."
        raise TableError(f"{table.folder}: {expected}, {found}")
    training = select(table, split=_TRAINING, limit=None)
    known = ConditionSource.read(training)
    # Row of the most similar task of another recording.
    recordings = np.array(training.recording_ids, dtype=object)
    nearest = np.zeros(len(selection), dtype=np.int64)
    for row, recording in enumerate(selection.recording_ids):
        poses = np.linalg.norm(known.initial_joints - source.initial_joints[row], axis=-1).mean(axis=-1)
        goals = np.linalg.norm(known.goal_location - source.goal_location[row], axis=-1)
        distance = np.where(recordings == recording, np.inf, poses + goals)
        nearest[row] = distance.argmin()
        if not np.isfinite(distance[nearest[row]]):
            remedy = "Build more recordings, or leave nearest-neighbour out."
            expected = f"expected training sequences of another recording than {recording}"
            raise TableError(f"{table.folder}: {expected}, found none. {remedy}")
    place = -1
    motions: dict[str, np.ndarray] = {}
    for rows in plan:
        if int(rows[0]) // WINDOW != place:
            # Only the motions of one window are held in memory.
            place = int(rows[0]) // WINDOW
            window = nearest[place * WINDOW : (place + 1) * WINDOW]
            motions = read_motions(table, frozenset(training.sequence_ids[row] for row in window), split=_TRAINING)
        n_frames = source.n_frames[rows]
        joints = np.zeros((len(rows), int(n_frames.max()), N_JOINTS, 3), dtype=np.float32)
        for i, row in enumerate(rows):
            found = int(nearest[row])
            motion = at_length(motions[training.sequence_ids[found]], int(n_frames[i]))
            joints[i, : n_frames[i]] = laid_on_goal(motion, known.goal_location[found], source.goal_location[row])
        yield Motions(joints, n_frames)
