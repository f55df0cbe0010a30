"""Placement of a generated motion: in the canonical frame, on the initial pose, on the body of the person."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS, Joint, canonical_frame, facing_yaw, invert_rigid, transform_points
from prbench.representation.clips import IN_MEMORY, canonicalise, check_joints, no_heading
from prbench.representation.converters.axes import at_rate, to_y_up
from prbench.representation.converters.plausibility import check_limbs, check_sides
from prbench.representation.features import FRAME_RATE
from prbench.representation.uniform_skeleton import rest_offsets, retarget

Height = Literal["pelvis", "floor"]


def to_canonical(
    joints: Float[np.ndarray, "frames 22 3"],
    fps: float,
    *,
    n_frames: int | None = None,
    wanted_fps: float = FRAME_RATE,
    up: str = "y",
    left_handed: bool = False,
    unit: str | float = "m",
    upright: bool = True,
    feet: bool = True,
    source: Path | str = IN_MEMORY,
) -> Float[np.ndarray, "kept 22 3"]:
    """A motion of the 22 joints as the benchmark wants one of which no initial pose is known.

    Axes and unit, then 20 frames a second by time, then the canonical frame: first pelvis over the origin, facing +Z,
    lowest joint of the whole motion at Y = 0. Where an initial pose is known, :func:`placed_on` follows.

    Args:
        joints: In the world of the source.
        fps: Frames a second.
        n_frames: Frames to give back; None for as many as the motion covers.
        wanted_fps: Their rate: ``batch.fps``.
        up: See :func:`to_y_up`.
        left_handed: Likewise.
        unit: Likewise.
        upright: False for people who lie or crawl.
        feet: False if the toes were computed and do not tell where the front is.
        source: File or name that messages begin with.

    Returns:
        Canonical frame, metres, float32.

    Raises:
        InputFileError: if positions are missing, not finite, in another unit, in another order or with another axis
            up, if left and right are exchanged, or if the motion is too short.
    """
    turned = to_y_up(joints.astype(np.float64), up=up, left_handed=left_handed, unit=unit)
    check_limbs(turned, source=source)
    check_joints(turned, source=source, min_frames=1, upright=upright)
    check_sides(turned, feet=feet, source=source)
    resampled = at_rate(turned, fps, n_frames=n_frames, wanted_fps=wanted_fps, source=source)
    return canonicalise(resampled, source=source, upright=upright).astype(np.float32)


def placed_on(
    joints: Float[np.ndarray, "frames 22 3"],
    initial_joints: Float[np.ndarray, "22 3"],
    *,
    height: Height = "pelvis",
    source: Path | str = IN_MEMORY,
) -> Float[np.ndarray, "frames 22 3"]:
    """The motion turned about the vertical and moved, so that its first pose stands where the initial pose does.

    The whole motion moves as one; no joint is bent and no bone stretched. What is left between the two first poses is
    the model's own error, which ``prbench adapters check`` reports.

    Args:
        joints: Y up, metres, any heading and place.
        initial_joints: Of the batch: canonical frame, metres.
        height: ``pelvis``: the first pelvis takes the height of the initial one. ``floor``: the lowest joint of the
            motion comes to Y = 0, where the floor of a recording is; choose it if bones differ from the person's.
        source: File or name that messages begin with.

    Returns:
        Canonical frame of the sequence, metres; the type of the numbers stays.

    Raises:
        InputFileError: if either first pose has no heading.
    """
    motion = joints.astype(np.float64)
    turn = _yaw(initial_joints, "initial_joints") - _yaw(motion[0], source)
    placed_from_given = np.eye(4)
    cosine = np.cos(turn)
    sine = np.sin(turn)
    placed_from_given[:3, :3] = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
    placed = transform_points(placed_from_given, motion)
    placed += initial_joints[Joint.PELVIS].astype(np.float64) - placed[0, Joint.PELVIS]
    if height == "floor":
        placed[..., 1] -= placed[..., 1].min()
    return placed.astype(joints.dtype)


def on_body_of(
    joints: Float[np.ndarray, "frames 22 3"],
    initial_joints: Float[np.ndarray, "22 3"],
    *,
    source: Path | str = IN_MEMORY,
) -> Float[np.ndarray, "frames 22 3"]:
    """The motion with the bone lengths of the initial pose; every bone keeps its direction.

    The path of the pelvis is scaled by the ratio of the right legs, so that feet do not slide; place the motion
    afterwards with :func:`placed_on`. A model that is conditioned on places in its own scale needs them in that scale:
    :class:`prbench.representation.UniformSkeleton`.

    Args:
        joints: Y up, metres; on the uniform skeleton or on any other body.
        initial_joints: Pose of the person, metres.
        source: File or name that messages begin with.

    Raises:
        InputFileError: if a bone of the motion has no length.
    """
    return retarget(joints, offsets=rest_offsets(initial_joints.astype(np.float64)), source=source, upright=False)


def on_floor(joints: Float[np.ndarray, "frames 22 3"]) -> Float[np.ndarray, "frames 22 3"]:
    """The motion with its lowest joint at Y = 0, over all joints and frames."""
    lowered = joints.copy()
    lowered[..., 1] -= joints[..., 1].min()
    return lowered


def in_frame_of(
    joints: Float[np.ndarray, "frames 22 3"], reference: Float[np.ndarray, "others 22 3"]
) -> Float[np.ndarray, "frames 22 3"]:
    """The motion in the canonical frame of another one that lies in the same world.

    For models that generate on from a few given frames: ``reference`` is what they were given.
    """
    return transform_points(invert_rigid(canonical_frame(reference)), joints.astype(np.float64)).astype(joints.dtype)


def padded(motions: Sequence[Float[np.ndarray, "_ 22 3"]]) -> Float[np.ndarray, "batch frames 22 3"]:
    """Motions of different lengths as one array for :class:`prbench.contract.Motions`; padding repeats the last frame.

    >>> padded([np.zeros((2, 22, 3)), np.ones((3, 22, 3))]).shape
    (2, 3, 22, 3)
    """
    longest = max(len(motion) for motion in motions)
    held = np.empty((len(motions), longest, N_JOINTS, 3), dtype=np.float32)
    for row, motion in zip(held, motions):
        row[: len(motion)] = motion
        row[len(motion) :] = motion[-1]
    return held


def _yaw(pose: np.ndarray, source: Path | str) -> float:
    try:
        return facing_yaw(pose)
    except ValueError as error:
        raise no_heading(source, error) from error
