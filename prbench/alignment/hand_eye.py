"""How a device sits on a body segment, from how both move: A X = X B (docs/specification/alignment.md).

A is the motion of the device between two instants, in the device's frame at the first; B that of the segment; X maps
coordinates of the segment to those of the device. Worlds drop out, so that neither has to be known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

SPANS = (0.1, 0.5)  # s between the two instants
TURNS = (2.0, 60.0)  # degrees; smaller turns tell more of noise than of an axis
_ANGLES_DIFFER = (0.5, 0.05)  # degrees and share by which the two angles may differ, which do not depend on X
_HUBER = 0.005  # m
_ROTATION_SCALE = np.deg2rad(0.1)
_TRANSLATION_SCALE = 0.002  # m

Transform = Float[np.ndarray, "4 4"]


@dataclass(frozen=True)
class Motions:
    """Motions of device (a) and segment (b) over the same times.

    Attributes:
        times: First instants, seconds.
        turn_a: Rotation vectors, radians.
        move_a: Translations, metres.
        matrix_a: The rotations of the device as matrices.
    """

    times: Float[np.ndarray, " n"]
    turn_a: Float[np.ndarray, "n 3"]
    move_a: Float[np.ndarray, "n 3"]
    turn_b: Float[np.ndarray, "n 3"]
    move_b: Float[np.ndarray, "n 3"]
    matrix_a: Float[np.ndarray, "n 3 3"]

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, chosen: slice | np.ndarray) -> Motions:
        return Motions(*(values[chosen] for values in vars(self).values()))


def motions_between(
    frames: tuple[np.ndarray, np.ndarray], times: Float[np.ndarray, " f"], *tracks: tuple[Any, np.ndarray]
) -> Motions:
    """Return the motions between pairs of frames.

    Args:
        frames: Frames at which the motions begin, and those at which they end.
        times: Time of each frame, seconds.
        tracks: Rotations and positions (metres) of the device, and those of the segment; each in its own world.
    """
    first, second = frames
    turns = []
    moves = []
    for rotation, position in tracks:
        back = rotation[first].inv()
        turns.append(back * rotation[second])
        moves.append(back.apply(position[second] - position[first]))
    turn_a, turn_b = (turn.as_rotvec() for turn in turns)
    return Motions(times[first], turn_a, moves[0], turn_b, moves[1], turns[0].as_matrix())


def usable(motions: Motions) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Tell which motions turn by 2° to 60°, and of which of them device and segment turn by the same angle."""
    smaller, larger = np.sort(np.rad2deg(np.linalg.norm([motions.turn_a, motions.turn_b], axis=2)), axis=0)
    turning = (smaller >= TURNS[0]) & (larger <= TURNS[1])
    return turning, turning & (larger - smaller < _ANGLES_DIFFER[0] + _ANGLES_DIFFER[1] * larger)


def rotation_of(motions: Motions) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Return the rotation R with a = R b in the least-squares sense, and the singular values of Σ b aᵀ.

    Where all turns have two axes only, the third singular value is zero and its vectors have either sign: the
    determinant decides. With one axis R is arbitrary; the second singular value is then zero too.
    """
    left, values, right = np.linalg.svd(motions.turn_b.T @ motions.turn_a)
    turn = right.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))]) @ left.T
    return turn, values


def translation_of(
    motions: Motions, rotation: Float[np.ndarray, "3 3"], *, huber: float = np.inf
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Return t of (R_A - I) t = R t_B - t_A by least squares, of smallest norm where it is not determined.

    Args:
        motions: One motion or more.
        rotation: The rotation of X.
        huber: Length of a residual, metres, from which a motion counts less.

    Returns:
        The translation in device coordinates, metres, and the normal matrix of the last step.
    """
    rows = (motions.matrix_a - np.eye(3)).reshape(-1, 3)
    wanted = (motions.move_b @ rotation.T - motions.move_a).reshape(-1)
    weight = np.ones(len(rows))
    translation = normal = np.zeros((3, 3))
    for _ in range(1 if huber == np.inf else 8):
        normal = (rows * weight[:, None]).T @ rows
        translation = np.linalg.pinv(normal, rcond=1e-12, hermitian=True) @ (rows.T @ (weight * wanted))
        error = np.linalg.norm((rows @ translation - wanted).reshape(-1, 3), axis=1)
        weight = np.repeat(huber / np.maximum(error, huber), 3) if huber < np.inf else weight
    return translation, normal


def errors_of(motions: Motions, x: Transform) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return what A X and X B differ by: rotation vectors (radians) and translations (metres), device coordinates."""
    turned = motions.turn_a - motions.turn_b @ x[:3, :3].T
    moved = motions.matrix_a @ x[:3, 3] - x[:3, 3] + motions.move_a - motions.move_b @ x[:3, :3].T
    return turned, moved


def sizes_of_errors(motions: Motions, x: Transform) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the sizes of :func:`errors_of` in degrees and millimetres."""
    turned, moved = errors_of(motions, x)
    return np.rad2deg(np.linalg.norm(turned, axis=1)), 1000.0 * np.linalg.norm(moved, axis=1)


def in_stages(motions: Motions) -> tuple[Transform, Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Return X from rotation first and translation (Huber, 5 mm) second, singular values and the normal matrix."""
    x = np.eye(4)
    x[:3, :3], singular = rotation_of(motions)
    x[:3, 3], normal = translation_of(motions, x[:3, :3], huber=_HUBER)
    return x, singular, normal


def refined(motions: Motions, x: Transform) -> Transform:
    """Return the X near the given one that fits rotations and translations together (soft-L1, 0.1° and 2 mm)."""

    def moved_by(step: np.ndarray) -> Transform:
        better = x.copy()
        better[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix() @ x[:3, :3]
        better[:3, 3] += step[3:]
        return better

    def residuals(step: np.ndarray) -> np.ndarray:
        turned, moved = errors_of(motions, moved_by(step))
        return np.concatenate([turned.ravel() / _ROTATION_SCALE, moved.ravel() / _TRANSLATION_SCALE])

    return moved_by(least_squares(residuals, np.zeros(6), loss="soft_l1", x_scale="jac").x)
