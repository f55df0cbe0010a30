"""One recording from its seed: world, person, plan, motion, gaze, truth.

Source: ``methods/synthetic-recordings.md``.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from prbench.errors import UsageError
from prbench.synthetic.people.carry import move_objects
from prbench.synthetic.people.gaze_plan import Look
from prbench.synthetic.people.head_eye import move_eyes
from prbench.synthetic.people.motion import Generators, Motion, synthesise
from prbench.synthetic.people.person import Person, draw_person
from prbench.synthetic.people.plan import Plan, plan_recording
from prbench.synthetic.people.population import Source, SplitRule, World, cast
from prbench.synthetic.people.presets import PRESETS, Preset
from prbench.synthetic.people.steps import plan_steps
from prbench.synthetic.people.truth import Scene, true_events
from prbench.synthetic.people.world import draw_room, seated
from prbench.synthetic.performance import Fixation, ObjectMotion, Performance

_CLOSING = 2.0  # seconds after the last movement
_WORST_WRIST = 0.020
_ATTEMPTS = 6


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
        provocations: Share of the movements for each tag of section 7; None: 10 % together, {}: none.
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
    plan, motion, times = _acted(constants, source, casting.room, person, index, n_events, rate, bystander_objects)
    gaze = move_eyes(
        motion.gaze_plan.looks, motion.head, motion.eye, times, source.generator("recording", index, "eye")
    )
    ids = _object_ids(source, index, len(plan.items))
    objects = move_objects(plan, motion.joints[:, 20:22], motion.hands, times, ids)
    recording_id = _recording_id(preset, seed, index)
    scene = Scene(times, motion.joints, motion.eye, gaze)
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
        events=true_events(plan, motion.gaze_plan, scene, objects, recording_id),
        fixations=tuple(_fixation(look, recording_id) for look in motion.gaze_plan.looks),
    )


def _acted(
    preset: Preset,
    source: Source,
    room_index: int,
    person: Person,
    index: int,
    n_events: int,
    rate: float,
    bystander_objects: int | None,
) -> tuple[Plan, Motion, np.ndarray]:
    """Plan and motion; planned anew when a wrist stays more than 2 cm from its target."""
    room = draw_room(preset, f"R{room_index:03d}", source.generator("room", room_index, "plan"), bystander_objects)
    for attempt in range(_ATTEMPTS):
        rng = source.generator("recording", index, f"plan{attempt}")
        is_seated = bool(rng.random() < preset.seated_share)
        here = seated(room, source.generator("room", room_index, "seated")) if is_seated else room
        plan = plan_recording(preset, person, here, n_events, rng, is_seated=is_seated)
        times = np.arange(int(np.ceil(_duration(plan) * rate)) + 1) / rate
        purposes = (source.generator("recording", index, f"{purpose}{attempt}") for purpose in ("sway", "gaze", "head"))
        motion = synthesise(plan, times, Generators(*purposes))
        if max(motion.misses, default=0.0) <= _WORST_WRIST:
            break
    return plan, motion, times


def _duration(plan: Plan) -> float:
    ends = [reach.event + 1.2 for reach in plan.reaches]
    ends += [step.landing for step in plan_steps(plan.person, plan.segments)]
    return max(ends, default=2.5) + _CLOSING


def _object_ids(source: Source, index: int, count: int) -> list[str]:
    """Sixteen decimal digits each, distinct within the recording."""
    rng = source.generator("object", index, "id")
    numbers: list[int] = []
    while len(numbers) < count:
        number = int(rng.integers(10**15, 9 * 10**15))
        if number not in numbers:
            numbers.append(number)
    return [str(number) for number in numbers]


def _recording_id(preset: str, seed: int, index: int) -> str:
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
    return Fixation(look.start, look.end, look.point, "goal" if look.is_goal else "fill", event)
