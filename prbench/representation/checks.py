"""What may not go into the features: silent garbage in the original, a named frame here.

Source: docs/specification/humanml3d.md#edge-effects.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.skeleton import N_JOINTS, PARENTS, Joint

_TALLEST_BODY = 20.0  # metres; larger ones are in millimetres or centimetres
_STEEPEST_LEAN = 60.0  # degrees between ankle-to-head and +y
_SHORTEST_BONE = 1e-6  # metres

IN_MEMORY = "joints"
"""What a message calls an array that comes from no file."""


def check_joints(
    joints: np.ndarray, *, source: Path | str = IN_MEMORY, min_frames: int = 2, upright: bool = True
) -> None:
    """Refuse positions from which no meaningful features come.

    Args:
        joints: Should be (frames, 22, 3), metres, Y up.
        source: File or name that a message begins with.
        min_frames: A step needs two frames.
        upright: Also refuse a motion whose median ankle-to-head vector leans more than 60 degrees from +y: another axis
            points up. Say False for people who lie or crawl.

    Raises:
        InputFileError: naming the source and, where one is to blame, frame and joint.
    """
    _check_shape(joints, source, min_frames)
    check_finite(joints, source)
    _check_unit(joints, source)
    if upright:
        _check_up_axis(joints, source)
    _check_bones(joints, source)


def _check_shape(joints: np.ndarray, source: Path | str, min_frames: int) -> None:
    if joints.ndim != 3 or joints.shape[1:] != (N_JOINTS, 3):
        raise InputFileError(
            source,
            "",
            expected=f"joint positions of the shape (frames, {N_JOINTS}, 3)",
            found=str(joints.shape),
            remedy="Give the 22 SMPL body joints in HumanML3D order.",
        )
    if len(joints) < min_frames:
        raise InputFileError(
            source,
            "",
            expected=f"{min_frames} frames or more",
            found=str(len(joints)),
            remedy="A row of features holds the step to the next frame; give next_joints with a single frame.",
        )


def check_finite(joints: np.ndarray, source: Path | str) -> None:
    """Refuse a motion (frames, 22, 3) with a position that is not a number or infinite.

    Raises:
        InputFileError: naming the source, the first such frame and its joint.
    """
    bad = np.argwhere(~np.isfinite(joints).all(axis=-1))
    if bad.size:
        frame, joint = bad[0]
        raise InputFileError(
            source,
            f"frame {frame}, {Joint(joint).name.lower()}",
            expected="a finite position",
            found=str(joints[frame, joint].tolist()),
            remedy="Leave the motion out, or cut it around the gap.",
        )


def _check_unit(joints: np.ndarray, source: Path | str) -> None:
    extent = float(np.median((joints.max(axis=1) - joints.min(axis=1)).max(axis=-1)))
    if extent > _TALLEST_BODY:
        raise InputFileError(
            source,
            "",
            expected="a body in metres",
            found=f"one whose extent is {extent:,.0f} in the median frame",
            remedy="This looks like millimetres: divide by 1,000.",
        )


def _check_up_axis(joints: np.ndarray, source: Path | str) -> None:
    ankles = (joints[:, Joint.LEFT_ANKLE] + joints[:, Joint.RIGHT_ANKLE]) / 2
    body = np.median(joints[:, Joint.HEAD] - ankles, axis=0)
    length = float(np.linalg.norm(body))
    if body[1] < np.cos(np.deg2rad(_STEEPEST_LEAN)) * length:
        lean = np.rad2deg(np.arccos(np.clip(body[1] / length, -1, 1)))
        axis = f"{'-' if body.sum() < 0 else ''}{'xyz'[np.abs(body).argmax()]}"
        raise InputFileError(
            source,
            "",
            expected="bodies along +y, the axis that points up",
            found=f"a median ankle-to-head vector {lean:.0f} degrees away from it, nearest to {axis}",
            remedy="Turn the axes (prbench.axes.y_up for Z up), or say upright=False if people lie or crawl.",
        )


def _check_bones(joints: np.ndarray, source: Path | str) -> None:
    lengths = np.linalg.norm(joints[:, 1:] - joints[:, PARENTS[1:]], axis=-1)
    bad = np.argwhere(lengths < _SHORTEST_BONE)
    if bad.size:
        frame, bone = bad[0]
        child, parent = Joint(bone + 1), Joint(PARENTS[bone + 1])
        raise InputFileError(
            source,
            f"frame {frame}, {child.name.lower()}",
            expected=f"a distance from {parent.name.lower()}, so that the bone has a direction",
            found=f"{lengths[frame, bone]:.1e} m",
            remedy="Leave the motion out, or repair this joint.",
        )
