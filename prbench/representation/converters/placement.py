"""Positions of any common world and rate as the benchmark asks for them: Y up, right-handed, metres, 20 fps.

Frames are resampled by time, never by index. Wrong units, exchanged sides and a wrong order of joints pass every check
of shapes; checks of limbs and sides show them here, before they become a score. ``prbench doctor`` looks at more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float, Num

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files.bounded import require, require_rows
from prbench.geometry.skeleton import (
    N_JOINTS,
    PARENTS,
    Joint,
    canonical_frame,
    facing_yaw,
    invert_rigid,
    transform_points,
)
from prbench.geometry.timelines import interpolate
from prbench.representation.encoding import (
    IN_MEMORY,
    canonicalise,
    check_finite,
    check_joints,
    no_heading,
    rest_offsets,
    retarget,
)
from prbench.representation.features import FRAME_RATE

Motion = Float[np.ndarray, "frames 22 3"]

# Maps each axis that may point up to source column and sign of x, y and z: rotations by a quarter or half turn.
_TURNS: Mapping[str, tuple[tuple[int, int], ...]] = MappingProxyType(
    {
        "y": ((0, 1), (1, 1), (2, 1)),
        "-y": ((0, 1), (1, -1), (2, -1)),
        "z": ((0, 1), (2, 1), (1, -1)),
        "-z": ((0, 1), (2, -1), (1, 1)),
        "x": ((1, -1), (0, 1), (2, 1)),
        "-x": ((1, 1), (0, -1), (2, 1)),
    }
)

# Metres a unit.
UNITS: Mapping[str, float] = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048})
_ROUNDING = 1e-6  # seconds


def to_y_up(
    points: Num[np.ndarray, "*batch 3"], *, up: str = "y", left_handed: bool = False, unit: str | float = "m"
) -> Float[np.ndarray, "*batch 3"]:
    """Positions with Y up, right-handed, in metres.

    The heading that comes out is arbitrary; :func:`prbench.representation.converters.placed_on` or
    :func:`prbench.representation.canonicalise` gives it a meaning.

    Args:
        points: Positions in the world of the source.
        up: Axis that points up there: ``y``, ``z``, ``x``, or one of them with a minus sign. ``-y`` is that of camera
            coordinates (x right, y down, z forward).
        left_handed: The source's axes are left-handed (Unity: Y up, Unreal: Z up). One horizontal axis is negated;
            names of joints stay, because the body is the same.
        unit: ``m``, ``cm``, ``mm``, ``inch``, ``foot``, or metres a unit.

    Raises:
        UsageError: if axis or unit is unknown.
    """
    if up not in _TURNS:
        raise UsageError(f"unknown up axis '{up}'.{did_you_mean(up, _TURNS)} Choose one of: {', '.join(_TURNS)}.")
    metres = unit
    if isinstance(unit, str):
        if unit not in UNITS:
            raise UsageError(f"unknown unit '{unit}'.{did_you_mean(unit, UNITS)} Choose one of: {', '.join(UNITS)}.")
        metres = UNITS[unit]
    elif not (np.isfinite(unit) and unit > 0):
        raise UsageError(f"unit: expected metres a unit, a number above 0, found {unit:g}.")
    columns, signs = np.transpose(_TURNS[up])
    exact = np.result_type(points.dtype, np.float32)  # millimetres may come as integers
    turned = points[..., columns].astype(exact) * (signs * float(metres)).astype(exact)
    if left_handed:
        turned[..., 0] = -turned[..., 0]
    return turned


def frames_needed(n_frames: int, fps: float, *, wanted_fps: float = FRAME_RATE) -> int:
    """Frames at ``fps`` that cover ``n_frames`` at ``wanted_fps``: what to ask a model of another rate for.

    >>> frames_needed(101, 30.0)  # five seconds
    151
    """
    return int(np.ceil((n_frames - 1) * fps / wanted_fps - 1e-9)) + 1


def at_rate(
    values: Num[np.ndarray, "frames *shape"],
    fps: float,
    *,
    n_frames: int | None = None,
    wanted_fps: float = FRAME_RATE,
    source: Path | str = IN_MEMORY,
) -> Float[np.ndarray, "wanted *shape"]:
    """Resample a motion to another rate, linearly interpolated; both begin on the first frame.

    The first frame of a generated motion is the initial pose, so the grid begins there.

    Args:
        values: Uniformly sampled positions or other vectors.
        fps: Their rate.
        n_frames: Frames to give back; None for as many as the motion covers.
        wanted_fps: Rate to come to.
        source: File or name that messages begin with.

    Raises:
        InputFileError: if a rate is no positive number, or the motion ends before the last frame that is asked for.
    """
    for rate in (fps, wanted_fps):
        require(source, (np.isfinite(rate) and rate > 0, "", "a frame rate above 0", f"{rate:g}", ""))
    return at_times(np.arange(len(values)) / fps, values, n_frames=n_frames, wanted_fps=wanted_fps, source=source)


def at_times(
    times: Float[np.ndarray, " frames"],
    values: Num[np.ndarray, "frames *shape"],
    *,
    n_frames: int | None = None,
    wanted_fps: float = FRAME_RATE,
    source: Path | str = IN_MEMORY,
) -> Float[np.ndarray, "wanted *shape"]:
    """:func:`at_rate` for a motion with a time stamp a frame, however they are spaced.

    Args:
        times: Seconds, strictly increasing; the first one is the start.
        values: One a time.
        n_frames: Frames to give back; None for as many as the motion covers.
        wanted_fps: Rate to come to.
        source: File or name that messages begin with.

    Raises:
        InputFileError: if there is no frame, time does not increase, or the motion is too short.
    """
    require(source, (len(times) > 0, "times", "increasing times, at least one", "none", ""))
    require_rows(
        source,
        np.diff(times) <= 0,
        lambda row: f"increasing times, after {times[row]:g} s",
        lambda row: f"{times[row + 1]:g} s",
        place="frame",
        first=1,
    )
    covered = float(times[-1] - times[0])
    most = int(np.floor((covered + _ROUNDING) * wanted_fps)) + 1
    wanted = most if n_frames is None else n_frames
    expected = f"{(wanted - 1) / wanted_fps:.3f} s of motion, for {wanted} frames at {wanted_fps:g} fps"
    found = f"{covered:.3f} s ({len(times)} frames)"
    remedy = "Ask the model for frames_needed(n_frames, fps) frames; a motion is never stretched."
    require(source, (wanted <= most, "", expected, found, remedy))
    query = times[0] + np.arange(wanted) / wanted_fps
    return interpolate(times.astype(np.float64), values, query).astype(np.result_type(values.dtype, np.float32))


_BEND = 0.01  # metres between knee and the line from hip to ankle; below it a leg says nothing about its front
_BACKWARDS = -0.3  # mean cosine between the front of the legs and that of the hips
_LIMB_LENGTHS = (0.12, 0.75)  # metres; thighs, shins and arms of children and of tall people
_ADULT_LIMB = 0.33  # metres, mean of the eight limbs
_TINIEST_BODY = 1e-9
_LIMB_RATIO = 1.6  # between a left limb and the right one


def check_limbs(joints: Motion, *, source: Path | str = IN_MEMORY) -> None:
    """Refuse thighs, shins, upper arms and forearms that no person has.

    Args:
        joints: Metres, any axes.
        source: File or name that the message begins with.

    Raises:
        InputFileError: if a position is not finite, or there is none; if a limb is shorter than 12 cm or longer than
            75 cm in the median frame (with the unit that would explain it), or left and right differ by more than a
            factor of 1.6.
    """
    check_finite(joints, source)
    require(source, (len(joints) > 0, "", "one frame or more", "none", ""))
    bones = np.linalg.norm(joints[:, 1:] - joints[:, PARENTS[1:]], axis=-1)
    median = dict(zip(Joint, [0.0, *np.median(bones, axis=0).tolist()]))
    # All limbs too long or too short by one factor: another unit.
    factor = float(np.median([median[end] for pair in _LIMB_PAIRS for end in pair])) / _ADULT_LIMB
    require(source, (factor >= _TINIEST_BODY, "", "joints of a body", "joints that lie on one another", ""))
    if not 1 / 3 < factor < 3:
        name = min(UNITS, key=lambda unit: abs(np.log(factor * UNITS[unit])))
        remedy = f"This looks like {name}: say unit='{name}'."
        if not 1 / 2 < factor * UNITS[name] < 2:
            remedy = f"If the model's bodies are normalised, unit={1 / factor:.3g} (metres a unit) makes them adults."
        expected = "a body in metres, whose thighs, shins and arms are 20 to 50 cm long"
        found = f"limbs {factor:.3g} times as long as an adult's"
        raise InputFileError(source, "unit", expected=expected, found=found, remedy=remedy)
    shortest, longest = _LIMB_LENGTHS
    for pair in _LIMB_PAIRS:
        for end, other in (pair, pair[::-1]):
            expected = ""
            if not shortest < median[end] < longest:
                expected = f"{shortest * 100:.0f} to {longest * 100:.0f} cm"
            elif not 1 / _LIMB_RATIO < median[end] / max(median[other], 1e-9) < _LIMB_RATIO:
                expected = f"about {median[other] * 100:.0f} cm, as on the other side"
            if expected:
                where = f"{Joint(PARENTS[end]).name.lower()} to {end.name.lower()}"
                found = f"{median[end] * 100:.1f} cm in the median frame"
                remedy = "The order of the joints is another one: name the skeleton (joint_map) and compare its list"
                remedy += " with yours."
                raise InputFileError(source, where, expected=expected, found=found, remedy=remedy)


# Joints in which thighs, shins, upper arms and forearms end.
_LIMB_PAIRS = tuple((Joint[f"LEFT_{end}"], Joint[f"RIGHT_{end}"]) for end in ("KNEE", "ANKLE", "ELBOW", "WRIST"))


def front_of_legs(joints: Motion, *, feet: bool = True) -> float | None:
    """Measure how far feet and bent knees point to the front that hips and shoulders give.

    Args:
        joints: Y up, right-handed, metres.
        feet: False if the toes were computed from the hips, so that only the knees know.

    Returns:
        Mean cosine on the ground plane, 1 for a body that is in order, -1 where left and right are exchanged (or where
        a left-handed world was not said to be one); None if legs are straight throughout and feet are not asked.
    """
    across = joints[:, Joint.LEFT_HIP] - joints[:, Joint.RIGHT_HIP]
    across = across + joints[:, Joint.LEFT_SHOULDER] - joints[:, Joint.RIGHT_SHOULDER]
    front = np.stack([-across[:, 2], across[:, 0]], axis=-1)
    # Sum over both legs of the knee's offset from the line between hip and ankle (frames, 3).
    bends = np.zeros((len(joints), 3))
    pointers = [bends]
    for side in ("LEFT", "RIGHT"):
        hip, knee, ankle, toe = (joints[:, Joint[f"{side}_{name}"]] for name in ("HIP", "KNEE", "ANKLE", "FOOT"))
        leg = ankle - hip
        part = ((knee - hip) * leg).sum(axis=-1) / np.maximum((leg**2).sum(axis=-1), 1e-12)
        bends += knee - hip - part[:, None] * leg
        pointers += [toe - ankle] if feet else []
    pointing = np.stack(pointers)[..., ::2]  # (pointers, frames, 2)
    length = np.linalg.norm(pointing, axis=-1)
    size = length * np.linalg.norm(front, axis=-1)
    decisive = length > _BEND
    if not decisive.any():
        return None
    cosine = (pointing * front).sum(axis=-1) / np.where(size > 0, size, 1.0)
    return float((cosine * length)[decisive].sum() / length[decisive].sum())


def check_sides(joints: Motion, *, feet: bool = True, source: Path | str = IN_MEMORY) -> None:
    """Refuse a body whose feet and knees point to its back.

    Args:
        joints: Y up, right-handed, metres.
        feet: See :func:`front_of_legs`.
        source: File or name that the message begins with.

    Raises:
        InputFileError: if left and right are exchanged, or the world is left-handed.
    """
    cosine = front_of_legs(joints, feet=feet)
    if cosine is None:
        return
    expected = "feet and knees that point to the body's front"
    found = f"a mean cosine of {cosine:.2f} between them and the front that hips and shoulders give"
    remedy = "Left and right joints are exchanged, or the world is left-handed: check the order of the joints, then say"
    require(source, (cosine >= _BACKWARDS, "left and right", expected, found, f"{remedy} left_handed=True."))


Height = Literal["pelvis", "floor"]


def to_canonical(
    joints: Motion,
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
    """Return a motion of the 22 joints as the benchmark wants one of which no initial pose is known.

    Axes and unit, then 20 frames a second by time, then the canonical frame: first pelvis over the origin, facing +Z,
    lowest joint of the whole motion at Y = 0. Where an initial pose is known, :func:`placed_on` follows.

    Args:
        joints: Joints in the world of the source.
        fps: Frames a second.
        n_frames: Frames to give back; None for as many as the motion covers.
        wanted_fps: Their rate: ``batch.fps``.
        up: See :func:`to_y_up`.
        left_handed: See :func:`to_y_up`.
        unit: See :func:`to_y_up`.
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
    joints: Motion,
    initial_joints: Float[np.ndarray, "22 3"],
    *,
    height: Height = "pelvis",
    source: Path | str = IN_MEMORY,
) -> Motion:
    """Return the motion turned about the vertical and moved, so that its first pose stands where the initial pose does.

    The whole motion moves as one; no joint is bent and no bone stretched. What is left between the two first poses is
    the model's own error, which ``prbench adapters check`` reports.

    Args:
        joints: Y up, metres, any heading and place.
        initial_joints: Initial pose of the batch, canonical frame, metres.
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


def on_body_of(joints: Motion, initial_joints: Float[np.ndarray, "22 3"], *, source: Path | str = IN_MEMORY) -> Motion:
    """Return the motion with the bone lengths of the initial pose; every bone keeps its direction.

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


def on_floor(joints: Motion) -> Motion:
    """Return the motion with its lowest joint at Y = 0, over all joints and frames."""
    lowered = joints.copy()
    lowered[..., 1] -= joints[..., 1].min()
    return lowered


def in_frame_of(joints: Motion, reference: Float[np.ndarray, "others 22 3"]) -> Motion:
    """Return the motion in the canonical frame of another one that lies in the same world.

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
