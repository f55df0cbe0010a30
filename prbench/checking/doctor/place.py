"""Finds motions in another frame: another axis up, another heading, off the floor or the origin, or torn apart."""

from __future__ import annotations

import dataclasses
from itertools import permutations, product

import numpy as np

from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, body_up, front, sidedness
from prbench.geometry.skeleton import Joint

_UP = np.array([0.0, 1.0, 0.0])
_GROUND = [0, 2]
_FEET = [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]
_CLEAR = 35.0  # degrees between bodies and an axis, below which it is certain
_TILTED = 25.0  # degrees from +Y that people do not lean
_CERTAIN_ANGLE = np.deg2rad(25.0)  # from the wanted heading
_SUSPICIOUS_ANGLE = np.deg2rad(15.0)
_AGREEING = 0.9  # length of the mean of unit vectors
_STILL = 1e-3  # metres that a pinned pelvis moves
_WALKED = 0.12  # metres that an ankle moves over the ground: no one sits
_CERTAIN_HEIGHT = 0.08  # metres over or under the floor
_SUSPICIOUS_HEIGHT = 0.04  # metres
_FAR = 0.25  # metres between the first pelvis and its place on the ground: certain
_NEAR = 0.10  # metres: not even suspicious
_TURN = np.deg2rad(25.0)  # radians from one frame to the next
_STEP = 6.0  # metres a second
_TIMES = 4.0  # what comes after it


def examine_up_axis(motion_set: MotionSet) -> Finding | None:
    """Find the axis along which bodies stand, from their ankles to their heads."""
    poses = motion_set.poses()
    up = body_up(poses).mean(axis=0)
    length = float(np.linalg.norm(up))
    if length < 0.3:
        return None  # no common direction
    nearest = int(np.abs(up).argmax())
    axis = np.zeros(3)
    axis[nearest] = np.sign(up[nearest])
    angle = float(np.rad2deg(np.arccos(np.clip(up @ axis / length, -1, 1))))
    name = f"{'+' if up[nearest] > 0 else '-'}{'xyz'[nearest]}"
    evidence = f"bodies (ankles to head) point along ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}),"
    evidence += f" {angle:.0f} degrees from {name}"
    if name == "+y":
        if angle < _TILTED:
            return None
        cause = "the world is tilted (gravity was not estimated, or a camera's frame was kept), or people lean or lie"
        leaning = Diagnosis("up-axis", False, evidence, cause, "Turn the world so that gravity points along -y.")
        return Finding((leaning,), motion_set)
    # Handedness shows in the front and the left side together, whichever axis points up.
    mirrored = float(sidedness(poses).mean()) < -0.5
    axes, signs, plain = _exchange(motion_set, axis, mirrored=mirrored)
    if mirrored and not plain:  # two faults: the second is found later
        mirrored = False
        axes, signs, _ = _exchange(motion_set, axis, mirrored=False)
    minus = ["-" if sign < 0 else "" for sign in signs]
    written = f"({', '.join(sign + 'xyz'[old] for sign, old in zip(minus, axes))})"
    code = f"np.stack([{', '.join(f'{sign}joints[..., {old}]' for sign, old in zip(minus, axes))}], axis=-1)"
    cause = f"{name} points up instead of +y"
    if mirrored:
        cause += f", and the world is mirrored as well: axes were exchanged or negated to {written} without a turn"
    remedy = f"Turn the axes, (x, y, z) to {written}: {code}."
    if written == "(x, z, -y)":
        remedy += " prbench.geometry.skeleton.y_up does this."
    elif not mirrored:
        remedy += f" Or prbench.representation.converters.to_y_up(joints, up='{name.lstrip('+')}'), then canonicalise."
    found = Diagnosis("up-axis", angle < _CLEAR, evidence, cause, remedy)
    return Finding((found,), motion_set.changed(lambda motion: motion[..., axes] * np.array(signs, dtype=float)))


def _exchange(motion_set: MotionSet, axis: np.ndarray, *, mirrored: bool) -> tuple[list[int], tuple[int, ...], bool]:
    """Return the exchange of axes that takes ``axis`` to +Y and leaves first poses facing +Z most nearly.

    New axis i is old axis ``axes[i]`` times ``signs[i]``. The last value is True for the usual slips that mirror the
    world: only two axes are exchanged, or one is negated.
    """
    facing = front(motion_set.first_poses()).mean(axis=0)
    fitting = []
    for axes, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        matrix = np.zeros((3, 3))
        matrix[range(3), axes] = signs
        if (matrix @ axis == _UP).all() and bool(np.linalg.det(matrix) < 0) is mirrored:
            moved = sum(old != new for new, old in enumerate(axes))
            plain = (moved, signs.count(-1)) in {(2, 0), (0, 1)}
            # Rounded, so that equally good turns are told apart by being plain and not by noise.
            fitting.append((round(float((matrix @ facing)[2]), 1), plain, signs, list(axes)))
    _, plain, signs, chosen = max(fitting, key=lambda each: each[:3])
    return chosen, signs, plain


def examine_facing(motion_set: MotionSet) -> Finding | None:
    """Compare the headings of first frames with those of the initial poses, or with +Z."""
    wanted = [0.0 if known.initial_joints is None else headings(known.initial_joints) for known in motion_set.expected]
    off = wrapped(headings(motion_set.first_poses()) - np.array(wanted))
    typical = float(np.median(np.abs(off)))
    if typical < _SUSPICIOUS_ANGLE:
        return None
    # Angles are averaged as unit vectors; their mean length tells how well they agree.
    mean = np.exp(1j * off).mean()
    if abs(mean) > _AGREEING:
        degrees = np.rad2deg(np.angle(mean))
        evidence = f"in their first frame bodies face {degrees:+.0f} degrees off +Z (positive towards +X)"
        cause = "motions are turned as a whole, by the axes of another program or a canonical frame of its own"
        off = np.full(len(motion_set), np.angle(mean))
    else:
        evidence = f"first frames face all ways: {np.rad2deg(typical):.0f} degrees off +Z (median), from"
        evidence += f" {np.rad2deg(off.min()):.0f} to {np.rad2deg(off.max()):.0f}"
        cause = "motions are in the frame of their rooms or recordings, and were not put into their canonical frames"
    if len(motion_set) > 1:
        evidence += f" ({len(motion_set)} motions)"
    remedy = "Turn each whole motion until its first frame faces +Z: prbench.representation.canonicalise."
    certain = typical > _CERTAIN_ANGLE and not motion_set.motionless
    undone = [turned(motion, -float(angle)) for motion, angle in zip(motion_set.motions, off, strict=True)]
    return Finding((Diagnosis("facing", certain, evidence, cause, remedy),), motion_set.with_motions(undone))


def examine_root(motion_set: MotionSet) -> Finding | None:
    """Look for a pelvis that stays in one place although limbs move against it."""
    pelvises = []
    feet = []
    at_zero = []
    for motion in motion_set.motions:
        # Relative to the pelvis and its heading, so that rigid movement of the whole body vanishes.
        limbs = turned(motion - motion[:, :1], -headings(motion)[:, None])
        if len(motion) >= 5 and float(np.ptp(limbs, axis=0).max()) > 0.05:
            pelvises.append(float(np.ptp(motion[:, Joint.PELVIS], axis=0)[_GROUND].max()))
            feet.append(float(np.ptp(limbs[:, _FEET][..., _GROUND], axis=0).max()))
            at_zero.append(float(np.abs(motion[:, Joint.PELVIS]).max()) < _STILL)
    if not pelvises:
        return None
    pinned = (np.array(pelvises) < _STILL) & (np.array(feet) > _WALKED)
    if np.mean(at_zero) > 0.5:
        evidence = f"the pelvis is at (0, 0, 0) in every frame of {motion_set.in_words(sum(at_zero))}"
        cause = "positions are relative to the pelvis; its path was not added"
        remedy = "Add the pelvis's path to all joints: joints + pelvis[:, None]."
    elif pinned.mean() > 0.5:
        evidence = f"the pelvis stays over one point (within {np.array(pelvises)[pinned].max() * 1000:.2g} mm) in"
        evidence += f" {motion_set.in_words(int(pinned.sum()))}, while ankles move up to"
        evidence += f" {np.array(feet)[pinned].max():.2f} m"
        cause = "the path over the ground was left out, or every frame was put into a canonical frame of its own"
        remedy = "Add up the root's velocities (prbench.representation.decode does it for the 263 features), and turn"
        remedy += " whole motions by the heading of their first frame: prbench.representation.canonicalise."
    else:
        return None
    on_the_floor = motion_set.changed(lambda motion: motion - motion[..., 1].min() * _UP)
    found = Diagnosis("root", True, evidence, cause, remedy)
    return Finding((found,), dataclasses.replace(on_the_floor, pinned=True))


def examine_floor(motion_set: MotionSet) -> Finding | None:
    """Look at the lowest joint of each motion: 0 in the canonical frame."""
    typical = float(np.median(np.array([motion[..., 1].min() for motion in motion_set.motions])))
    if motion_set.pinned or abs(typical) < _SUSPICIOUS_HEIGHT:
        return None
    evidence = f"the lowest joint of a motion lies at Y = {typical:+.3f} m (median of {len(motion_set)}), not at 0"
    cause = f"the floor of another frame: bodies {'float over' if typical > 0 else 'sink into'} it"
    if abs(float(np.median(motion_set.first_poses()[:, Joint.PELVIS, 1]))) < 0.03:
        cause = "heights are measured from the pelvis"
    remedy = "Move each whole motion until its lowest joint is at Y = 0: prbench.representation.canonicalise."
    found = Diagnosis("floor", abs(typical) > _CERTAIN_HEIGHT, evidence, cause, remedy)
    return Finding((found,), motion_set.changed(lambda motion: motion - motion[..., 1].min() * _UP))


def examine_position(motion_set: MotionSet) -> Finding | None:
    """Compare where the pelvis begins with the initial pose, or with the origin."""
    off = motion_set.first_poses()[:, Joint.PELVIS] * (1, 0, 1)
    for row, known in enumerate(motion_set.expected):
        if known.initial_joints is not None:
            off[row] -= known.initial_joints[Joint.PELVIS] * (1, 0, 1)
    typical = float(np.median(np.linalg.norm(off, axis=1)))
    if motion_set.pinned or typical < _NEAR:
        return None
    evidence = f"the pelvis begins {typical:.2f} m off the point over the origin (median of {len(motion_set)})"
    cause = "motions are still where they were in their room"
    middle = np.median(off, axis=0)
    if len(motion_set) > 1 and float(np.median(np.linalg.norm(off - middle, axis=1))) < 0.2 * typical:
        evidence += f", always near x = {middle[0]:+.2f}, z = {middle[2]:+.2f}"
        cause += ", all with the same shift"
    remedy = "Move each whole motion until its first pelvis stands over x = z = 0: prbench.representation.canonicalise."
    found = Diagnosis("position", typical > _FAR and not motion_set.motionless, evidence, cause, remedy)
    undone = [motion - shift for motion, shift in zip(motion_set.motions, off, strict=True)]
    return Finding((found,), motion_set.with_motions(undone))


def examine_first_frame(motion_set: MotionSet) -> Finding | None:
    """Look for a turn or a leap of the whole body between frames 0 and 1 that does not go on."""
    long = [row for row, motion in enumerate(motion_set.motions) if len(motion) > 3]
    if not long:
        return None
    turns = np.array([wrapped(np.diff(headings(motion_set.motions[row][:3]))) for row in long])
    pelvis = np.stack([motion_set.motions[row][:3, Joint.PELVIS] for row in long])
    steps = np.linalg.norm(np.diff(pelvis, axis=1), axis=-1)
    # A fast turn goes on in the next frame; a torn first frame does not.
    turning = (np.abs(turns[:, 0]) > _TURN) & (np.abs(turns[:, 0]) > _TIMES * np.abs(turns[:, 1]))
    leaping = (steps[:, 0] * motion_set.fps > _STEP) & (steps[:, 0] > _TIMES * steps[:, 1])
    broken = turning | leaping
    if broken.mean() <= 0.5:
        return None
    by = np.rad2deg(np.median(np.abs(turns[broken, 0])))
    evidence = f"from frame 0 to frame 1 the body of {motion_set.in_words(int(broken.sum()))} turns by {by:.0f}"
    evidence += f" degrees and leaps by {np.median(steps[broken, 0]):.2f} m (medians), and not in the frame after"
    cause = "only the first frame is canonical: the initial pose was put before motions that live in another frame"
    remedy = "Give all frames the transform of the first (prbench.representation.canonicalise moves whole motions)."
    kind = "facing" if turning.mean() >= leaping.mean() / 2 else "position"
    # The frames after the first are moved rigidly, so that they go on from it.
    motions = list(motion_set.motions)
    for place in np.flatnonzero(broken):
        first, *_ = motion = motions[long[place]]
        rest = turned(motion[1:], float(turns[place, 1] - turns[place, 0]))
        path = rest[:, Joint.PELVIS]
        rest += first[Joint.PELVIS] + (path[1] - path[0]) - path[0]
        motions[long[place]] = np.concatenate([motion[:1], rest])
    return Finding((Diagnosis(kind, True, evidence, cause, remedy),), motion_set.with_motions(motions))


def headings(poses: np.ndarray) -> np.ndarray:
    """Return the heading of each pose, as ``skeleton.facing_yaw`` defines it; (…, 22, 3) to (…)."""
    right = poses[..., Joint.RIGHT_HIP, :] + poses[..., Joint.RIGHT_SHOULDER, :]
    across = right - poses[..., Joint.LEFT_HIP, :] - poses[..., Joint.LEFT_SHOULDER, :]
    return np.asarray(np.arctan2(across[..., 2], -across[..., 0]))


def wrapped(angles: np.ndarray) -> np.ndarray:
    """Wrap angles to [-pi, pi)."""
    return np.mod(np.asarray(angles) + np.pi, 2 * np.pi) - np.pi


def turned(points: np.ndarray, yaw: float | np.ndarray) -> np.ndarray:
    """Turn points (…, 3) about +Y by radians; +Z goes towards +X."""
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)
