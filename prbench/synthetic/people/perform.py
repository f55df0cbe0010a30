"""One recording from its seed: world, person, plan, motion, gaze, truth.

Source: docs/specification/synthetic-recordings.md. The motion is made in the order base, feet, trunk, head, arms, legs,
and refined until the wrists arrive.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from jaxtyping import Bool, Float

from prbench.errors import UsageError
from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench.synthetic.people import body as bodies
from prbench.synthetic.people.gaze_plan import GazePlan, plan_gaze, repaired
from prbench.synthetic.people.kinematics import frame_of_bone, quaternion, rotation_quaternion, turn
from prbench.synthetic.people.person import PRESETS, Person, Trunk, draw_person, of_second_world
from prbench.synthetic.people.plan import OPENING, Plan, plan_recording, shares_for
from prbench.synthetic.people.reaching import Reacher, shoulder_in_posture, solve_posture
from prbench.synthetic.people.truth import Scene, events_of_others, move_objects, true_events
from prbench.synthetic.people.walking import BasePath, Feet, Legs, place_feet, plan_steps, pose_legs, sample_base
from prbench.synthetic.people.world import Room, Source, assign, draw_room, seated
from prbench.synthetic.performance import Fixation, ObjectMotion, OtherPerson, Performance, World

_WRIST_TOLERANCE = 0.008  # metres
_CORRECTIONS = 2  # rounds; what is left decides whether the recording is planned anew


# One stream for each kind of choice (sway, gaze, head), so that a change in one leaves the others alone.
Quaternions = Float[np.ndarray, "n 4"]
Hands = Float[np.ndarray, "n 2 3 3"]
Generators = tuple[np.random.Generator, np.random.Generator, np.random.Generator]


@dataclass(frozen=True)
class Motion:
    """The whole body at every frame.

    Attributes:
        misses: Distance of the wrist from its target at every event, metres.
    """

    joints: Float[np.ndarray, "n 22 3"]
    rotations: Float[np.ndarray, "n 22 4"]
    head: bodies.Head
    head_rotation: Quaternions
    eye: Float[np.ndarray, "n 3"]
    hands: Hands
    finger_bases: Float[np.ndarray, "n 2 3"]
    planted: Bool[np.ndarray, "n 2"]
    base: BasePath
    gaze_plan: GazePlan
    misses: tuple[float, ...]


def synthesise(plan: Plan, times: Float[np.ndarray, " n"], generators: Generators) -> Motion:
    """Act out a plan.

    Args:
        plan: All decisions but the looks.
        times: Uniform frame times, seconds.
        generators: Generators of small movements, looks and head tremor.
    """
    person = plan.person
    for_sway, for_gaze, for_head = generators
    base = sample_base(plan.start, plan.segments, times)
    steps = plan_steps(person, plan.segments)
    feet = place_feet(person, base, steps, times, seated=plan.is_seated)
    sway = bodies.draw_sway(plan, base, steps, times, for_sway)
    postures = [reach.posture for reach in plan.reaches]

    rough = bodies.move_trunk(plan, base, bodies.bend(plan, postures, times), sway, feet, steps, times, None)
    # The eye positions of a head that looks along the chest.
    body = person.body
    up = body.neck_length * np.cos(body.neck_tilt) + body.eye[1]
    ahead = body.neck_length * np.sin(body.neck_tilt) + body.eye[2]
    rough_eye = rough.neck + turn(rough.yaws[3], 0.0, np.array([0.0, up, ahead]))
    gaze_plan = plan_gaze(plan, base, rough_eye, times, for_gaze)
    head = bodies.move_head(plan, gaze_plan, base.heading, rough_eye, times, for_head)

    frames = np.searchsorted(times, [reach.event for reach in plan.reaches])
    left = _CORRECTIONS
    while True:
        trunk = bodies.move_trunk(plan, base, bodies.bend(plan, postures, times), sway, feet, steps, times, head)
        arms = bodies.pose_arms(body, person.habits.elbow_flare, trunk, bodies.move_wrists(plan, trunk, sway, times))
        misses = tuple(
            float(np.linalg.norm(arms.wrist[frame, reach.hand] - reach.grasp.wrist))
            for frame, reach in zip(frames, plan.reaches, strict=True)
        )
        if not left or max(misses, default=0.0) <= _WRIST_TOLERANCE:
            break
        left -= 1
        # Solve the posture again where the wrist did not arrive, with the shoulder where it really was.
        for number, reach in enumerate(plan.reaches):
            if misses[number] > _WRIST_TOLERANCE:
                who = Reacher(person, reach.base, reach.hand, plan.pelvis_height)
                offset = trunk.shoulders[reach.hand][frames[number]] - shoulder_in_posture(who, postures[number])
                posture = solve_posture(who, reach.grasp.wrist, offset)
                postures[number] = replace(posture, chest_turn=reach.posture.chest_turn)
    return assemble(plan, base, feet, trunk, head, arms, times, gaze_plan, misses)


def assemble(
    plan: Plan,
    base: BasePath,
    feet: Feet,
    trunk: Trunk,
    head: bodies.Head,
    arms: bodies.Arms,
    times: np.ndarray,
    gaze_plan: GazePlan,
    misses: tuple[float, ...],
) -> Motion:
    """Assemble the body from its parts: legs below the hips, neck and head above the chest, hands at the wrists."""
    body = plan.person.body
    habits = plan.person.habits
    legs = pose_legs(body, np.stack(trunk.hips, axis=1), trunk.yaws[0], feet)
    neck_yaw = trunk.yaws[3] + habits.neck_share * (head.yaw - trunk.yaws[3])
    neck_pitch = trunk.pitches[3] + habits.neck_share * (head.pitch - trunk.pitches[3])
    along_neck = body.neck_length * np.array([0.0, np.cos(body.neck_tilt), np.sin(body.neck_tilt)])
    head_joint = trunk.neck + turn(neck_yaw, neck_pitch, along_neck)
    eye = head_joint + turn(head.yaw, head.pitch, np.array(body.eye))
    hands = bodies.turn_hands(plan, arms, times)
    head_rotation = rotation_quaternion(head.yaw, head.pitch)
    neck = rotation_quaternion(neck_yaw, neck_pitch)
    hips = np.stack(trunk.hips, axis=1)
    shoulders = np.stack(trunk.shoulders, axis=1)
    joints = np.empty((len(head_joint), N_JOINTS, 3))
    joints[:, Joint.PELVIS] = trunk.pelvis
    joints[:, [Joint.SPINE1, Joint.SPINE2, Joint.SPINE3]] = np.stack(trunk.spine, axis=1)
    joints[:, Joint.NECK] = trunk.neck
    joints[:, Joint.HEAD] = head_joint
    for left, pair in (
        (Joint.LEFT_HIP, hips),
        (Joint.LEFT_KNEE, legs.knee),
        (Joint.LEFT_ANKLE, legs.ankle),
        (Joint.LEFT_FOOT, legs.ball),
        (Joint.LEFT_COLLAR, np.stack(trunk.collars, axis=1)),
        (Joint.LEFT_SHOULDER, shoulders),
        (Joint.LEFT_ELBOW, arms.elbow),
        (Joint.LEFT_WRIST, arms.wrist),
    ):
        joints[:, left : left + 2] = pair  # the right joint of a pair follows the left one
    rotations = _segment_rotations(trunk, neck, head_rotation, legs, feet, arms, hands)
    finger_bases = arms.wrist + body.hand * hands[..., 1]
    seen = (head, head_rotation, eye, hands, finger_bases)
    return Motion(joints, rotations, *seen, feet.planted, base, gaze_plan, misses)


def _segment_rotations(
    trunk: Trunk, neck: Quaternions, head: Quaternions, legs: Legs, feet: Feet, arms: bodies.Arms, hands: Hands
) -> Float[np.ndarray, "n 22 4"]:
    """Return world from segment at each joint: trunk and feet y up, limbs y along the bone, x the hinge."""
    hips = np.stack(trunk.hips, axis=1)
    shoulders = np.stack(trunk.shoulders, axis=1)
    turned = np.empty((len(head), N_JOINTS, 4))
    spine = (Joint.PELVIS, Joint.SPINE1, Joint.SPINE2, Joint.SPINE3)
    for joint, yaw, pitch in zip(spine, trunk.yaws, trunk.pitches, strict=True):
        turned[:, joint] = rotation_quaternion(yaw, pitch)
    turned[:, Joint.NECK] = neck
    turned[:, Joint.HEAD] = head
    knee_hinge = np.cross(legs.knee - hips, legs.ankle - legs.knee)
    foot = rotation_quaternion(feet.yaw, feet.pitch)
    limbs = (
        (Joint.LEFT_HIP, legs.knee - hips, knee_hinge),
        (Joint.LEFT_KNEE, legs.ankle - legs.knee, knee_hinge),
        (Joint.LEFT_SHOULDER, arms.elbow - shoulders, arms.hinge),
        (Joint.LEFT_ELBOW, arms.wrist - arms.elbow, arms.hinge),
    )
    for side in (0, 1):
        turned[:, Joint.LEFT_COLLAR + side] = turned[:, Joint.SPINE3]
        turned[:, Joint.LEFT_ANKLE + side] = foot[:, side]
        turned[:, Joint.LEFT_FOOT + side] = foot[:, side]
        for left, bone, hinge in limbs:
            turned[:, left + side] = quaternion(frame_of_bone(bone[:, side], hinge[:, side]))
        turned[:, Joint.LEFT_WRIST + side] = quaternion(hands[:, side])
    return turned


_EVENTS = 2
_PLANS_OF_BYSTANDER = 8
_POLITE_DISTANCE = 0.9  # metres between two people
_CLOSING = 2.0  # seconds after the last movement
_WORST_WRIST = 0.020  # metres between wrist and target, beyond which a recording is planned anew
_ATTEMPTS = 6
_REPAIRS = 3  # rounds of moving fills that would prime a goal too early
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
) -> Performance:
    """Act out one recording.

    Equal arguments give equal arrays; recording ``index`` depends on nothing but the arguments.

    Args:
        preset: ``hd-epic``, ``mogaze``, ``hot3d``, ``adt`` or ``gimo``.
        seed: Seed of the whole synthetic dataset.
        index: Number of the recording in it.
        world: How many people and rooms exist: 24 and 12, or 400 and 200 (``large``); ``second`` has 24 people who move
        by other laws, for tests of transfer alone.
        n_events: Picks and puts.
        rate: Frames a second.
        provocations: Share of the movements for each tag of docs/specification/synthetic-recordings.md#provocations;
        None: 10 % together, {}: none.
        bystander_objects: Objects that never move; 3 to 12, drawn with the room, if None.

    Raises:
        UsageError: if there is no such preset.
    """
    if preset not in PRESETS:
        raise UsageError(f"synthetic preset '{preset}' is unknown. Take one of: {', '.join(PRESETS)}.")
    constants = PRESETS[preset]
    source = Source(seed, preset, world)
    room_number, person_number, split = assign(source, index)
    person = _casting(source, f"S{person_number:03d}", "person", person_number, "body")
    room_rng = source.generator("room", room_number, "plan")
    room = draw_room(constants, f"R{room_number:03d}", room_rng, bystander_objects)
    shares = shares_for(constants, provocations)
    plan, motion, times = _acted(source, room, person, index, n_events, rate, shares)
    gaze_plan, gaze = _look(source, index, plan, motion, times)
    # Ids of sixteen decimal digits, distinct within the recording.
    id_rng = source.generator("object", index, "id")
    numbers: dict[str, None] = {}
    while len(numbers) < len(plan.items) + _OTHERS_OBJECTS:
        numbers[str(int(id_rng.integers(10**15, 9 * 10**15)))] = None
    ids = list(numbers)
    objects = move_objects(plan, motion.joints[:, 20:22], motion.hands, times, ids[:-_OTHERS_OBJECTS])
    recording_id = name_of_recording(preset, seed, index)
    scene = Scene(times, motion.joints, motion.eye, gaze)
    events = true_events(plan, gaze_plan, scene, objects, recording_id)
    chance = source.generator("recording", index, "bystander").random()
    others = ()
    if chance < shares.get("bystander", 0.0) * n_events:
        other = _bystander_acts(source, index, plan, motion, times, ids[-_OTHERS_OBJECTS:])
        if other is not None:
            passer_by, their_plan, their_objects = other
            others = (passer_by,)
            events += events_of_others(their_plan, scene, their_objects, recording_id)
            objects += their_objects
    fixations = []
    for look in gaze_plan.looks:
        event_id = None if look.reach is None else f"{recording_id}/{look.reach:03d}"
        kind = "goal" if look.is_goal else "fill"
        fixations.append(Fixation(float(look.start), float(look.end), look.point, kind, event_id))
    about = (preset, world, seed, index, recording_id, plan.room.room_id, split, person, rate)
    body = (motion.joints, motion.rotations, motion.finger_bases, motion.head_rotation, motion.eye)
    everything = (*objects, *_furniture(plan, source, room_number))
    return Performance(*about, times, *body, gaze, motion.planted, everything, events, tuple(fixations), others)


def _casting(source: Source, participant_id: str, kind: str, number: int, purpose: str) -> Person:
    """Draw a person of the source's preset and world."""
    rng = source.generator(kind, number, purpose)
    person = draw_person(PRESETS[source.preset], participant_id, rng)
    return of_second_world(person, rng) if source.world == "second" else person


def _look(
    source: Source, index: int, plan: Plan, motion: Motion, times: np.ndarray
) -> tuple[GazePlan, Float[np.ndarray, "n 3"]]:
    """Return the looks and the true gaze, after moving fills that would prime a goal too early; the head stays."""
    gaze_plan = motion.gaze_plan
    shifts = source.generator("recording", index, "repair")
    gaze = np.empty((0, 3))
    for left in reversed(range(_REPAIRS + 1)):
        rng = source.generator("recording", index, "eye")
        gaze = bodies.move_eyes(gaze_plan.looks, motion.head, motion.eye, times, rng)
        better = repaired(plan, gaze_plan, motion.eye, gaze, times, shifts) if left else gaze_plan
        if better is gaze_plan:
            break
        gaze_plan = better
    return gaze_plan, gaze


def _acted(
    source: Source, room: Room, person: Person, index: int, n_events: int, rate: float, shares: Mapping[str, float]
) -> tuple[Plan, Motion, np.ndarray]:
    """Plan and motion; planned anew when a wrist stays more than 2 cm from its target."""
    preset = PRESETS[source.preset]
    attempt = 0
    while True:
        rng = source.generator("recording", index, f"plan{attempt}")
        is_seated = bool(rng.random() < preset.seated_share)
        here = seated(room, source.generator("recording", index, "table")) if is_seated else room
        provoker = source.generator("recording", index, f"provocations{attempt}")
        plan = plan_recording(
            preset, person, here, n_events, rng, is_seated=is_seated, shares=shares, provoker=provoker
        )
        # Until the last reach and step have ended, in tenths of a second: streams of 10, 30 and 120 Hz end together.
        stays = [each for each in plan.reaches if isfinite(each.dwell)]
        ends = [each.event + 1.2 + (0.0 if each.carries else each.dwell) for each in stays]
        ends += [step.landing for step in plan_steps(plan.person, plan.segments)]
        duration = float(np.ceil(10.0 * (max(ends, default=OPENING) + _CLOSING))) / 10.0
        times = np.arange(round(duration * rate) + 1) / rate
        motion = synthesise(plan, times, _generators(source, index, f"{{}}{attempt}"))
        attempt += 1
        if max(motion.misses, default=0.0) <= _WORST_WRIST or attempt == _ATTEMPTS:
            return plan, motion, times


def name_of_recording(preset: str, seed: int, index: int) -> str:
    """Return the recording's id, known before it is acted out; unlike any real one."""
    if preset == "adt":
        return f"Apartment_release_synthetic_seed{seed}_seq{index:03d}_M1292"
    return f"{preset}_synthetic_seed{seed}_{index:04d}"


def _bystander_acts(
    source: Source, index: int, wearer: Plan, motion: Motion, times: np.ndarray, object_ids: list[str]
) -> tuple[OtherPerson, Plan, list[ObjectMotion]] | None:
    """Let somebody else pick and put one object in the same room at the same time.

    Args:
        source: Names the generators.
        index: Number of the recording.
        wearer: Whose objects must not be in the way.
        motion: Motion of the wearer, from whom the other person keeps away.
        times: Frame times of the recording, seconds.
        object_ids: Ids for the objects of the other person.

    Returns:
        The other person, what they planned, and the objects that they moved; None if the recording is too short for it.
    """
    preset = wearer.preset
    person = _casting(source, f"B{index:04d}", "recording", index, "bystander-body")
    # Something that stands where the wearer's object was or will be.
    taken = [replace(wearer.items[reach.item], position=reach.centre, rides_on=None) for reach in wearer.reaches]
    room = replace(wearer.room, bystanders=(*wearer.room.bystanders, *taken))
    best: tuple[float, Plan] | None = None
    for attempt in range(_PLANS_OF_BYSTANDER):
        rng = source.generator("recording", index, f"bystander-plan{attempt}")
        plan = plan_recording(preset, person, room, _EVENTS, rng)
        if len(plan.reaches) < _EVENTS or plan.reaches[-1].event > times[-1] - 1.5:
            continue
        path = sample_base(plan.start, plan.segments, times)
        distance = float(np.hypot(path.x - motion.base.x, path.z - motion.base.z).min())
        if best is None or distance > best[0]:
            best = distance, plan
        if distance > _POLITE_DISTANCE:
            break
    if best is None:
        return None
    plan = best[1]
    motion = synthesise(plan, times, _generators(source, index, "bystander-{}"))
    handled = 1 + max(reach.item for reach in plan.reaches)
    plan = replace(plan, items=plan.items[:handled])
    objects = move_objects(plan, motion.joints[:, 20:22], motion.hands, times, object_ids[:handled])
    held = [replace(item, held_by=np.where(item.held_by >= 0, 2, -1)) for item in objects]
    person = OtherPerson(plan.person.participant_id, motion.joints, motion.finger_bases)
    return person, plan, held


def _generators(source: Source, index: int, purpose: str) -> Generators:
    sway, gaze, head = (source.generator("recording", index, purpose.format(name)) for name in ("sway", "gaze", "head"))
    return sway, gaze, head


def _furniture(plan: Plan, source: Source, room_index: int) -> list[ObjectMotion]:
    """Return each surface as a static box from the floor, or a board, up to its top."""
    rng = source.generator("room", room_index, "furniture-id")
    pieces = []
    for number, surface in enumerate(plan.room.surfaces):
        thickness = surface.height if surface.height < 1.0 else 0.03
        half = np.array([surface.width / 2.0, thickness / 2.0, surface.kind.depth / 2.0])
        centre = surface.point(0.0, surface.kind.depth / 2.0) - np.array([0.0, thickness / 2.0, 0.0])
        heading = surface.facing
        object_id = str(int(rng.integers(9 * 10**15, 10**16)))
        name = f"{surface.kind.name.title().replace(' ', '')}_{number + 1}"
        turned = np.array([[np.cos(heading / 2.0), 0.0, np.sin(heading / 2.0), 0.0]])
        at_rest = (centre[None], turned, np.array([-1]))
        pieces.append(ObjectMotion(object_id, name, surface.kind.name, half, *at_rest, movable=False))
    return pieces
