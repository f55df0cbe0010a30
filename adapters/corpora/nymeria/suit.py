"""The suit's file: read by key, checked, cleaned, cut where its clock jumps; and its motion on the 22 joints.

Source: docs/specification/nymeria.md#the-suits-file.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import require
from prbench.geometry.skeleton import XSENS_SEGMENTS, Joint, rotation_matrices, y_up
from prbench.protocol.manifests import Manifest
from prbench_adapters.corpora.nymeria.format import N_SEGMENTS, SUIT_RATE, Suit

_DOWNLOAD = "The file may be truncated or another version; download it again."
_NEEDED = ("timestamps_us", "segment_tXYZ", "segment_qWXYZ")
_SIZES = {"segment_tXYZ": 3, "segment_qWXYZ": 4}  # Numbers of a segment in the two large arrays.
_SPEED_STEP = 24  # frames; a tenth of a second
_FEWEST_WALKING = 20  # tenths of a second in which the body walks, before its direction means anything
_OPTIONAL = ("frameRate", "frameCount", "tpose_segment_tXYZ", "tpose_segment_qWXYZ")


@dataclass(frozen=True)
class Piece:
    """A stretch of the suit's frames without a jump of its clock and without a missing position, at 240 Hz.

    Attributes:
        start: TIME_CODE of the first frame, seconds; frame i of the piece is ``start + i / 240``.
        joints: Y up, metres.
        first: Number of its first frame in the file.
    """

    start: float
    joints: Float[np.ndarray, "n 22 3"]
    first: int = 0

    @property
    def stop(self) -> int:
        """Frame of the file behind the last one."""
        return self.first + len(self.joints)

    @property
    def end(self) -> float:
        """TIME_CODE of the last frame, seconds."""
        return self.start + (len(self.joints) - 1) / SUIT_RATE


@dataclass(frozen=True)
class CleanSuit:
    """A suit recording that can be used: pieces of steady time with the 22 joints, and whole rotations.

    Attributes:
        head_rotation: Unit quaternions, w x y z, segment to world; of all frames of the file.
    """

    pieces: tuple[Piece, ...]
    pose_source: str
    head_tilt_deg: float
    messages: tuple[str, ...]
    head_rotation: Float[np.ndarray, "n 4"]

    @property
    def span(self) -> tuple[float, float]:
        """First and last TIME_CODE of the usable motion, seconds."""
        return self.pieces[0].start, max(piece.end for piece in self.pieces)


def open_suit(path: Path) -> tuple[Archive, Int[np.ndarray, " n"]]:
    """Check what ``xdata.npz`` holds before its large arrays are unpacked.

    Returns:
        The archive, and its times: TIME_CODE, microseconds.

    Raises:
        InputFileError: if the file is no archive of plain arrays, a key is missing, a shape does not fit the others,
            or the rate is not 240 Hz.
    """
    archive = Archive(path, remedy=_DOWNLOAD)
    archive.require(_NEEDED)
    arrays = archive.load(["timestamps_us", *_OPTIONAL])
    time = np.asarray(arrays["timestamps_us"]).ravel()
    n = len(time)
    for key, fits, expected in (
        ("timestamps_us", n >= 2, "at least two frames"),
        ("timestamps_us", np.isfinite(time.astype(np.float64)).all(), "finite times"),
        ("frameRate", _is(arrays.get("frameRate"), SUIT_RATE), f"{SUIT_RATE:g}"),
        ("frameCount", _is(arrays.get("frameCount"), n), str(n)),
        *((key, key not in arrays or arrays[key].dtype.kind in "fiu", "numbers") for key in _OPTIONAL[2:]),
    ):
        if not fits:
            found = f"{arrays[key].dtype} {arrays[key].ravel()[:3].tolist()}"
            raise InputFileError(path, key, expected=expected, found=found, remedy=_DOWNLOAD)
    for key, size in _SIZES.items():
        shapes = ((n, N_SEGMENTS * size), (n, N_SEGMENTS, size))
        header = archive.header(key)
        fits = header.shape in shapes and np.issubdtype(header.dtype, np.floating)
        expected = f"numbers of the shape {shapes[0]} or {shapes[1]}, for the {n} times"
        require(path, (fits, key, expected, f"{header.dtype} of the shape {header.shape}", _DOWNLOAD))
    return archive, np.rint(time).astype(np.int64)


def read_suit(path: Path) -> Suit:
    """Read ``xdata.npz``.

    Raises:
        InputFileError: see :func:`open_suit`.
    """
    archive, time = open_suit(path)
    arrays = {}
    for key, size in _SIZES.items():  # one after the other: each halves before the next is unpacked
        values = archive.load([key])[key]
        # Single precision (8 micrometres a hundred metres away): an hour of both then fits below a gigabyte.
        kept = values.astype(np.float32) if values.dtype == np.float64 else values
        arrays[key] = kept.reshape(len(time), N_SEGMENTS, size)
        del values
    calibration: list[np.ndarray | None] = []
    for key, size in zip(_OPTIONAL[2:], _SIZES.values(), strict=True):
        pose = archive.load([key]).get(key)
        fitting = pose if pose is not None and pose.size == N_SEGMENTS * size else None
        calibration.append(None if fitting is None else fitting.reshape(N_SEGMENTS, size).astype(float))
    return Suit(time, arrays["segment_tXYZ"], arrays["segment_qWXYZ"], *calibration)


def _is(values: np.ndarray | None, wanted: float) -> bool:
    """Return True for an array of one number, the wanted one, and for none."""
    return values is None or (values.size == 1 and abs(float(values.ravel()[0]) - wanted) <= 1e-6)


def clean_suit(suit: Suit, manifest: Manifest, *, path: Path | str, pose_source: str | None = None) -> CleanSuit:
    """Fill missing rotations, cut at jumps, map to the 22 joints, and check that up is up and left is left.

    Args:
        suit: The recording, as :func:`read_suit` returns it.
        manifest: Segment of each joint, thresholds, and the head tilt for a file without calibration pose.
        path: The file, for messages.
        pose_source: Name of the result; the manifest's by default.

    Raises:
        InputFileError: if no piece is long enough, the body stands on its head, or left and right are swapped: then it
            walks backwards.
    """
    thresholds = manifest.thresholds
    # Not "less than": a comparison with NaN is false, and NaN has to count as missing.
    missing = ~(np.einsum("nsk,nsk->ns", suit.rotation, suit.rotation) >= thresholds["smallest_quaternion"] ** 2)
    pelvis, head = (segment_rotation(suit, XSENS_SEGMENTS.index(name), manifest) for name in ("Pelvis", "Head"))
    finite = np.asarray(np.isfinite(suit.position).all(axis=(1, 2)))
    # Steps of the clock that are not 1/240 s.
    jumps = np.abs(np.diff(suit.time_us) - 1e6 / SUIT_RATE) > thresholds["clock_tolerance"] * 1e6
    joined = ~jumps & finite[1:] & finite[:-1]
    # Stretches between jumps and missing frames, in file order, that are long enough.
    long_enough = list(stretches(joined, thresholds["shortest_piece"] * SUIT_RATE + 1))
    lost = int((~finite).sum())
    expected = f"at least {thresholds['shortest_piece']:g} s of steady 240 Hz with all positions"
    found = f"{int(jumps.sum())} time steps off 240 Hz and {lost} frames without position"
    require(path, (long_enough, "timestamps_us", expected, found, "The recording is damaged; leave it out."))
    part = np.concatenate([suit.position[first:stop:24, :, 2] for first, stop in long_enough])
    top, *feet = (part[:, XSENS_SEGMENTS.index(name)] for name in ("Head", "R_Foot", "L_Foot"))
    height = float(np.median(top - np.mean(feet, axis=0)))
    found = f"the head {height:.2f} m above the feet in z"
    remedy = "Other axes than the suit's own are not supported."
    require(path, (height > 0.0, "segment_tXYZ", "Z up: the head above the feet", found, remedy))
    messages = []
    if missing.any():
        messages.append(f"{int(missing.sum())} missing segment rotations repeat the frame before")
    if jumps.any():
        messages.append(f"cut at {int(jumps.sum())} jumps of the clock")
    if lost:
        messages.append(f"{lost} frames without position are left out")
    rows = [XSENS_SEGMENTS.index(name) for name in manifest.body.joint_mapping]
    pieces = tuple(
        Piece(float(suit.time_us[first]) / 1e6, y_up(suit.position[first:stop, rows]), first)
        for first, stop in long_enough
    )
    # Forward, from the hips, must be where the body walks; the pelvis segment's own x axis is asked beside it.
    along = []
    agrees = []
    for piece in pieces:
        joints = piece.joints[::_SPEED_STEP]
        across = joints[:, Joint.LEFT_HIP] - joints[:, Joint.RIGHT_HIP]
        forward = np.stack([-across[:, 2], across[:, 0]], axis=-1)
        forward /= np.maximum(np.linalg.norm(forward, axis=-1, keepdims=True), 1e-9)
        velocity = np.diff(joints[:, Joint.PELVIS][:, [0, 2]], axis=0) * (SUIT_RATE / _SPEED_STEP)
        speed = np.linalg.norm(velocity, axis=-1)
        fast = speed > thresholds["walking_speed"]
        along.append(((velocity * forward[:-1]).sum(axis=-1) / np.maximum(speed, 1e-9))[fast])
        axis = y_up(rotation_matrices(pelvis[piece.first : piece.stop : _SPEED_STEP])[..., 0])
        agrees.append((axis[:, [0, 2]] * forward).sum(axis=-1))
    walked = np.concatenate(along)
    by_segment = float(np.concatenate(agrees).mean())
    knows = len(walked) >= _FEWEST_WALKING
    backwards = float(walked.mean() if knows else by_segment) < 0.0
    expected = "a body that faces where it walks" if knows else "hips that face along the pelvis segment's x"
    remedy = "Left and right segments seem to be swapped; leave the recording out."
    require(path, (not backwards, "segment_tXYZ", expected, "the opposite", remedy))
    if by_segment < 0.0:
        messages.append("the pelvis segment's x axis points backwards")
    tilt = measured_head_tilt(suit)
    if tilt is None:
        tilt = manifest.body.head_tilt_deg
    return CleanSuit(pieces, pose_source or manifest.body.pose_source, tilt, tuple(messages), head)


def stretches(joined: Bool[np.ndarray, " n_but_one"], shortest: float) -> Iterator[tuple[int, int]]:
    """Yield first frame and end of each stretch of frames that are joined to one another and not too few."""
    borders = np.flatnonzero(np.concatenate([[True], ~joined, [True]])).tolist()
    yield from (pair for pair in itertools.pairwise(borders) if pair[1] - pair[0] >= shortest)


def segment_rotation(suit: Suit, segment: int, manifest: Manifest) -> Float[np.ndarray, "n 4"]:
    """Return the unit quaternions of a segment; a missing one repeats the last before it, or is the identity."""
    rotation = suit.rotation[:, segment].astype(np.float64)
    # Not "less than", here and above: a comparison with NaN is false, and NaN has to count as missing.
    missing = ~(np.linalg.norm(rotation, axis=-1) >= manifest.thresholds["smallest_quaternion"])
    last = np.maximum.accumulate(np.where(missing, -1, np.arange(len(missing))))[:, None]
    filled = np.where(last < 0, [1.0, 0.0, 0.0, 0.0], rotation[np.maximum(last[:, 0], 0)])
    return filled / np.linalg.norm(filled, axis=-1, keepdims=True)


def measured_head_tilt(suit: Suit) -> float | None:
    """Tilt of the neck-head bone towards the front in the calibration pose, degrees; None without such a pose."""
    if suit.tpose is None:
        return None
    tpose = y_up(suit.tpose)
    segments = ("L_UpperLeg", "R_UpperLeg", "Neck", "Head")
    left, right, neck, head = (tpose[XSENS_SEGMENTS.index(name)] for name in segments)
    across = left - right
    forward = np.array([-across[2], 0.0, across[0]])  # across x up
    size = float(np.linalg.norm(forward))
    bone = head - neck
    if size < 1e-6 or float(np.linalg.norm(bone)) < 1e-3:
        return None
    return round(float(np.rad2deg(np.arctan2(bone @ forward / size, bone[1]))), 4)
