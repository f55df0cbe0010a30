"""Turns a script into joints: base, feet, trunk, head, arms, legs, by the channels of prime-and-reach motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.randomness import named_generator
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.activities import script as scripts
from prbench.synthetic.activities.narrate import NarratedMotion, narrate, narrate_events
from prbench.synthetic.people import PRESETS, perform
from prbench.synthetic.people import body as bodies
from prbench.synthetic.people.gaze_plan import GazePlan, filled
from prbench.synthetic.people.kinematics import add_bump, blend, bump, direction, eased_trapezoid, minimum_jerk, turn
from prbench.synthetic.people.perform import Motion, assemble
from prbench.synthetic.people.person import Preset, Trunk, draw_person, seated_pelvis_height, standing_pelvis_height
from prbench.synthetic.people.plan import Plan
from prbench.synthetic.people.walking import BasePath, Legs, place_feet, plan_steps, pose_legs, sample_base
from prbench.synthetic.people.world import Room, Source, assign

_ALONG_THIGH = 0.62
_ABOVE_THIGH = 0.055
_LOOP_EASE = 0.35  # s in which a loop begins and ends
_SEAT_BACK = 0.22  # of the stature, behind the feet
_SITTING_LEAN = np.deg2rad(35.0)
_NOWHERE = Room("", (0.0, 0.0), (), ())


def act_out(preset: Preset, script: scripts.Script, rate: float, rng: np.random.Generator) -> Motion:
    """Return the whole body at every frame.

    Args:
        preset: Gains of the head.
        script: What to do.
        rate: Frames a second.
        rng: Generator of small movements and idle looks.
    """
    person = script.person
    times = np.arange(round(script.end * rate) + 1) / rate
    plan = Plan(preset, person, _NOWHERE, False, script.start, (), script.segments, ())
    # Where the feet carry the person, at every frame.
    path = sample_base(script.start, (), times)
    x = path.x.copy()
    z = path.z.copy()
    heading = path.heading.copy()
    for move in script.moves:
        first = int(np.searchsorted(times, move.begin))
        if isinstance(move, scripts.Arc):
            duration = move.end - move.begin
            elapsed = (times[first:] - move.begin) / duration
            easing = (min(scripts.ARC_START / duration, 0.45), min(scripts.ARC_STOP / duration, 0.5))
            progress = eased_trapezoid(elapsed, *easing)
            x[first:], z[first:], heading[first:] = move.at(progress)
        else:
            part = sample_base(move.start, (move,), times)
            x[first:], z[first:], heading[first:] = part.x[first:], part.z[first:], part.heading[first:]
    velocity = np.gradient(np.stack([x, z], axis=-1), times, axis=0)
    feet_base = BasePath(x, z, heading, np.hypot(velocity[:, 0], velocity[:, 1]))
    # 0 where the person stands to 1 where they sit.
    seated = np.zeros(times.size)
    for begin, down in script.sits:
        blend(seated, times, begin, scripts.SITTING_TIME, float(down))
    # The pelvis moves back onto the seat; the feet stay.
    back = _SEAT_BACK * person.body.stature * seated
    base = replace(feet_base, x=x - back * np.sin(heading), z=z - back * np.cos(heading))
    steps = plan_steps(person, script.segments)
    feet = place_feet(person, feet_base, steps, times, seated=False)
    sway = bodies.draw_sway(plan, feet_base, steps, times, rng)
    # Lean and crouch of the bends, and what sitting adds.
    channels = np.zeros((times.size, 3))
    for begin, duration, taken_up in sorted(script.bends, key=lambda bend: bend[0]):
        blend(channels, times, begin, duration, np.array(taken_up))
    lean = channels[:, 0]
    crouch = channels[:, 1]
    for begin, _ in script.sits:
        lean += _SITTING_LEAN * bump((times - begin) / scripts.SITTING_TIME)
    body = person.body
    drop = (standing_pelvis_height(body) - seated_pelvis_height(body)) / body.leg
    bending = bodies.Bending(lean, crouch + drop * seated, channels[:, 2])
    # The looks of the activities, and looks ahead in between.

    def look_ahead(now: float, until: float, _: np.ndarray | None) -> tuple[float, np.ndarray]:
        """Draw how long, and a point some metres ahead of where the person will soon be and face."""
        length = min(float(np.clip(0.7 * np.exp(0.4 * rng.standard_normal()), 0.3, 1.6)), until - now)
        index = min(int(np.searchsorted(times, now + 0.5)), times.size - 1)
        pose = feet_base.pose(index)
        height = body.stature * (0.93 - 0.22 * float(seated[index]))
        yaw = pose.heading + rng.normal(0.0, 0.22)
        pitch = rng.normal(0.16, 0.08)
        ahead = np.array([0.0, height, 0.0]) + rng.uniform(2.0, 3.5) * direction(yaw, pitch)
        return length, pose.point + ahead

    gaze = GazePlan(filled(script.looks, float(times[-1]), look_ahead), (), ())
    rough = bodies.move_trunk(plan, base, bending, sway, feet, steps, times, None)
    eye = rough.neck + np.array([0.0, 0.06, 0.0]) * person.body.stature
    head = bodies.move_head(plan, gaze, base.heading, eye, times, rng)
    trunk = bodies.move_trunk(plan, base, bending, sway, feet, steps, times, head)
    legs = pose_legs(person.body, np.stack(trunk.hips, axis=1), trunk.yaws[0], feet)
    wrists, poles = _move_hands(plan, script, trunk, legs, bodies.move_wrists(plan, trunk, sway, times), head, times)
    arms = bodies.pose_arms(person.body, person.habits.elbow_flare, trunk, wrists, poles)
    return assemble(plan, base, feet, trunk, head, arms, times, gaze, ())


def _move_hands(
    plan: Plan, script: scripts.Script, trunk: Trunk, legs: Legs, rest: np.ndarray, head: bodies.Head, times: np.ndarray
) -> tuple[Float[np.ndarray, "n 2 3"], Float[np.ndarray, "n 2 3"]]:
    """Return wanted wrists, and directions of the elbows in the chest's frame. Commands act in time order."""
    wrists = rest.copy()
    commands = sorted(script.hands, key=lambda command: command.begin)
    for command in commands:
        target = _target(plan, command, trunk, legs, rest, head, times)
        blend(wrists[:, command.hand], times, command.begin, command.duration, target)
        if command.bulge:
            forward = turn(trunk.yaws[3], 0.0, np.array([0.0, 0.0, command.bulge]))
            first, last = np.searchsorted(times, [command.begin, command.begin + command.duration])
            add_bump(wrists[:, command.hand], times, command.begin, command.duration, forward[first:last])
    usual = bodies.elbow_poles(plan.person.habits.elbow_flare, trunk, wrists)
    poles = usual.copy()
    for command in commands:
        pole = usual[:, command.hand]
        if command.pole is not None:
            outwards, up, forward = command.pole
            pole = np.array([outwards if command.hand == 0 else -outwards, up, forward])
        blend(poles[:, command.hand], times, command.begin, command.duration, pole)
    return wrists, poles


def _target(
    plan: Plan, command: scripts.Hand, trunk: Trunk, legs: Legs, rest: np.ndarray, head: bodies.Head, times: np.ndarray
) -> np.ndarray:
    hand = command.hand
    side = 1.0 if command.hand == 0 else -1.0
    stature = plan.person.body.stature
    offset = np.array([side * command.offset[0], command.offset[1], command.offset[2]]) * stature
    if command.place == "rest":
        return rest[:, hand]
    if command.place == "world":
        return np.array(command.offset)
    if command.place == "thigh":
        hip = trunk.hips[hand]
        return hip + _ALONG_THIGH * (legs.knee[:, hand] - hip) + np.array([0.0, _ABOVE_THIGH, 0.0])
    if command.place == "head":
        middle = trunk.neck + turn(head.yaw, 0.0, np.array([0.0, 0.06 * stature, 0.02 * stature]))
        return middle + turn(head.yaw, 0.0, offset) + _loop(command.loop, trunk, times)
    shoulder = trunk.shoulders[hand]
    if command.place == "middle":
        shoulder = 0.5 * (trunk.shoulders[0] + trunk.shoulders[1])
    return shoulder + turn(trunk.yaws[3], 0.0, offset) + _loop(command.loop, trunk, times)


def _loop(loop: scripts.Loop | None, trunk: Trunk, times: np.ndarray) -> np.ndarray:
    """Return the ellipse in the chest's frame, growing at its beginning and shrinking at its end."""
    if loop is None:
        return np.zeros(3)
    size = minimum_jerk((times - loop.begin) / _LOOP_EASE) * minimum_jerk((loop.end - times) / _LOOP_EASE)
    phase = 2.0 * np.pi * loop.frequency * (times - loop.begin)
    way = np.sin(phase)[:, None] * loop.first + np.cos(phase)[:, None] * loop.second
    return turn(trunk.yaws[3], 0.0, size[:, None] * way)


RATE = 240.0
_N_ACTIVITIES = 14
N_EVENTS = 8
# Each so many-th recording shows picks and puts.
_EVERY = 4
_BASE_PRESET = "hd-epic"
_GOAL_PRESETS = ("adt", "mogaze", "gimo", "hd-epic")
_FIRST_TEXT = (0.205, 0.225)  # s after the suit, as in real sequences of known clocks
_WAITS = 0.5  # share of short activities after which people wait …
_SHORTEST_ALONE = 3.1  # … until so many seconds after their beginning, so that a text fits
_CLOSING = 0.8
_OF_BODY = ("joints", "rotations", "head_rotation", "eye", "planted")


@dataclass(frozen=True)
class Identity:
    """Name, person and split of one recording, known before it is acted out.

    Attributes:
        goal_preset: Preset of a prime-and-reach recording; None for activities.
    """

    recording_id: str
    participant_id: str
    split: Literal["train", "validation", "test"]
    goal_preset: str | None
    person: int


def identity_of(seed: int, index: int) -> Identity:
    """Return who acts in recording ``index`` of the corpus of a seed."""
    preset = _GOAL_PRESETS[(index // _EVERY) % len(_GOAL_PRESETS)] if index % _EVERY == _EVERY - 1 else None
    source = Source(seed, "activities", "default")
    if preset is not None:
        source = Source(_goal_seed(seed), preset, "default")
    _, person, split = assign(source, index)
    participant = f"invented_{'a' if preset is None else preset.replace('-', '')}{person:03d}"
    return Identity(f"20000101_s0_{participant}_act{seed}_n{index:05d}", participant, split, preset, person)


def narrated_recording(seed: int, index: int) -> NarratedMotion:
    """Act out recording ``index``; it depends on nothing but the two numbers."""
    identity = identity_of(seed, index)
    known = {name: getattr(identity, name) for name in ("recording_id", "participant_id", "split")} | {"rate": RATE}
    if identity.goal_preset is not None:
        # Picks and puts, described.
        performance = perform(
            identity.goal_preset, seed=_goal_seed(seed), index=index, n_events=N_EVENTS, rate=RATE, provocations={}
        )
        words = Source(seed, "corpus", "default").generator("recording", index, "narration")
        return NarratedMotion(
            **known,
            **{name: getattr(performance, name) for name in _OF_BODY},
            neck_tilt_deg=performance.person.neck_tilt_deg,
            narrations=narrate_events(performance, words),
        )
    source = Source(seed, "activities", "default")
    preset = replace(PRESETS[_BASE_PRESET], name="activities", work_pose=None, speed=1.0)
    person = draw_person(preset, identity.participant_id, source.generator("person", identity.person, "body"))
    # Draw one activity after the other; people stand up before they walk on.
    rng = source.generator("recording", index, "plan")
    writer = scripts.ScriptWriter(person, rng)
    writer.now = writer.draw(*_FIRST_TEXT)
    scripts.stand(writer)
    for _ in range(_N_ACTIVITIES):
        last = writer.script.acts[-1]
        waits = last.name in scripts.SHORT and writer.rng.random() < _WAITS
        writer.now = max(writer.now + writer.draw(*scripts.PAUSE), last.begin + _SHORTEST_ALONE if waits else 0.0)
        choices = scripts.SITTING if writer.is_seated else scripts.STANDING
        weights = np.array(list(choices.values()))
        list(choices)[int(rng.choice(len(weights), p=weights / weights.sum()))](writer)
    writer.script.end = writer.now + _CLOSING
    script = writer.script
    motion = act_out(preset, script, RATE, source.generator("recording", index, "motion"))
    words = source.generator("recording", index, "narration")
    return NarratedMotion(
        **known,
        **{name: getattr(motion, name) for name in _OF_BODY},
        neck_tilt_deg=person.neck_tilt_deg,
        narrations=narrate(script, motion, RATE, words),
    )


def _goal_seed(seed: int) -> int:
    """Return the seed of the prime-and-reach recordings, which nobody gives to a benchmark table."""
    return int(named_generator("prbench-synth", GENERATOR_VERSION, seed, "corpus", "goals").integers(2**40, 2**60))
