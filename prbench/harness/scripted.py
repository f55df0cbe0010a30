"""Controls that move by formula: ``scripted``, with constant timing, the cheats, and recordings that were changed.

Every sequence starts 2 s before its prime, so a motion that faces the goal at 2.0 s without looking at anything else
is a fair opponent. It knows the first pose, the goal and the head tilt, whatever the condition is, and does always the
same. ``scripted`` is one :class:`Body`:

1. Until 2.0 s the rigid body of the first frame turns about its pelvis until the head-forward ray points at the goal,
   and the head nods on the neck to the goal's height. Both follow a minimum-jerk curve over the second before, so the
   turn slows down as it arrives.
2. From 2.0 s to the last frame the body glides in a straight line until it stands 0.45 m before the goal (not at all
   if it already stands nearer), and over the same time the wrist that was nearer in the first frame moves to the goal.
   The elbow keeps both bones' lengths where the goal is within the arm's length of the shoulder; where it is not, the
   arm stretches, which bone_length_change shows.

The feet never step. Sequences that end less than half a second after 2.0 s begin the second part earlier.

The cheats earn scores without doing what the scores are meant to reward; ``docs/audit.md`` tells what they show. All
but ``teleport`` are other parameters of the same body, and ``prbench audit --search`` looks for better ones. They are
controls, so that anybody can see what a metric is worth on a table, and are never ranked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import CHAINS, Joint, head_forward
from prbench.metrics import MotionBatch
from prbench.synthetic.people.kinematics import bump, turn

_STAND_OFF = 0.45  # m between pelvis and goal on the ground: about an arm's length with a bent elbow
_STEEPEST_LOOK = np.deg2rad(75.0)  # above or below the horizon
_ARRIVAL = 2.0  # s, the lead of every sequence before its prime time (docs/specification/curation.md#clip)
_SHORTEST_REACH = 0.5  # s
_TREMOR_PERIOD = 3  # frames; with a period of two the turning speed would be the same in every frame
_TURN_RADIUS = 0.35  # m; a turn on the spot takes as many steps as a walk around such a circle
_SHORTEST_STEP = 0.1  # m
_DEEPEST = 0.45  # of the pelvis's height
_LEAN_PER_METRE = 1.8  # radians; about what lowers the shoulders by a metre
_FARTHEST_LEAN = 1.6  # radians
# Left and right: shoulder, elbow and wrist; hip, knee, ankle and toe.
_ARMS = (CHAINS[4][2:], CHAINS[3][2:])
_LEGS = (CHAINS[1][1:], CHAINS[0][1:])
_FEET = [leg[2:] for leg in _LEGS]
_UPPER = [joint for joint in Joint if joint not in {Joint.PELVIS, *_LEGS[0], *_LEGS[1]}]

_Joints = Float[np.ndarray, "batch frames 22 3"]


@dataclass(frozen=True)
class ScriptedStart:
    """The knowledge of the constant-timing control about B sequences; canonical frame, metres."""

    initial_joints: Float[np.ndarray, "batch 22 3"]
    goal_location: Float[np.ndarray, "batch 3"]
    head_tilt_deg: Float[np.ndarray, " batch"]


def _usually(value: float, lowest: float, highest: float) -> float:
    """Declare a parameter: its value in ``scripted``, and the lowest and highest one that a search tries."""
    return field(default=value, metadata={"range": (lowest, highest)})


@dataclass(frozen=True)
class Body:
    """What a body does; lengths in metres, times in seconds, angles in degrees.

    Attributes:
        turn_end: Moment at which it faces the goal; before 0 for one that faces it in frame 0.
        turn_time: Duration of the turn.
        nod: Nod off the goal and back, upwards positive.
        nod_end: Moment at which it is back.
        nod_time: Duration of the nod.
        tremor: Way of the head, further forward in every third frame.
        twist: Share of the turn that trunk and head make on the hips.
        go: Moment at which it leaves, half a second before the end at the latest.
        settle: Time at the end for which it stands with the hand on the goal.
        stop: Distance from pelvis to goal over the ground at which it stops.
        reach: Share of the hand's way to the goal that it makes.
        stretch: Share by which a limb may grow for what lies beyond its reach.
        rise: Way by which the whole body rises.
        ankle: Height of the ankles above the floor; 0 for that of the first pose.
        toe: Height of the toes; 0 for that of the first pose.
        rise_time: Time after which it has risen.
        step: Length of a step; below 0.1 the body glides.
        lift: Height of a step.
        swing: Share of a step's duration in which the foot moves.
        crouch: Share of the height between shoulders and goal by which the pelvis sinks.
        lean: Share of the rest of that height for which the trunk bends.
        size: Factor of the whole body from frame 0 on.
        arm: Factor of both arms from frame 0 on.
    """

    turn_end: float = _usually(_ARRIVAL, -1.0, 2.9)
    turn_time: float = _usually(1.0, 0.05, 2.0)
    nod: float = _usually(0.0, -60.0, 60.0)
    nod_end: float = _usually(_ARRIVAL, 0.3, 2.9)
    nod_time: float = _usually(0.5, 0.1, 1.0)
    tremor: float = _usually(0.0, 0.0, 0.002)
    twist: float = _usually(0.0, 0.0, 1.0)
    go: float = _usually(_ARRIVAL, 0.0, 2.5)
    settle: float = _usually(0.0, 0.0, 0.6)
    stop: float = _usually(_STAND_OFF, 0.15, 3.0)
    reach: float = _usually(1.0, 0.0, 1.0)
    stretch: float = _usually(np.inf, 0.0, 1.0)
    rise: float = _usually(0.0, -0.05, 0.12)
    ankle: float = _usually(0.0, 0.0, 0.2)
    toe: float = _usually(0.0, 0.0, 0.2)
    rise_time: float = _usually(0.5, 0.1, 2.0)
    step: float = _usually(0.0, 0.0, 0.9)
    lift: float = _usually(0.05, 0.0, 0.15)
    swing: float = _usually(0.8, 0.4, 1.0)
    crouch: float = _usually(0.0, 0.0, 1.0)
    lean: float = _usually(0.0, 0.0, 1.0)
    size: float = _usually(1.0, 0.2, 1.3)
    arm: float = _usually(1.0, 0.7, 3.0)


@dataclass(frozen=True)
class Altered:
    """What is done to a recording that is handed in as a method's.

    Attributes:
        sway: Metres by which the whole body sways sideways.
        period: Seconds of that sway.
    """

    sway: float = _usually(0.0, 0.0, 0.10)
    period: float = _usually(2.0, 0.3, 8.0)


def ranges_of(family: type[Body | Altered]) -> dict[str, tuple[float, float]]:
    """Map each parameter to the lowest and highest value that a search tries."""
    return {each.name: each.metadata["range"] for each in fields(family)}


def minimum_jerk(phase: np.ndarray) -> np.ndarray:
    """0 to 1 with speed and acceleration zero at both ends."""
    x = np.clip(phase, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def yaw_to_goal(joints: np.ndarray, goal: np.ndarray, head_tilt_deg: np.ndarray) -> np.ndarray:
    """Turn about the vertical through the pelvis after which the head-forward ray passes over or under the goal.

    The head is not above the pelvis: with l its offset to the side of the ray and r the goal's distance from the
    pelvis, the ray meets the goal when the goal stands asin(l / r) beside the forward direction.
    """
    forward, _ = head_forward(joints, head_tilt_deg)
    head = joints[:, Joint.HEAD] - joints[:, Joint.PELVIS]
    to_goal = goal - joints[:, Joint.PELVIS]
    distance = np.maximum(np.hypot(to_goal[:, 0], to_goal[:, 2]), 1e-6)
    heading = np.arctan2(forward[:, 0], forward[:, 2])
    # component of the head's offset along the direction at +90 degrees of yaw from forward
    beside = head[:, 0] * np.cos(heading) - head[:, 2] * np.sin(heading)
    yaw = np.arctan2(to_goal[:, 0], to_goal[:, 2]) - heading - np.arcsin(np.clip(beside / distance, -1.0, 1.0))
    return (yaw + np.pi) % (2 * np.pi) - np.pi


def nod_to_goal(joints: np.ndarray, goal: np.ndarray, head_tilt_deg: np.ndarray) -> np.ndarray:
    """Pitch of the head on the neck, upwards positive, that lifts the head-forward ray to the goal's height."""
    forward, _ = head_forward(joints, head_tilt_deg)
    elevation = np.arcsin(np.clip(forward[:, 1], -1.0, 1.0))
    nod = np.zeros(len(joints))
    for _ in range(3):  # the head moves a little as it nods
        to_goal = goal - nodded(joints[:, None], nod[:, None])[:, 0, Joint.HEAD]
        wanted = np.arctan2(to_goal[:, 1], np.hypot(to_goal[:, 0], to_goal[:, 2]))
        nod = np.clip(wanted, -_STEEPEST_LOOK, _STEEPEST_LOOK) - elevation
    return nod


def about_pelvis(joints: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Joints (batch, 1, 22, 3) turned by yaw (batch, frames) about the vertical through the pelvis."""
    pelvis = joints[:, :, :1]
    return turn(yaw[..., None], 0.0, joints - pelvis) + pelvis


def nodded(joints: np.ndarray, nod: np.ndarray) -> np.ndarray:
    """Joints (batch, frames, 22, 3) with the head turned about the neck's shoulder axis, upwards positive."""
    neck = joints[..., Joint.NECK, :]
    bone = joints[..., Joint.HEAD, :] - neck
    left = joints[..., Joint.LEFT_SHOULDER, :] - joints[..., Joint.RIGHT_SHOULDER, :]
    squared = np.maximum((bone * bone).sum(axis=-1, keepdims=True), 1e-12)
    left = left - (left * bone).sum(axis=-1, keepdims=True) / squared * bone
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
    angle = -nod[..., None]  # a positive turn about the left axis looks down
    nodded = joints.copy()
    nodded[..., Joint.HEAD, :] = neck + bone * np.cos(angle) + np.cross(left, bone) * np.sin(angle)
    return nodded


def glide(joints: np.ndarray, goal: np.ndarray, stop: float) -> np.ndarray:
    """Horizontal way of the body, (batch, 3), which ends ``stop`` metres before the goal."""
    to_goal = goal - joints[:, Joint.PELVIS]
    # Over the ground only: the body keeps its height above the floor.
    to_goal[:, 1] = 0.0
    distance = np.linalg.norm(to_goal, axis=1, keepdims=True)
    return to_goal * np.clip(1 - stop / np.maximum(distance, 1e-9), 0.0, None)


def body_joints(start: ScriptedStart, n_frames: Int[np.ndarray, " batch"], fps: float, body: Body) -> _Joints:
    """Make the motion of each sequence.

    Args:
        start: First pose, goal and tilt of the head of each sequence, canonical frame, metres.
        n_frames: Frames of each sequence.
        fps: Frame rate, in frames per second.
        body: What it does.

    Returns:
        Joints, canonical frame, metres; frames beyond a sequence's own continue its end.
    """
    initial = _sized(start.initial_joints.astype(np.float64), body)
    pelvis = initial[:, Joint.PELVIS]
    time = np.arange(int(n_frames.max())) / fps
    risen = minimum_jerk(time / body.rise_time)[:, None]
    # The goal is given to the formula lower, so that the risen hand and eyes meet the true one.
    goal = start.goal_location.astype(np.float64) - [0.0, body.rise, 0.0]
    # The turn ends at the arrival, so the ray is on the goal from then on.
    turned = minimum_jerk((time - (body.turn_end - body.turn_time)) / body.turn_time)
    turned = np.broadcast_to(turned, (len(n_frames), len(time)))
    end = ((n_frames - 1) / fps)[:, None] - body.settle
    begin = np.clip(end - _SHORTEST_REACH, 0.0, body.go)
    gone = minimum_jerk((time - begin) / np.maximum(end - begin, 1 / fps))
    way = glide(initial, goal, body.stop)
    shoulders = initial[:, [_ARMS[0][0], _ARMS[1][0]], 1].mean(axis=1)
    crouch = np.minimum(body.crouch * np.maximum(shoulders - goal[:, 1], 0.0), _DEEPEST * pelvis[:, 1])
    lean = body.lean * (shoulders - goal[:, 1] - crouch) * _LEAN_PER_METRE

    # The hips make their share of the turn, the trunk the rest, and it bends forwards over them.
    yaw = yaw_to_goal(initial, goal, start.head_tilt_deg)
    hips = ((1.0 - body.twist) * yaw)[:, None] * turned
    joints = turn(hips[..., None], 0.0, (initial - pelvis[:, None])[:, None])
    upper = turn(((yaw[:, None] * turned) - hips)[..., None], 0.0, (initial[:, _UPPER] - pelvis[:, None])[:, None])
    bent = np.clip(lean, 0.0, _FARTHEST_LEAN)[:, None] * gone
    joints[:, :, _UPPER] = turn(hips[..., None], bent[..., None], upper)
    joints = joints + pelvis[:, None, None]

    # The look to the goal, and the nod off it and back.
    facing = about_pelvis(initial[:, None], yaw[:, None])[:, 0]
    nod = nod_to_goal(facing, goal, start.head_tilt_deg)[:, None] * turned
    nod_off = bump((time - body.nod_end) / body.nod_time + 1.0)
    joints = nodded(joints, nod + np.deg2rad(body.nod) * nod_off)
    if body.tremor:
        # Across both bone and shoulders, so that the ray nods; a head that moves along its bone would not turn it.
        bone = joints[:, :, Joint.HEAD] - joints[:, :, Joint.NECK]
        forward = np.cross(joints[:, :, Joint.LEFT_SHOULDER] - joints[:, :, Joint.RIGHT_SHOULDER], bone)
        forward = forward / np.maximum(np.linalg.norm(forward, axis=-1, keepdims=True), 1e-9)
        joints[:, ::_TREMOR_PERIOD, Joint.HEAD] += body.tremor * forward[:, ::_TREMOR_PERIOD]

    joints = joints + gone[..., None, None] * way[:, None, None]
    if body.step or body.ankle or body.toe or body.crouch:
        joints[..., 1] -= (crouch[:, None] * gone)[..., None]
        _stand(joints, _feet(initial, (1.0 - body.twist) * yaw, way, turned, gone, body), initial, risen, body)
    if body.reach:
        joints = reaching(joints, goal, body.reach * gone, stretch=body.stretch)
    joints[..., 1] += body.rise * risen
    return joints


def _sized(initial: np.ndarray, body: Body) -> np.ndarray:
    """Return the first pose in another size, scaled about the floor under the pelvis, with other arms."""
    if body.size == body.arm == 1.0:
        return initial
    floor = initial[:, :1] * [1.0, 0.0, 1.0]
    sized = (initial - floor) * body.size + floor
    for arm in _ARMS:
        shoulder = sized[:, arm[:1]]
        sized[:, arm] = shoulder + body.arm * (sized[:, arm] - shoulder)
    return sized


def _feet(
    initial: np.ndarray, yaw: np.ndarray, way: np.ndarray, turned: np.ndarray, gone: np.ndarray, body: Body
) -> Float[np.ndarray, "batch frames 2 2 3"]:
    """Return ankle and toe of the left and the right leg: planted and stepping, or gliding with the body.

    Args:
        initial: First pose of each sequence.
        yaw: Turn of the hips, radians.
        way: Way of the body.
        turned: Share of the turn that is done in each frame.
        gone: Share of the way that is done in each frame.
        body: What it does.
    """
    pelvis = initial[:, Joint.PELVIS]
    own = initial[:, _FEET] - pelvis[:, None, None]
    # The turn on the spot and the way after it are one path, which takes steps.
    turning = _TURN_RADIUS * np.abs(yaw)[:, None]
    walking = np.linalg.norm(way, axis=1)[:, None]
    whole = turning + walking
    done = turning * turned + walking * gone

    def placed(path: np.ndarray) -> np.ndarray:
        heading = yaw[:, None] * np.clip(path / np.maximum(turning, 1e-6), 0.0, 1.0)
        share = np.clip((path - turning) / np.maximum(walking, 1e-6), 0.0, 1.0)[..., None]
        base = pelvis[:, None] + way[:, None] * share
        return turn(heading[..., None, None], 0.0, own[:, None]) + base[:, :, None, None]

    if body.step < _SHORTEST_STEP:
        return placed(done)
    steps = np.ceil(whole / body.step)
    # After the last step the other foot is set beside it.
    number = (steps + 1.0) * done / np.maximum(whole, 1e-9)
    index = np.minimum(np.floor(number), steps)
    phase = (number - index - (1.0 - body.swing) / 2) / body.swing
    length = whole / np.maximum(steps, 1.0)
    feet = np.empty((*done.shape, *own.shape[1:]))
    for side in range(2):
        moves = index % 2 == side
        before = np.maximum(index - moves, 0.0)
        after = np.where(moves, np.minimum(index + 1.0, steps), before)
        start = placed(before * length)[:, :, side]
        progress = minimum_jerk(phase)[..., None, None]
        feet[:, :, side] = start + (placed(after * length)[:, :, side] - start) * progress
        feet[:, :, side, :, 1] += np.where(after > before, body.lift * bump(phase), 0.0)[..., None]
    return feet


def _stand(joints: _Joints, feet: np.ndarray, initial: np.ndarray, risen: np.ndarray, body: Body) -> None:
    """Put the legs on the feet, and ankles, toes and body to their heights, by the share ``risen`` in each frame."""
    wanted = np.array([body.ankle, body.toe])
    higher = np.where(wanted > 0.0, wanted - initial[:, _FEET, 1], 0.0)[:, None] * risen[..., None]
    joints[..., 1] += higher[..., 0].max(axis=-1, keepdims=True)
    # The body sinks until both ankles are in reach. Knees bend forwards, and a toe is as far from its ankle as it was.
    feet[..., 1] += higher
    hips = joints[:, :, [leg[0] for leg in _LEGS]]
    bones = [initial[:, leg[1:]] - initial[:, leg[:-1]] for leg in _LEGS]
    lengths = np.linalg.norm(bones, axis=-1)[:, :, None]  # leg, sequence, 1, bone
    away = hips - feet[:, :, :, 0]
    legs = np.moveaxis(lengths[..., :2].sum(axis=-1), 0, -1)
    reach = np.sqrt(np.maximum(legs**2 - away[..., 0] ** 2 - away[..., 2] ** 2, 0.0))
    joints[..., 1] -= np.maximum(away[..., 1] - reach, 0.0).max(axis=-1, keepdims=True)
    forward = np.cross([0.0, 1.0, 0.0], joints[:, :, Joint.RIGHT_HIP] - joints[:, :, Joint.LEFT_HIP])
    for side, (hip, knee, ankle, toe) in enumerate(_LEGS):
        foot = feet[:, :, side, 0]
        bone = feet[:, :, side, 1] - foot
        level = np.maximum(np.hypot(bone[..., 0], bone[..., 2]), 1e-9)
        bone[..., ::2] *= (np.sqrt(np.maximum(lengths[side, ..., 2] ** 2 - bone[..., 1] ** 2, 0.0)) / level)[..., None]
        leg = (joints[:, :, hip], joints[:, :, knee], joints[:, :, ankle])
        joints[:, :, knee], joints[:, :, ankle] = limb(*leg, foot, bias=forward, stretch=body.stretch)
        joints[:, :, toe] = joints[:, :, ankle] + bone


def reaching(body: np.ndarray, goal: np.ndarray, progress: np.ndarray, *, stretch: float = np.inf) -> np.ndarray:
    """Return the body with the wrist of one arm moved to the goal as ``progress`` goes from 0 to 1.

    The arm is the one whose wrist is nearer in the first frame; once the body faces the goal, both are about as near.
    The hand's way is a straight line as seen from the body, so that the arm never lags behind while the body glides.
    """
    nearer = np.argmin([np.linalg.norm(body[:, 0, wrist] - goal, axis=1) for _, _, wrist in _ARMS], axis=0)
    moved = body.copy()
    for side, (shoulder, elbow, wrist) in enumerate(_ARMS):
        rows = np.flatnonzero(nearer == side)
        share = progress[rows][..., None]
        hand = body[rows, :, wrist] + (goal[rows] - body[rows, -1, wrist])[:, None] * share
        arm = (body[rows, :, shoulder], body[rows, :, elbow], body[rows, :, wrist])
        bias = share * np.array([0.0, -0.05, 0.0])
        moved[rows, :, elbow], moved[rows, :, wrist] = limb(*arm, hand, bias=bias, stretch=stretch)
    return moved


def limb(
    root: np.ndarray, middle: np.ndarray, end: np.ndarray, target: np.ndarray, *, bias: np.ndarray, stretch: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return elbow and wrist (or knee and ankle) of a limb that reaches for ``target``; both bones keep their lengths.

    It bends to the side on which it was, changed by ``bias``, which decides for a limb that was straight. Beyond the
    limb's length both bones are stretched in proportion, by the share ``stretch`` at most.
    """
    upper = np.linalg.norm(middle - root, axis=-1, keepdims=True)
    lower = np.linalg.norm(end - middle, axis=-1, keepdims=True)
    reach = target - root
    distance = np.maximum(np.linalg.norm(reach, axis=-1, keepdims=True), 1e-6)
    direction = reach / distance
    farthest = (upper + lower) * (1.0 + stretch)
    target = np.where(distance > farthest, root + direction * farthest, target)
    distance = np.minimum(distance, farthest)
    side = (middle - root) + bias
    side = side - (side * direction).sum(axis=-1, keepdims=True) * direction
    side = side / np.maximum(np.linalg.norm(side, axis=-1, keepdims=True), 1e-9)
    bent = np.clip(distance, np.abs(upper - lower), upper + lower)
    along = (bent**2 + upper**2 - lower**2) / (2 * np.maximum(bent, 1e-6))
    height = np.sqrt(np.maximum(upper**2 - along**2, 0.0))
    along = np.where(distance > upper + lower, distance * upper / np.maximum(upper + lower, 1e-6), along)
    return root + direction * along + side * height, target


def _teleport(start: ScriptedStart, n_frames: np.ndarray, fps: float) -> _Joints:
    initial = start.initial_joints.astype(np.float64)
    goal = start.goal_location.astype(np.float64)
    # A motion that ends before 2.0 s jumps in its last frame.
    jump = np.minimum(round(_ARRIVAL * fps), n_frames - 1)[:, None]
    there = (np.arange(int(n_frames.max())) >= jump).astype(np.float64)
    body = body_joints(start, n_frames, fps, replace(BODIES["stare"], turn_end=np.inf))
    # It stands before the goal first and looks then, so that the ray meets the goal from the new place.
    moved = ScriptedStart(initial + glide(initial, goal, _STAND_OFF)[:, None], goal, start.head_tilt_deg)
    arrived = body_joints(moved, n_frames, fps, BODIES["stare"])
    return reaching(np.where(there[..., None, None] > 0, arrived, body), goal, there)


def altered_joints(recorded: MotionBatch, fps: float, altered: Altered) -> Float[np.ndarray, "frames 22 3"]:
    """Return recordings, one after the other, with something done to them; canonical frame, metres."""
    row = np.arange(len(recorded.values)) - recorded.first[recorded.sequence_of_row]
    joints = recorded.values.astype(np.float64)
    joints[:, :, 0] += altered.sway * np.sin(2 * np.pi * row / fps / altered.period)[:, None]
    return joints


# The bodies of docs/audit.md by the names of their controls.
BODIES: Mapping[str, Body] = {
    "scripted": Body(),
    "stare": Body(turn_end=-1.0, stop=np.inf, reach=0.0),
    "stare-late": Body(turn_time=0.5, stop=np.inf, reach=0.0),
    # Far below what any recording resolves.
    "tremor": Body(turn_end=-1.0, stop=np.inf, reach=0.0, tremor=1e-4),
    # Twice the height of a foot that Foot Skating takes for standing.
    "float": Body(rise=0.10),
    "heel-skater": Body(ankle=0.045, toe=0.053, twist=0.5, lean=1.0, stop=0.3, stretch=0.0),
    "hover": Body(ankle=0.09, toe=0.05, rise_time=0.1, twist=0.5, lean=1.0, stop=0.3, stretch=0.0),
    "long-arms": Body(arm=2.0, twist=0.6, stretch=0.0),
    "doll": Body(size=0.26, twist=1.0, stretch=0.0),
    "nodder": Body(turn_end=-1.0, nod=40.0, stop=np.inf, reach=0.0),
    "stepper": Body(turn_time=1.8, twist=0.3, go=1.6, stop=1.9, stretch=0, step=0.65, lift=0.15, crouch=0.4, lean=0.8),
}
SWAYING = Altered(sway=0.03)
# Maps the name of each control to what makes its motions.
SCRIPTED_CONTROLS: Mapping[str, Callable[[ScriptedStart, np.ndarray, float], _Joints]] = {
    **{name: partial(body_joints, body=body) for name, body in BODIES.items()},
    "teleport": _teleport,
}
