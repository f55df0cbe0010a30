"""Notice motions that are the recorded ones, handed in as a method's own.

A path of poses is compared with the recorded path as a curve in the space of all joints, so that neither another frame
rate nor a shift in time hides it; and after the first frames, or all frames, were laid over one another, so that an
offset, a turn or a scale does not. What a method may know of a sequence (its first pose, its last one) makes the
straight way between the two at most. A motion is called recorded only where it follows the recording several times
closer than that straight way does, and only if it leaves its own straight way as far. So a body that stands still never
is, and nothing is said of recordings in which hardly anything happens.

The same is asked of the lower and of the upper body alone, so that recorded motion with other arms, or on other legs,
is noticed, too. There the limit is half as large: legs take the few steps to a goal in few ways.

Motions of another length than the recorded ones are told with the cause that the numbers suggest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.geometry.skeleton import Joint
from prbench.metrics import MotionBatch

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
        return (
            "There is one frame too many: the frame before the first (previous_joints) is no part of the motion, and"
            " the last frame is the one of the goal."
        )
    if (off == -1).all():
        return (
            "There is one frame too few: the first frame is the given initial one, and features of differences have a"
            " row less than there are frames."
        )
    # One motion of another length says nothing about a rate.
    for rate in _USUAL_RATES if len(expected) > 1 else ():
        if rate != fps and (np.abs(found - ((expected - 1) * rate / fps + 1)) <= 1).all():
            return (
                f"They look like motions at {rate:g} frames per second where {fps:g} are asked for: score"
                f" them with --native-fps {rate:g}, or resample them."
            )
    return ""


# A copy is off by less than this share of what the straight way from first to last pose is off by.
_SHARE = 0.2
# Metres; where the recording departs less from that straight way, nothing can be told.
_LEAST_TOLERANCE = 1e-3


@dataclass(frozen=True)
class _Part:
    """A part of the body that may be a copy by itself.

    Attributes:
        pairs: Joints whose smallest and largest distances a copy shares.
        reach: Metres by which these extremes may differ at most, once both bodies are of one size.
        farthest: Metres that a copy may be off at most, over joints and frames. A copy with noise of 1 cm in every
            coordinate is 1.7 cm off. Motions of a trained model came as near as 3.1 cm with the whole body, 2.2 cm with
            the lower and 2.8 cm with the upper (1,157 validation sequences of synthetic people).
    """

    joints: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]
    reach: float
    farthest: float


_WHOLE = _Part(
    tuple(Joint),
    (
        (Joint.PELVIS, Joint.LEFT_WRIST),
        (Joint.PELVIS, Joint.RIGHT_WRIST),
        (Joint.LEFT_WRIST, Joint.RIGHT_WRIST),
        (Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE),
        (Joint.HEAD, Joint.LEFT_ANKLE),
    ),
    0.08,
    0.02,
)
_LOWER = _Part(
    (Joint.PELVIS, *(joint for joint in Joint if joint.name.endswith(("_HIP", "_KNEE", "_ANKLE", "_FOOT")))),
    (
        (Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE),
        (Joint.LEFT_KNEE, Joint.RIGHT_KNEE),
        (Joint.PELVIS, Joint.LEFT_ANKLE),
        (Joint.PELVIS, Joint.RIGHT_ANKLE),
    ),
    0.04,  # fewer joints look alike more easily
    0.01,
)
_UPPER = _Part(
    tuple(joint for joint in Joint if joint not in _LOWER.joints),
    (
        (Joint.LEFT_WRIST, Joint.RIGHT_WRIST),
        (Joint.SPINE3, Joint.LEFT_WRIST),
        (Joint.SPINE3, Joint.RIGHT_WRIST),
        (Joint.HEAD, Joint.RIGHT_WRIST),
    ),
    0.04,
    0.01,
)


def is_recorded_motion(predicted: MotionBatch, recorded: MotionBatch) -> Bool[np.ndarray, " sequences"]:
    """Return True for each motion that is its sequence's recorded one, changed by little more than noise.

    Args:
        predicted: Motions of a method, metres; lengths may differ from the recorded ones.
        recorded: The recorded motions of the same sequences.
    """
    found = np.zeros(recorded.n_sequences, dtype=bool)
    for part in (_WHOLE, _LOWER, _UPPER):
        # A quick look at where a copy is possible at all spares nearly all motions the close one.
        reach = _extremes(predicted, part)
        expected = _extremes(recorded, part)
        # A body of another size is a copy, too.
        scale = expected.sum(axis=0) / np.maximum(reach.sum(axis=0), 1e-9)
        off = np.minimum(np.abs(scale * reach - expected).max(axis=0), np.abs(reach - expected).max(axis=0))
        for row in np.flatnonzero(~found & (off < part.reach)):
            frames = slice(predicted.offsets[row], predicted.offsets[row + 1])
            motion = predicted.values[frames, part.joints].astype(np.float64)
            frames = slice(recorded.offsets[row], recorded.offsets[row + 1])
            original = recorded.values[frames, part.joints].astype(np.float64)
            # A person who settles in the first frames, stands, and leaves in the last ones is far off that straight
            # way and yet near to any body that stands there all the time. Such a body does not leave its own straight
            # way; a copy does.
            departure = min(_distance(original, original[[0, -1]]), _distance(motion, motion[[0, -1]]))
            tolerance = min(part.farthest, _SHARE * departure)
            # A recording in which nothing happens is followed by any motion that stands still.
            if tolerance < _LEAST_TOLERANCE:
                continue
            # As it is, moved so that the first frames agree, and so that all frames do as well as they can.
            laid_over = [motion, _moved(motion, motion[:1], original[:1], scaled=False)]
            if len(motion) == len(original):
                laid_over.append(_moved(motion, motion, original, scaled=True))
            away = [max(_distance(laid, original), _distance(original, laid)) for laid in laid_over]
            found[row] = min(away) <= tolerance
    return found


def _extremes(motions: MotionBatch, part: _Part) -> Float[np.ndarray, "pairs_and_ends sequences"]:
    """Smallest and largest distance of each pair of joints in each motion: the same wherever and whenever it moves."""
    apart = [np.linalg.norm(motions.values[:, one] - motions.values[:, other], axis=1) for one, other in part.pairs]
    ends = [end.reduceat(distances, motions.first) for distances in apart for end in (np.minimum, np.maximum)]
    return np.stack(ends)


def _moved(motion: np.ndarray, points: np.ndarray, targets: np.ndarray, *, scaled: bool) -> np.ndarray:
    """Return the motion under the similarity transform that brings points nearest to their targets (Umeyama)."""
    source = points.reshape(-1, 3)
    target = targets.reshape(-1, 3)
    source_middle = source.mean(axis=0)
    target_middle = target.mean(axis=0)
    left, singular, right = np.linalg.svd((target - target_middle).T @ (source - source_middle))
    # Without the sign the best fit may be a reflection (Umeyama 1991, equation 43).
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = (left * signs) @ right
    scale = 1.0
    if scaled:
        scale = float((singular * signs).sum() / max(((source - source_middle) ** 2).sum(), 1e-12))
    return scale * (motion - source_middle) @ rotation.T + target_middle


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
    nearest = np.maximum(squared.min(axis=1), 0.0)
    return float(np.sqrt(nearest / poses.shape[1]).mean())
