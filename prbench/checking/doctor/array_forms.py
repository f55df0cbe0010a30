"""Ways in which an array can hold the joints of a motion, and which of them a body moves in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.bones import Distances, fit
from prbench.checking.doctor.orders import OTHER_ORDERS
from prbench.representation.converters import JOINT_MAPS
from prbench.skeleton import N_JOINTS, Joint

_KNOWN_JOINTS = frozenset(
    {N_JOINTS}
    | {len(order.joints) for order in OTHER_ORDERS}
    | {len(each.source_joints) for each in JOINT_MAPS.values()}
)


@dataclass(frozen=True)
class Reading:
    """One way to understand an array."""

    form: str
    convert: Callable[[np.ndarray], np.ndarray]
    """To (frames, joints, 3)."""
    remedy: str


def best_reading(motions: tuple[np.ndarray, ...]) -> Reading | None:
    """The way to understand all arrays in which joints move most smoothly and keep their distances best."""
    shapes = [motion.shape for motion in motions]
    if len({len(shape) for shape in shapes}) != 1:
        return None
    candidates = _readings_of_planes(shapes) if len(shapes[0]) == 3 else _readings_of_rows(shapes)
    some = motions[:8]
    if not candidates:
        return None
    read = {reading: tuple(reading.convert(motion) for motion in some) for reading in candidates}
    restless = {reading: _restlessness(joints) for reading, joints in read.items()}
    best = min(candidates, key=lambda reading: (not _is_a_body(read[reading]), restless[reading]))
    return best if len(shapes[0]) == 3 or restless[best] < 0.25 else None


def _is_a_body(motions: tuple[np.ndarray, ...]) -> bool:
    """Whether the bones are people's, in HumanML3D's order."""
    if motions[0].shape[1] != N_JOINTS:
        return False
    finite = tuple(np.nan_to_num(motion) for motion in motions)
    return fit(Distances.of(finite), {joint.name.lower(): joint.value for joint in Joint}).misfit < 0.3


def _readings_of_planes(shapes: list[tuple[int, ...]]) -> list[Reading]:
    readings = []
    for order, form, remedy in (
        ((0, 1, 2), "", ""),
        ((0, 2, 1), "(frames, 3, joints)", "Exchange the last two axes: joints.transpose(0, 2, 1)."),
        ((2, 0, 1), "(joints, 3, frames), as in MDM's files", "Move frames to the front: joints.transpose(2, 0, 1)."),
        ((2, 1, 0), "(3, joints, frames)", "Turn the axes round: joints.transpose(2, 1, 0)."),
        ((1, 0, 2), "(joints, frames, 3)", "Exchange the first two axes: joints.transpose(1, 0, 2)."),
        ((1, 2, 0), "(3, frames, joints)", "Move the coordinates to the end: joints.transpose(1, 2, 0)."),
    ):
        turned = [tuple(shape[axis] for axis in order) for shape in shapes]
        same = len({shape[1] for shape in turned}) == 1
        if same and turned[0][1] in _KNOWN_JOINTS and all(shape[2] == 3 for shape in turned):
            readings.append(Reading(form, lambda motion, order=order: motion.transpose(order), remedy))
    if (
        not readings
        and all(shape[2] == 3 for shape in shapes)
        and len({shape[1] for shape in shapes}) == 1
        and shapes[0][1] > 8
    ):
        readings.append(Reading("", lambda motion: motion, ""))
    return readings


def _readings_of_rows(shapes: list[tuple[int, ...]]) -> list[Reading]:
    width = shapes[0][-1]
    if (
        len(shapes[0]) != 2
        or any(shape[-1] != width for shape in shapes)
        or width % 3
        or width // 3 not in _KNOWN_JOINTS
    ):
        return []
    joints = width // 3
    by_axis = f"joints.reshape(-1, 3, {joints}).transpose(0, 2, 1)"
    return [
        Reading(
            f"{joints} joints after one another, x y z each",
            lambda motion: motion.reshape(-1, joints, 3),
            f"Give every frame its joints: joints.reshape(-1, {joints}, 3).",
        ),
        Reading(
            "all x, then all y, then all z",
            lambda motion: motion.reshape(-1, 3, joints).transpose(0, 2, 1),
            f"Give every frame its joints: {by_axis}.",
        ),
    ]


def _restlessness(motions: tuple[np.ndarray, ...]) -> float:
    """How much a body's distances change from frame to frame, as a share of its size; little if axes are right."""
    changes = []
    for motion in motions:
        some = np.nan_to_num(motion[: min(len(motion), 64)])
        apart = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1)
        size = np.median(apart.max(axis=(1, 2)))
        relative = apart.std(axis=0) / np.maximum(apart.mean(axis=0), 1e-9)
        rigid = np.sort(relative[np.triu_indices(len(relative), 1)])
        steps = np.abs(np.diff(some, axis=0)).mean() / max(float(size), 1e-9) if len(some) > 1 else 0.0
        changes.append(float(rigid[: len(relative)].mean()) + float(steps))
    return float(np.median(changes))
