"""A synthetic hand in UmeTrack's form: 80 vertices, 21 landmarks, and how it follows a performance.

Model frame as in the dataset: x from the wrist along the middle finger, y out of the back of the hand, z towards the
thumb. All lengths are shares of the distance from the wrist to the base of the middle finger.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.readers.hot3d import hands_umetrack as umetrack
from prbench.readers.hot3d.format import HandModel
from prbench.synthetic.people.kinematics import unit

_BASES = ((0.20, -0.10, 0.18), (1.00, 0.00, 0.28), (1.00, 0.02, 0.00), (0.95, 0.00, -0.25), (0.86, -0.04, -0.48))
_STEPS = (
    ((0.32, 0.02, 0.16), (0.22, -0.16, 0.20), (0.22, -0.10, 0.20)),
    ((0.00, 0.00, 0.00), (0.42, -0.02, 0.00), (0.26, -0.02, 0.00)),
    ((0.00, 0.00, 0.00), (0.47, -0.02, -0.02), (0.30, -0.02, -0.02)),
    ((0.00, 0.00, 0.00), (0.44, -0.02, -0.06), (0.28, -0.02, -0.04)),
    ((0.00, 0.00, 0.00), (0.34, -0.02, -0.10), (0.22, -0.02, -0.06)),
)
"""From each joint of a finger to the next; the first two joints of a finger but the thumb share a place."""
_TIP = 0.26
_THUMB_AXES = ((0.8, 0.6, 0.0), (0.0, 0.6, 0.8), (0.6, 0.8, 0.0), (0.6, 0.8, 0.0))
_FINGER_AXES = ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, -1.0), (0.0, 0.0, -1.0))
"""Spreading, then three times bending towards the palm."""
_THICKNESS = 0.10
_PALM_ALONG = (0.08, 0.30, 0.52, 0.74, 0.94)
_PALM_ACROSS = (-0.35, 0.22)
_DECIMALS = 6  # of millimetres
_OPEN = 0.20
_CLOSED = 0.55
"""Bending of each finger joint of an empty and of a holding hand, radians."""
_SPREAD = 0.03
"""Radians; never 0, at which the dataset's own toolkit divides by zero."""
_ROOT = 0
_WRIST = 1


def synthetic_hand(length: float) -> HandModel:
    """Return the left hand of somebody whose middle finger begins ``length`` metres from the wrist."""
    joints = _joints()
    bones = [first + step for first in range(0, 20, 4) for step in (1, 2, 3)]
    tips = np.array([joints[first + 3] + _TIP * unit(joints[first + 3] - joints[first + 2]) for first in _firsts()])
    points = []
    weights = []
    for bone, joint in enumerate(bones, start=2):
        end = tips[(bone - 2) // 3] if (bone - 2) % 3 == 2 else joints[joint + 1]
        # The middle joint of three belongs to the base: a base phalanx is skinned to the wrist as well.
        share = 0.2 if (bone - 2) % 3 == 0 else 0.0
        points.append(_ring(joints[joint], end))
        weights.append(np.tile(share * _one_hot(_WRIST) + (1 - share) * _one_hot(bone), (4, 1)))
    palm = np.array([(x, y, z) for x in _PALM_ALONG for z in _PALM_ACROSS for y in (-0.12, 0.12)])
    points.append(palm)
    weights.append(np.tile(0.2 * _one_hot(_ROOT) + 0.8 * _one_hot(_WRIST), (len(palm), 1)))
    landmarks, landmark_weights = _landmarks(joints, tips)
    vertices = np.concatenate(points)
    return HandModel(
        vertices=_metres(vertices, length),
        weights=np.concatenate(weights),
        joint_positions=_metres(joints, length),
        joint_axes=np.array([*_THUMB_AXES, *_FINGER_AXES * 4, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]),
        landmarks=_metres(landmarks, length),
        landmark_weights=landmark_weights,
        triangles=_triangles(len(vertices)),
    )


def wrist_rotation(segment: Rotation, side: int) -> Rotation:
    """Return UmeTrack's wrist rotation from a hand segment (y along the hand, x to the left at neutral).

    Args:
        segment: World from segment.
        side: 0 left, 1 right; a right hand's x axis points back along the hand, since posing mirrors it.
    """
    mirror = 1.0 if side == 0 else -1.0
    columns = np.array([[0.0, mirror, 0.0], [mirror, 0.0, 0.0], [0.0, 0.0, -1.0]])  # y, x, -z
    return segment * Rotation.from_matrix(columns)


def finger_angles(closed: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 22"]:
    """Return the joint angles of a hand between open (0) and closed around something (1), radians."""
    angles = np.zeros((len(closed), umetrack.N_JOINTS))
    bend = _OPEN + closed * (_CLOSED - _OPEN)
    for first in _firsts():
        angles[:, first] = _SPREAD
        angles[:, first + 1 : first + 4] = bend[:, None]
    angles[:, 0:4] = 0.3 * bend[:, None]
    return angles


def _firsts() -> range:
    return range(0, umetrack.N_ANGLES, umetrack.JOINTS_A_FINGER)


def _joints() -> Float[np.ndarray, "22 3"]:
    fingers = [np.cumsum([base, *steps], axis=0) for base, steps in zip(_BASES, _STEPS, strict=True)]
    return np.concatenate([*fingers, np.zeros((2, 3))])


def _ring(start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 3"]:
    """Return four points around a bone, a fifth of the way along it."""
    centre = start + 0.2 * (end - start)
    along = unit(end - start)
    aside = unit(np.cross(along, (0.0, 1.0, 0.0)))
    above = np.cross(aside, along)
    return centre + _THICKNESS * np.array([aside, above, -aside, -above])


def _landmarks(
    joints: Float[np.ndarray, "22 3"], tips: Float[np.ndarray, "5 3"]
) -> tuple[Float[np.ndarray, "21 3"], Float[np.ndarray, "21 17"]]:
    """Return the tips, wrist, two of the thumb, three of every other finger, palm; each fixed to one bone."""
    thumb = [joints[2], joints[3]]
    others = [joints[first + step] for first in (4, 8, 12, 16) for step in (1, 2, 3)]
    points = np.array([*tips, np.zeros(3), *thumb, *others, (0.7, -0.12, 0.0)])
    bones = [4, 7, 10, 13, 16, _WRIST, 2, 3]
    bones += [bone for last in (7, 10, 13, 16) for bone in (_WRIST, last - 2, last - 1)]
    return points, np.array([_one_hot(bone) for bone in (*bones, _WRIST)])


def _triangles(n_vertices: int) -> Int[np.ndarray, "f 3"]:
    """Return a strip over each group of four vertices; nothing is computed from them."""
    first = np.arange(0, n_vertices, 4)[:, None]
    return np.concatenate([first + np.array(corners) for corners in ((0, 1, 2), (0, 2, 3))])


def _metres(shares: Float[np.ndarray, "n 3"], length: float) -> Float[np.ndarray, "n 3"]:
    """Return lengths in metres, as a reader computes them from rounded millimetres."""
    return np.round(shares * length / umetrack.METRES_A_UNIT, _DECIMALS) * umetrack.METRES_A_UNIT


def _one_hot(bone: int) -> Float[np.ndarray, "17"]:
    return np.eye(umetrack.N_BONES)[bone]
