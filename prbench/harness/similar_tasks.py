"""Recorded motions of similar tasks, laid on one goal: what people do where the table has each task only once.

A motion is stretched in time to the asked number of frames, turned about the vertical through its first pelvis until
its goal lies in the given goal's direction, and moved over the ground until the two goals stand above one another. Its
height stays, because feet belong on the floor. So a recorded body stays as it was, but for its speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.sequences.table import SequenceTable

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
        ids: list[str] = []
        recordings: list[str] = []
        goals: list[np.ndarray] = []
        seconds: list[np.ndarray] = []
        for chunk in table.chunks(columns=["recording_id", "goal_location", "fps"]):
            ids += chunk.sequence_ids
            recordings += chunk.strings("recording_id")
            goals.append(chunk.vectors("goal_location").astype(np.float64))
            seconds.append(chunk.n_frames / chunk.numbers("fps"))
        return cls(tuple(ids), np.array(recordings, dtype=object), np.concatenate(goals), np.concatenate(seconds))

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
        parts = np.split(chunk.joints, chunk.offsets[1:-1])
        motions |= dict(zip(chunk.sequence_ids, parts, strict=True))
    return motions


def at_length(motion: Float[np.ndarray, "frames 22 3"], n_frames: int) -> Float[np.ndarray, "n_frames 22 3"]:
    """The whole motion in another number of frames, interpolated linearly."""
    place = np.linspace(0.0, len(motion) - 1, n_frames)
    left = np.minimum(place.astype(np.int64), len(motion) - 2)
    share = (place - left)[:, None, None]
    return motion[left].astype(np.float64) * (1 - share) + motion[left + 1] * share


def laid_on_goal(
    motion: Float[np.ndarray, "frames 22 3"], its_goal: Float[np.ndarray, "3"], goal: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "frames 22 3"]:
    """The motion turned about the vertical through the origin, and moved over the ground, until the goals agree.

    In a canonical frame the first pelvis stands over the origin, so this keeps the distance to the goal's direction.
    """
    its_goal = its_goal.astype(np.float64)
    angle = 0.0
    if min(np.hypot(its_goal[0], its_goal[2]), np.hypot(goal[0], goal[2])) > _NO_DIRECTION:
        angle = float(np.arctan2(goal[0], goal[2]) - np.arctan2(its_goal[0], its_goal[2]))
    moved = turned(motion, angle)
    step = goal - turned(its_goal, angle)
    step[1] = 0.0
    return moved + step


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Points (..., 3) turned about the vertical; positive angles turn +Z towards +X."""
    cosine = np.cos(angle)
    sine = np.sin(angle)
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([x * cosine + z * sine, y, z * cosine - x * sine], axis=-1)
