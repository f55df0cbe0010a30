"""Turns a plan into joints: base, feet, trunk, head, arms, legs, in this order, refined until the wrists arrive.

Sources: docs/specification/synthetic-recordings.md#base-motion,
docs/specification/synthetic-recordings.md#reaching-and-holding and
docs/specification/synthetic-recordings.md#eye-head-trunk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench.synthetic.people.arms import Arms, move_wrists, pose_arms, turn_hands
from prbench.synthetic.people.base import BasePath, sample_base
from prbench.synthetic.people.gaze_plan import GazePlan, plan_gaze
from prbench.synthetic.people.grasp import Posture, shoulder_in_posture, solve_posture
from prbench.synthetic.people.head_eye import Head, move_head
from prbench.synthetic.people.kinematics import frame_of_bone, quaternion, rotation_quaternion, turn
from prbench.synthetic.people.legs import Feet, Legs, place_feet, plan_steps, pose_legs
from prbench.synthetic.people.person import Trunk
from prbench.synthetic.people.plan import Plan
from prbench.synthetic.people.posture import bend, draw_sway, move_trunk

_WRIST_TOLERANCE = 0.008  # metres
_CORRECTIONS = 2  # rounds; what is left decides whether the recording is planned anew


@dataclass(frozen=True)
class Generators:
    """One stream for each kind of choice, so that a change in one leaves the others alone."""

    sway: np.random.Generator
    gaze: np.random.Generator
    head: np.random.Generator


@dataclass(frozen=True)
class Motion:
    """The whole body at every frame."""

    joints: Float[np.ndarray, "n 22 3"]
    rotations: Float[np.ndarray, "n 22 4"]
    head: Head
    head_rotation: Float[np.ndarray, "n 4"]
    eye: Float[np.ndarray, "n 3"]
    hands: Float[np.ndarray, "n 2 3 3"]
    finger_bases: Float[np.ndarray, "n 2 3"]
    planted: Bool[np.ndarray, "n 2"]
    base: BasePath
    gaze_plan: GazePlan
    misses: tuple[float, ...]
    """Distance of the wrist from its target at every event, metres."""


def synthesise(plan: Plan, times: Float[np.ndarray, " n"], generators: Generators) -> Motion:
    """Act out a plan.

    Args:
        plan: All decisions but the looks.
        times: Uniform frame times, seconds.
        generators: Of small movements, looks and head tremor.
    """
    person = plan.person
    base = sample_base(plan.start, plan.segments, times)
    steps = plan_steps(person, plan.segments)
    feet = place_feet(person, base, steps, times, seated=plan.is_seated)
    sway = draw_sway(plan, base, steps, times, generators.sway)
    postures = [reach.posture for reach in plan.reaches]

    rough = move_trunk(plan, base, bend(plan, postures, times), sway, feet, steps, times, None)
    rough_eye = _rough_eye(plan, rough)
    gaze_plan = plan_gaze(plan, base, rough_eye, times, generators.gaze)
    head = move_head(plan.preset, person.habits, gaze_plan, base.heading, rough_eye, times, generators.head)

    def act(tried: list[Posture]) -> tuple[Trunk, Arms, tuple[float, ...]]:
        trunk = move_trunk(plan, base, bend(plan, tried, times), sway, feet, steps, times, head)
        arms = pose_arms(person.body, person.habits.elbow_flare, trunk, move_wrists(plan, trunk, sway, times))
        return trunk, arms, _misses(plan, arms, times)

    trunk, arms, misses = act(postures)
    for _ in range(_CORRECTIONS):
        if max(misses, default=0.0) <= _WRIST_TOLERANCE:
            break
        postures = _corrected(plan, postures, misses, trunk, times)
        trunk, arms, misses = act(postures)
    return assemble(plan, base, feet, trunk, head, arms, times, gaze_plan, misses)


def _rough_eye(plan: Plan, trunk: Trunk) -> np.ndarray:
    """Return the eye positions of a head that looks along the chest."""
    body = plan.person.body
    up = body.neck_length * np.cos(body.neck_tilt) + body.eye[1]
    ahead = body.neck_length * np.sin(body.neck_tilt) + body.eye[2]
    return trunk.neck + turn(trunk.yaws[3], 0.0, np.array([0.0, up, ahead]))


def _misses(plan: Plan, arms: Arms, times: np.ndarray) -> tuple[float, ...]:
    frames = np.searchsorted(times, [reach.event for reach in plan.reaches])
    return tuple(
        float(np.linalg.norm(arms.wrist[frame, reach.hand] - reach.grasp.wrist))
        for frame, reach in zip(frames, plan.reaches, strict=True)
    )


def _corrected(
    plan: Plan,
    postures: list[Posture],
    misses: tuple[float, ...],
    trunk: Trunk,
    times: np.ndarray,
) -> list[Posture]:
    """Solve the posture again where the wrist did not arrive, with the shoulder where it really was."""
    frames = np.searchsorted(times, [reach.event for reach in plan.reaches])
    postures = list(postures)
    for number, reach in enumerate(plan.reaches):
        if misses[number] <= _WRIST_TOLERANCE:
            continue
        planned = shoulder_in_posture(plan.person, reach.base, reach.hand, postures[number], plan.pelvis_height)
        offset = trunk.shoulders[reach.hand][frames[number]] - planned
        posture = solve_posture(plan.person, reach.base, reach.hand, reach.grasp.wrist, plan.pelvis_height, offset)
        postures[number] = replace(posture, chest_turn=reach.posture.chest_turn)
    return postures


def assemble(
    plan: Plan,
    base: BasePath,
    feet: Feet,
    trunk: Trunk,
    head: Head,
    arms: Arms,
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
    hands = turn_hands(plan, arms, times)
    head_rotation = rotation_quaternion(head.yaw, head.pitch)
    return Motion(
        joints=_joints(trunk, legs, arms, head_joint),
        rotations=_rotations(trunk, legs, arms, feet, rotation_quaternion(neck_yaw, neck_pitch), head_rotation, hands),
        head=head,
        head_rotation=head_rotation,
        eye=eye,
        hands=hands,
        finger_bases=arms.wrist + body.hand * hands[..., 1],
        planted=feet.planted,
        base=base,
        gaze_plan=gaze_plan,
        misses=misses,
    )


def _joints(trunk: Trunk, legs: Legs, arms: Arms, head_joint: np.ndarray) -> Float[np.ndarray, "n 22 3"]:
    joints = np.empty((len(head_joint), N_JOINTS, 3))
    joints[:, Joint.PELVIS] = trunk.pelvis
    joints[:, [Joint.SPINE1, Joint.SPINE2, Joint.SPINE3]] = np.stack(trunk.spine, axis=1)
    joints[:, Joint.NECK] = trunk.neck
    joints[:, Joint.HEAD] = head_joint
    joints[:, [Joint.LEFT_HIP, Joint.RIGHT_HIP]] = np.stack(trunk.hips, axis=1)
    joints[:, [Joint.LEFT_KNEE, Joint.RIGHT_KNEE]] = legs.knee
    joints[:, [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]] = legs.ankle
    joints[:, [Joint.LEFT_FOOT, Joint.RIGHT_FOOT]] = legs.ball
    joints[:, [Joint.LEFT_COLLAR, Joint.RIGHT_COLLAR]] = np.stack(trunk.collars, axis=1)
    joints[:, [Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER]] = np.stack(trunk.shoulders, axis=1)
    joints[:, [Joint.LEFT_ELBOW, Joint.RIGHT_ELBOW]] = arms.elbow
    joints[:, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]] = arms.wrist
    return joints


def _rotations(
    trunk: Trunk, legs: Legs, arms: Arms, feet: Feet, neck: np.ndarray, head: np.ndarray, hands: np.ndarray
) -> Float[np.ndarray, "n 22 4"]:
    """Return world from segment at each joint: trunk and feet y up, limbs y along the bone, x the hinge."""
    turned = np.empty((len(head), N_JOINTS, 4))
    for joint, yaw, pitch in zip(
        (Joint.PELVIS, Joint.SPINE1, Joint.SPINE2, Joint.SPINE3), trunk.yaws, trunk.pitches, strict=True
    ):
        turned[:, joint] = rotation_quaternion(yaw, pitch)
    turned[:, Joint.NECK], turned[:, Joint.HEAD] = neck, head
    hips = np.stack(trunk.hips, axis=1)
    shoulders = np.stack(trunk.shoulders, axis=1)
    knee_hinge = np.cross(legs.knee - hips, legs.ankle - legs.knee)
    foot = rotation_quaternion(feet.yaw, feet.pitch)
    for side in (0, 1):
        turned[:, Joint.LEFT_COLLAR + side] = turned[:, Joint.SPINE3]
        turned[:, Joint.LEFT_HIP + side] = quaternion(
            frame_of_bone(legs.knee[:, side] - hips[:, side], knee_hinge[:, side])
        )
        turned[:, Joint.LEFT_KNEE + side] = quaternion(
            frame_of_bone(legs.ankle[:, side] - legs.knee[:, side], knee_hinge[:, side])
        )
        turned[:, Joint.LEFT_ANKLE + side] = foot[:, side]
        turned[:, Joint.LEFT_FOOT + side] = foot[:, side]
        turned[:, Joint.LEFT_SHOULDER + side] = quaternion(
            frame_of_bone(arms.elbow[:, side] - shoulders[:, side], arms.hinge[:, side])
        )
        turned[:, Joint.LEFT_ELBOW + side] = quaternion(
            frame_of_bone(arms.wrist[:, side] - arms.elbow[:, side], arms.hinge[:, side])
        )
        turned[:, Joint.LEFT_WRIST + side] = quaternion(hands[:, side])
    return turned
