"""Joints to features and features to joints, in NumPy; clips before they are encoded; bodies on one skeleton.

Sources: docs/specification/humanml3d.md#forward-conversion and docs/specification/humanml3d.md#inverse. What the
original turns into features without a word is refused here with the name of frame and joint
(docs/specification/humanml3d.md#edge-effects).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.bounded import require
from prbench.geometry.skeleton import (
    N_JOINTS,
    PARENTS,
    Joint,
    bone_lengths,
    canonical_frame,
    invert_rigid,
    transform_points,
)
from prbench.representation.features import (
    CONTACT_JOINTS,
    CONTACT_THRESHOLD,
    HALF_TURN_MIDWAYS,
    HEADING_KERNEL,
    JOINT_POSITIONS,
    OPPOSITE,
    REFLECTION_SIGNS,
    REST_DIRECTIONS,
    REST_OFFSETS,
    ROOT_HEIGHT,
    ROOT_LINEAR_VELOCITY,
    ROOT_YAW_VELOCITY,
    ROTATION_PARENTS,
    Mode,
)

Poses = Float[np.ndarray, "batch 22 3"]

_TALLEST_BODY = 20.0  # metres; larger ones are in millimetres or centimetres
_STEEPEST_LEAN = 60.0  # degrees between ankle-to-head and +y
_SHORTEST_BONE = 1e-6  # metres

# Name in messages of an array that comes from no file.
IN_MEMORY = "joints"
# Maps each joint to the one in whose place it stands in a mirror.
MIRRORED_JOINTS: tuple[int, ...] = tuple(
    Joint[
        joint.name.replace("LEFT", "RIGHT") if joint.name.startswith("LEFT") else joint.name.replace("RIGHT", "LEFT")
    ].value
    for joint in Joint
)


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
    shape = f"joint positions of the shape (frames, {N_JOINTS}, 3)"
    order = "Give the 22 SMPL body joints in HumanML3D order."
    require(source, (joints.ndim == 3 and joints.shape[1:] == (N_JOINTS, 3), "", shape, joints.shape, order))
    alone = "A row of features holds the step to the next frame; give next_joints with a single frame."
    require(source, (len(joints) >= min_frames, "", f"{min_frames} frames or more", len(joints), alone))
    check_finite(joints, source)
    extent = float(np.median((joints.max(axis=1) - joints.min(axis=1)).max(axis=-1)))
    found = f"one whose extent is {extent:,.0f} in the median frame"
    remedy = "This looks like millimetres: divide by 1,000."
    require(source, (extent <= _TALLEST_BODY, "", "a body in metres", found, remedy))
    ankles = (joints[:, Joint.LEFT_ANKLE] + joints[:, Joint.RIGHT_ANKLE]) / 2
    body = np.median(joints[:, Joint.HEAD] - ankles, axis=0)
    length = float(np.linalg.norm(body))
    if upright and body[1] < np.cos(np.deg2rad(_STEEPEST_LEAN)) * length:
        lean = np.rad2deg(np.arccos(np.clip(body[1] / length, -1, 1)))
        axis = f"{'-' if body.sum() < 0 else ''}{'xyz'[np.abs(body).argmax()]}"
        expected = "bodies along +y, the axis that points up"
        found = f"a median ankle-to-head vector {lean:.0f} degrees away from it, nearest to {axis}"
        remedy = "Turn the axes (prbench.geometry.skeleton.y_up for Z up),"
        remedy += " or say upright=False if people lie or crawl."
        raise InputFileError(source, "", expected=expected, found=found, remedy=remedy)
    lengths = np.linalg.norm(joints[:, 1:] - joints[:, PARENTS[1:]], axis=-1)
    bad = np.argwhere(lengths < _SHORTEST_BONE)
    if bad.size:
        frame, bone = bad[0]
        where = f"frame {frame}, {Joint(bone + 1).name.lower()}"
        expected = f"a distance from {Joint(PARENTS[bone + 1]).name.lower()}, so that the bone has a direction"
        remedy = "Leave the motion out, or repair this joint."
        raise InputFileError(source, where, expected=expected, found=f"{lengths[frame, bone]:.1e} m", remedy=remedy)


def check_finite(joints: np.ndarray, source: Path | str) -> None:
    """Refuse a motion (frames, 22, 3) with a position that is not a number or infinite.

    Raises:
        InputFileError: naming the source, the first such frame and its joint.
    """
    bad = np.argwhere(~np.isfinite(joints).all(axis=-1))
    if bad.size:
        frame, joint = bad[0]
        where = f"frame {frame}, {Joint(joint).name.lower()}"
        expected = "a finite position"
        remedy = "Leave the motion out, or cut it around the gap."
        raise InputFileError(source, where, expected=expected, found=str(joints[frame, joint].tolist()), remedy=remedy)


def canonicalise(
    joints: Float[np.ndarray, "frames ..."], *, source: Path | str = IN_MEMORY, upright: bool = True
) -> Float[np.ndarray, "frames 22 3"]:
    """Return the motion with its first pelvis over the origin, facing +Z, and its lowest joint at Y = 0.

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
    """Return the poses as a mirror at x = 0 shows them: x negated, left and right limbs exchanged."""
    return joints[..., MIRRORED_JOINTS, :] * np.array([-1, 1, 1], dtype=joints.dtype)


def encode(
    joints: Float[np.ndarray, "frames ..."],
    *,
    next_joints: Float[np.ndarray, "22 3"] | None = None,
    mode: Mode = "continuous",
    source: Path | str = IN_MEMORY,
    upright: bool = True,
    checked: bool = False,
) -> Float[np.ndarray, "rows 263"]:
    """Return the features of a canonical motion, with its own bone lengths.

    Row t holds frame t and the step to frame t + 1. Without ``next_joints`` the last frame has no step and is lost, as
    in the original; with it there are as many rows as frames (docs/specification/pr-model.md#data-and-features). The
    heading is smoothed over two seconds on either side, so encode the final clip and never cut features.

    Args:
        joints: (frames, 22, 3), canonical frame (:func:`prbench.representation.canonicalise`), metres, 20 fps.
        next_joints: The frame after the last one, same frame: the recorded one, or a copy of the last.
        mode: What happens to the yaw when the heading passes the opposite of its start.
        source: File or name that messages begin with.
        upright: False for people who lie or crawl (:func:`prbench.representation.check_joints`).
        checked: True for a part of a motion that passed ``check_joints`` before, which takes a third of the time.

    Returns:
        Raw features, float32: frames - 1 rows, or as many as frames with ``next_joints``.

    Raises:
        InputFileError: if positions are missing, not finite, in another unit or with another axis up, if a bone has no
            length, or if there is no step at all.
    """
    motion = np.asarray(joints, dtype=np.float64)
    if next_joints is not None:
        motion = np.concatenate([motion, np.asarray(next_joints, dtype=np.float64)[None]])
    if not checked:
        check_joints(motion, source=source, upright=upright)

    cos, sin, half_turns = _headings(motion, mode)
    steps = motion[1:] - motion[:-1]
    here = motion[:-1]
    pelvis = here[:, Joint.PELVIS]
    root_steps = _turned(steps[:, Joint.PELVIS], cos[1:], sin[1:])  # seen from the frame they lead to
    positions = _turned(here[:, 1:] - (pelvis * (1, 0, 1))[:, None], cos[:-1, None], sin[:-1, None])
    rotations = _rotations(here, cos[:-1], sin[:-1])
    velocities = _turned(steps, cos[:-1, None], sin[:-1, None])
    contacts = (steps[:, CONTACT_JOINTS] ** 2).sum(axis=-1) < CONTACT_THRESHOLD
    rows = len(here)
    blocks = (half_turns[:, None], root_steps[:, ::2], pelvis[:, 1:2], positions, rotations, velocities, contacts)
    return np.concatenate([block.reshape(rows, -1) for block in blocks], axis=1).astype(np.float32)


def _headings(motion: np.ndarray, mode: Mode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cosine and sine (N,) of the turn from the world to each frame's heading, and the half angles (N-1,) between them.

    Two quirks of the original are part of the representation: the hips enter with the opposite sign of
    :func:`prbench.geometry.skeleton.facing_yaw`, and frame 0 is not turned at all.
    """
    if mode == "reference":
        # Headings through quaternions (w, y) of positive w and in single precision, to the rounding of the original.
        x, z = _forward(motion.astype(np.float32)).T
        w = np.sqrt(x**2 + z**2) + z
        y = -x
        length = np.sqrt(w**2 + y**2)
        y[length == 0], length[length == 0] = 1.0, 1.0  # exactly opposite: half a turn
        w = w / length
        y = y / length
        w[0], y[0] = 1.0, 0.0
        return w**2 - y**2, 2 * w * y, np.arcsin(np.clip(y[1:] * w[:-1] - w[1:] * y[:-1], -1, 1))
    x, z = _forward(motion).T
    x[0], z[0] = 0.0, 1.0
    turns = np.diff(0.5 * np.arctan2(-x, z))
    return z, -x, turns - np.pi * np.round(turns / np.pi)


def _forward(motion: np.ndarray) -> np.ndarray:
    """Smoothed x and z (N, 2) of the unit forward vector Y x across; +Z without any heading."""
    from scipy.ndimage import correlate1d  # late: 0.3 s that a run and its workers do not need

    hips = motion[:, Joint.LEFT_HIP] - motion[:, Joint.RIGHT_HIP]
    across = _unit(hips + (motion[:, Joint.RIGHT_SHOULDER] - motion[:, Joint.LEFT_SHOULDER]))
    forward = np.stack([across[:, 2], -across[:, 0]], axis=1)
    forward = _unit(correlate1d(forward, HEADING_KERNEL, axis=0, mode="nearest"))
    forward[~forward.any(axis=1)] = 0.0, 1.0
    return forward


def _rotations(frames: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Six numbers (N, 21, 6) a joint: the first two columns of its bone's rotation, seen from the bone before it.

    The shortest rotation from the rest direction u to the bone's direction v is the reflection at u followed by that at
    the direction w half-way between them, ``(2 w w' - 1)(2 u u' - 1)``; unlike the quaternion's formula it keeps its
    precision when v comes close to -u.
    """
    directions = _unit(frames[:, 1:] - frames[:, PARENTS[1:]])
    midways = directions + REST_DIRECTIONS[1:]
    opposite = (midways**2).sum(axis=-1, keepdims=True) < OPPOSITE**2
    midways = _unit(np.where(opposite, HALF_TURN_MIDWAYS[1:], midways))
    reflections = 2 * midways[..., :, None] * midways[..., None, :] - np.eye(3)
    bones = reflections * REFLECTION_SIGNS[1:, None, :]

    before = np.concatenate([yaw_matrices(cos, sin)[:, None], bones], axis=1)[:, ROTATION_PARENTS[1:]]
    relative = np.swapaxes(before, -1, -2) @ bones[..., :2]
    return np.swapaxes(relative, -1, -2).reshape(len(frames), -1, 6)


def yaw_matrices(cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) about +Y by the angles with these cosines and sines."""
    zero = np.zeros_like(cos)
    one = np.ones_like(cos)
    return np.stack([cos, zero, sin, zero, one, zero, -sin, zero, cos], axis=-1).reshape(*cos.shape, 3, 3)


def _turned(vectors: np.ndarray, cos: np.ndarray, sin: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) turned about +Y; angles broadcast against their leading axes."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Return unit vectors; a zero vector stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 1e-12, length, 1.0)


def decode(features: Float[np.ndarray, "*batch frames 263"]) -> Float[np.ndarray, "*batch frames 22 3"]:
    """Joints of every row from its position features; the motion starts over the origin, facing +Z.

    Args:
        features: Raw features, not standardised. Rows depend on earlier rows only, so padding may hold anything.

    Returns:
        Canonical frame, metres, float32.
    """
    rows = features.astype(np.float64)
    # Sum over all earlier rows: 0 in row 0.
    values = rows[..., ROOT_YAW_VELOCITY]
    total = np.zeros_like(values)
    np.cumsum(values[..., :-1, :], axis=-2, out=total[..., 1:, :])
    half_yaw = total[..., 0]
    world_from_heading = yaw_matrices(np.cos(2 * half_yaw), -np.sin(2 * half_yaw))

    steps = np.zeros((*rows.shape[:-1], 3))
    steps[..., 1:, ::2] = rows[..., :-1, ROOT_LINEAR_VELOCITY]
    pelvis = np.cumsum((world_from_heading @ steps[..., None])[..., 0], axis=-2)
    pelvis[..., 1] = rows[..., ROOT_HEIGHT][..., 0]

    seen_from_heading = rows[..., JOINT_POSITIONS].reshape(*rows.shape[:-1], N_JOINTS - 1, 3)
    joints = np.empty((*rows.shape[:-1], N_JOINTS, 3))
    joints[..., Joint.PELVIS, :] = pelvis
    joints[..., 1:, :] = seen_from_heading @ np.swapaxes(world_from_heading, -1, -2)
    joints[..., 1:, ::2] += pelvis[..., None, ::2]
    return joints.astype(np.float32)


_LEG = (Joint.RIGHT_KNEE, Joint.RIGHT_ANKLE)  # ends of the two bones that decide the scale: right thigh and shin


def rest_offsets(joints: Float[np.ndarray, "*batch 22 3"]) -> Float[np.ndarray, "*batch 22 3"]:
    """Return the rest skeleton with a pose's own bone lengths: offset of each joint from its parent, metres."""
    offsets = np.zeros(joints.shape)
    offsets[..., 1:, :] = REST_DIRECTIONS[1:] * bone_lengths(joints)[..., None]
    return offsets


def root_scale(
    joints: Float[np.ndarray, "*batch 22 3"], offsets: Float[np.ndarray, "22 3"] = REST_OFFSETS
) -> Float[np.ndarray, "*batch"]:
    """Factor s of the root's path: right thigh and shin of the uniform skeleton over those of the pose."""
    own = bone_lengths(joints)[..., np.array(_LEG) - 1].sum(axis=-1)
    return np.asarray(np.linalg.norm(offsets[np.array(_LEG)], axis=-1).sum() / own)


def retarget(
    joints: Float[np.ndarray, "frames ..."],
    *,
    offsets: Float[np.ndarray, "22 3"] = REST_OFFSETS,
    source: Path | str = IN_MEMORY,
    upright: bool = True,
) -> Float[np.ndarray, "frames 22 3"]:
    """Return the motion on the uniform skeleton: bones keep directions, the root's path is scaled about the origin.

    Feet no longer stand exactly on the floor; :func:`prbench.representation.canonicalise` puts them there again.

    Args:
        joints: (frames, 22, 3), any frame with Y up, metres.
        offsets: Rest offsets of the skeleton to come to.
        source: File or name that messages begin with.
        upright: False for people who lie or crawl.

    Returns:
        Same frame, metres; the type of the numbers stays.

    Raises:
        InputFileError: as :func:`prbench.representation.check_joints`.
    """
    check_joints(np.asarray(joints), source=source, min_frames=1, upright=upright)
    return _with_lengths(joints, root_scale(joints[0], offsets), np.linalg.norm(offsets, axis=-1)).astype(joints.dtype)


@dataclass(frozen=True)
class UniformSkeleton:
    """Change of a batch of bodies to and from the skeleton of a model that learnt from HumanML3D.

    Conditions go in with :meth:`poses` and :meth:`locations`, generated motion comes out with :meth:`own_scale`
    (docs/specification/pr-model.md#data-and-features). Lengths scale about the canonical origin; bone proportions stay
    the model's.

    Attributes:
        scale: Root scale s of each body.
        offsets: Rest offsets of the uniform skeleton, metres.
    """

    scale: Float[np.ndarray, " batch"]
    offsets: Float[np.ndarray, "22 3"]

    @classmethod
    def of(cls, initial_joints: Poses, offsets: Float[np.ndarray, "22 3"] = REST_OFFSETS) -> UniformSkeleton:
        """Return the change of skeleton for bodies whose first frames are given.

        Raises:
            InputFileError: if a body has no right leg to measure.
        """
        check_joints(initial_joints, source="initial_joints", min_frames=0, upright=False)
        return cls(root_scale(initial_joints, offsets), offsets)

    def poses(self, joints: Float[np.ndarray, "batch *frames 22 3"]) -> Float[np.ndarray, "batch *frames 22 3"]:
        """Poses of the bodies, on the uniform skeleton."""
        scale = self._like(joints)[..., 0, 0]
        return _with_lengths(joints, scale, np.linalg.norm(self.offsets, axis=-1)).astype(joints.dtype)

    def locations(self, points: Float[np.ndarray, "batch *points 3"]) -> Float[np.ndarray, "batch *points 3"]:
        """Places in the world of the bodies (goals, object locations), in that of the uniform skeleton."""
        return (points * self._like(points)).astype(points.dtype)

    def own_scale(self, joints: Float[np.ndarray, "batch *points 3"]) -> Float[np.ndarray, "batch *points 3"]:
        """Bring what was generated on the uniform skeleton to the scale of the bodies."""
        return (joints / self._like(joints)).astype(joints.dtype)

    def _like(self, values: np.ndarray) -> np.ndarray:
        return self.scale.reshape(-1, *(1,) * (values.ndim - 1))


def _with_lengths(joints: np.ndarray, scale: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Return same bone directions, other lengths (22,); the pelvis is scaled (scale broadcasts against poses)."""
    moved = np.empty(joints.shape)
    moved[..., Joint.PELVIS, :] = joints[..., Joint.PELVIS, :] * np.asarray(scale)[..., None]
    for joint in range(1, N_JOINTS):
        bone = np.asarray(joints[..., joint, :] - joints[..., PARENTS[joint], :], dtype=np.float64)
        direction = bone / np.linalg.norm(bone, axis=-1, keepdims=True)
        moved[..., joint, :] = moved[..., PARENTS[joint], :] + direction * lengths[joint]
    return moved
