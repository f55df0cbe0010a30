"""Clips before they are encoded: canonical frame, 20 frames a second, mirror image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.representation.checks import IN_MEMORY, check_joints
from prbench.representation.features import FRAME_RATE
from prbench.skeleton import Joint, canonical_frame, invert_rigid, transform_points
from prbench.timelines import SequenceGrid, interpolate

MIRRORED_JOINTS: tuple[int, ...] = tuple(
    Joint[
        joint.name.replace("LEFT", "RIGHT") if joint.name.startswith("LEFT") else joint.name.replace("RIGHT", "LEFT")
    ].value
    for joint in Joint
)
"""For each joint the one in whose place it stands in a mirror."""


def canonicalise(
    joints: Float[np.ndarray, "frames ..."], *, source: Path | str = IN_MEMORY, upright: bool = True
) -> Float[np.ndarray, "frames 22 3"]:
    """The motion with its first pelvis over the origin, facing +Z, and its lowest joint at Y = 0.

    Steps 2 to 4 of docs/specification/humanml3d.md#forward-conversion; :func:`prbench.skeleton.canonical_frame` is the
    transform. A body that faces exactly -Z is turned by half a turn.

    Args:
        joints: (frames, 22, 3), any frame with Y up, metres.
        source: File or name that messages begin with.
        upright: False for people who lie or crawl.

    Returns:
        Canonical frame, metres; the type of the numbers stays.

    Raises:
        InputFileError: as :func:`prbench.representation.check_joints`, or if the first pose faces nowhere.
    """
    check_joints(np.asarray(joints), source=source, min_frames=1, upright=upright)
    motion = joints.astype(np.float64)
    try:
        canonical_from_world = invert_rigid(canonical_frame(motion))
    except ValueError as error:
        raise InputFileError(
            source, "frame 0", expected="a pose with a heading", found=str(error), remedy="Start at another frame."
        ) from error
    return transform_points(canonical_from_world, motion).astype(joints.dtype)


def mirror(joints: Float[np.ndarray, "*batch 22 3"]) -> Float[np.ndarray, "*batch 22 3"]:
    """The poses as a mirror at x = 0 shows them: x negated, left and right limbs exchanged."""
    return joints[..., MIRRORED_JOINTS, :] * np.array([-1, 1, 1], dtype=joints.dtype)


def at_20_fps(
    joints: Float[np.ndarray, "frames 22 3"], fps: float, *, source: Path | str = IN_MEMORY
) -> Float[np.ndarray, "kept 22 3"]:
    """The motion at 20 frames a second, linearly interpolated on a grid that ends on its last frame.

    The event of a sequence is its last frame, so that frame is kept exactly
    (docs/specification/humanml3d.md#down-sampling-to-20-fps).

    Args:
        joints: Uniformly sampled positions, any frame, metres.
        fps: Their rate.
        source: File or name that messages begin with.

    Returns:
        Same frame, metres; the type of the numbers stays.

    Raises:
        InputFileError: if the rate is no positive number.
    """
    _check_rate(fps, source)
    end = (len(joints) - 1) / fps
    grid = SequenceGrid.ending_at(end, prime_time=0.0, lead=0.0, fps=FRAME_RATE)
    return interpolate(np.arange(len(joints)) / fps, joints, grid.times).astype(joints.dtype)


def every_stride(
    joints: Float[np.ndarray, "frames 22 3"], fps: float, *, source: Path | str = IN_MEMORY
) -> tuple[Float[np.ndarray, "kept 22 3"], float]:
    """What the original's preprocessing does: every floor(fps / 20)-th frame, and the rate that this really gives.

    Only multiples of 20 come out at 20 fps: 59 gives 29.5, 30 stays 30. Use it to reproduce the released data, and
    :func:`at_20_fps` for everything else.

    Raises:
        InputFileError: if the rate is below 20, so that no stride exists.
    """
    _check_rate(fps, source)
    stride = int(fps / FRAME_RATE)
    if stride < 1:
        raise InputFileError(
            source, "", expected="20 frames a second or more", found=f"{fps:g}", remedy="Interpolate with at_20_fps."
        )
    return joints[::stride], fps / stride


def _check_rate(fps: float, source: Path | str) -> None:
    if not (np.isfinite(fps) and fps > 0):
        raise InputFileError(source, "", expected="a frame rate above 0", found=f"{fps:g}")
