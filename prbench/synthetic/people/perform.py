"""One recording from its seed: world, person, plan, motion, gaze, truth.

Source: docs/specification/synthetic-recordings.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite

import numpy as np

from prbench.errors import UsageError
from prbench.synthetic.people.bystander import bystander_acts
from prbench.synthetic.people.carry import move_objects
from prbench.synthetic.people.gaze_plan import GazePlan, Look
from prbench.synthetic.people.head_eye import move_eyes
from prbench.synthetic.people.motion import Generators, Motion, synthesise
from prbench.synthetic.people.person import Person, draw_person
from prbench.synthetic.people.plan import OPENING, Plan
from prbench.synthetic.people.planner import plan_recording
from prbench.synthetic.people.population import Source, SplitRule, World, cast
from prbench.synthetic.people.presets import PRESETS, Preset
from prbench.synthetic.people.provocations import shares_for
from prbench.synthetic.people.repair import repaired
from prbench.synthetic.people.steps import plan_steps
from prbench.synthetic.people.truth import Scene, events_of_others, true_events
from prbench.synthetic.people.world import Room, draw_room, seated
from prbench.synthetic.performance import Fixation, ObjectMotion, Performance

_CLOSING = 2.0  # seconds after the last movement
_WORST_WRIST = 0.020
_ATTEMPTS = 6
_REPAIRS = 3
_OTHERS_OBJECTS = 4  # ids kept for what a bystander moves


def perform(
    preset: str,
    *,
    seed: int,
    index: int,
    world: World = "default",
    n_events: int = 10,
    rate: float = 120.0,
    provocations: Mapping[str, float] | None = None,
    bystander_objects: int | None = None,
    split_rule: SplitRule = "person_and_room",
) -> Performance:
    """Act out one recording.

    Equal arguments give equal arrays; recording ``index`` depends on nothing but the arguments.

    Args:
        preset: ``hd-epic``, ``mogaze``, ``hot3d``, ``adt`` or ``gimo``.
        seed: Of the whole synthetic dataset.
        index: Of the recording in it.
        world: How many people and rooms exist: 24 and 12, or 400 and 200.
        n_events: Picks and puts.
        rate: Frames a second.
        provocations: Share of the movements for each tag of docs/specification/synthetic-recordings.md#provocations;
        None: 10 % together, {}: none.
        bystander_objects: Objects that never move; 3 to 12, drawn with the room, if None.
        split_rule: See :func:`prbench.synthetic.people.population.cast`.

    Raises:
        UsageError: if there is no such preset.
    """
    if preset not in PRESETS:
        raise UsageError(f"synthetic preset '{preset}' is unknown. Take one of: {', '.join(PRESETS)}.")
    constants, source = PRESETS[preset], Source(seed, preset, world)
    casting = cast(source, index, split_rule)
    person = draw_person(constants, f"S{casting.person:03d}", source.generator("person", casting.person, "body"))
    room_rng = source.generator("room", casting.room, "plan")
    room = draw_room(constants, f"R{casting.room:03d}", room_rng, bystander_objects)
    shares = shares_for(constants, provocations)
    plan, motion, times = _acted(constants, source, room, person, index, n_events, rate, shares)
    gaze_plan, gaze = _looked(source, index, plan, motion, times)
    ids = _object_ids(source, index, len(plan.items) + _OTHERS_OBJECTS)
    objects = move_objects(plan, motion.joints[:, 20:22], motion.hands, times, ids[:-_OTHERS_OBJECTS])
    recording_id = name_of_recording(preset, seed, index)
    scene = Scene(times, motion.joints, motion.eye, gaze)
    events = true_events(plan, gaze_plan, scene, objects, recording_id)
    chance = source.generator("recording", index, "bystander").random()
    others = ()
    if chance < shares.get("bystander", 0.0) * n_events:
        other = bystander_acts(source, index, plan, motion, times, ids[-_OTHERS_OBJECTS:])
        if other is not None:
            others = (other.person,)
            events += events_of_others(other.plan, scene, other.objects, recording_id)
            objects += other.objects
    return Performance(
        preset=preset,
        world=world,
        seed=seed,
        index=index,
        recording_id=recording_id,
        room_id=plan.room.room_id,
        split=casting.split,
        person=person.style(),
        rate=rate,
        times=times,
        joints=motion.joints,
        rotations=motion.rotations,
        finger_bases=motion.finger_bases,
        head_rotation=motion.head_rotation,
        eye=motion.eye,
        gaze=gaze,
        planted=motion.planted,
        objects=(*objects, *_furniture(plan, source, casting.room)),
        events=events,
        fixations=tuple(_fixation(look, recording_id) for look in gaze_plan.looks),
        other_people=others,
    )


def _acted(
    preset: Preset,
    source: Source,
    room: Room,
    person: Person,
    index: int,
    n_events: int,
    rate: float,
    shares: Mapping[str, float],
) -> tuple[Plan, Motion, np.ndarray]:
    """Plan and motion; planned anew when a wrist stays more than 2 cm from its target."""

    def act(attempt: int) -> tuple[Plan, Motion, np.ndarray]:
        rng = source.generator("recording", index, f"plan{attempt}")
        is_seated = bool(rng.random() < preset.seated_share)
        here = seated(room, source.generator("recording", index, "table")) if is_seated else room
        provoker = source.generator("recording", index, f"provocations{attempt}")
        plan = plan_recording(
            preset, person, here, n_events, rng, is_seated=is_seated, shares=shares, provoker=provoker
        )
        times = np.arange(round(_duration(plan) * rate) + 1) / rate
        purposes = (source.generator("recording", index, f"{purpose}{attempt}") for purpose in ("sway", "gaze", "head"))
        return plan, synthesise(plan, times, Generators(*purposes)), times

    acted = act(0)
    for attempt in range(1, _ATTEMPTS):
        if max(acted[1].misses, default=0.0) <= _WORST_WRIST:
            break
        acted = act(attempt)
    return acted


def _looked(source: Source, index: int, plan: Plan, motion: Motion, times: np.ndarray) -> tuple[GazePlan, np.ndarray]:
    """True gaze, after moving fills that would prime a goal too early; the head stays as it was."""
    gaze_plan, shifts = motion.gaze_plan, source.generator("recording", index, "repair")
    gaze = np.empty((0, 3))
    for left in reversed(range(_REPAIRS + 1)):
        gaze = move_eyes(gaze_plan.looks, motion.head, motion.eye, times, source.generator("recording", index, "eye"))
        better = repaired(plan, gaze_plan, motion.eye, gaze, times, shifts) if left else gaze_plan
        if better is gaze_plan:
            break
        gaze_plan = better
    return gaze_plan, gaze


def _duration(plan: Plan) -> float:
    ends = [
        reach.event + 1.2 + (0.0 if reach.carries else reach.dwell) for reach in plan.reaches if isfinite(reach.dwell)
    ]
    ends += [step.landing for step in plan_steps(plan.person, plan.segments)]
    tenths = np.ceil(10.0 * (max(ends, default=OPENING) + _CLOSING))  # streams of 10, 30 and 120 Hz end together
    return float(tenths) / 10.0


def _object_ids(source: Source, index: int, count: int) -> list[str]:
    """Sixteen decimal digits each, distinct within the recording."""
    rng = source.generator("object", index, "id")
    numbers: list[int] = []
    while len(numbers) < count:
        number = int(rng.integers(10**15, 9 * 10**15))
        if number not in numbers:
            numbers.append(number)
    return [str(number) for number in numbers]


def name_of_recording(preset: str, seed: int, index: int) -> str:
    """The recording's id, known before it is acted out; unlike any real one."""
    if preset == "adt":
        return f"Apartment_release_synthetic_seed{seed}_seq{index:03d}_M1292"
    return f"{preset}_synthetic_seed{seed}_{index:04d}"


def _furniture(plan: Plan, source: Source, room_index: int) -> list[ObjectMotion]:
    """Each surface as a static box from the floor, or a board, up to its top."""
    rng = source.generator("room", room_index, "furniture-id")
    pieces = []
    for number, surface in enumerate(plan.room.surfaces):
        thickness = surface.height if surface.height < 1.0 else 0.03
        half = np.array([surface.width / 2.0, thickness / 2.0, surface.kind.depth / 2.0])
        centre = surface.point(0.0, surface.kind.depth / 2.0) - np.array([0.0, thickness / 2.0, 0.0])
        heading = surface.facing
        pieces.append(
            ObjectMotion(
                object_id=str(int(rng.integers(9 * 10**15, 10**16))),
                name=f"{surface.kind.name.title().replace(' ', '')}_{number + 1}",
                category=surface.kind.name,
                half_extents=half,
                position=centre[None],
                rotation=np.array([[np.cos(heading / 2.0), 0.0, np.sin(heading / 2.0), 0.0]]),
                held_by=np.array([-1]),
                movable=False,
            )
        )
    return pieces


def _fixation(look: Look, recording_id: str) -> Fixation:
    event = None if look.reach is None else f"{recording_id}/{look.reach:03d}"
    return Fixation(float(look.start), float(look.end), look.point, "goal" if look.is_goal else "fill", event)
