"""The 22 joints of a recording from its suit, or from the SMPL fit of the Plus release with the user's own body model.

Source: docs/specification/nymeria.md#the-22-joints.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.geometry.skeleton import PARENTS, XSENS_SEGMENTS, Joint, bone_lengths, y_up
from prbench.representation.converters import SmplParameters, read_rest_joints, smpl_joints
from prbench_adapters.corpora.nymeria.format import SUIT_RATE, Suit
from prbench_adapters.corpora.nymeria.suit import CleanSuit

_SPEED_STEP = 24  # frames; a tenth of a second
_FEWEST_WALKING = 20  # tenths of a second in which the body walks, before its direction means anything
_FIT_KEYS = ("betas", "body_pose", "global_orient", "transl", "timestamps")


@dataclass(frozen=True)
class MotionPiece:
    """Joints of one piece, Y up, metres, without gaps."""

    start: float
    """TIME_CODE of the first frame, seconds."""
    rate: float
    joints: Float[np.ndarray, "n 22 3"]


@dataclass(frozen=True)
class BodyMotion:
    """The pieces of one recording."""

    pieces: tuple[MotionPiece, ...]
    pose_source: str
    head_tilt_deg: float
    messages: tuple[str, ...]
    measured: tuple[tuple[str, str], ...]


def suit_motion(
    clean: CleanSuit,
    mapping: Sequence[str],
    pose_source: str,
    fallback_tilt_deg: float,
    thresholds: Mapping[str, float],
    *,
    path: Path | str,
) -> BodyMotion:
    """The 22 joints of a suit recording.

    Args:
        clean: The suit's pieces.
        mapping: Segment of each joint.
        pose_source: Name of the result.
        fallback_tilt_deg: Head tilt for a file without calibration pose.
        thresholds: Of the manifest.
        path: The file, for messages.

    Raises:
        InputFileError: if the body walks backwards, which means that left and right are swapped.
    """
    rows = [XSENS_SEGMENTS.index(name) for name in mapping]
    pieces = tuple(
        MotionPiece(piece.start, SUIT_RATE, y_up(clean.suit.position[piece.first : piece.stop, rows]))
        for piece in clean.pieces
    )
    messages = [*clean.messages, *_check_sides(clean, pieces, thresholds["walking_speed"], path)]
    tilt = measured_head_tilt(clean.suit)
    change = max(_bone_change(piece.joints) for piece in pieces)
    if change > 1e-3:
        messages.append(f"bones change their length by {change * 1e3:.1f} mm")
    measured = [("bone_length_change_mm", f"{change * 1e3:.3f}"), ("head_tilt_measured", str(tilt is not None).lower())]
    if clean.suit.tpose is not None:
        measured.append(("l5_above_hips_m", f"{_l5_above_hips(clean.suit.tpose):.4f}"))
    return BodyMotion(
        pieces, pose_source, fallback_tilt_deg if tilt is None else tilt, tuple(messages), tuple(measured)
    )


def _check_sides(
    clean: CleanSuit, pieces: tuple[MotionPiece, ...], walking_speed: float, path: Path | str
) -> list[str]:
    """Forward, from the hips, must be where the body walks; the pelvis segment's own x axis is asked beside it."""
    along = []
    agrees = []
    for piece, span in zip(pieces, clean.pieces, strict=True):
        joints = piece.joints[::_SPEED_STEP]
        across = joints[:, Joint.LEFT_HIP] - joints[:, Joint.RIGHT_HIP]
        forward = np.stack([-across[:, 2], across[:, 0]], axis=-1)
        forward /= np.maximum(np.linalg.norm(forward, axis=-1, keepdims=True), 1e-9)
        velocity = np.diff(joints[:, Joint.PELVIS][:, [0, 2]], axis=0) * (SUIT_RATE / _SPEED_STEP)
        speed = np.linalg.norm(velocity, axis=-1)
        fast = speed > walking_speed
        along.append(((velocity * forward[:-1]).sum(axis=-1) / np.maximum(speed, 1e-9))[fast])
        # The first column of the rotation matrix is the segment's own x axis in the world.
        w, x, y, z = clean.pelvis_rotation[span.first : span.stop : _SPEED_STEP].T
        axis = y_up(np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=-1))
        agrees.append((axis[:, [0, 2]] * forward).sum(axis=-1))
    walked = np.concatenate(along)
    by_segment = float(np.concatenate(agrees).mean())
    knows = len(walked) >= _FEWEST_WALKING
    if float(walked.mean() if knows else by_segment) < 0.0:
        raise InputFileError(
            path,
            "segment_tXYZ",
            expected="a body that faces where it walks" if knows else "hips that face along the pelvis segment's x",
            found="the opposite",
            remedy="Left and right segments seem to be swapped; leave the recording out.",
        )
    return ["the pelvis segment's x axis points backwards"] if by_segment < 0.0 else []


def measured_head_tilt(suit: Suit) -> float | None:
    """Tilt of the neck-head bone towards the front in the calibration pose, degrees; None without such a pose."""
    if suit.tpose is None:
        return None
    tpose = y_up(suit.tpose)
    left, right, neck, head = (
        tpose[XSENS_SEGMENTS.index(name)] for name in ("L_UpperLeg", "R_UpperLeg", "Neck", "Head")
    )
    across = left - right
    forward = np.array([-across[2], 0.0, across[0]])  # across x up
    size = float(np.linalg.norm(forward))
    bone = head - neck
    if size < 1e-6 or float(np.linalg.norm(bone)) < 1e-3:
        return None
    return round(float(np.rad2deg(np.arctan2(bone @ forward / size, bone[1]))), 4)


def _bone_change(joints: np.ndarray) -> float:
    lengths = bone_lengths(joints[::_SPEED_STEP])
    return float(np.abs(lengths - lengths[0]).max())


def _l5_above_hips(tpose: np.ndarray) -> float:
    left, right, spine = (tpose[XSENS_SEGMENTS.index(name), 2] for name in ("L_UpperLeg", "R_UpperLeg", "L5"))
    return float(spine - 0.5 * (left + right))


def read_smpl_fit(path: Path, model: Path, *, tolerance: float, shortest: float) -> tuple[MotionPiece, ...]:
    """The 22 joints of the fit, cut where its clock jumps.

    Args:
        path: ``xdata_smpl_neutral.npz``: Y up, metres, microseconds.
        model: SMPL neutral model as ``.npz`` with plain arrays (``J_regressor``, ``v_template``, ``shapedirs``).
        tolerance: Seconds by which a time step may differ from 1/240 s.
        shortest: Seconds; shorter pieces are left out.

    Raises:
        InputFileError: if either file lacks an array, or shapes do not fit.
    """
    fit = _arrays(path)
    n = len(fit["transl"])
    shapes = {"body_pose": (n, 69), "global_orient": (n, 3), "transl": (n, 3), "timestamps": (n,)}
    for key, shape in shapes.items():
        if fit[key].shape != shape or not np.isfinite(fit[key]).all():
            raise InputFileError(path, key, expected=f"finite numbers of the shape {shape}", found=str(fit[key].shape))
    parameters = SmplParameters.from_arrays(
        global_orient=fit["global_orient"],
        body_pose=fit["body_pose"],
        transl=fit["transl"],
        betas=fit["betas"],
        source=path,
    )
    joints = smpl_joints(parameters, read_rest_joints(model))
    times = fit["timestamps"].astype(np.int64)
    jumps = np.flatnonzero(np.abs(np.diff(times) - 1e6 / SUIT_RATE) > tolerance * 1e6) + 1
    borders = np.concatenate([[0], jumps, [n]])
    pieces = tuple(
        MotionPiece(float(times[first]) / 1e6, SUIT_RATE, joints[first:stop])
        for first, stop in itertools.pairwise(borders)
        if stop - first > shortest * SUIT_RATE
    )
    if not pieces:
        raise InputFileError(path, "timestamps", expected=f"at least {shortest:g} s of steady 240 Hz", found="none")
    return pieces


def _arrays(path: Path) -> dict[str, np.ndarray]:
    archive = Archive(path)
    archive.require(_FIT_KEYS)
    return archive.load(_FIT_KEYS)


def smpl_motion(pieces: tuple[MotionPiece, ...], pose_source: str, head_tilt_deg: float) -> BodyMotion:
    """The fit as a body's motion."""
    return BodyMotion(pieces, pose_source, head_tilt_deg, (), (("bones", str(len(PARENTS) - 1)),))
