"""BVH files as any program writes them: hierarchy, channels and motion, and the positions of their joints."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.bounded import read_text, require, require_rows
from prbench.files.storage import write_text
from prbench.geometry.skeleton import Joint, match_names
from prbench.geometry.timelines import interpolate
from prbench.readers.files import must_exist

POSITION_CHANNELS = ("Xposition", "Yposition", "Zposition")
_CHANNELS = {name.lower(): name for name in (*POSITION_CHANNELS, "Xrotation", "Yrotation", "Zrotation")}


@dataclass(frozen=True)
class BvhJoint:
    """One joint of the hierarchy; end sites are left out, they carry no motion.

    Attributes:
        parent: Index of the parent; -1 for the root.
        offset: Offset from the parent, in the parent's frame, file unit.
        channels: Names of its channels, in the order of the file.
    """

    name: str
    parent: int
    offset: tuple[float, float, float]
    channels: tuple[str, ...]


@dataclass(frozen=True)
class BvhMotion:
    """The content of one BVH file.

    Attributes:
        joints: Joints in the order of the hierarchy, parents before children.
        frame_time: Seconds between two frames.
        values: One row a frame, one column a channel; file unit and degrees.
    """

    joints: tuple[BvhJoint, ...]
    frame_time: float
    values: Float[np.ndarray, "n c"]


def read_bvh(path: Path) -> BvhMotion:
    """Read one BVH file: any order of channels, any number of them a joint.

    Raises:
        InputFileError: if the file is missing, its hierarchy is broken, a channel is unknown, or the numbers of the
            motion do not fill the frames that it announces.
    """
    with must_exist(path):
        text = read_text(path)
    hierarchy, has_motion, motion = text.partition("MOTION")
    lacking = "MOTION" if "HIERARCHY" in hierarchy else "HIERARCHY"
    is_bvh = bool(has_motion) and "HIERARCHY" in hierarchy
    found = f"{text[:40].strip()!r} and no {lacking}"
    remedy = "The file may be truncated; copy or download it again."
    require(path, (is_bvh, "", "the sections HIERARCHY and MOTION", found, remedy))
    joints = _read_hierarchy(path, hierarchy.partition("HIERARCHY")[2])
    width = sum(len(joint.channels) for joint in joints)

    header, _, rest = motion.partition("Frame Time:")
    seconds, _, numbers = rest.lstrip().partition("\n")
    try:
        count = int(header.split()[-1])
        frame_time = float(seconds)
        values = np.array([float(word) for word in numbers.split()])
    except (ValueError, IndexError) as error:
        raise InputFileError(path, "MOTION", expected="frames of numbers", found=str(error)) from error
    fits = 0 < frame_time < math.inf and count * width == values.size and count > 0
    expected = f"{count} frames of {width} numbers, more than 0 s apart"
    found = f"{values.size} numbers, {frame_time} s apart"
    require(path, (fits, "MOTION", expected, found, "The file is cut; copy it again."))
    rows = values.reshape(count, width)
    bad = ~np.isfinite(rows).all(axis=1)
    require_rows(path, bad, "finite numbers", "NaN or infinity", place="MOTION, frame", first=0)
    return BvhMotion(joints, frame_time, rows)


def _read_hierarchy(path: Path, text: str) -> tuple[BvhJoint, ...]:
    """Return the joints in the order of the file, parents first; offsets in the file's unit."""
    joints: list[BvhJoint] = []
    open_joints: list[int] = []  # index of every joint whose brace is open; -1 for an end site
    name: str | None = ""
    for line in text.replace("{", "\n{\n").replace("}", "\n}\n").splitlines():
        where = f"HIERARCHY, at {joints[-1].name if joints else 'the root'}"
        match line.split():
            case []:
                continue
            case ["ROOT" | "JOINT", *parts]:  # some programs put spaces into names
                name = " ".join(parts)
            case ["End", *_]:
                name = None
            case ["{"] if name is not None:
                parent = next((index for index in reversed(open_joints) if index >= 0), -1)
                open_joints.append(len(joints))
                joints.append(BvhJoint(name, parent, (0.0, 0.0, 0.0), ()))
            case ["{"]:
                open_joints.append(-1)
            case ["}"] if open_joints:
                open_joints.pop()
            case ["OFFSET", *numbers] if open_joints and len(numbers) == 3:
                x, y, z = (_number(number) for number in numbers)
                wrong = next((word for word in numbers if not math.isfinite(_number(word))), None)
                require(path, (wrong is None, where, "a number", f"'{wrong}'", ""))
                if open_joints[-1] >= 0:
                    joints[open_joints[-1]] = replace(joints[open_joints[-1]], offset=(x, y, z))
            case ["CHANNELS", count, *channels] if open_joints and count == str(len(channels)):
                wrong = next((word for word in channels if word.lower() not in _CHANNELS), None)
                expected = "a channel such as Xposition or Zrotation"
                require(path, (wrong is None, where, expected, f"'{wrong}'", ""))
                named = tuple(_CHANNELS[word.lower()] for word in channels)
                if open_joints[-1] >= 0:
                    joints[open_joints[-1]] = replace(joints[open_joints[-1]], channels=named)
            case _:
                expected = "JOINT, OFFSET with 3 numbers, CHANNELS with as many names, or a brace"
                raise InputFileError(path, where, expected=expected, found=f"'{line.strip()}'")
    closed = bool(joints) and not open_joints
    found = f"{len(open_joints)} that are open"
    require(path, (closed, "HIERARCHY", "closed braces around at least one joint", found, ""))
    return tuple(joints)


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def write_bvh(motion: BvhMotion, path: Path, *, tip: float = 5.0) -> None:
    """Write one BVH file, whole or not at all; six decimals.

    Args:
        motion: The content; joints in the order of a file, each before its children and these before its siblings.
        path: The file.
        tip: Length of the end site that stands above every joint without children, file unit.
    """
    lines = ["HIERARCHY", *_joint_lines(motion, 0, "", tip), "MOTION", f"Frames: {len(motion.values)}"]
    lines.append(f"Frame Time: {motion.frame_time!r}")
    lines += [" ".join(f"{value:.6f}" for value in row) for row in motion.values.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def _joint_lines(motion: BvhMotion, index: int, indent: str, tip: float) -> list[str]:
    joint = motion.joints[index]
    inner = indent + "  "
    children = [child for child, other in enumerate(motion.joints) if other.parent == index]
    below = [line for child in children for line in _joint_lines(motion, child, inner, tip)]
    end = [f"{inner}End Site", f"{inner}{{", f"{inner}  OFFSET 0.0 {tip!r} 0.0", f"{inner}}}"]
    return [
        f"{indent}{'ROOT' if joint.parent < 0 else 'JOINT'} {joint.name}",
        f"{indent}{{",
        f"{inner}OFFSET {' '.join(repr(value) for value in joint.offset)}",
        f"{inner}CHANNELS {len(joint.channels)} {' '.join(joint.channels)}",
        *(below or end),
        f"{indent}}}",
    ]


def joint_poses(motion: BvhMotion) -> tuple[Float[np.ndarray, "n j 3"], list[Rotation]]:
    """Return the positions of all joints in the frame and unit of the file, and the rotations of each over time.

    Rotations are applied in the order of their channels (``Z X Y`` means R = Rz Rx Ry). Position channels stand in for
    the offset of their joint; programs differ in whether a root's offset is added to them, which shifts the whole body.
    """
    rotations: list[Rotation] = []
    positions = np.empty((len(motion.values), len(motion.joints), 3))
    column = 0
    for index, joint in enumerate(motion.joints):
        values = motion.values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        local = Rotation.identity(len(values))
        turned = [place for place, channel in enumerate(joint.channels) if channel not in POSITION_CHANNELS]
        if turned:
            axes = "".join(joint.channels[place][0] for place in turned)
            local = Rotation.from_euler(axes, values[:, turned], degrees=True)
        offset = np.tile(np.array(joint.offset), (len(values), 1))
        for place, channel in enumerate(joint.channels):
            if channel in POSITION_CHANNELS:
                offset[:, POSITION_CHANNELS.index(channel)] = values[:, place]
        if joint.parent < 0:
            positions[:, index] = offset
            rotations.append(local)
            continue
        parent = rotations[joint.parent]
        positions[:, index] = positions[:, joint.parent] + parent.apply(offset)
        rotations.append(parent * local)
    return positions, rotations


_UNITS = (1.0, 0.01, 0.001)  # Metres a file unit, in the order of trial.
_LEG = (0.5, 1.2)  # metres from hip to ankle of a person
_STEP = 1 / 30  # seconds between the starts that are tried first
_STANDS_STILL = 0.2  # metres; a shorter walk fits anywhere


def joints_in_metres(motion: BvhMotion, name: Path | str) -> tuple[Float[np.ndarray, "n 22 3"], Rotation]:
    """Return the 22 joints in the frame of the file, metres, and the rotation of the head.

    Args:
        motion: Content of the file.
        name: The file, for messages.

    Raises:
        InputFileError: if joints have unknown names, or legs no human length.
    """
    columns, unmatched, convention = match_names([joint.name for joint in motion.joints])
    missing = ", ".join(Joint(index).name.lower() for index, column in enumerate(columns) if column < 0)
    expected = f"joints for {missing} (best naming: {convention})"
    found = f"unmatched names: {', '.join(unmatched) or 'none'}"
    require(name, (not missing, "HIERARCHY", expected, found, "Rename the joints in the file."))
    positions, rotations = joint_poses(motion)
    joints = positions[:, list(columns)]
    thigh = np.linalg.norm(joints[0, Joint.LEFT_KNEE] - joints[0, Joint.LEFT_HIP])
    leg = float(thigh + np.linalg.norm(joints[0, Joint.LEFT_ANKLE] - joints[0, Joint.LEFT_KNEE]))
    unit = next((unit for unit in _UNITS if _LEG[0] <= leg * unit <= _LEG[1]), None)
    expected = f"legs of {_LEG[0]} to {_LEG[1]} m, in metres, centimetres or millimetres"
    require(name, (unit is not None, "HIERARCHY", expected, f"{leg:.3f}", ""))
    return joints * unit, rotations[columns[Joint.HEAD]]


def place_skeleton(
    motion: BvhMotion, seconds: Float[np.ndarray, " n"], pelvis: Float[np.ndarray, "n 3"], name: str, worst: float
) -> tuple[Float[np.ndarray, "n 22 3"], list[str]]:
    """Align a skeleton in time with a pelvis track, and move its hips onto it frame by frame.

    Args:
        motion: Content of the file; its frame must be that of the track, up to a constant offset.
        seconds: Times of the track, increasing, from any origin.
        pelvis: The track, metres, Y up.
        name: Name of the file, for messages.
        worst: Metres; a worse alignment is refused.

    Returns:
        The joints at the instants of the track and in its frame, and remarks: when the skeleton's file begins, how far
        its hips are from the track, and whether the pelvis moves far enough to tell.

    Raises:
        InputFileError: if joints have unknown names, legs no human length, the file is shorter than the track, or no
            start brings the two tracks together.
    """
    joints, _ = joints_in_metres(motion, name)
    times = np.arange(len(joints)) * motion.frame_time
    since = seconds - seconds[0]
    latest = float(times[-1] - since[-1])
    is_long = latest >= -motion.frame_time / 2
    remedy = "This skeleton belongs to another recording, or the file is cut."
    require(name, (is_long, "", f"at least the {since[-1]:.2f} s of the segment", f"{times[-1]:.2f} s", remedy))

    # The start that leaves the least distance: tried every thirtieth of a second, then refined.
    hips = joints[:, Joint.PELVIS]
    latest = max(latest, 0.0)

    def spread(start: float) -> float:
        apart = interpolate(times, hips, start + since) - pelvis
        # Both frames may lie a constant offset apart, which tells nothing about time.
        return float(((apart - apart.mean(axis=0)) ** 2).sum(axis=1).mean())

    tried = np.arange(int(latest / _STEP) + 1) * _STEP
    start = float(tried[int(np.argmin([spread(start) for start in tried]))])
    bounds = max(start - _STEP, 0.0), min(start + _STEP, latest)
    if bounds[1] > bounds[0]:
        refined = float(minimize_scalar(spread, bounds=bounds, method="bounded", options={"xatol": 1e-5}).x)
        start = min((refined, start), key=spread)
    error = float(np.sqrt(spread(start)))
    remedy = "The skeleton lies in another frame or belongs to another recording; use the fitted body instead"
    remedy += " (options vposer_model and smplx_model)."
    expected = f"hips within {worst * 100:.0f} cm of the fitted pelvis"
    found = f"{error * 100:.1f} cm at the best start ({start:.2f} s)"
    require(name, (error <= worst, "", expected, found, remedy))
    # The limbs are the suit's, the place is that of the fitted pelvis, frame by frame.
    laid = interpolate(times, joints, start + since)
    laid = laid + (pelvis - laid[:, Joint.PELVIS])[:, None]
    file = name.rpartition("/")[2]
    said = f"limbs from {file}, which begins {start:.3f} s before the segment"
    remarks = [f"{said} and follows the fitted pelvis within {error * 1000:.0f} mm"]
    if float(np.linalg.norm(pelvis - pelvis[0], axis=1).max()) < _STANDS_STILL:
        remarks.append("the pelvis hardly moves, so the skeleton's start is a guess")
    return laid, remarks
