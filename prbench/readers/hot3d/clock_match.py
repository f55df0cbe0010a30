"""Two clocks of one device, aligned by poses that both of them stamp (docs/specification/hot3d.md#two-clocks).

HOT3D's headset rows are rows of the MPS trajectory, sampled at the nearest millisecond and stamped by another clock.
Where a row is found again, the offset of the clocks is known to half a trajectory step; many rows narrow it down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linprog
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from prbench.errors import RecordingUnusable

_SAME_POSITION = 1e-6
_SAME_ROTATION = np.deg2rad(0.01)
"""Metres and radians within which a row is found again; rounding alone turns it by up to 0.004 degree."""
_NEAREST = 4
_LARGEST_RESIDUAL = 1e-3  # metres, median over the rows
_LARGEST_WIDTH_NS = 1e6
_FEWEST_ROWS = 3
_STRAY_NS = 5e6
"""A match whose offset is so far from the median belongs to another moment at the same place."""
_SMALLEST_AGREEING = 0.5
_LARGEST_DRIFT_PPM = 50.0


@dataclass(frozen=True)
class ClockMatch:
    """``device = truth + offset + drift * (truth - origin)``, nanoseconds."""

    offset_ns: float
    """At ``origin_ns``."""
    half_width_ns: float
    """Largest error of the offset."""
    drift: float
    """0 unless one constant cannot hold for all rows."""
    origin_ns: int
    """An instant on the clock of the ground truth."""
    matched: int
    """Rows that told the offset."""
    rows: int

    def truth_ns(self, device_ns: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Times of the ground truth's clock, in integers (device times may exceed what a float holds exactly)."""
        shift = round(self.offset_ns) + self.origin_ns
        since = device_ns - shift
        if self.drift == 0.0:
            return since + self.origin_ns
        # The equation above, solved for truth: since = (1 + drift) * (truth - origin).
        return since + self.origin_ns - np.rint(since * (self.drift / (1 + self.drift))).astype(np.int64)

    @property
    def remark(self) -> str:
        """Messages for the user."""
        drift = f", drift {self.drift * 1e6:+.2f} ppm" if self.drift else ""
        return (
            f"clocks aligned by {self.matched} of {self.rows} headset rows:"
            f" device - ground truth = {self.offset_ns / 1e9:.6f} s ± {self.half_width_ns / 1e6:.2f} ms{drift}"
        )


def match_clocks(
    truth_ns: Int[np.ndarray, " n"],
    position: Float[np.ndarray, "n 3"],
    rotation: Float[np.ndarray, "n 4"],
    device_ns: Int[np.ndarray, " m"],
    device_position: Float[np.ndarray, "m 3"],
    device_rotation: Float[np.ndarray, "m 4"],
    *,
    recording: str,
) -> ClockMatch:
    """Find the offset of two clocks from poses that are rows of a denser trajectory.

    Args:
        truth_ns: Times of the sparse rows on their clock.
        position: Their positions, metres.
        rotation: Their rotations, w x y z.
        device_ns: Times of the dense rows on the other clock.
        device_position: Their positions.
        device_rotation: Their rotations.
        recording: Name for the message.

    Raises:
        RecordingUnusable: if the rows are none of the trajectory's (median distance above 1 mm, or too few found), if
            no offset (and drift) fits all of them, or if it stays uncertain by more than 1 ms.
    """
    found, row, nearest = _find_rows(position, rotation, device_position, device_rotation)
    residual = float(np.median(nearest)) if len(nearest) else np.inf
    if residual > _LARGEST_RESIDUAL:
        raise RecordingUnusable(
            f"{recording}: headset rows and MPS trajectory lie {residual * 1e3:.1f} mm apart (median): not one world,"
            " or not one recording. Gaze cannot be brought to the ground truth; download both again."
        )
    if len(found) < _FEWEST_ROWS:
        raise RecordingUnusable(
            f"{recording}: {len(found)} of {len(truth_ns)} headset rows are found in the MPS trajectory, at least"
            f" {_FEWEST_ROWS} are needed to align the clocks. Download both files again."
        )
    low, high = _offset_bounds(truth_ns[found], device_ns, row)
    # Relative to one offset the bounds are small enough for floats to hold them exactly.
    reference = int(np.median(low + high) / 2)
    agreeing = np.abs((low + high) / 2 - reference) <= _STRAY_NS
    if agreeing.mean() < _SMALLEST_AGREEING:
        raise RecordingUnusable(
            f"{recording}: only {int(agreeing.sum())} of {len(found)} headset rows that are found in the MPS trajectory"
            " agree about the offset of the clocks within 5 ms. Download both files again."
        )
    times = truth_ns[found][agreeing]
    bounds = (low[agreeing] - reference).astype(np.float64), (high[agreeing] - reference).astype(np.float64)
    return _intersection(times, *bounds, reference=reference, rows=len(truth_ns), recording=recording)


def _find_rows(
    position: Float[np.ndarray, "n 3"],
    rotation: Float[np.ndarray, "n 4"],
    device_position: Float[np.ndarray, "m 3"],
    device_rotation: Float[np.ndarray, "m 4"],
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Float[np.ndarray, " n"]]:
    """Rows that are found exactly once, where they are found, and every row's distance to the nearest one.

    Bit-identical positions go before close ones; a row with several candidates of the same kind is dropped.
    """
    count = min(_NEAREST, len(device_position))
    distance, index = KDTree(device_position).query(position, k=count)
    distance = distance.reshape(len(position), count)
    index = index.reshape(len(position), count)
    turned = Rotation.from_quat(device_rotation[index.ravel()], scalar_first=True).inv() * Rotation.from_quat(
        np.repeat(rotation, count, axis=0), scalar_first=True
    )
    near = (distance < _SAME_POSITION) & (turned.magnitude().reshape(distance.shape) < _SAME_ROTATION)
    exact = near & (distance == 0.0)
    candidates = np.where(exact.any(axis=1, keepdims=True), exact, near)
    found = np.flatnonzero(candidates.sum(axis=1) == 1)
    return found, index[found, candidates[found].argmax(axis=1)], distance[:, 0]


def _offset_bounds(
    truth_ns: Int[np.ndarray, " k"], device_ns: Int[np.ndarray, " m"], row: Int[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Least and largest offset that each row allows: the nearest one was taken, so half a step to either side."""
    offset = device_ns[row] - truth_ns
    half = np.diff(device_ns) // 2
    return offset - np.append(half[:1], half)[row], offset + np.append(half, half[-1:])[row]


def _intersection(
    times: Int[np.ndarray, " k"],
    low: Float[np.ndarray, " k"],
    high: Float[np.ndarray, " k"],
    *,
    reference: int,
    rows: int,
    recording: str,
) -> ClockMatch:
    """The middle of the offsets that all rows allow; with a drift if no constant fits."""
    origin = int(times[0])
    lowest = float(low.max())
    highest = float(high.min())
    slope = 0.0
    if lowest > highest:
        middle, slope, half = _with_drift((times - origin) / 1e9, low, high)
        if half < 0 or abs(slope) * 1e-3 > _LARGEST_DRIFT_PPM:
            raise RecordingUnusable(
                f"{recording}: no offset and no drift of the clocks fits all {len(times)} headset rows that are found"
                f" in the MPS trajectory (short by {(lowest - highest) / 1e6:.2f} ms). Download both files again."
            )
    else:
        middle = (lowest + highest) / 2
        half = (highest - lowest) / 2
    if 2 * half > _LARGEST_WIDTH_NS:
        raise RecordingUnusable(
            f"{recording}: the offset of the clocks stays uncertain by {2 * half / 1e6:.2f} ms, 1 ms is needed."
        )
    return ClockMatch(reference + middle, half, slope * 1e-9, origin, len(times), rows)


def _with_drift(
    seconds: Float[np.ndarray, " k"], low: Float[np.ndarray, " k"], high: Float[np.ndarray, " k"]
) -> tuple[float, float, float]:
    """Offset (ns), drift (ns a second) and margin (ns) of the line that stays furthest inside of all intervals."""
    ones = np.ones_like(seconds)
    above = np.column_stack([-ones, -seconds, ones])
    below = np.column_stack([ones, seconds, ones])
    solved = linprog(
        c=[0.0, 0.0, -1.0],
        A_ub=np.concatenate([above, below]),
        b_ub=np.concatenate([-low, high]),
        bounds=[(None, None)] * 3,
    )
    if not solved.success:
        return 0.0, 0.0, -1.0
    offset, slope, margin = solved.x
    return float(offset), float(slope), float(margin)
