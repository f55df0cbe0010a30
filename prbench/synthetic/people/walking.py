"""The path of the body over the floor (turn, walk, turn; or shuffle), and the legs over planted and swinging feet.

Source: docs/specification/synthetic-recordings.md#base-motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from prbench.synthetic.people import kinematics
from prbench.synthetic.people.kinematics import blend, direction, minimum_jerk, smooth, turn, wrap
from prbench.synthetic.people.person import BALL_HEIGHT, Body, Habits, Person

Signal = Float[np.ndarray, " n"]  # one number a time
Sides = Float[np.ndarray, "n 2 3"]  # left and right, metres
Vector = Float[np.ndarray, "3"]  # metres

_WALK_FROM = 0.7  # metres; shorter ways are shuffled
_STAY_WITHIN = 0.04  # metres; nearer, and turned by less than 12 degrees, the feet stay
_STAY_TURN = np.deg2rad(12.0)
# People walk sideways for a step or two at most (Handford & Srinivasan 2014): on longer ways they turn into them.
_SIDESTEP = (0.16, 0.34)  # metres; the turn into the way grows from none to whole between the two
_SIDEWAYS_LEFT = np.deg2rad(40.0)  # angle between body and way that is not turned away
_LARGEST_TURN = np.deg2rad(45.0)
_LARGEST_TURNS = np.deg2rad(55.0)  # with the change of heading: a planted foot must not be left behind the pelvis
_TURNING = 0.42  # share of a shuffle in which the body turns into the way, and of that in which it turns back


@dataclass(frozen=True)
class BasePose:
    """The point under the pelvis and the heading, which is never wrapped."""

    x: float
    z: float
    heading: float

    @property
    def point(self) -> Vector:
        """Return the position on the floor: x, 0, z in metres, world frame."""
        return np.array([self.x, 0.0, self.z])

    @property
    def left(self) -> Vector:
        """Unit vector to the left."""
        return np.array([np.cos(self.heading), 0.0, -np.sin(self.heading)])

    @property
    def forward(self) -> Vector:
        """Unit vector ahead."""
        return np.array([np.sin(self.heading), 0.0, np.cos(self.heading)])


@dataclass(frozen=True)
class Segment:
    """One change of place. Times in seconds of the recording.

    Attributes:
        end: Base at rest from here on.
        arrival: End of the translation.
        course: Heading while walking, unwrapped against the start.
        first_turn: Duration of the turn into the course.
        turn_into: Angle by which the body turns into the way of a shuffle and back, radians; > 0 to the left.
    """

    kind: Literal["walk", "shuffle"]
    start: BasePose
    goal: BasePose
    begin: float
    end: float
    arrival: float
    speed: float
    course: float
    first_turn: float
    last_turn: float
    translation_begin: float
    turn_into: float = 0.0

    @property
    def distance(self) -> float:
        """Metres between start and goal."""
        return float(np.hypot(self.goal.x - self.start.x, self.goal.z - self.start.z))

    @property
    def total_turn(self) -> float:
        """Sum of the turns' sizes, radians."""
        if self.kind == "shuffle":
            return abs(self.goal.heading - self.start.heading) + 2.0 * abs(self.turn_into)
        return abs(self.course - self.start.heading) + abs(self.goal.heading - self.course)


def plan_segment(
    habits: Habits, pace: float, start: BasePose, goal: BasePose, begin: float, *, faces_on: bool = False
) -> Segment | None:
    """Plan the way from one standing place to another.

    Args:
        habits: Habits of the person.
        pace: The preset's speed factor.
        start: Place where the person stands.
        goal: Place to come to; its heading is understood modulo full turns.
        begin: Motor start.
        faces_on: Whether somebody who shuffles keeps facing the same way, however far.

    Returns:
        The segment, with ``goal`` unwrapped so that the person turns the short way; None if the feet may stay.
    """
    distance = float(np.hypot(goal.x - start.x, goal.z - start.z))
    # Short ways are walked more slowly: the speed nears the usual one over about a metre.
    speed = habits.walk_speed * pace * (1.0 - np.exp(-distance / 1.45))
    if distance > _WALK_FROM:
        turn_in = float(wrap(np.arctan2(goal.x - start.x, goal.z - start.z) - start.heading))
        course = start.heading + turn_in
        turn_out = float(wrap(goal.heading - course))
        first_turn = max(0.3, abs(turn_in) / habits.turn_rate - 0.15) + 0.25
        last_turn = max(0.9, abs(turn_out) / habits.turn_rate)
        moves_from = begin + 0.55 * first_turn
        arrival = moves_from + distance / speed + 0.45
        end = arrival + 0.15 * last_turn
        goal = BasePose(goal.x, goal.z, course + turn_out)
        return Segment("walk", start, goal, begin, end, arrival, speed, course, first_turn, last_turn, moves_from)
    turn = float(wrap(goal.heading - start.heading))
    if distance < _STAY_WITHIN and abs(turn) < _STAY_TURN:
        return None
    duration = max(0.55 + 0.8 * distance / max(speed, 0.25), 0.8 + 0.75 * distance, abs(turn) / habits.turn_rate + 0.3)
    turn_into = 0.0
    if not faces_on:
        # How far the body turns towards a way that it shuffles.
        way = float(wrap(np.arctan2(goal.x - start.x, goal.z - start.z) - start.heading - 0.5 * turn))
        most = max(0.0, min(_LARGEST_TURN, _LARGEST_TURNS - abs(turn)))
        excess = float(np.clip(abs(way) - _SIDEWAYS_LEFT, 0.0, most))
        shortest, longest = _SIDESTEP
        turn_into = float(np.sign(way)) * excess * float(minimum_jerk((distance - shortest) / (longest - shortest)))
    duration = max(duration, abs(turn_into) / (_TURNING * habits.turn_rate))
    end = begin + duration
    goal = BasePose(goal.x, goal.z, start.heading + turn)
    return Segment("shuffle", start, goal, begin, end, end, speed, start.heading, duration, 0.0, begin, turn_into)


@dataclass(frozen=True)
class BasePath:
    """Base pose at every frame.

    Attributes:
        speed: Metres per second.
    """

    x: Signal
    z: Signal
    heading: Signal
    speed: Signal

    @cached_property
    def points(self) -> Float[np.ndarray, "n 3"]:
        """Under the pelvis, on the floor."""
        return np.stack([self.x, np.zeros_like(self.x), self.z], axis=-1)

    def pose(self, index: int) -> BasePose:
        """Return the base pose at one frame."""
        return BasePose(float(self.x[index]), float(self.z[index]), float(self.heading[index]))


def sample_base(start: BasePose, segments: tuple[Segment, ...], times: Signal) -> BasePath:
    """Return the base pose at every frame of a recording that begins standing at ``start``."""
    position = np.tile([start.x, start.z], (times.size, 1))
    heading = np.full(times.size, start.heading)
    for segment in segments:
        if segment.kind == "shuffle":
            duration = segment.end - segment.begin
            blend(position, times, segment.begin, duration, np.array([segment.goal.x, segment.goal.z]))
            blend(heading, times, segment.begin, duration, segment.goal.heading)
            if segment.turn_into:
                # Into the way and back, on top of the change of heading.
                first, last = np.searchsorted(times, [segment.begin, segment.end])
                progress = (times[first:last] - segment.begin) / duration
                there = minimum_jerk(progress / _TURNING)
                back = minimum_jerk((progress - (1.0 - _TURNING)) / _TURNING)
                heading[first:last] += segment.turn_into * (there - back)
        else:
            blend(heading, times, segment.begin, segment.first_turn, segment.course)
            last_begin = segment.arrival - 0.85 * segment.last_turn
            blend(heading, times, last_begin, segment.end - last_begin, segment.goal.heading)
            first = int(np.searchsorted(times, segment.translation_begin))
            duration = segment.arrival - segment.translation_begin
            elapsed = (times[first:] - segment.translation_begin) / duration
            progress = kinematics.eased_trapezoid(elapsed, min(0.5 / duration, 0.45), min(0.65 / duration, 0.5))
            origin = np.array([segment.start.x, segment.start.z])
            position[first:] = origin + progress[:, None] * (np.array([segment.goal.x, segment.goal.z]) - origin)
    velocity = np.gradient(position, times, axis=0)
    return BasePath(position[:, 0], position[:, 1], heading, np.hypot(velocity[:, 0], velocity[:, 1]))


_ROLL_BEFORE_LIFT = 0.05  # the ball begins to rise before it moves, as a rolling foot does
_HEEL_UP = np.deg2rad(58.0)
_TOES_UP = np.deg2rad(-16.0)
BALL_TO_TOE = 0.033  # of the stature; the foot of a swing rolls off the tip of its toe
HEEL_TO_BALL = 0.098  # of the stature; the foot lands on its heel
_FOOT_LIFT = 0.044  # metres that the whole foot is lifted
_SLOW_WALK = 1.03  # m/s
_FLAT_AFTER = 0.10  # seconds from the heel's landing to the ball's
_SEATED_FEET_AHEAD = 0.22  # of the stature


@dataclass(frozen=True)
class Step:
    """One foot's way through the air.

    Attributes:
        foot: 0 left, 1 right.
        period: Time between two lifts of different feet.
    """

    foot: int
    lift: float
    period: float
    swing: float
    walking: bool

    @property
    def landing(self) -> float:
        """The heel is down."""
        return self.lift + self.swing

    @property
    def flat(self) -> float:
        """The ball is down."""
        return self.landing + min(_FLAT_AFTER, self.period - self.swing)


Steps = tuple[Step, ...]  # in the order of their lifts


@dataclass(frozen=True)
class Feet:
    """Both feet at every frame.

    Attributes:
        pitch: > 0: heel up.
        planted: The ball is at rest.
        carrying: The ball or the heel is down.
    """

    ball: Sides
    yaw: Float[np.ndarray, "n 2"]
    pitch: Float[np.ndarray, "n 2"]
    planted: Bool[np.ndarray, "n 2"]
    carrying: Bool[np.ndarray, "n 2"]


def plan_steps(person: Person, segments: tuple[Segment, ...]) -> Steps:
    """Return the steps that carry a person along the segments of the base."""
    steps = []
    for segment in segments:
        if person.manner.even_steps:
            steps += _even_steps(person, segment)
            continue
        walking = segment.kind == "walk"
        # Speed is step length times cadence, and the walk ratio is step length over cadence: their quotient is
        # cadence². Below 62 metres a minute the ratio rises (Murakami & Otaka 2017).
        slower = max(1.0, _SLOW_WALK / max(segment.speed, 1e-9))  # who stands has no speed
        cadence = np.clip(np.sqrt(60.0 * segment.speed / (person.habits.walk_ratio * slower**0.5)), 60.0, 128.0)
        turn_in, turn_out = (abs(segment.course - segment.start.heading), abs(segment.goal.heading - segment.course))
        if not walking:
            turn_in = segment.total_turn
        # Turns take more and shorter steps than the way between them: a foot must not be left behind the pelvis.
        turning = [max(cadence, 72.0 + 22.0 * min(1.0, turn / 1.2)) for turn in (turn_in, turn_out)]
        borders = np.array(
            [segment.begin, segment.begin + segment.first_turn, segment.arrival - 0.85 * segment.last_turn, segment.end]
        )
        borders = np.maximum.accumulate(borders)
        counts = np.concatenate([[0.0], np.cumsum(np.diff(borders) * [turning[0], cadence, turning[1]]) / 60.0])
        n_steps = max(round(counts[-1] + 0.62), 3 if segment.distance > 0.5 else 2)
        # The first foot is that on the side of the turn, or of the side step.
        if walking:
            first = int(segment.course < segment.start.heading)
        else:
            n_steps = max(n_steps, int(np.ceil(counts[-1])), int(np.ceil(segment.distance / 0.34)) + 1)
            sideways = (segment.goal.point - segment.start.point) @ segment.start.left
            first = int(sideways + 0.3 * (segment.goal.heading - segment.start.heading) < 0.0)
        lifts = np.interp(np.arange(n_steps) / (n_steps - 0.62) * counts[-1], counts, borders)
        periods = np.diff(lifts, append=lifts[-1] + (segment.end - lifts[-1]) / 0.38)
        # The slower, the longer both feet stand.
        swing = 0.62 + 0.14 * min(segment.speed / 1.2, 1.0) if walking else 0.80
        for number in range(n_steps):
            period = float(periods[number])
            steps.append(Step((first + number) % 2, float(lifts[number]), period, swing * period, walking))
    return tuple(steps)


def _even_steps(person: Person, segment: Segment) -> list[Step]:
    """Return steps of even length: a leg swings like a pendulum by an angle that grows with the root of the speed."""
    times = np.linspace(segment.begin, segment.end, 201)
    base = sample_base(segment.start, (segment,), times)
    length = 0.72 * person.body.leg * float(np.sqrt(segment.speed / 1.2))
    turned = np.abs(np.gradient(base.heading, times))
    # Nobody pauses in mid-stride, and nobody hurries: there are 1 to 2.1 steps a second.
    rate = np.clip(np.maximum(base.speed / length, turned / np.deg2rad(60.0)), 1.0, 2.1)
    counts = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(times))])
    n_steps = max(int(np.ceil(counts[-1] + 0.5)), 2)
    lifts = np.interp(np.arange(n_steps) / (n_steps - 0.62) * counts[-1], counts, times)
    periods = np.diff(lifts, append=lifts[-1] + (segment.end - lifts[-1]) / 0.38)
    way = segment.goal.point - segment.start.point
    first = int(way @ segment.start.left + 0.3 * (segment.goal.heading - segment.start.heading) < 0.0)
    return [
        Step((first + number) % 2, float(lift), float(period), 0.7 * float(period), segment.kind == "walk")
        for number, (lift, period) in enumerate(zip(lifts, periods, strict=True))
    ]


def place_feet(person: Person, base: BasePath, steps: Steps, times: Signal, *, seated: bool) -> Feet:
    """Return the balls of both feet over time.

    Args:
        person: Who.
        base: Base pose at every frame.
        steps: Foot falls in the order of their lifts.
        times: Frame times, seconds.
        seated: Whether the feet stand ahead, before a chair.
    """
    n = times.size
    ahead = _SEATED_FEET_AHEAD * person.body.stature if seated else None
    spots = [_plant(person, base.pose(0), foot, 0.0, ahead) for foot in (0, 1)]
    ball = np.stack([np.tile(spot[0], (n, 1)) for spot in spots], axis=1)
    yaw = np.stack([np.full(n, spot[1]) for spot in spots], axis=1)
    pitch = np.zeros((n, 2))
    planted = np.ones((n, 2), dtype=bool)
    carrying = np.ones((n, 2), dtype=bool)
    for step in steps:
        index = int(min(np.searchsorted(times, step.lift + 1.38 * step.period), n - 1))
        old_ball, old_yaw = spots[step.foot]
        spots[step.foot] = _plant(person, base.pose(index), step.foot, float(base.speed[index]), None)
        new_ball, new_yaw = spots[step.foot]
        stride = float(np.linalg.norm(new_ball - old_ball))
        first, last = np.searchsorted(times, [step.lift - _ROLL_BEFORE_LIFT, step.landing])
        carrying[first:last, step.foot] = False
        planted[first : np.searchsorted(times, step.flat), step.foot] = False
        # The swing: along the floor, up and down.
        elapsed = times[first:last] - step.lift
        rolls = min(1.0, stride / 1.1)
        lifts = min(1.0, stride / 0.12 + abs(new_yaw - old_yaw) / 0.5)
        # The tip of the toe comes nearest to the floor half-way through the swing, the more the foot rolls.
        low = rolls * kinematics.bump((elapsed / step.swing - 0.32) / 0.36)
        clearance = lifts * (_FOOT_LIFT + low * (person.habits.toe_clearance - _FOOT_LIFT))
        progress = person.manner.swing_foot(np.clip(elapsed / step.swing, 0.0, 1.0))
        up = minimum_jerk((elapsed + _ROLL_BEFORE_LIFT) / 0.16)
        down = minimum_jerk((elapsed / step.swing - 0.77) / 0.23)
        _roll(pitch[:, step.foot], times, step, rolls)
        tiptoe = BALL_TO_TOE * person.body.stature * np.sin(np.maximum(pitch[first:last, step.foot], 0.0))
        ball[first:last, step.foot] = old_ball + progress[:, None] * (new_ball - old_ball)
        ball[first:last, step.foot, 1] = BALL_HEIGHT + up * (clearance * (1.0 - down) + tiptoe)
        ball[last:, step.foot] = new_ball
        yaw[first:last, step.foot] = old_yaw + progress * (new_yaw - old_yaw)
        yaw[last:, step.foot] = new_yaw
    # A foot that lands stands on its heel until the ball is down.
    heel = HEEL_TO_BALL * person.body.stature
    landing = np.minimum(pitch, 0.0)
    ball += heel * (turn(yaw, landing, np.array([0.0, 0.0, 1.0])) - turn(yaw, 0.0, np.array([0.0, 0.0, 1.0])))
    return Feet(ball, yaw, pitch, planted, carrying)


def _plant(person: Person, pose: BasePose, foot: int, speed: float, ahead: float | None) -> tuple[Vector, float]:
    """Return where the ball of a foot rests when the base is at ``pose``, and its yaw."""
    side = 1.0 if foot == 0 else -1.0
    forward = person.body.foot_length * (0.62 - 0.30 * min(1.0, speed)) if ahead is None else ahead
    # Walking feet pass nearer to each other than standing ones stand.
    aside = side * person.habits.half_stance * (1.0 - 0.45 * min(1.0, speed / 0.8))
    ball = pose.point + aside * pose.left + forward * pose.forward
    ball[1] = BALL_HEIGHT
    return ball, pose.heading + side * person.habits.toe_out


def _roll(pitch: np.ndarray, times: np.ndarray, step: Step, factor: float) -> None:
    """Lift the heel before the foot, land with the toes up, and set the foot flat soon after."""
    heel_off = step.lift - 0.55 * step.period
    keys = np.array([heel_off, step.lift + 0.06, step.lift + 0.88 * step.swing, step.landing, step.flat])
    values = factor * np.array([0.0, _HEEL_UP, _TOES_UP, _TOES_UP, 0.0])
    borders = np.searchsorted(times, keys)
    for part in range(len(keys) - 1):
        span = slice(borders[part], borders[part + 1])
        share = minimum_jerk((times[span] - keys[part]) / (keys[part + 1] - keys[part]))
        pitch[span] += values[part] + share * (values[part + 1] - values[part])


_PLANTED_LEG = 0.9885
_LEG_LIMIT = (0.9925, 0.9985)
_POLE_DOWN = np.arctan(0.35)  # stays regular when the foot trails behind a crouching pelvis


@dataclass(frozen=True)
class Legs:
    """Joints of both legs; index 1 is the side."""

    knee: Sides
    ankle: Sides
    ball: Sides


def ankles(body: Body, feet: Feet) -> Sides:
    """Return the ankles of feet that turn and roll about their balls."""
    return feet.ball - turn(feet.yaw, feet.pitch, np.array([0.0, -body.ankle_height, body.foot_length]))


def lowered_pelvis(
    body: Body, height: Signal, hips: Sides, feet: Feet, steps: Steps, times: Signal, rate: float
) -> Signal:
    """Lower the pelvis where the planted feet ask for it, and nowhere because of the swinging one.

    Args:
        body: Bone lengths.
        height: Wanted pelvis height.
        hips: Hip positions at that height.
        feet: Balls, yaw, pitch and contacts.
        steps: Foot falls.
        times: Frame times, seconds.
        rate: Frames a second.

    Returns:
        Pelvis height at which no planted leg is longer than it can be.
    """
    # The highest pelvis for which every planted leg is at most .9885 of its length.
    ankle = ankles(body, feet)
    across = hips - ankle
    horizontal = across[..., 0] ** 2 + across[..., 2] ** 2
    reach = np.sqrt(np.maximum((_PLANTED_LEG * body.leg) ** 2 - horizontal, 0.0))
    room = np.where(feet.carrying, ankle[..., 1] + reach - hips[..., 1], np.inf).min(axis=1)
    allowed = height + room
    dip = np.zeros(times.size)
    missing = np.maximum(height - allowed, 0.0)
    for step, following in zip(steps, (*steps[1:], None), strict=False):
        upto = step.landing + 0.24 * step.period
        if following is not None and following.lift > step.landing:
            upto = min(upto, following.lift)
        # A plateau as deep as the most that is missing, with smooth flanks.
        begin, end = np.searchsorted(times, (step.landing, upto))
        depth = missing[begin : end + 1].max(initial=0.0)
        if depth > 0.0:
            flank = 0.42 * step.period
            first, last = np.searchsorted(times, [step.landing - flank, upto + flank])
            near = times[first:last]
            shape = minimum_jerk((near - step.landing) / flank + 1.0) * minimum_jerk((upto - near) / flank + 1.0)
            dip[first:last] = np.maximum(dip[first:last], depth * shape)
    lowered = height - smooth(dip, 0.050, rate)
    return smooth(np.minimum(lowered, allowed), 0.025, rate)


def pose_legs(body: Body, hips: Sides, pelvis_yaw: Signal, feet: Feet) -> Legs:
    """Find the knees by two-bone kinematics; a swinging foot follows the ankle where the leg is too short for it."""
    wanted = ankles(body, feet)
    knees = []
    reached = []
    for side in (0, 1):
        heading = 0.5 * (pelvis_yaw + feet.yaw[:, side])
        knee, ankle = kinematics.two_bone(
            hips[:, side], wanted[:, side], (body.thigh, body.shin), direction(heading, _POLE_DOWN), _LEG_LIMIT
        )
        knees.append(knee)
        reached.append(ankle)
    ankle = np.stack(reached, axis=1)
    return Legs(np.stack(knees, axis=1), ankle, feet.ball + (ankle - wanted))
