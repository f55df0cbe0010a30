"""Another axis than +Y points up."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.anatomy import body_up, front, left_of_hips, sidedness
from prbench.checking.doctor.axes import EXCHANGES, UP, Exchange, nearest_axis
from prbench.checking.doctor.patient import Finding, Patient, healthy
from prbench.checking.doctor.types import Diagnosis

_CLEAR, _TILTED = 35.0, 25.0  # degrees between bodies and an axis


def examine_up_axis(patient: Patient) -> Finding:
    """Find the axis along which bodies stand, from their ankles to their heads."""
    poses = patient.poses()
    up = body_up(poses).mean(axis=0)
    name, axis, angle = nearest_axis(up)
    evidence = (
        f"bodies (ankles to head) point along ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}), {angle:.0f} degrees from {name}"
    )
    if np.linalg.norm(up) < 0.3:
        return healthy(patient)  # no common direction
    if name == "+y":
        return healthy(patient) if angle < _TILTED else Finding((_leaning(evidence),), patient)
    mirrored = float(sidedness(poses, left_of_hips(poses)).mean()) < -0.5
    exchange = _best(patient, axis, mirrored=mirrored)
    if mirrored and not exchange.plain:  # two faults: the second is found later
        mirrored, exchange = False, _best(patient, axis, mirrored=False)
    cause = f"{name} points up instead of +y"
    if mirrored:
        cause += f", and the world is mirrored as well: axes were exchanged or negated to {exchange} without a turn"
    remedy = f"Turn the axes, (x, y, z) to {exchange}: {exchange.as_code()}."
    if str(exchange) == "(x, z, -y)":
        remedy += " prbench.axes.y_up does this."
    elif not mirrored:
        remedy += f" Or prbench.representation.converters.to_y_up(joints, up='{name.lstrip('+')}'), then canonicalise."
    found = Diagnosis("up-axis", angle < _CLEAR, evidence, cause, remedy)
    return Finding((found,), patient.changed(exchange))


def _best(patient: Patient, axis: np.ndarray, *, mirrored: bool) -> Exchange:
    """Of the exchanges that take an axis to +Y the one after which first poses face +Z most nearly."""
    facing = front(patient.first_poses()).mean(axis=0)
    fitting = [each for each in EXCHANGES if (each(axis) == UP).all() and each.mirrors is mirrored]
    return max(fitting, key=lambda each: (round(float(each(facing)[2]), 1), each.plain, each.signs))


def _leaning(evidence: str) -> Diagnosis:
    cause = "the world is tilted (gravity was not estimated, or a camera's frame was kept), or people lean or lie"
    return Diagnosis("up-axis", False, evidence, cause, "Turn the world so that gravity points along -y.")
