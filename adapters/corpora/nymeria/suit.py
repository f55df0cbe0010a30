"""The suit's file: read by key, checked, cleaned, cut where its clock jumps; and its motion on the 22 joints.

Source: docs/specification/nymeria.md#the-suits-file.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.geometry.skeleton import PARENTS, XSENS_SEGMENTS, Joint, bone_lengths, y_up
from prbench.representation.converters import SmplParameters, read_rest_joints, smpl_joints
from prbench_adapters.corpora.nymeria.format import N_SEGMENTS, SUIT_RATE, Suit

_DOWNLOAD = "The file may be truncated or another version; download it again."
_NEEDED = ("timestamps_us", "segment_tXYZ", "segment_qWXYZ")
_LARGE = ("segment_tXYZ", "segment_qWXYZ")
_OPTIONAL = ("frameRate", "frameCount", "tpose_segment_tXYZ")


@dataclass(frozen=True)
class Piece:
    """A stretch of the suit's frames without a jump of its clock and without a missing position."""

    first: int
    stop: int
    start: float
    """TIME_CODE of the first frame, seconds; frame i of the piece is ``start + i / 240``."""

    @property
    def duration(self) -> float:
        """Seconds from the first to the last frame."""
        return (self.stop - self.first - 1) / SUIT_RATE


@dataclass(frozen=True)
class CleanSuit:
    """A suit recording that can be used: pieces of steady time and whole rotations."""

    suit: Suit
    pelvis_rotation: Float[np.ndarray, "n 4"]
    """Unit quaternions, w x y z, segment to world."""
    head_rotation: Float[np.ndarray, "n 4"]
    pieces: tuple[Piece, ...]
    messages: tuple[str, ...]

    @property
    def span(self) -> tuple[float, float]:
        """First and last TIME_CODE of the usable motion, seconds."""
        last = self.pieces[-1]
        return self.pieces[0].start, max(piece.start + piece.duration for piece in (last, *self.pieces))


def read_suit(path: Path) -> Suit:
    """Read ``xdata.npz``.

    Raises:
        InputFileError: if the file is no archive of plain arrays, a key is missing, a shape does not fit the others,
            or the rate is not 240 Hz.
    """
    archive = Archive(path, remedy=_DOWNLOAD)
    archive.require(_NEEDED)
    arrays: dict[str, np.ndarray] = {}
    for key in (*_NEEDED, *_OPTIONAL):  # one after the other: the large ones halve before the next is unpacked
        arrays |= {name: _small(array) if name in _LARGE else array for name, array in archive.load([key]).items()}
    time = np.asarray(arrays["timestamps_us"]).ravel()
    n = len(time)
    if n < 2:
        raise InputFileError(path, "timestamps_us", expected="at least two frames", found=str(n), remedy=_DOWNLOAD)
    if not np.isfinite(time.astype(np.float64)).all():
        raise InputFileError(path, "timestamps_us", expected="finite times", found="NaN", remedy=_DOWNLOAD)
    _require_number(path, arrays, "frameRate", SUIT_RATE, "Other rates than 240 Hz are not known to exist.")
    _require_number(path, arrays, "frameCount", float(n), _DOWNLOAD)
    tpose = arrays.get("tpose_segment_tXYZ")
    if tpose is not None and tpose.dtype.kind not in "fiu":
        raise InputFileError(
            path, "tpose_segment_tXYZ", expected="numbers", found=f"an array of {tpose.dtype}", remedy=_DOWNLOAD
        )
    return Suit(
        time_us=np.rint(time).astype(np.int64),
        position=_vectors(path, arrays, "segment_tXYZ", n, 3),
        rotation=_vectors(path, arrays, "segment_qWXYZ", n, 4),
        tpose=None if tpose is None or tpose.size != N_SEGMENTS * 3 else tpose.reshape(N_SEGMENTS, 3).astype(float),
    )


def _small(values: np.ndarray) -> np.ndarray:
    """Single precision (8 micrometres a hundred metres away): an hour of both arrays then fits below a gigabyte."""
    return values.astype(np.float32, copy=False) if values.dtype == np.float64 else values


def _require_number(path: Path, arrays: Mapping[str, np.ndarray], key: str, wanted: float, remedy: str) -> None:
    if key in arrays and (arrays[key].size != 1 or abs(float(arrays[key].ravel()[0]) - wanted) > 1e-6):
        found = str(arrays[key].ravel()[:3].tolist())
        raise InputFileError(path, key, expected=f"{wanted:g}", found=found, remedy=remedy)


def _vectors(path: Path, arrays: Mapping[str, np.ndarray], key: str, n: int, size: int) -> np.ndarray:
    """Values of the shape (F, 23 * size) or (F, 23, size), as the latter."""
    values = arrays[key]
    shapes = ((n, N_SEGMENTS * size), (n, N_SEGMENTS, size))
    if values.shape not in shapes or not np.issubdtype(values.dtype, np.floating):
        raise InputFileError(
            path,
            key,
            expected=f"numbers of the shape {shapes[0]} or {shapes[1]}, for the {n} times",
            found=f"{values.dtype} of the shape {values.shape}",
            remedy=_DOWNLOAD,
        )
    return values.reshape(n, N_SEGMENTS, size)


def clean_suit(suit: Suit, thresholds: Mapping[str, float], *, path: Path | str) -> CleanSuit:
    """Fill missing rotations, cut at jumps, and check that up is up and left is left.

    Args:
        suit: As read.
        thresholds: Of the manifest.
        path: The file, for messages.

    Raises:
        InputFileError: if no piece is long enough, the body stands on its head, or left and right are swapped.
    """
    missing = _missing_rotations(suit.rotation, thresholds["smallest_quaternion"])
    pelvis, head = (
        _filled(suit.rotation[:, segment], missing[:, segment])
        for segment in (XSENS_SEGMENTS.index(name) for name in ("Pelvis", "Head"))
    )
    filled = int(missing.sum())
    finite = np.asarray(np.isfinite(suit.position).all(axis=(1, 2)))
    # Steps of the clock that are not 1/240 s.
    jumps = np.abs(np.diff(suit.time_us) - 1e6 / SUIT_RATE) > thresholds["clock_tolerance"] * 1e6
    # Stretches between jumps and missing frames, in file order, that are long enough.
    shortest = thresholds["shortest_piece"]
    joined = ~jumps & finite[1:] & finite[:-1]
    borders = np.flatnonzero(np.concatenate([[True], ~joined, [True]]))
    pieces = [
        Piece(int(first), int(stop), float(suit.time_us[first]) / 1e6)
        for first, stop in itertools.pairwise(borders)
        if finite[first]
    ]
    pieces = tuple(piece for piece in pieces if piece.duration >= shortest)
    if not pieces:
        raise InputFileError(
            path,
            "timestamps_us",
            expected=f"at least {thresholds['shortest_piece']:g} s of steady 240 Hz with all positions",
            found=f"{int(jumps.sum())} time steps off 240 Hz and {int((~finite).sum())} frames without position",
            remedy="The recording is damaged; leave it out.",
        )
    _require_upright(suit, pieces, path)
    messages = [
        f"{filled} missing segment rotations repeat the frame before" if filled else "",
        f"cut at {int(jumps.sum())} jumps of the clock" if jumps.any() else "",
        f"{int((~finite).sum())} frames without position are left out" if not finite.all() else "",
    ]
    return CleanSuit(suit, pelvis, head, pieces, tuple(message for message in messages if message))


def _missing_rotations(rotation: np.ndarray, smallest: float) -> Bool[np.ndarray, "n 23"]:
    """Quaternions that are none: too short, or NaN."""
    # Not "less than": a comparison with NaN is false, and NaN has to count as missing.
    return ~(np.einsum("nsk,nsk->ns", rotation, rotation) >= smallest**2)


def _filled(rotation: np.ndarray, missing: np.ndarray) -> Float[np.ndarray, "n 4"]:
    """Unit quaternions; a missing one repeats the last one before it, or is the identity at the beginning."""
    source = np.maximum.accumulate(np.where(missing, -1, np.arange(len(rotation))))
    filled = np.where(source[:, None] < 0, [1.0, 0.0, 0.0, 0.0], rotation[np.maximum(source, 0)].astype(np.float64))
    return filled / np.linalg.norm(filled, axis=-1, keepdims=True)


def _require_upright(suit: Suit, pieces: tuple[Piece, ...], path: Path | str) -> None:
    head = XSENS_SEGMENTS.index("Head")
    feet = [XSENS_SEGMENTS.index(name) for name in ("R_Foot", "L_Foot")]
    part = np.concatenate([suit.position[piece.first : piece.stop : 24] for piece in pieces])
    height = float(np.median(part[:, head, 2] - part[:, feet, 2].mean(axis=1)))
    if not height > 0.0:
        raise InputFileError(
            path,
            "segment_tXYZ",
            expected="Z up: the head above the feet",
            found=f"the head {height:.2f} m above the feet in z",
            remedy="Other axes than the suit's own are not supported.",
        )


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
    archive = Archive(path)
    archive.require(_FIT_KEYS)
    fit = archive.load(_FIT_KEYS)
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


def smpl_motion(pieces: tuple[MotionPiece, ...], pose_source: str, head_tilt_deg: float) -> BodyMotion:
    """The fit as a body's motion."""
    return BodyMotion(pieces, pose_source, head_tilt_deg, (), (("bones", str(len(PARENTS) - 1)),))
