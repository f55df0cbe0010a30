"""Why a wrist gets to the goal or not: one cause for each motion (docs/error-budget.md#reach-success)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import WRISTS, Joint
from prbench.metrics import MotionBatch, ScoringTargets
from prbench.protocol.manifests import MetricConstants

REACHED = "reached"
FAR = "stands too far"
LEAVES = "comes and leaves"
UNDER_WAY = "under way"
SHORT = "stops short"
CAUSES = (REACHED, FAR, LEAVES, UNDER_WAY, SHORT)
"""In the order in which they are asked for."""

_SHOULDERS = (Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER)
_ELBOWS = (Joint.LEFT_ELBOW, Joint.RIGHT_ELBOW)
_LEAVES = 0.05  # metres from its nearest place at which a wrist is said to have left it: half of reach_distance
_APPROACH = 0.1  # m/s towards the goal above which a wrist is said to be under way: standing arms sway below it
_LAST_SECONDS = 0.25  # of the motion, over which that speed is measured


@dataclass(frozen=True, eq=False)
class Reaching:
    """The nearer wrist of n motions against their goals."""

    cause: tuple[str, ...]
    """One of :data:`CAUSES`."""
    smallest: Float[np.ndarray, " n"]
    """Smallest distance of either wrist from the goal in any frame, metres."""
    smallest_before_end: Float[np.ndarray, " n"]
    """Time from that frame to the last, seconds."""
    final: Float[np.ndarray, " n"]
    """Distance of the nearer wrist in the last frame, metres."""
    slack: Float[np.ndarray, " n"]
    """Length of the arm minus the distance of its shoulder from the goal, in the frame of the smallest distance, m.

    What the arm could still be stretched by; negative where it is too short."""


def diagnose_reaching(motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants) -> Reaching:
    """Find out of each motion why Reach Success counts it or not.

    The cause is the first of these that holds: *reached*; *stands too far*, if shoulder and goal are farther apart than
    the arm is long plus ``reach_distance`` in the frame of the wrist's smallest distance; *comes and leaves*, if the
    nearer wrist ends more than 5 cm farther away than that; *under way*, if it comes nearer by more than 0.1 m/s on
    average over the last quarter of a second; *stops short* otherwise.

    Args:
        motion: Canonical frame, metres.
        targets: Of the sequences.
        constants: Of the protocol.
    """
    fps = targets.fps_of_sequence
    found = []
    for row in range(motion.n_sequences):
        joints = motion.values[motion.offsets[row] : motion.offsets[row + 1]].astype(np.float64)
        found.append(_reach_of(joints, targets.goal_location[row], float(fps[row]), constants))
    columns = list(zip(*found, strict=True))
    return Reaching(columns[0], *(np.array(column) for column in columns[1:]))


def _reach_of(joints: np.ndarray, goal: np.ndarray, fps: float, constants: MetricConstants) -> tuple:
    """Return the fields of :class:`Reaching` of one motion."""
    distances = np.linalg.norm(joints[:, WRISTS] - goal, axis=-1)  # (frames, 2)
    frame, side = np.unravel_index(distances.argmin(), distances.shape)
    nearer = distances.min(axis=1)
    smallest = float(distances[frame, side])
    pose = joints[frame]
    upper = np.linalg.norm(pose[_ELBOWS[side]] - pose[_SHOULDERS[side]])
    lower = np.linalg.norm(pose[WRISTS[side]] - pose[_ELBOWS[side]])
    slack = float(upper + lower - np.linalg.norm(pose[_SHOULDERS[side]] - goal))
    limit = constants.reach_distance + constants.threshold_tolerance
    steps = min(len(nearer) - 1, max(1, round(_LAST_SECONDS * fps)))
    approach = (nearer[-1 - steps] - nearer[-1]) * fps / max(steps, 1)
    if smallest <= limit:
        cause = REACHED
    elif slack < -constants.reach_distance:
        cause = FAR
    elif nearer[-1] > smallest + _LEAVES:
        cause = LEAVES
    elif approach > _APPROACH:
        cause = UNDER_WAY
    else:
        cause = SHORT
    return cause, smallest, (len(nearer) - 1 - int(frame)) / fps, float(nearer[-1]), slack
