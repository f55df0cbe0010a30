"""Bodies, gait and reaching, piece by piece."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest

from prbench.geometry.skeleton import bone_lengths
from prbench.randomness import named_generator
from prbench.synthetic.people import PRESETS
from prbench.synthetic.people.kinematics import (
    blend,
    eased_trapezoid,
    matrix_of,
    minimum_jerk,
    quaternion,
    rotation,
    rotation_quaternion,
    turn,
    two_bone,
    wobble,
)
from prbench.synthetic.people.perform import Motion, synthesise
from prbench.synthetic.people.person import Body, Person, draw_person
from prbench.synthetic.people.plan import Plan, plan_recording
from prbench.synthetic.people.reaching import kept_away, solve_posture, take_hold
from prbench.synthetic.people.walking import BasePose, place_feet, plan_segment, plan_steps, sample_base
from prbench.synthetic.people.world import draw_room

ADT = PRESETS["adt"]


def rng(*name: str | int) -> np.random.Generator:
    return named_generator("test", *name)


def test_minimum_jerk_passes_through_the_middle_and_stays_at_its_ends() -> None:
    assert minimum_jerk(np.array([-1.0, 0.0, 0.25, 0.5, 1.0, 2.0])) == pytest.approx([0, 0, 0.103515625, 0.5, 1, 1])


def test_a_blend_ends_exactly_on_a_moving_target() -> None:
    times = np.arange(0.0, 3.0, 0.01)
    channel, target = np.zeros(times.size), np.sin(times)
    blend(channel, times, 0.5, 1.0, target)
    assert np.all(channel[times < 0.5] == 0.0)
    assert np.all(channel[times >= 1.5] == target[times >= 1.5])


def test_an_eased_trapezoid_covers_the_way_without_a_jump_of_speed() -> None:
    progress = eased_trapezoid(np.linspace(0.0, 1.0, 1001), 0.3, 0.4)
    assert progress[[0, -1]] == pytest.approx([0.0, 1.0])
    speed = np.diff(progress) * 1000
    assert speed.max() == pytest.approx(1.0 / (1.0 - 0.15 - 0.2), rel=1e-6)
    assert np.abs(np.diff(speed)).max() < 0.02


def test_a_wobble_has_the_wanted_size() -> None:
    assert np.std(wobble(np.arange(0.0, 400.0, 0.02), 0.3, 0.3, 3.0, rng("wobble"))) == pytest.approx(0.3, rel=0.1)


def test_two_bone_limbs_keep_their_lengths_and_reach_what_is_within_reach() -> None:
    root, target = rng("limb").normal(size=(2, 200, 3))
    pole = np.tile([0.0, -1.0, 0.3], (200, 1))
    middle, end = two_bone(root, target, (0.9, 1.1), pole, (0.95, 0.995))
    assert np.linalg.norm(middle - root, axis=1) == pytest.approx(0.9)
    assert np.linalg.norm(end - middle, axis=1) == pytest.approx(1.1)
    near = np.linalg.norm(target - root, axis=1) < 0.95 * 2.0
    near &= np.linalg.norm(target - root, axis=1) > 0.25
    assert end[near] == pytest.approx(target[near])


def test_quaternions_and_matrices_agree() -> None:
    yaw, pitch = rng("angles").uniform(-7.0, 7.0, (2, 300))
    matrices = rotation(yaw, pitch)
    assert matrix_of(quaternion(matrices)) == pytest.approx(matrices)
    assert rotation_quaternion(yaw, pitch) == pytest.approx(quaternion(matrices))
    assert matrices @ [0.0, 0.0, 1.0] == pytest.approx(turn(yaw, pitch, np.array([0.0, 0.0, 1.0])))


def test_people_differ_in_every_length_and_habit() -> None:
    one, other = (draw_person(ADT, str(number), rng("person", number)) for number in (1, 2))
    same = [f.name for f in fields(one.habits) if getattr(one.habits, f.name) == getattr(other.habits, f.name)]
    assert same in ([], ["right_handed"])
    assert one.body.thigh / one.body.stature != other.body.thigh / other.body.stature


def test_statures_follow_the_specified_spread() -> None:
    statures = [draw_person(ADT, "x", rng("stature", number)).body.stature for number in range(400)]
    assert np.mean(statures) == pytest.approx(1.70, abs=0.02)
    assert np.std(statures) == pytest.approx(0.095, abs=0.01)
    assert 1.50 <= min(statures) <= max(statures) <= 1.95


@pytest.mark.parametrize("goal", [BasePose(2.0, 1.0, 2.5), BasePose(0.2, 0.1, 0.3), BasePose(-1.0, -1.5, -3.0)])
def test_the_base_arrives_exactly_and_so_do_the_feet(goal: BasePose) -> None:
    person = draw_person(ADT, "x", rng("walker"))
    segment = plan_segment(person.habits, 0.9, BasePose(0.0, 0.0, 0.0), goal, 1.0)
    assert segment is not None
    times = np.arange(0.0, segment.end + 2.0, 1 / 120)
    base = sample_base(BasePose(0.0, 0.0, 0.0), (segment,), times)
    assert (base.x[-1], base.z[-1]) == pytest.approx((goal.x, goal.z))
    assert np.cos(base.heading[-1] - goal.heading) == pytest.approx(1.0)
    steps = plan_steps(person, (segment,))
    feet = place_feet(person, base, steps, times, seated=False)
    middle = feet.ball[-1].mean(axis=0) - [goal.x, 0.0, goal.z]
    ahead = 0.62 * person.body.foot_length
    assert middle[[0, 2]] == pytest.approx(ahead * np.array([np.sin(goal.heading), np.cos(goal.heading)]), abs=1e-6)
    assert all(one.foot != following.foot for one, following in pairwise(steps))


def test_planted_feet_do_not_move_at_all() -> None:
    person = draw_person(ADT, "x", rng("walker"))
    segment = plan_segment(person.habits, 0.9, BasePose(0.0, 0.0, 0.0), BasePose(2.0, 1.0, 2.5), 1.0)
    assert segment is not None
    times = np.arange(0.0, segment.end + 2.0, 1 / 120)
    base = sample_base(BasePose(0.0, 0.0, 0.0), (segment,), times)
    feet = place_feet(person, base, plan_steps(person, (segment,)), times, seated=False)
    still = feet.planted[1:] & feet.planted[:-1]
    assert np.all(np.diff(feet.ball, axis=0)[still] == 0.0)


def test_a_small_shift_needs_no_step() -> None:
    person = draw_person(ADT, "x", rng("walker"))
    assert plan_segment(person.habits, 0.9, BasePose(0.0, 0.0, 0.0), BasePose(0.02, 0.01, 0.1), 1.0) is None


def test_low_goals_are_reached_by_bending_and_near_ones_upright() -> None:
    person = draw_person(ADT, "x", rng("reacher"))
    base = BasePose(0.0, 0.0, 0.0)
    high = solve_posture(person, base, 1, np.array([-0.15, 1.2, 0.4]))
    low = solve_posture(person, base, 1, np.array([-0.15, 0.5, 0.5]))
    assert (high.lean, high.crouch) < (np.deg2rad(15.0), 0.1)
    assert low.lean + low.crouch > high.lean + high.crouch + 0.5
    assert solve_posture(person, base, 1, np.array([-0.15, 1.0, 1.6])).extension > 0.92


def test_adt_fingertips_stop_a_centimetre_before_the_box() -> None:
    person = draw_person(ADT, "x", rng("reacher"))
    half, centre, yaw = np.array([0.04, 0.06, 0.03]), np.array([0.1, 1.0, 0.5]), 0.7
    grasp = take_hold(ADT, person.body, np.array([0.0, 1.4, 0.0]), centre, half, yaw, 0.012)
    finger = grasp.wrist + person.body.hand * grasp.hand[:, 1]
    in_box = turn(-yaw, 0.0, finger - centre)
    assert 0.004 < np.linalg.norm(np.maximum(np.abs(in_box) - half, 0.0)) <= 0.012 + 1e-9
    away = kept_away(grasp, person.body.hand, centre, half, yaw, 0.04)
    in_box = turn(-yaw, 0.0, away.wrist + person.body.hand * away.hand[:, 1] - centre)
    assert np.linalg.norm(np.maximum(np.abs(in_box) - half, 0.0)) == pytest.approx(0.04, abs=0.001)


def planned(number: int) -> Plan:
    room, person = draw_room(ADT, "r", rng("room", number)), draw_person(ADT, "p", rng("actor", number))
    return plan_recording(ADT, person, room, 6, rng("plan", number))


def acted(plan: Plan) -> Motion:
    times = np.arange(0.0, plan.reaches[-1].event + 2.0, 1 / 60)
    return synthesise(plan, times, (rng("sway"), rng("gaze"), rng("head")))


def test_wrists_arrive_within_two_centimetres() -> None:
    misses = [miss for number in range(4) for miss in acted(planned(number)).misses]
    assert max(misses) < 0.02
    assert np.median(misses) < 0.004


def scaled(body: Body, stature: float) -> Body:
    """The same proportions at another stature."""

    def stretch(value: object) -> object:
        if isinstance(value, tuple):
            return tuple(stretch(part) for part in value)
        return value * stature / body.stature

    changed = {f.name: stretch(getattr(body, f.name)) for f in fields(body) if f.name != "neck_tilt"}
    return replace(body, **changed)


def test_two_people_of_one_stature_move_differently_on_the_same_plan() -> None:
    plan = planned(1)
    other = draw_person(ADT, "other", rng("actor", 99))
    twin = Person("twin", scaled(other.body, plan.person.body.stature), other.habits)
    one, two = acted(plan), acted(replace(plan, person=twin))
    assert np.linalg.norm(one.joints - two.joints, axis=-1).mean() > 0.01
    assert bone_lengths(two.joints).std(axis=0).max() < 1e-9
