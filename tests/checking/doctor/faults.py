"""What goes wrong when motions are handed over, each as a change of correct motions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.motion_set import ORDERS_OF_22
from prbench.geometry.skeleton import Joint
from prbench.representation import canonicalise, encode
from prbench.representation.encoding import MIRRORED_JOINTS

Change = Callable[[np.ndarray], np.ndarray]
_NAMES = [joint.name.lower() for joint in Joint]


@dataclass(frozen=True)
class Fault:
    """One change, and the kinds of diagnosis that name it."""

    name: str
    change: Change
    kinds: tuple[str, ...]
    moving: bool = True
    """Whether a body has to move for the fault to show."""


def turned(motion: np.ndarray, degrees: float) -> np.ndarray:
    angle = np.deg2rad(degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return motion @ turn.T


def at_indices(motion: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Frames at fractional places, straight lines between frames."""
    places = np.clip(places, 0, len(motion) - 1)
    left = np.minimum(places.astype(int), len(motion) - 2)
    weight = (places - left)[:, None, None]
    return motion[left] * (1 - weight) + motion[left + 1] * weight


def first_frame_only(motion: np.ndarray, degrees: float, shift: tuple[float, float, float]) -> np.ndarray:
    moved = turned(motion, degrees) + shift
    moved[0] = motion[0]
    return moved


def frames_canonical(motion: np.ndarray) -> np.ndarray:
    """Every frame over the origin, facing +Z."""
    across = motion[:, 2] - motion[:, 1] + motion[:, 17] - motion[:, 16]
    yaw = np.rad2deg(np.arctan2(across[:, 2], -across[:, 0]))
    own = motion - motion[:, :1] * [1, 0, 1]
    return np.stack([turned(frame, -angle) for frame, angle in zip(own, yaw, strict=True)])


def in_order(names: tuple[str, ...]) -> Change:
    index = [_NAMES.index(name) for name in names]
    return lambda motion: motion[:, index]


def swapped(*parts: str) -> Change:
    index = list(range(22))
    for part in parts:
        left, right = _NAMES.index(f"left_{part}"), _NAMES.index(f"right_{part}")
        index[left], index[right] = right, left
    return lambda motion: motion[:, index]


def with_hands(motion: np.ndarray) -> np.ndarray:
    """SMPL's 24 joints: hands in the direction of the forearms."""
    return np.concatenate([motion, 1.3 * motion[:, 20:22] - 0.3 * motion[:, 18:20]], axis=1)


def with_nan(motion: np.ndarray) -> np.ndarray:
    broken = motion.copy()
    broken[len(broken) // 2, 4] = np.nan
    return broken


def padded_with_zeros(motion: np.ndarray) -> np.ndarray:
    padded = motion.copy()
    padded[-len(padded) // 5 :] = 0
    return padded


def repeated_rows(every: int) -> Change:
    """As nearest-neighbour resampling to a higher rate does: each ``every``-th frame is the one before it again."""

    def change(motion: np.ndarray) -> np.ndarray:
        slow = np.floor(np.arange(len(motion)) * (every - 1) / every)
        return at_indices(motion, slow * every / (every - 1))

    return change


def dropped_rows(every: int) -> Change:
    """As index rounding to a lower rate does: each ``every``-th frame of a faster motion is left out."""

    def change(motion: np.ndarray) -> np.ndarray:
        fast = np.arange(0, len(motion) - 1, (every - 1) / every)
        return at_indices(motion, fast[np.arange(len(fast)) % every != every - 1])

    return change


def frozen_end(motion: np.ndarray) -> np.ndarray:
    kept = (
        len(motion) // 2 + int(np.argmax(_speed(motion)[len(motion) // 2 : -6]))
        if len(motion) > 24
        else len(motion) // 2
    )
    return np.concatenate([motion[: kept + 1], np.repeat(motion[kept : kept + 1], len(motion) - kept - 1, axis=0)])


def delayed(frames: int) -> Change:
    """The motion begins late, in full speed, and its end is cut off."""

    def change(motion: np.ndarray) -> np.ndarray:
        start = int(np.argmax(_speed(motion)[: len(motion) // 2]))
        late = canonicalise(motion[start:])
        return np.concatenate([np.repeat(late[:1], frames, axis=0), late])

    return change


def _speed(motion: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(motion, axis=0), axis=-1).mean(axis=1)


def features(motion: np.ndarray) -> np.ndarray:
    return encode(motion)


def standing(motion: np.ndarray) -> np.ndarray:
    return motion - motion[:, :1]


def without_path(motion: np.ndarray) -> np.ndarray:
    return motion - motion[:, :1] * [1, 0, 1]


def add(*shift: float) -> Change:
    return lambda motion: motion + np.array(shift)


def scaled(factor: float) -> Change:
    return lambda motion: motion * factor


def axes(order: tuple[int, int, int], signs: tuple[int, int, int]) -> Change:
    return lambda motion: motion[..., list(order)] * np.array(signs, dtype=float)


SPACE: tuple[Fault, ...] = (
    Fault("millimetres", scaled(1000), ("unit",)),
    Fault("centimetres", scaled(100), ("unit",)),
    Fault("inches", scaled(1 / 0.0254), ("unit",)),
    Fault("feet", scaled(1 / 0.3048), ("unit",)),
    Fault("divided by 10", scaled(0.1), ("unit",)),
    Fault("z up", axes((0, 2, 1), (1, -1, 1)), ("up-axis",)),
    Fault("z up, HumanML3D's exchange not done", axes((0, 2, 1), (-1, 1, 1)), ("up-axis",)),
    Fault("x up", axes((1, 2, 0), (1, 1, 1)), ("up-axis",)),
    Fault("-y up (camera)", axes((0, 1, 2), (1, -1, -1)), ("up-axis",)),
    Fault("-z up", axes((0, 2, 1), (1, 1, -1)), ("up-axis",)),
    Fault("-x up", axes((1, 0, 2), (-1, 1, 1)), ("up-axis",)),
    Fault("y and z exchanged without a sign", axes((0, 2, 1), (1, 1, 1)), ("up-axis",)),
    Fault("y negated", axes((0, 1, 2), (1, -1, 1)), ("up-axis",)),
    Fault("x negated (mirrored world)", axes((0, 1, 2), (-1, 1, 1)), ("left-right", "mirrored")),
    Fault("z negated (mirrored world)", axes((0, 1, 2), (1, 1, -1)), ("left-right", "mirrored")),
    Fault("left and right exchanged", lambda motion: motion[:, list(MIRRORED_JOINTS)], ("left-right",)),
    Fault("left and right arm exchanged", swapped("collar", "shoulder", "elbow", "wrist"), ("left-right",)),
    Fault("left and right leg exchanged", swapped("hip", "knee", "ankle", "foot"), ("left-right",)),
    Fault("left and right ankle exchanged", swapped("ankle"), ("joint-order",)),
    Fault("left and right wrist exchanged", swapped("wrist"), ("joint-order",)),
    Fault("left and right shoulder exchanged", swapped("shoulder"), ("joint-order",)),
    *(Fault(name, in_order(joints), ("joint-order",)) for name, joints in ORDERS_OF_22.items()),
    Fault("24 joints of SMPL", with_hands, ("joint-order",)),
    Fault("turned by 90 degrees", lambda motion: turned(motion, 90), ("facing",)),
    Fault("turned by -45 degrees", lambda motion: turned(motion, -45), ("facing",)),
    Fault("turned by 180 degrees", lambda motion: turned(motion, 180), ("facing",)),
    Fault("only frame 0 canonical, turned", lambda motion: first_frame_only(motion, 90, (0, 0, 0)), ("facing",)),
    Fault("only frame 0 canonical, shifted", lambda motion: first_frame_only(motion, 0, (1.5, 0, 0.5)), ("position",)),
    Fault("3 m from the origin", add(3, 0, -1), ("position",)),
    Fault("floats by 0.15 m", add(0, 0.15, 0), ("floor",)),
    Fault("sinks by 0.9 m", add(0, -0.9, 0), ("floor",)),
    Fault("relative to the pelvis", standing, ("root",)),
    Fault("NaN in a frame", with_nan, ("not-finite",)),
    Fault("zeros at the end", padded_with_zeros, ("empty-frames",)),
    Fault("flat frames", lambda motion: motion.reshape(len(motion), 66), ("shape",)),
    Fault("all x, then y, then z", lambda motion: motion.transpose(0, 2, 1).reshape(len(motion), 66), ("shape",)),
    Fault("(frames, 3, 22)", lambda motion: motion.transpose(0, 2, 1), ("shape",)),
    Fault("(22, 3, frames)", lambda motion: motion.transpose(1, 2, 0), ("shape",)),
    Fault("263 features", features, ("features",)),
)  # fmt: skip
"""Faults in single numbers and frames."""

WALKING: tuple[Fault, ...] = (
    Fault("path over the ground left out", without_path, ("root",)),
    Fault("every frame canonical", frames_canonical, ("root",)),
)
"""Faults that show in people who walk or turn."""

TIME: tuple[Fault, ...] = (
    Fault("every 3rd frame repeated", repeated_rows(3), ("clock",)),
    Fault("every 2nd frame repeated", repeated_rows(2), ("clock",)),
    Fault("every 5th frame repeated", repeated_rows(5), ("clock",)),
    Fault("every 3rd frame dropped", dropped_rows(3), ("clock",)),
    Fault("every 4th frame dropped", dropped_rows(4), ("clock",)),
    Fault("every 6th frame dropped", dropped_rows(6), ("clock",)),
    Fault("end frozen in full speed", frozen_end, ("clock",)),
    Fault("begins 6 frames late in full speed", delayed(6), ("clock",)),
)
"""Faults of the clock that show in the motion alone."""


def played(rate: float) -> Change:
    """Made at ``rate`` frames a second and handed over as if at 20."""
    return lambda motion: at_indices(motion, np.arange(0, len(motion) - 1, 20 / rate))


def cut_to_length(change: Change) -> Change:
    """The same number of frames as before, as an adapter that fulfils its contract returns: cut, or held at the end."""

    def cut(motion: np.ndarray) -> np.ndarray:
        changed = change(motion)[: len(motion)]
        return np.concatenate([changed, np.repeat(changed[-1:], len(motion) - len(changed), axis=0)])

    return cut


RATES: tuple[Fault, ...] = (
    Fault("30 frames a second as 20, all frames", played(30), ("frame-rate",)),
    Fault("60 frames a second as 20, all frames", played(60), ("frame-rate",)),
    Fault("10 frames a second as 20, all frames", played(10), ("frame-rate",)),
    Fault("30 frames a second as 20, cut", cut_to_length(played(30)), ("frame-rate",)),
    Fault("60 frames a second as 20, cut", cut_to_length(played(60)), ("frame-rate",)),
)
"""Faults of the rate; certain where lengths or initial velocities are known, else suspicious."""
