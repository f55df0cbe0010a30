"""Directions that a body shows by itself, whatever axes and names it was given.

Poses are (poses, 22, 3) in any unit and any world, right-handed or not; every function turns and moves along with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from prbench.skeleton import Joint

LEFTS = [joint for joint in Joint if joint.name.startswith("LEFT")]
RIGHTS = [joint for joint in Joint if joint.name.startswith("RIGHT")]
PARTS = tuple(joint.name.removeprefix("LEFT_").lower() for joint in LEFTS)
"""What exists on both sides, from the hips to the wrists."""
_NEGLIGIBLE = 1e-9


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length one; those without a length stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > _NEGLIGIBLE, vectors / np.maximum(length, _NEGLIGIBLE), 0.0)


def body_up(poses: np.ndarray) -> np.ndarray:
    """From the ankles to the head, (poses, 3)."""
    return unit(poses[:, Joint.HEAD] - _middle(poses, Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE))


def left_of_hips(poses: np.ndarray) -> np.ndarray:
    """From the right hip to the left one as they are named, (poses, 3)."""
    return unit(poses[:, Joint.LEFT_HIP] - poses[:, Joint.RIGHT_HIP])


def left_of_shoulders(poses: np.ndarray) -> np.ndarray:
    """From the right shoulder to the left one as they are named, (poses, 3)."""
    return unit(poses[:, Joint.LEFT_SHOULDER] - poses[:, Joint.RIGHT_SHOULDER])


def front(poses: np.ndarray) -> np.ndarray:
    """Where toes point, knees bend and the head lies before the neck; elbows bend the other way; (poses, 3).

    Names of left and right do not matter, nor does the handedness of the world.
    """
    toes = _sum(poses, Joint.LEFT_FOOT, Joint.RIGHT_FOOT) - _sum(poses, Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE)
    knees = _bend(poses, Joint.LEFT_HIP, Joint.LEFT_KNEE, Joint.LEFT_ANKLE) + _bend(
        poses, Joint.RIGHT_HIP, Joint.RIGHT_KNEE, Joint.RIGHT_ANKLE
    )
    elbows = _bend(poses, Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST) + _bend(
        poses, Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST
    )
    head = poses[:, Joint.HEAD] - poses[:, Joint.NECK]
    cue = 2 * toes + knees + head - elbows / 2
    up = body_up(poses)
    return unit(cue - (cue * up).sum(axis=-1, keepdims=True) * up)


def sideways_agreement(poses: np.ndarray) -> np.ndarray:
    """For hips, knees … wrists whether left lies on the side of the left hip: 1 always, -1 never; (8 parts,)."""
    hips = left_of_hips(poses)
    sideways = ((poses[:, LEFTS] - poses[:, RIGHTS]) * hips[:, None]).sum(axis=-1)
    return sideways.mean(axis=0) / np.maximum(np.abs(sideways).mean(axis=0), _NEGLIGIBLE)


def sidedness(poses: np.ndarray, left: np.ndarray) -> np.ndarray:
    """+1 where ``left`` lies to the left of the front, seen with the body's head up; -1 where it lies to the right."""
    return (np.cross(left, body_up(poses)) * front(poses)).sum(axis=-1)


def with_sides(index: Sequence[int], exchanged: np.ndarray) -> list[int]:
    """An index of joints with left and right exchanged for some of :data:`PARTS`."""
    result = list(index)
    for left, right, swap in zip(LEFTS, RIGHTS, exchanged, strict=True):
        if swap:
            result[left], result[right] = result[right], result[left]
    return result


def _middle(poses: np.ndarray, one: int, other: int) -> np.ndarray:
    return _sum(poses, one, other) / 2


def _sum(poses: np.ndarray, one: int, other: int) -> np.ndarray:
    return poses[:, one] + poses[:, other]


def _bend(poses: np.ndarray, upper: int, middle: int, lower: int) -> np.ndarray:
    """How far the middle joint of a limb lies from the middle between its ends."""
    return poses[:, middle] - _middle(poses, upper, lower)
