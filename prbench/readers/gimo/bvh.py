"""BVH files as any program writes them: hierarchy, channels and motion, and the positions of their joints."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.bounded import read_text
from prbench.geometry.skeleton import Joint, match_names
from prbench.geometry.timelines import interpolate
from prbench.readers.files import missing_file

POSITION_CHANNELS = ("Xposition", "Yposition", "Zposition")
_ROTATION_CHANNELS = ("Xrotation", "Yrotation", "Zrotation")
_CHANNELS = {name.lower(): name for name in (*POSITION_CHANNELS, *_ROTATION_CHANNELS)}


@dataclass(frozen=True)
class BvhJoint:
    """One joint of the hierarchy; end sites are left out, they carry no motion."""

    name: str
    parent: int
    """Index of the parent; -1 for the root."""
    offset: tuple[float, float, float]
    """From the parent, in the parent's frame, file unit."""
    channels: tuple[str, ...]
    """In the order of the file."""


@dataclass(frozen=True)
class BvhMotion:
    """The content of one BVH file."""

    joints: tuple[BvhJoint, ...]
    """In the order of the hierarchy: parents before children."""
    frame_time: float
    """Seconds between two frames."""
    values: Float[np.ndarray, "n c"]
    """One row a frame, one column a channel; file unit and degrees."""


def read_bvh(path: Path) -> BvhMotion:
    """Read one BVH file: any order of channels, any number of them a joint.

    Raises:
        InputFileError: if the file is missing, its hierarchy is broken, a channel is unknown, or the numbers of the
            motion do not fill the frames that it announces.
    """
    try:
        text = read_text(path)
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except UnicodeDecodeError as error:
        raise InputFileError(path, "", expected="a BVH text file", found="other bytes") from error
    hierarchy, found, motion = text.partition("MOTION")
    if not found or "HIERARCHY" not in hierarchy:
        raise InputFileError(
            path,
            "",
            expected="the sections HIERARCHY and MOTION",
            found=f"{text[:40].strip()!r} and no {'MOTION' if 'HIERARCHY' in hierarchy else 'HIERARCHY'}",
            remedy="The file may be truncated; copy or download it again.",
        )
    joints = _Hierarchy(path, hierarchy.split()[1:]).parse()
    frame_time, values = _motion(path, motion, sum(len(joint.channels) for joint in joints))
    return BvhMotion(joints, frame_time, values)


@dataclass
class _Hierarchy:
    """Reads words one after the other; braces keep the stack of joints."""

    path: Path
    words: list[str]
    place: int = 0
    joints: list[BvhJoint] = field(default_factory=list)

    def parse(self) -> tuple[BvhJoint, ...]:
        """Return the joints in file order, parents first; offsets in the file's unit.

        Raises:
            InputFileError: at a word that does not belong where it stands, with its place.
        """
        stack: list[int] = []
        name = ""
        is_end = False
        while self.place < len(self.words):
            word = self._next()
            if word in ("ROOT", "JOINT"):
                name = self._name()
                is_end = False
            elif word == "End":
                self._next()
                is_end = True
            elif word == "{":
                parent = next((index for index in reversed(stack) if index >= 0), -1)
                if is_end:
                    stack.append(-1)
                else:
                    self.joints.append(BvhJoint(name, parent, (0.0, 0.0, 0.0), ()))
                    stack.append(len(self.joints) - 1)
            elif word == "}":
                if not stack:
                    raise self._broken("a joint", "a closing brace")
                stack.pop()
            elif word == "OFFSET":
                x, y, z = (self._number() for _ in range(3))
                self._change(stack, offset=(x, y, z))
            elif word == "CHANNELS":
                count = self._count()
                self._change(stack, channels=tuple(self._channel() for _ in range(count)))
            else:
                raise self._broken("JOINT, OFFSET, CHANNELS or a brace", f"'{word}'")
        if stack or not self.joints:
            raise self._broken("closed braces around at least one joint", f"{len(stack)} that are open")
        return tuple(self.joints)

    def _change(self, stack: list[int], **values: object) -> None:
        if not stack:
            raise self._broken("an opening brace", "a value outside of any joint")
        if stack[-1] >= 0:
            joint = self.joints[stack[-1]]
            self.joints[stack[-1]] = BvhJoint(**{**vars(joint), **values})  # type: ignore[arg-type]

    def _name(self) -> str:
        """All words up to the opening brace: some programs put spaces into names."""
        parts = []
        while self.place < len(self.words) and self.words[self.place] != "{":
            parts.append(self._next())
        return " ".join(parts)

    def _channel(self) -> str:
        word = self._next()
        if word.lower() not in _CHANNELS:
            raise self._broken("a channel such as Xposition or Zrotation", f"'{word}'")
        return _CHANNELS[word.lower()]

    def _count(self) -> int:
        number = self._number()
        if not (0 <= number <= len(_CHANNELS) and number.is_integer()):
            raise self._broken(f"at most {len(_CHANNELS)} channels", f"{number}")
        return int(number)

    def _number(self) -> float:
        word = self._next()
        try:
            number = float(word)
        except ValueError as error:
            raise self._broken("a number", f"'{word}'") from error
        if not math.isfinite(number):
            raise self._broken("a finite number", f"'{word}'")
        return number

    def _next(self) -> str:
        if self.place >= len(self.words):
            raise self._broken("more of the hierarchy", "its end")
        self.place += 1
        return self.words[self.place - 1]

    def _broken(self, expected: str, found: str) -> InputFileError:
        last = self.joints[-1].name if self.joints else "the root"
        return InputFileError(self.path, f"HIERARCHY, at {last}", expected=expected, found=found)


def _motion(path: Path, text: str, width: int) -> tuple[float, Float[np.ndarray, "n c"]]:
    """Frame time and one row a frame."""
    header, _, rest = text.partition("Frame Time:")
    words = header.split()
    seconds, _, numbers = rest.lstrip().partition("\n")
    try:
        count = int(words[-1])
        frame_time = float(seconds)
        values = np.array([float(word) for word in numbers.split()])
    except (ValueError, IndexError) as error:
        raise InputFileError(path, "MOTION", expected="frames of numbers", found=str(error)) from error
    if not 0 < frame_time < math.inf or count * width != values.size or count == 0:
        raise InputFileError(
            path,
            "MOTION",
            expected=f"{count} frames of {width} numbers, more than 0 s apart",
            found=f"{values.size} numbers, {frame_time} s apart",
            remedy="The file is cut; copy it again.",
        )
    rows = values.reshape(count, width)
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if bad.size:
        raise InputFileError(path, f"MOTION, frame {bad[0]}", expected="finite numbers", found="NaN or infinity")
    return frame_time, rows


def joint_positions(motion: BvhMotion) -> Float[np.ndarray, "n j 3"]:
    """Positions of all joints in the frame and unit of the file.

    Rotations are applied in the order of their channels (``Z X Y`` means R = Rz Rx Ry). Position channels stand in for
    the offset of their joint; programs differ in whether a root's offset is added to them, which shifts the whole body.
    """
    rotations: list[Rotation] = []
    positions = np.empty((len(motion.values), len(motion.joints), 3))
    column = 0
    for index, joint in enumerate(motion.joints):
        values = motion.values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        local = _local_rotation(joint.channels, values)
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
    return positions


def _local_rotation(channels: tuple[str, ...], values: Float[np.ndarray, "n c"]) -> Rotation:
    turned = [(place, channel[0]) for place, channel in enumerate(channels) if channel in _ROTATION_CHANNELS]
    if not turned:
        return Rotation.from_quat(np.tile([0.0, 0.0, 0.0, 1.0], (len(values), 1)))
    axes = "".join(axis for _, axis in turned)
    return Rotation.from_euler(axes, values[:, [place for place, _ in turned]], degrees=True)


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
    # The 22 joints in metres.
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
    joints = joints * unit
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
