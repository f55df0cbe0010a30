"""Clips before they are encoded: refused where nothing can come of them, canonical, at 20 frames a second, mirrored.

What the original turns into features without a word is refused here with the name of frame and joint
(docs/specification/humanml3d.md#edge-effects).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint, canonical_frame, invert_rigid, transform_points
from prbench.geometry.timelines import SequenceGrid, interpolate
from prbench.representation.features import FRAME_RATE

_TALLEST_BODY = 20.0  # metres; larger ones are in millimetres or centimetres
_STEEPEST_LEAN = 60.0  # degrees between ankle-to-head and +y
_SHORTEST_BONE = 1e-6  # metres

IN_MEMORY = "joints"
"""Name in messages of an array that comes from no file."""
MIRRORED_JOINTS: tuple[int, ...] = tuple(
    Joint[
        joint.name.replace("LEFT", "RIGHT") if joint.name.startswith("LEFT") else joint.name.replace("RIGHT", "LEFT")
    ].value
    for joint in Joint
)
"""Maps each joint to the one in whose place it stands in a mirror."""


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
            remedy="Turn the axes (prbench.geometry.axes.y_up for Z up), or say upright=False if people lie or crawl.",
        )


def _check_bones(joints: np.ndarray, source: Path | str) -> None:
    lengths = np.linalg.norm(joints[:, 1:] - joints[:, PARENTS[1:]], axis=-1)
    bad = np.argwhere(lengths < _SHORTEST_BONE)
    if bad.size:
        frame, bone = bad[0]
        child = Joint(bone + 1)
        parent = Joint(PARENTS[bone + 1])
        raise InputFileError(
            source,
            f"frame {frame}, {child.name.lower()}",
            expected=f"a distance from {parent.name.lower()}, so that the bone has a direction",
            found=f"{lengths[frame, bone]:.1e} m",
            remedy="Leave the motion out, or repair this joint.",
        )


def canonicalise(
    joints: Float[np.ndarray, "frames ..."], *, source: Path | str = IN_MEMORY, upright: bool = True
) -> Float[np.ndarray, "frames 22 3"]:
    """The motion with its first pelvis over the origin, facing +Z, and its lowest joint at Y = 0.

    Steps 2 to 4 of docs/specification/humanml3d.md#forward-conversion;
    :func:`prbench.geometry.skeleton.canonical_frame` is the
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
        raise no_heading(source, error) from error
    return transform_points(canonical_from_world, motion).astype(joints.dtype)


def no_heading(source: Path | str, error: ValueError) -> InputFileError:
    """Return the refusal of a first pose that faces nowhere."""
    return InputFileError(
        source, "frame 0", expected="a pose with a heading", found=str(error), remedy="Start at another frame."
    )


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
    check_rate(fps, source)
    end = (len(joints) - 1) / fps
    grid = SequenceGrid.ending_at(end, prime_time=0.0, lead=0.0, fps=FRAME_RATE)
    return interpolate(np.arange(len(joints)) / fps, joints, grid.times).astype(joints.dtype)


def every_stride(
    joints: Float[np.ndarray, "frames 22 3"], fps: float, *, source: Path | str = IN_MEMORY
) -> tuple[Float[np.ndarray, "kept 22 3"], float]:
    """Keep every floor(fps / 20)-th frame, as the original's preprocessing does; return also the rate that this gives.

    Only multiples of 20 come out at 20 fps: 59 gives 29.5, 30 stays 30. Use it to reproduce the released data, and
    :func:`at_20_fps` for everything else.

    Raises:
        InputFileError: if the rate is below 20, so that no stride exists.
    """
    check_rate(fps, source)
    stride = int(fps / FRAME_RATE)
    if stride < 1:
        raise InputFileError(
            source, "", expected="20 frames a second or more", found=f"{fps:g}", remedy="Interpolate with at_20_fps."
        )
    return joints[::stride], fps / stride


def check_rate(fps: float, source: Path | str) -> None:
    """Refuse a frame rate that is no positive number.

    Raises:
        InputFileError: naming the source.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise InputFileError(source, "", expected="a frame rate above 0", found=f"{fps:g}")
