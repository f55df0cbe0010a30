"""One recording from its seed: world, person, plan, motion, gaze, truth.

Source: docs/specification/synthetic-recordings.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from prbench.errors import UsageError
from prbench.synthetic.people.base import sample_base
from prbench.synthetic.people.carry import move_objects
from prbench.synthetic.people.gaze_plan import GazePlan, Look, repaired
from prbench.synthetic.people.head_eye import move_eyes
from prbench.synthetic.people.legs import plan_steps
from prbench.synthetic.people.motion import Generators, Motion, synthesise
from prbench.synthetic.people.person import Person, draw_person
from prbench.synthetic.people.plan import OPENING, Plan, shares_for
from prbench.synthetic.people.planner import plan_recording
from prbench.synthetic.people.presets import PRESETS, Preset
from prbench.synthetic.people.truth import Scene, events_of_others, true_events
from prbench.synthetic.people.world import Item, Room, Source, SplitRule, World, assign, draw_room, seated
from prbench.synthetic.performance import Fixation, ObjectMotion, OtherPerson, Performance

_EVENTS = 2
_PLANS_OF_BYSTANDER = 8
_POLITE_DISTANCE = 0.9  # metres between two people
_CLOSING = 2.0  # seconds after the last movement
_WORST_WRIST = 0.020  # metres between wrist and target, beyond which a recording is planned anew
_ATTEMPTS = 6
_REPAIRS = 3  # rounds of moving fills that would prime a goal too early
_OTHERS_OBJECTS = 4  # ids kept for what a bystander moves


@dataclass(frozen=True)
class _Bystander:
    """The other person, what they planned, and the objects that they moved."""

    person: OtherPerson
    plan: Plan
    objects: list[ObjectMotion]


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
        split_rule: See :func:`prbench.synthetic.people.world.assign`.

    Raises:
        UsageError: if there is no such preset.
    """
    if preset not in PRESETS:
        raise UsageError(f"synthetic preset '{preset}' is unknown. Take one of: {', '.join(PRESETS)}.")
    constants = PRESETS[preset]
    source = Source(seed, preset, world)
    assigned = assign(source, index, split_rule)
    person = draw_person(constants, f"S{assigned.person:03d}", source.generator("person", assigned.person, "body"))
    room_rng = source.generator("room", assigned.room, "plan")
    room = draw_room(constants, f"R{assigned.room:03d}", room_rng, bystander_objects)
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
        other = _bystander_acts(source, index, plan, motion, times, ids[-_OTHERS_OBJECTS:])
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
        split=assigned.split,
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
        objects=(*objects, *_furniture(plan, source, assigned.room)),
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
    """Return the true gaze, after moving fills that would prime a goal too early; the head stays as it was."""
    gaze_plan = motion.gaze_plan
    shifts = source.generator("recording", index, "repair")
    gaze = np.empty((0, 3))
    for left in reversed(range(_REPAIRS + 1)):
        gaze = move_eyes(gaze_plan.looks, motion.head, motion.eye, times, source.generator("recording", index, "eye"))
        better = repaired(plan, gaze_plan, motion.eye, gaze, times, shifts) if left else gaze_plan
        if better is gaze_plan:
            break
        gaze_plan = better
    return gaze_plan, gaze


def _object_ids(source: Source, index: int, count: int) -> list[str]:
    """Draw ids of sixteen decimal digits, distinct within the recording."""
    rng = source.generator("object", index, "id")
    numbers: list[int] = []
    while len(numbers) < count:
        number = int(rng.integers(10**15, 9 * 10**15))
        if number not in numbers:
            numbers.append(number)
    return [str(number) for number in numbers]


def name_of_recording(preset: str, seed: int, index: int) -> str:
    """Return the recording's id, known before it is acted out; unlike any real one."""
    if preset == "adt":
        return f"Apartment_release_synthetic_seed{seed}_seq{index:03d}_M1292"
    return f"{preset}_synthetic_seed{seed}_{index:04d}"


def _bystander_acts(
    source: Source, index: int, wearer: Plan, motion: Motion, times: np.ndarray, object_ids: list[str]
) -> _Bystander | None:
    """Let somebody else pick and put one object in the same room at the same time.

    Args:
        source: Names the generators.
        index: Of the recording.
        wearer: Whose objects must not be in the way.
        motion: Of the wearer, to keep away from.
        times: Frame times of the recording, seconds.
        object_ids: Ids for the objects of the other person.

    Returns:
        None if the recording is too short for it.
    """
    preset = wearer.preset
    participant = f"B{index:04d}"
    person = draw_person(preset, participant, source.generator("recording", index, "bystander-body"))
    taken = [_stand_in(wearer, reach.item, reach.centre) for reach in wearer.reaches]
    room = replace(wearer.room, bystanders=(*wearer.room.bystanders, *taken))
    best: tuple[float, Plan] | None = None
    for attempt in range(_PLANS_OF_BYSTANDER):
        plan = plan_recording(
            preset, person, room, _EVENTS, source.generator("recording", index, f"bystander-plan{attempt}")
        )
        if len(plan.reaches) < _EVENTS or plan.reaches[-1].event > times[-1] - 1.5:
            continue
        path = sample_base(plan.start, plan.segments, times)
        distance = float(np.hypot(path.x - motion.base.x, path.z - motion.base.z).min())
        if best is None or distance > best[0]:
            best = distance, plan
        if distance > _POLITE_DISTANCE:
            break
    return None if best is None else _move_bystander(source, index, best[1], times, object_ids)


def _stand_in(wearer: Plan, item: int, centre: np.ndarray) -> Item:
    """Return something that stands where the wearer's object was or will be."""
    return replace(wearer.items[item], position=centre, rides_on=None)


def _move_bystander(source: Source, index: int, plan: Plan, times: np.ndarray, object_ids: list[str]) -> _Bystander:
    purposes = (source.generator("recording", index, f"bystander-{name}") for name in ("sway", "gaze", "head"))
    motion = synthesise(plan, times, Generators(*purposes))
    handled = 1 + max(reach.item for reach in plan.reaches)
    plan = replace(plan, items=plan.items[:handled])
    objects = move_objects(plan, motion.joints[:, 20:22], motion.hands, times, object_ids[:handled])
    held = [replace(item, held_by=np.where(item.held_by >= 0, 2, -1)) for item in objects]
    person = OtherPerson(plan.person.participant_id, motion.joints, motion.finger_bases)
    return _Bystander(person, plan, held)


def _furniture(plan: Plan, source: Source, room_index: int) -> list[ObjectMotion]:
    """Return each surface as a static box from the floor, or a board, up to its top."""
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


def _duration(plan: Plan) -> float:
    ends = [
        reach.event + 1.2 + (0.0 if reach.carries else reach.dwell) for reach in plan.reaches if isfinite(reach.dwell)
    ]
    ends += [step.landing for step in plan_steps(plan.person, plan.segments)]
    tenths = np.ceil(10.0 * (max(ends, default=OPENING) + _CLOSING))  # streams of 10, 30 and 120 Hz end together
    return float(tenths) / 10.0
