"""Notice motions that are the recorded ones, handed in as a method's own.

A motion is stripped of all that a disguise may change for free: the place of the body and where it faces, frame by
frame, the lengths of its bones, and which side is left. What is left is a row of postures, of which two questions are
asked.

* Do all joints make the same small movements at the same time? Both rows are freed of what changes over more than a
  second; a slow sway goes with it. Movements of other people for the same goal may look alike, but not to this degree.
* Do the postures follow the recorded ones, at whatever times? Each row is compared with the other as a curve in the
  space of all postures, so that no change of speed, pause or reversal hides it. A body that hardly leaves the straight
  way from its first to its last posture follows many curves, so it is told of those alone that leave it far.

Noise in each frame is measured by how little consecutive frames agree. Both rows are averaged over time accordingly,
and what the average leaves of the noise is taken out of the differences.

The same is asked of the lower and of the upper body alone, so that recorded motion with other arms, or on other legs,
is noticed, too, with narrower limits: legs take the few steps to a goal in few ways.

Motions of another length than the recorded ones are told with the cause that the numbers suggest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter1d

from prbench.geometry.skeleton import BONES, N_JOINTS, Joint
from prbench.metrics import MotionBatch
from prbench.representation.encoding import MIRRORED_JOINTS

_USUAL_RATES = (10.0, 12.5, 15.0, 20.0, 24.0, 25.0, 30.0, 50.0, 60.0, 90.0, 100.0, 120.0)


def length_problem(
    place: Callable[[int], str], expected: Int[np.ndarray, " n"], found: Int[np.ndarray, " n"], *, fps: float
) -> str | None:
    """Say what is wrong with the lengths of some motions; None if they are right.

    Args:
        place: Gives the file and name of a motion by its row, for messages.
        expected: Frames that each should have.
        found: Frames that each has.
        fps: Rate of ``expected``.

    Returns:
        The first motion of another length, how many more there are, and the likely cause.
    """
    wrong = np.flatnonzero(found != expected)
    if not wrong.size:
        return None
    row = int(wrong[0])
    more = f" (and {wrong.size - 1} other motions of {len(expected)})" if wrong.size > 1 else ""
    cause = likely_cause(expected, found, fps=fps)
    return f"{place(row)}: expected {expected[row]} frames, found {found[row]}{more}.{' ' if cause else ''}{cause}"


def likely_cause(expected: Int[np.ndarray, " n"], found: Int[np.ndarray, " n"], *, fps: float) -> str:
    """Return a sentence that explains all the lengths that are wrong, or nothing."""
    wrong = found != expected
    off = (found - expected)[wrong]
    # Off by one comes first: such lengths also fit a frame rate within the rounding of a frame.
    if (off == 1).all():
        problem = "the frame before the first (previous_joints) is no part of the motion"
        why = "the last frame is the one of the goal."
        return f"There is one frame too many: {problem}, and {why}"
    if (off == -1).all():
        why = "and features of differences have a row less than there are frames."
        return f"There is one frame too few: the first frame is the given initial one, {why}"
    # One motion of another length says nothing about a rate.
    for rate in _USUAL_RATES if len(expected) > 1 else ():
        if rate != fps and (np.abs(found - ((expected - 1) * rate / fps + 1)) <= 1).all():
            why = f"score them with --native-fps {rate:g}, or resample them."
            return f"They look like motions at {rate:g} frames per second where {fps:g} are asked for: {why}"
    return ""


@dataclass(frozen=True)
class _Part:
    """A part of the body that may be a copy by itself.

    Attributes:
        joints: Its joints.
        across: Joints left and right of the middle that say where it faces.
        alike: Correlation of the quick movements from which on they are the recorded ones.
        farthest: Metres that a copy's postures may be off at most, over joints and frames.
    """

    joints: tuple[int, ...]
    across: tuple[tuple[int, int], ...]
    alike: float
    farthest: float


_HIPS = (Joint.LEFT_HIP, Joint.RIGHT_HIP)
_SHOULDERS = (Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER)
_LEGS = (Joint.PELVIS, *(joint for joint in Joint if joint.name.endswith(("_HIP", "_KNEE", "_ANKLE", "_FOOT"))))
_PARTS = (
    _Part(tuple(Joint), (_HIPS, _SHOULDERS), 0.97, 0.01),
    _Part(_LEGS, (_HIPS,), 0.99, 0.005),
    _Part(tuple(joint for joint in Joint if joint not in _LEGS), (_SHOULDERS,), 0.98, 0.005),
)
# A copy is off by less than this share of what the straight way from first to last posture is off by.
_SHARE = 0.2
# Metres; where the recording departs less from that straight way, nothing can be told.
_LEAST_TOLERANCE = 1e-3
# Metres of noise in a coordinate from which on rows are averaged over more frames.
_NOISY = 0.01
# Frames: what changes over more of them is slow. A row of fewer tells nothing.
_QUICK = 15
# The bones between the pelvis and each joint.
_ANCESTRY = np.zeros((N_JOINTS, len(BONES)))
for _number, (_parent, _child) in enumerate(BONES):
    _ANCESTRY[_child] = _ANCESTRY[_parent]
    _ANCESTRY[_child, _number] = 1.0


def is_recorded_motion(predicted: MotionBatch, recorded: MotionBatch) -> Bool[np.ndarray, " sequences"]:
    """Return True for each motion that is its sequence's recorded one, changed by little more than noise.

    Args:
        predicted: Motions of a method, metres; lengths may differ from the recorded ones.
        recorded: The recorded motions of the same sequences.
    """
    found = np.zeros(recorded.n_sequences, dtype=bool)
    for row in range(recorded.n_sequences):
        motion = predicted.values[predicted.offsets[row] : predicted.offsets[row + 1]].astype(np.float64)
        original = recorded.values[recorded.offsets[row] : recorded.offsets[row + 1]].astype(np.float64)
        # White noise of variance v makes second differences of variance 6 v; the median of their squares is 45 % of it.
        noise = 0.0
        if len(motion) > 2:
            noise = float(np.median(np.diff(motion, n=2, axis=0) ** 2)) / (6 * 0.455)
        window = 3 if noise < _NOISY**2 else 9
        motion = uniform_filter1d(motion, window, axis=0, mode="nearest")
        original = uniform_filter1d(original, window, axis=0, mode="nearest")
        motion = _with_bones_of(original, motion, noise / window)
        mirrored = motion[:, list(MIRRORED_JOINTS)] * np.array([-1.0, 1.0, 1.0])
        for part in _PARTS:
            expected = _postures(original, part)
            for disguised in (motion, mirrored):
                found[row] |= _is_copy(_postures(disguised, part), expected, part, noise, window)
    return found


def _with_bones_of(original: np.ndarray, motion: np.ndarray, noise: float) -> Float[np.ndarray, "frames 22 3"]:
    """Return the motion, pelvis at the origin, with bones of the mean lengths that they have in the recorded one.

    Args:
        original: The recorded motion, metres.
        motion: The motion, metres.
        noise: Variance of a coordinate of the motion that is noise, which makes bones longer than they are.
    """
    parents, children = np.transpose(BONES)
    bones = motion[:, children] - motion[:, parents]
    squared = (bones**2).sum(axis=-1).mean(axis=0)
    wanted = ((original[:, children] - original[:, parents]) ** 2).sum(axis=-1).mean(axis=0)
    squared = np.maximum(np.maximum(squared - 6 * noise, squared / 2), 1e-12)
    return _ANCESTRY @ (bones * np.sqrt(wanted / squared)[:, None])


def _postures(motion: np.ndarray, part: _Part) -> Float[np.ndarray, "frames joints 3"]:
    """Return a part of the body around its own middle, facing one way in all frames."""
    across = np.sum([motion[:, left] - motion[:, right] for left, right in part.across], axis=0)
    joints = motion[:, part.joints]
    joints = joints - joints.mean(axis=1, keepdims=True)
    x, z = across[:, 0], across[:, 2]
    length = np.maximum(np.hypot(x, z), 1e-9)
    cosine, sine = (x / length)[:, None], (z / length)[:, None]
    turned_x = cosine * joints[..., 0] + sine * joints[..., 2]
    turned_z = cosine * joints[..., 2] - sine * joints[..., 0]
    return np.stack([turned_x, joints[..., 1], turned_z], axis=-1)


def _is_copy(motion: np.ndarray, original: np.ndarray, part: _Part, noise: float, window: int) -> bool:
    """Answer the two questions of the module's docstring on one part of the body.

    Args:
        motion: Postures of the motion, metres.
        original: Those of the recorded motion.
        part: The part of the body.
        noise: Variance of a coordinate of the motion that is noise, before the average.
        window: Frames over which both were averaged.
    """
    left = noise * 3 * (1 - 1 / len(part.joints))  # noise of a joint around the middle
    if len(motion) == len(original) >= 2 * _QUICK:
        slow = _QUICK * max(1, window // 4)
        own, theirs = (row - uniform_filter1d(row, slow, axis=0, mode="nearest") for row in (motion, original))
        energy = float((own**2).sum())
        real = energy - left * (1 / window - 1 / slow) * own.shape[0] * own.shape[1]
        # Where more than half is noise, nothing can be told.
        alike = float((own * theirs).sum()) / np.sqrt(max(real, energy / 2) * (theirs**2).sum() + 1e-12)
        if real > energy / 2 and alike >= part.alike:
            return True
    floor = left / window
    # A quick look at a few postures spares nearly all motions the close one.
    if _distance(motion[:: max(1, len(motion) // 8)], original) ** 2 > (2 * part.farthest) ** 2 + floor:
        return False
    own_way = max(_distance(motion, motion[[0, -1]]) ** 2 - floor, 0.0)
    departure = min(_distance(original, original[[0, -1]]), np.sqrt(own_way))
    tolerance = min(part.farthest, _SHARE * departure)
    away = max(_distance(motion, original), _distance(original, motion))
    # What noise leaves is known to a few percent: where it is several times the tolerance, nothing can be told.
    told = tolerance >= _LEAST_TOLERANCE and floor <= 4 * tolerance**2
    return told and away**2 <= tolerance**2 + floor


def _distance(poses: np.ndarray, path: np.ndarray) -> float:
    """Mean distance of poses from the path through the poses of another motion, as metres a joint (RMS over joints)."""
    points = poses.reshape(len(poses), -1)
    corners = path.reshape(len(path), -1)
    starts = corners[:-1]
    steps = np.diff(corners, axis=0)
    lengths = np.maximum((steps**2).sum(axis=1), 1e-12)
    along = points @ steps.T - (starts * steps).sum(axis=1)
    share = np.clip(along / lengths, 0.0, 1.0)  # where on each step of the path a pose is nearest
    squared = (points**2).sum(axis=1)[:, None] - 2 * points @ starts.T + (starts**2).sum(axis=1)
    squared = squared - 2 * share * along + share**2 * lengths
    return float(np.sqrt(np.maximum(squared.min(axis=1), 0.0) / poses.shape[1]).mean())
