"""The 22 joints from a suit's own skeleton, laid along the pelvis of a body that was fitted to it.

GIMO's ``skeleton.bvh`` has unknown names, unit and start (docs/specification/gimo.md#three-routes-to-the-22-joints,
route C). Names come from a table, the unit from the length of the legs, the start from the pelvis: the two tracks must
be one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from prbench.errors import InputFileError
from prbench.geometry.joint_names import match_names
from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import interpolate
from prbench.readers.gimo.bvh import BvhMotion, joint_positions

_UNITS = (1.0, 0.01, 0.001)
"""Metres a file unit, in the order of trial."""
_LEG = (0.5, 1.2)  # metres from hip to ankle of a person
_STEP = 1 / 30  # seconds between the starts that are tried first
_STANDS_STILL = 0.2  # metres; a shorter walk fits anywhere


@dataclass(frozen=True)
class PlacedSkeleton:
    """Joints at the instants of the pelvis track, in its frame."""

    joints: Float[np.ndarray, "n 22 3"]
    start: float
    """Seconds in the skeleton's file at which the pelvis track begins."""
    error: float
    """Root mean square distance of hips and pelvis after alignment, a constant offset apart, metres."""
    is_sure: bool
    """Return True where the pelvis moves far enough to tell the start."""


def place_skeleton(
    motion: BvhMotion,
    seconds: Float[np.ndarray, " n"],
    pelvis: Float[np.ndarray, "n 3"],
    *,
    name: str,
    largest_error: float,
) -> PlacedSkeleton:
    """Align a skeleton in time with a pelvis track, and move its hips onto it frame by frame.

    Args:
        motion: Content of the file; its frame must be that of the track, up to a constant offset.
        seconds: Times of the track, increasing, from any origin.
        pelvis: The track, metres, Y up.
        name: Of the file, for messages.
        largest_error: Metres; a worse alignment is refused.

    Raises:
        InputFileError: if joints have unknown names, legs no human length, the file is shorter than the track, or no
            start brings the two tracks together.
    """
    joints = _body_joints(motion, name)
    times = np.arange(len(joints)) * motion.frame_time
    latest = times[-1] - (seconds[-1] - seconds[0])
    if latest < -motion.frame_time / 2:
        raise InputFileError(
            name,
            "",
            expected=f"at least the {seconds[-1] - seconds[0]:.2f} s of the segment",
            found=f"{times[-1]:.2f} s",
            remedy="This skeleton belongs to another recording, or the file is cut.",
        )
    since = seconds - seconds[0]
    start, error = _best_start(times, joints[:, Joint.PELVIS], since, pelvis, max(float(latest), 0.0))
    if error > largest_error:
        raise InputFileError(
            name,
            "",
            expected=f"hips within {largest_error * 100:.0f} cm of the fitted pelvis",
            found=f"{error * 100:.1f} cm at the best start ({start:.2f} s)",
            remedy="The skeleton lies in another frame or belongs to another recording; use the fitted body instead"
            " (options vposer_model and smplx_model).",
        )
    laid = interpolate(times, joints, start + since)
    # The limbs are the suit's, the place is that of the fitted pelvis, frame by frame.
    laid = laid + (pelvis - laid[:, Joint.PELVIS])[:, None]
    far = float(np.linalg.norm(pelvis - pelvis[0], axis=1).max())
    return PlacedSkeleton(laid, start, error, far >= _STANDS_STILL)


def _body_joints(motion: BvhMotion, name: str) -> Float[np.ndarray, "n 22 3"]:
    """The 22 joints in metres.

    Raises:
        InputFileError: naming the joints that are missing, and those of the file that were not understood.
    """
    matched = match_names([joint.name for joint in motion.joints])
    missing = [Joint(index).name.lower() for index, column in enumerate(matched.columns) if column < 0]
    if missing:
        raise InputFileError(
            name,
            "HIERARCHY",
            expected=f"joints for {', '.join(missing)} (best naming: {matched.convention})",
            found=f"unmatched names: {', '.join(matched.unmatched) or 'none'}",
            remedy="Rename the joints in the file.",
        )
    joints = joint_positions(motion)[:, list(matched.columns)]
    thigh = np.linalg.norm(joints[0, Joint.LEFT_KNEE] - joints[0, Joint.LEFT_HIP])
    leg = float(thigh + np.linalg.norm(joints[0, Joint.LEFT_ANKLE] - joints[0, Joint.LEFT_KNEE]))
    unit = next((unit for unit in _UNITS if _LEG[0] <= leg * unit <= _LEG[1]), None)
    if unit is None:
        raise InputFileError(
            name,
            "HIERARCHY",
            expected=f"legs of {_LEG[0]} to {_LEG[1]} m, in metres, centimetres or millimetres",
            found=f"{leg:.3f}",
        )
    return joints * unit


def _best_start(
    times: Float[np.ndarray, " m"],
    hips: Float[np.ndarray, "m 3"],
    since: Float[np.ndarray, " n"],
    pelvis: Float[np.ndarray, "n 3"],
    latest: float,
) -> tuple[float, float]:
    """The start that leaves the least distance, and that distance: tried every thirtieth of a second, then refined."""

    def spread(start: float) -> float:
        apart = interpolate(times, hips, start + since) - pelvis
        # Both frames may lie a constant offset apart, which tells nothing about time.
        return float(((apart - apart.mean(axis=0)) ** 2).sum(axis=1).mean())

    tried = np.arange(int(latest / _STEP) + 1) * _STEP
    best = float(tried[int(np.argmin([spread(start) for start in tried]))])
    bounds = max(best - _STEP, 0.0), min(best + _STEP, latest)
    if bounds[1] > bounds[0]:
        refined = float(minimize_scalar(spread, bounds=bounds, method="bounded", options={"xatol": 1e-5}).x)
        best = min((refined, best), key=spread)
    return best, float(np.sqrt(spread(best)))
