"""Gaze of a Nymeria recording in the world of its suit.

Suit and glasses have worlds of their own, and the suit's drifts. What stays is how the glasses sit on the head: one
rotation, found from how both turn. Gaze then goes from the glasses to the head segment, and with it into the suit's
world (docs/specification/nymeria.md#head-trajectory-and-gaze).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import y_up
from prbench.geometry.timelines import slerp
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import find_gaze_file
from prbench_adapters.corpora.nymeria.clock import ClockOffset
from prbench_adapters.corpora.nymeria.format import SUIT_RATE
from prbench_adapters.corpora.nymeria.suit import CleanSuit

_STEP = 0.1  # s between two poses whose turn is compared
_LEAST_TURN = np.deg2rad(2.0)  # smaller turns tell more of noise than of an axis
_FEWEST_TURNS = 100
_LARGEST_RESIDUAL = np.deg2rad(1.0)  # median; users measured 0.09 degrees at the 95th percentile of one file


def gaze_file(trajectory: Path) -> Path | None:
    """The preferred gaze file beside a trajectory (``mps/slam``, ``mps/eye_gaze``); None if there is none."""
    return find_gaze_file(trajectory.parent.parent / mps.GAZE_FOLDER)


def head_from_device(
    clean: CleanSuit,
    offset: ClockOffset,
    times: Float[np.ndarray, " n"],
    rotation: Float[np.ndarray, "n 4"],
) -> tuple[Rotation | None, str]:
    """How the glasses sit on the head segment: the X with a = X b for the turns a of the head and b of the glasses.

    Args:
        clean: The suit; its longest piece is used.
        offset: From the glasses' clock to the suit's.
        times: Of the glasses' poses, seconds, their own clock.
        rotation: Of the glasses, w x y z.

    Returns:
        The rotation, or None and why not.
    """
    if offset.approximate:
        return None, "gaze: the clocks of suit and glasses are not known well enough"
    piece = max(clean.pieces, key=lambda each: each.duration)
    head = clean.head_rotation[piece.first : piece.stop]
    step = round(_STEP * SUIT_RATE)
    frames = np.arange(0, len(head), step)
    at = piece.start + frames / SUIT_RATE - offset.seconds
    seen = (at >= times[0]) & (at <= times[-1])
    if seen.sum() < 2:
        return None, "gaze: the glasses' trajectory does not overlap the suit's"
    of_head = _turns(head[frames[seen]])
    of_glasses = _turns(slerp(times, rotation, at[seen]))
    # Poses that are not neighbours of one another were left out at the ends alone, so that all steps are equal.
    large = (np.linalg.norm(of_head, axis=1) > _LEAST_TURN) & (np.linalg.norm(of_glasses, axis=1) > _LEAST_TURN)
    if large.sum() < _FEWEST_TURNS:
        return None, f"gaze: the head turns {int(large.sum())} times only, which does not tell how the glasses sit"
    found = Rotation.align_vectors(of_head[large], of_glasses[large])[0]
    residual = float(np.median(np.linalg.norm(of_head[large] - found.apply(of_glasses[large]), axis=1)))
    if residual > _LARGEST_RESIDUAL:
        return None, f"gaze: suit and glasses turn differently (median {np.rad2deg(residual):.1f} degrees a step)"
    return found, ""


def _turns(rotation: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "m 3"]:
    """Rotation vectors from each pose to the next one, in the frame of the first."""
    pose = Rotation.from_quat(rotation, scalar_first=True)
    return (pose[:-1].inv() * pose[1:]).as_rotvec()


def gaze_in_suit_world(
    clean: CleanSuit,
    head_from_glasses: Rotation,
    times: Float[np.ndarray, " n"],
    angles: mps.GazeAngles,
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Directions of gaze in the suit's world, Y up.

    The head segment is that of the suit's last frame before each sample, so that nothing later is read.

    Args:
        clean: The suit.
        head_from_glasses: See :func:`head_from_device`.
        times: Of the samples, seconds on the suit's clock.
        angles: Of the samples, in the central pupil frame.

    Returns:
        Unit vectors, +Z where nothing was measured; and where something was.
    """
    with np.errstate(invalid="ignore"):
        widest = np.maximum(np.abs(angles.yaw), np.abs(angles.pitch)) <= mps.WIDEST_GAZE_ANGLE
    head = np.zeros((len(times), 4))
    there = np.zeros(len(times), dtype=bool)
    for piece in clean.pieces:
        frame = np.floor((times - piece.start) * SUIT_RATE + 1e-6).astype(np.int64)
        inside = (frame >= 0) & (frame < piece.stop - piece.first)
        head[inside] = clean.head_rotation[piece.first + frame[inside]]
        there |= inside
    valid = widest & there
    directions = np.tile([0.0, 0.0, 1.0], (len(times), 1))
    if valid.any():
        in_cpf = mps.gaze_directions_cpf(angles.yaw[valid], angles.pitch[valid])
        # The size of the glasses moves the pupils, and turns nothing.
        in_head = head_from_glasses.apply(in_cpf @ mps.device_from_cpf("DVT-S")[:3, :3].T)
        directions[valid] = y_up(Rotation.from_quat(head[valid], scalar_first=True).apply(in_head))
    return directions, valid
