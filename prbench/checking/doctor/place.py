"""Finds motions in another frame: another axis up, another heading, off the floor or the origin, or torn apart."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from prbench.checking.doctor.motion_set import (
    Diagnosis,
    Finding,
    MotionSet,
    body_up,
    front,
    left_of_hips,
    no_finding,
    sidedness,
)
from prbench.geometry.skeleton import Joint

_NAMES = "xyz"
_UP = np.array([0.0, 1.0, 0.0])
_CLEAR = 35.0  # degrees between bodies and an axis, below which it is certain
_TILTED = 25.0  # degrees from +Y that people do not lean


@dataclass(frozen=True)
class _Exchange:
    """New axis i is old axis ``axes[i]`` times ``signs[i]``."""

    axes: tuple[int, int, int]
    signs: tuple[int, int, int]

    @property
    def mirrors(self) -> bool:
        """True if it turns a right-handed world into a left-handed one."""
        return bool(np.linalg.det(self.matrix) < 0)

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3); new = matrix @ old."""
        matrix = np.zeros((3, 3))
        matrix[range(3), self.axes] = self.signs
        return matrix

    @property
    def plain(self) -> bool:
        """True if only two axes are exchanged, or one is negated: the usual slips that mirror the world."""
        moved = sum(axis != place for place, axis in enumerate(self.axes))
        negated = sum(sign < 0 for sign in self.signs)
        return (moved, negated) in {(2, 0), (0, 1)}

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points (…, 3) with exchanged axes, without rounding."""
        return points[..., list(self.axes)] * np.array(self.signs, dtype=points.dtype)

    def __str__(self) -> str:
        return f"({', '.join(('-' if sign < 0 else '') + _NAMES[axis] for axis, sign in zip(self.axes, self.signs))})"

    def as_code(self) -> str:
        """An expression for the new joints."""
        parts = (f"{'-' if sign < 0 else ''}joints[..., {axis}]" for axis, sign in zip(self.axes, self.signs))
        return f"np.stack([{', '.join(parts)}], axis=-1)"


def examine_up_axis(motion_set: MotionSet) -> Finding:
    """Find the axis along which bodies stand, from their ankles to their heads."""
    poses = motion_set.poses()
    up = body_up(poses).mean(axis=0)
    name, axis, angle = _nearest_axis(up)
    evidence = (
        f"bodies (ankles to head) point along ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}), {angle:.0f} degrees from {name}"
    )
    if np.linalg.norm(up) < 0.3:
        return no_finding(motion_set)  # no common direction
    if name == "+y":
        return no_finding(motion_set) if angle < _TILTED else Finding((_leaning(evidence),), motion_set)
    # Handedness shows in the front and the left side together, whichever axis points up.
    mirrored = float(sidedness(poses, left_of_hips(poses)).mean()) < -0.5
    exchange = _best(motion_set, axis, mirrored=mirrored)
    if mirrored and not exchange.plain:  # two faults: the second is found later
        mirrored = False
        exchange = _best(motion_set, axis, mirrored=False)
    cause = f"{name} points up instead of +y"
    if mirrored:
        cause += f", and the world is mirrored as well: axes were exchanged or negated to {exchange} without a turn"
    remedy = f"Turn the axes, (x, y, z) to {exchange}: {exchange.as_code()}."
    if str(exchange) == "(x, z, -y)":
        remedy += " prbench.geometry.skeleton.y_up does this."
    elif not mirrored:
        remedy += f" Or prbench.representation.converters.to_y_up(joints, up='{name.lstrip('+')}'), then canonicalise."
    found = Diagnosis("up-axis", angle < _CLEAR, evidence, cause, remedy)
    return Finding((found,), motion_set.changed(exchange))


def _best(motion_set: MotionSet, axis: np.ndarray, *, mirrored: bool) -> _Exchange:
    """Return the exchange that takes ``axis`` to +Y and leaves first poses facing +Z most nearly."""
    facing = front(motion_set.first_poses()).mean(axis=0)
    fitting = [each for each in _EXCHANGES if (each(axis) == _UP).all() and each.mirrors is mirrored]
    # Rounded, so that equally good turns are told apart by being plain and not by noise.
    return max(fitting, key=lambda each: (round(float(each(facing)[2]), 1), each.plain, each.signs))


def _leaning(evidence: str) -> Diagnosis:
    cause = "the world is tilted (gravity was not estimated, or a camera's frame was kept), or people lean or lie"
    return Diagnosis("up-axis", False, evidence, cause, "Turn the world so that gravity points along -y.")


def _nearest_axis(direction: np.ndarray) -> tuple[str, np.ndarray, float]:
    """Name and unit vector of the signed axis next to a direction, and the angle between them in degrees."""
    axis = int(np.abs(direction).argmax())
    sign = 1.0 if direction[axis] >= 0 else -1.0
    vector = np.zeros(3)
    vector[axis] = sign
    cosine = float(direction @ vector / max(float(np.linalg.norm(direction)), 1e-12))
    return f"{'+' if sign > 0 else '-'}{_NAMES[axis]}", vector, float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))


_EXCHANGES = tuple(
    _Exchange((first, second, third), (one, two, three))
    for first, second, third in permutations(range(3))
    for one, two, three in product((1, -1), repeat=3)
)


_CERTAIN_ANGLE = np.deg2rad(25.0)  # from the wanted heading
_SUSPICIOUS_ANGLE = np.deg2rad(15.0)
_AGREEING = 0.9  # length of the mean of unit vectors
_STILL = 1e-3  # metres that a pinned pelvis moves
_WALKED = 0.12  # metres that an ankle moves over the ground: no one sits
_SLID = 0.02  # metres that a foot moves under a pinned pelvis
_EXACT = np.deg2rad(0.05)  # nobody keeps a heading like this
_FEET = [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]


def examine_facing(motion_set: MotionSet) -> Finding:
    """Compare the headings of first frames with those of the initial poses, or with +Z."""
    off = wrapped(headings(motion_set.first_poses()) - _wanted_headings(motion_set))
    typical = float(np.median(np.abs(off)))
    if typical < _SUSPICIOUS_ANGLE:
        return no_finding(motion_set)
    # Angles are averaged as unit vectors; their mean length tells how well they agree.
    mean = np.exp(1j * off).mean()
    common = abs(mean) > _AGREEING
    certain = bool(typical > _CERTAIN_ANGLE) and not motion_set.motionless
    degrees = np.rad2deg(np.angle(mean)) if common else np.rad2deg(typical)
    if common:
        evidence = f"in their first frame bodies face {degrees:+.0f} degrees off +Z (positive towards +X)"
        cause = "motions are turned as a whole, by the axes of another program or a canonical frame of its own"
        undone = motion_set.changed(lambda motion: turned(motion, -float(np.angle(mean))))
    else:
        lowest = np.rad2deg(off.min())
        highest = np.rad2deg(off.max())
        evidence = (
            f"first frames face all ways: {degrees:.0f} degrees off +Z (median), from {lowest:.0f} to {highest:.0f}"
        )
        cause = "motions are in the frame of their rooms or recordings, and were not put into their canonical frames"
        undone = motion_set.with_motions(
            [turned(motion, -float(angle)) for motion, angle in zip(motion_set.motions, off, strict=True)]
        )
    if len(motion_set) > 1:
        evidence += f" ({len(motion_set)} motions)"
    remedy = "Turn each whole motion until its first frame faces +Z: prbench.representation.canonicalise."
    return Finding((Diagnosis("facing", certain, evidence, cause, remedy),), undone)


def _wanted_headings(motion_set: MotionSet) -> np.ndarray:
    return np.array(
        [
            0.0 if known.initial_joints is None else float(headings(known.initial_joints))
            for known in motion_set.expected
        ]
    )


def examine_root(motion_set: MotionSet) -> Finding:
    """Look for a pelvis that stays in one place and for a heading that never changes."""
    moving = [row for row, motion in enumerate(motion_set.motions) if _moves(motion)]
    if not moving:
        return no_finding(motion_set)
    diagnoses = [each for each in (_pinned(motion_set, moving), _one_heading(motion_set, moving)) if each is not None]
    if not any(each.kind == "root" for each in diagnoses):
        return Finding(tuple(diagnoses), motion_set)
    return Finding(tuple(diagnoses), dataclasses.replace(_on_the_floor(motion_set), pinned=True))


def _moves(motion: np.ndarray) -> bool:
    """Return True if limbs move against the pelvis."""
    if len(motion) < 5:
        return False
    return float(np.ptp(_seen_by_the_body(motion), axis=0).max()) > 0.05


def _pinned(motion_set: MotionSet, moving: list[int]) -> Diagnosis | None:
    motions = [motion_set.motions[row] for row in moving]
    ranges = np.array([np.ptp(motion[:, Joint.PELVIS], axis=0) for motion in motions])
    at_zero = np.array([np.abs(motion[:, Joint.PELVIS]).max() < _STILL for motion in motions])
    if at_zero.mean() > 0.5:
        evidence = f"the pelvis is at (0, 0, 0) in every frame of {motion_set.in_words(int(at_zero.sum()))}"
        remedy = "Add the pelvis's path to all joints: joints + pelvis[:, None]."
        return Diagnosis("root", True, evidence, "positions are relative to the pelvis; its path was not added", remedy)
    feet = np.array([np.ptp(_seen_by_the_body(motion)[:, _FEET][..., [0, 2]], axis=0).max() for motion in motions])
    pinned = (ranges[:, [0, 2]].max(axis=1) < _STILL) & (feet > _WALKED)
    if pinned.mean() <= 0.5:
        return None
    evidence = (
        f"the pelvis stays over one point (within {ranges[pinned][:, [0, 2]].max() * 1000:.2g} mm) in"
        f" {motion_set.in_words(int(pinned.sum()))}, while ankles move up to {feet[pinned].max():.2f} m"
    )
    cause = "the path over the ground was left out, as in the position features of HumanML3D"
    remedy = "Add up the root's velocities: prbench.representation.decode does it for the 263 features."
    return Diagnosis("root", True, evidence, cause, remedy)


def _one_heading(motion_set: MotionSet, moving: list[int]) -> Diagnosis | None:
    motions = [motion_set.motions[row] for row in moving]
    spreads = np.array([np.ptp(wrapped(angles - angles[0])) for angles in map(headings, motions)])
    same = spreads < _EXACT
    if same.mean() <= 0.5:
        return None
    evidence = (
        f"bodies of {motion_set.in_words(int(same.sum()))} keep their heading to {np.rad2deg(spreads[same].max()):.1g}"
        " degrees in all frames, while their limbs move"
    )
    remedy = "Turn whole motions by the heading of their first frame: prbench.representation.canonicalise."
    own_frames = "every frame was put into a canonical frame of its own; only the first frame decides"
    centred = same & np.array([_stays_over_the_origin(motion) for motion in motions])
    if centred.mean() > 0.5:
        evidence += f"; pelvises of {int(centred.sum())} stay over the origin, while their feet move"
        return Diagnosis("heading", True, evidence, own_frames, remedy)
    cause = f"the method never turns a body, which is allowed, or {own_frames}"
    return Diagnosis("heading", False, evidence, cause, f"If it was made so, nothing. Otherwise: {remedy}")


def _stays_over_the_origin(motion: np.ndarray) -> bool:
    """Return True if the pelvis is pinned there while feet slide; in a mere reach feet stand still."""
    ground = motion[..., [0, 2]]
    feet = float(np.ptp(ground[:, _FEET], axis=0).max())
    return float(np.abs(ground[:, Joint.PELVIS]).max()) < _STILL and feet > _SLID


def _seen_by_the_body(motion: np.ndarray) -> np.ndarray:
    """Return joints relative to the pelvis and its heading, so that rigid movement of the whole body vanishes."""
    return turned(motion - motion[:, :1], -headings(motion)[:, None])


def _on_the_floor(motion_set: MotionSet) -> MotionSet:
    lift = np.array([0.0, 1.0, 0.0])
    return motion_set.changed(lambda motion: motion - motion[..., 1].min() * lift)


def headings(poses: np.ndarray) -> np.ndarray:
    """Return the heading of each pose, as ``skeleton.facing_yaw`` defines it; (…, 22, 3) to (…)."""
    across = (
        poses[..., Joint.RIGHT_HIP, :]
        - poses[..., Joint.LEFT_HIP, :]
        + poses[..., Joint.RIGHT_SHOULDER, :]
        - poses[..., Joint.LEFT_SHOULDER, :]
    )
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


_CERTAIN = 0.08  # metres over or under the floor
_SUSPICIOUS = 0.04  # metres
_STRONG_DRIFT = 0.30  # metres over a motion, for which few motions suffice
_DRIFT = 0.12  # metres over a motion that are certain in several motions
_SLIGHT_DRIFT = 0.07  # metres over a motion that count at all
_STRAIGHT = 0.7  # share of the change that a straight line explains
_SHORTEST = 1.0  # seconds
_ENOUGH = 3  # motions that drift alike; a single person may climb a step
_FAR = 0.25  # metres between the first pelvis and its place on the ground: certain
_NEAR = 0.10  # metres: not even suspicious
_GROUND = [0, 2]
_TURN = np.deg2rad(25.0)  # radians from one frame to the next
_STEP = 6.0  # metres a second
_TIMES = 4.0  # what comes after it


@dataclass(frozen=True)
class _Drift:
    """Change of the lowest height in one motion."""

    rise: float
    """Metres from the first to the last frame."""
    straightness: float
    """Share of the variance that the line explains."""


def examine_floor(motion_set: MotionSet) -> Finding:
    """Look at the lowest joint: 0 in the canonical frame, and never far from it where feet stand."""
    if motion_set.pinned:
        return no_finding(motion_set)
    drift = _examine_drift(motion_set)
    constant = _examine_height(drift.motion_set)
    return Finding((*drift.diagnoses, *constant.diagnoses), constant.motion_set)


def _examine_height(motion_set: MotionSet) -> Finding:
    lowest = np.array([motion[..., 1].min() for motion in motion_set.motions])
    typical = float(np.median(lowest))
    if abs(typical) < _SUSPICIOUS:
        return no_finding(motion_set)
    pelvis = float(np.median(motion_set.first_poses()[:, Joint.PELVIS, 1]))
    evidence = f"the lowest joint of a motion lies at Y = {typical:+.3f} m (median of {len(motion_set)}), not at 0"
    if abs(pelvis) < 0.03:
        cause = "heights are measured from the pelvis"
    else:
        cause = f"the floor of another frame: bodies {'float over' if typical > 0 else 'sink into'} it"
    remedy = "Move each whole motion until its lowest joint is at Y = 0: prbench.representation.canonicalise."
    found = Diagnosis("floor", abs(typical) > _CERTAIN, evidence, cause, remedy)
    undone = [motion - low * _UP for motion, low in zip(motion_set.motions, lowest, strict=True)]
    return Finding((found,), motion_set.with_motions(undone))


def _examine_drift(motion_set: MotionSet) -> Finding:
    rows = [row for row, motion in enumerate(motion_set.motions) if len(motion) >= _SHORTEST * motion_set.fps]
    drifts = {row: _drift(motion_set.motions[row], motion_set.fps) for row in rows}
    strong = [row for row in rows if abs(drifts[row].rise) > _SLIGHT_DRIFT and drifts[row].straightness > _STRAIGHT]
    if not rows or len(strong) <= len(rows) / 2:
        return no_finding(motion_set)
    rises = np.array([drifts[row].rise for row in strong])
    typical = float(np.median(np.abs(rises)))
    evidence = (
        f"the lowest joint {'rises' if np.median(rises) > 0 else 'sinks'} by {typical:.2f} m from the first to the last"
        f" frame of {len(strong)} of {len(rows)} motions, along a straight line"
    )
    cause = "height is added up from velocities and drifts, or the ground of the source is tilted"
    remedy = "Take the height itself instead of adding up its changes (column 3 of the 263 features is the height)."
    certain = typical > (_DRIFT if len(strong) >= _ENOUGH else _STRONG_DRIFT)
    found = Diagnosis("floor", certain, evidence, cause, remedy)
    undone = [
        _levelled(motion, drifts[row]) if row in strong else motion for row, motion in enumerate(motion_set.motions)
    ]
    return Finding((found,), motion_set.with_motions(undone))


def _drift(motion: np.ndarray, fps: float) -> _Drift:
    reach = max(1, round(0.25 * fps))  # frames on each side: a swinging foot does not count
    lowest = np.pad(motion[..., 1].min(axis=1), reach, mode="edge")
    # The lowest height within half a second: one foot or the other stands in it.
    support = np.lib.stride_tricks.sliding_window_view(lowest, 2 * reach + 1).min(axis=1)
    time = np.linspace(0.0, 1.0, len(motion))
    slope, _ = np.polyfit(time, support, 1)
    correlation = np.corrcoef(time, support)[0, 1] if np.ptp(support) > 1e-6 else 0.0
    return _Drift(float(slope), float(correlation**2))


def _levelled(motion: np.ndarray, drift: _Drift) -> np.ndarray:
    """Remove the drift and put the motion on the floor."""
    level = motion - np.linspace(0.0, drift.rise, len(motion))[:, None, None] * _UP
    return level - level[..., 1].min() * _UP


def examine_position(motion_set: MotionSet) -> Finding:
    """Compare where the pelvis begins with the initial pose, or with the origin."""
    if motion_set.pinned:
        return no_finding(motion_set)
    off = motion_set.first_poses()[:, Joint.PELVIS][:, _GROUND] - np.array(
        [
            np.zeros(2) if known.initial_joints is None else known.initial_joints[Joint.PELVIS][_GROUND]
            for known in motion_set.expected
        ]
    )
    distance = np.linalg.norm(off, axis=1)
    typical = float(np.median(distance))
    if typical < _NEAR:
        return no_finding(motion_set)
    middle = np.median(off, axis=0)
    common = float(np.median(np.linalg.norm(off - middle, axis=1))) < 0.2 * typical
    evidence = f"the pelvis begins {typical:.2f} m off the point over the origin (median of {len(motion_set)})"
    if common and len(motion_set) > 1:
        evidence += f", always near x = {middle[0]:+.2f}, z = {middle[1]:+.2f}"
    cause = "motions are still where they were in their room" + (
        ", all with the same shift" if common and len(motion_set) > 1 else ""
    )
    remedy = "Move each whole motion until its first pelvis stands over x = z = 0: prbench.representation.canonicalise."
    certain = typical > _FAR and not motion_set.motionless
    shifts = [np.array([x, 0.0, z]) for x, z in off]
    undone = [motion - shift for motion, shift in zip(motion_set.motions, shifts, strict=True)]
    return Finding((Diagnosis("position", certain, evidence, cause, remedy),), motion_set.with_motions(undone))


def examine_first_frame(motion_set: MotionSet) -> Finding:
    """Look for a turn or a leap of the whole body between frames 0 and 1 that does not go on."""
    long = [row for row, motion in enumerate(motion_set.motions) if len(motion) > 3]
    if not long:
        return no_finding(motion_set)
    turns = np.array([wrapped(np.diff(headings(motion_set.motions[row][:3]))) for row in long])
    pelvis = [motion_set.motions[row][:3, Joint.PELVIS] for row in long]
    steps = np.array([np.linalg.norm(np.diff(path, axis=0), axis=1) for path in pelvis]) * motion_set.fps
    # A fast turn goes on in the next frame; a torn first frame does not.
    turning = (np.abs(turns[:, 0]) > _TURN) & (np.abs(turns[:, 0]) > _TIMES * np.abs(turns[:, 1]))
    leaping = (steps[:, 0] > _STEP) & (steps[:, 0] > _TIMES * steps[:, 1])
    broken = turning | leaping
    if broken.mean() <= 0.5:
        return no_finding(motion_set)
    kind = "facing" if turning.mean() >= leaping.mean() / 2 else "position"
    metres = np.median(steps[broken, 0]) / motion_set.fps
    degrees = np.rad2deg(np.median(np.abs(turns[broken, 0])))
    evidence = (
        f"from frame 0 to frame 1 the body of {motion_set.in_words(int(broken.sum()))} turns by {degrees:.0f} degrees"
        f" and leaps by {metres:.2f} m (medians), and not in the frame after"
    )
    cause = "only the first frame is canonical: the initial pose was put before motions that live in another frame"
    remedy = "Give all frames the transform of the first (prbench.representation.canonicalise moves whole motions)."
    found = Diagnosis(kind, True, evidence, cause, remedy)
    joined = {row: _joined(motion_set.motions[row]) for row, is_broken in zip(long, broken, strict=True) if is_broken}
    return Finding(
        (found,), motion_set.with_motions([joined.get(row, motion) for row, motion in enumerate(motion_set.motions)])
    )


def _joined(motion: np.ndarray) -> np.ndarray:
    """Move the frames after the first rigidly, so that they go on from it."""
    turns = wrapped(np.diff(headings(motion[:3])))
    rest = turned(motion[1:], float(turns[1] - turns[0]))
    path = rest[:, Joint.PELVIS]
    rest += motion[0, Joint.PELVIS] + (path[1] - path[0]) - path[0]
    return np.concatenate([motion[:1], rest])
