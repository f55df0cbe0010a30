"""Who acts where, bodies, gait and reaching, piece by piece."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise
from typing import Literal

import numpy as np
import pytest

from prbench.geometry.skeleton import WRISTS, bone_lengths
from prbench.randomness import named_generator
from prbench.synthetic.people import PRESETS
from prbench.synthetic.people.body import Head, move_eyes, move_head
from prbench.synthetic.people.gaze_plan import GazePlan, Look, _draw_gap
from prbench.synthetic.people.kinematics import (
    turn,
)
from prbench.synthetic.people.perform import Motion, synthesise
from prbench.synthetic.people.person import BALL_HEIGHT, Body, Person, draw_person, of_second_world
from prbench.synthetic.people.plan import Plan, plan_recording
from prbench.synthetic.people.reaching import Reacher, kept_away, solve_posture, take_hold
from prbench.synthetic.people.walking import (
    BALL_TO_TOE,
    HEEL_TO_BALL,
    BasePose,
    Feet,
    Segment,
    Steps,
    place_feet,
    plan_segment,
    plan_steps,
    sample_base,
)
from prbench.synthetic.people.world import Room, Source, assign, draw_room

ADT = PRESETS["adt"]


def rng(*name: str | int) -> np.random.Generator:
    return named_generator("test", *name)


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


def straight_walk(pace: float) -> tuple[Person, Segment, Steps, Feet, np.ndarray]:
    """Walk five metres straight ahead, at a share of the usual speed."""
    person = draw_person(ADT, "x", rng("walker"))
    start = BasePose(0.0, 0.0, 0.0)
    segment = plan_segment(person.habits, pace, start, BasePose(0.0, 5.0, 0.0), 1.0)
    assert segment is not None
    times = np.arange(0.0, segment.end + 1.0, 1 / 120)
    steps = plan_steps(person, (segment,))
    feet = place_feet(person, sample_base(start, (segment,), times), steps, times, seated=False)
    return person, segment, steps, feet, times


@pytest.mark.parametrize(("pace", "swing"), [(1.1, (0.37, 0.40)), (0.6, (0.33, 0.37))])
def test_steps_follow_the_walk_ratio_and_slow_ones_swing_for_less_of_the_stride(pace: float, swing) -> None:
    person, segment, steps, _, _ = straight_walk(pace)
    middle = steps[2:-2]
    cadence = np.array([60.0 / step.period for step in middle])
    longer = max(1.0, 1.03 / segment.speed) ** 0.5  # slow steps are longer for their cadence
    assert 60.0 * segment.speed / cadence**2 == pytest.approx(person.habits.walk_ratio * longer, rel=0.2)
    assert all(swing[0] <= step.swing / (2 * step.period) <= swing[1] for step in middle)


def test_toes_pass_low_over_the_floor_and_feet_land_on_their_heels() -> None:
    person, _, steps, feet, times = straight_walk(1.0)
    stature = person.body.stature
    tips, heels = (
        feet.ball + turn(feet.yaw, feet.pitch, np.array([0.0, 0.0, length * stature]))
        for length in (BALL_TO_TOE, -HEEL_TO_BALL)
    )
    for step in steps[2:-2]:
        middle = slice(*np.searchsorted(times, [step.lift + 0.3 * step.swing, step.lift + 0.7 * step.swing]))
        assert 0.012 < tips[middle, step.foot, 1].min() - BALL_HEIGHT < 0.026
        assert feet.ball[middle, step.foot, 1].min() - BALL_HEIGHT > 0.030, "the ball is higher than the tip"
        landing = int(np.searchsorted(times, step.landing))
        assert heels[landing, step.foot, 1] == pytest.approx(BALL_HEIGHT, abs=0.003)
        assert feet.ball[landing, step.foot, 1] > BALL_HEIGHT + 0.03


def test_people_of_the_second_world_step_evenly_and_reach_by_another_law() -> None:
    person, segment, usual, _, _ = straight_walk(1.0)
    other = of_second_world(person, rng("second"))
    steps = plan_steps(other, (segment,))
    middle = np.median([step.period for step in steps])
    assert steps[0].period > 1.3 * middle, "steps are even in length and not in time"
    assert usual[0].period < 1.1 * np.median([step.period for step in usual])
    assert other.body.upper_arm > 1.1 * person.body.upper_arm
    assert other.manner.reach(np.array([0.0, 1.0])) == pytest.approx([0.0, 1.0])
    assert other.manner.reach(np.array([0.25]))[0] < 0.6 * person.manner.reach(np.array([0.25]))[0]


def test_a_small_shift_needs_no_step() -> None:
    person = draw_person(ADT, "x", rng("walker"))
    assert plan_segment(person.habits, 0.9, BasePose(0.0, 0.0, 0.0), BasePose(0.02, 0.01, 0.1), 1.0) is None


def test_low_goals_are_reached_by_bending_and_near_ones_upright() -> None:
    person = draw_person(ADT, "x", rng("reacher"))
    base = BasePose(0.0, 0.0, 0.0)
    who = Reacher(person, base, hand=1)
    high = solve_posture(who, np.array([-0.15, 1.2, 0.4]))
    low = solve_posture(who, np.array([-0.15, 0.5, 0.5]))
    assert (high.lean, high.crouch) < (np.deg2rad(15.0), 0.1)
    assert low.lean + low.crouch > high.lean + high.crouch + 0.5
    assert solve_posture(who, np.array([-0.15, 1.0, 1.6])).extension > 0.92


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


def test_longer_reaches_take_longer() -> None:
    ways, durations = [], []
    for number in range(4):
        plan = planned(number)
        wrists = acted(plan).joints[:, WRISTS]
        for reach in plan.reaches:
            first, last = np.searchsorted(np.arange(len(wrists)) / 60, [reach.reach_start, reach.contact])
            ways.append(np.linalg.norm(wrists[last, reach.hand] - wrists[first, reach.hand]))
            durations.append(reach.contact - reach.reach_start)
    assert np.corrcoef(ways, durations)[0, 1] > 0.5


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
    twin = Person("twin", scaled(other.body, plan.person.body.stature), other.habits, other.manner)
    one, two = acted(plan), acted(replace(plan, person=twin))
    assert np.linalg.norm(one.joints - two.joints, axis=-1).mean() > 0.01
    assert bone_lengths(two.joints).std(axis=0).max() < 1e-9


def test_gaps_do_not_pile_up_at_the_end_of_the_window() -> None:
    gaps = np.array([_draw_gap(PRESETS["adt"], rng) for rng in [np.random.default_rng(0)] for _ in range(2000)])
    assert gaps.max() <= 9.7
    assert (gaps > 9.6).mean() < 0.02


def test_a_person_turns_into_a_way_of_half_a_metre_and_back() -> None:
    habits = draw_person(PRESETS["adt"], "S000", np.random.default_rng(1)).habits
    start = BasePose(0.0, 0.0, 0.0)
    segment = plan_segment(habits, 1.0, start, BasePose(0.5, 0.0, 0.0), 0.0)
    assert segment is not None
    path = sample_base(start, (segment,), np.arange(0.0, segment.end + 0.5, 0.01))
    assert np.rad2deg(path.heading.max()) == pytest.approx(45.0, abs=0.5)  # to the left, where the way goes
    assert path.heading[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("metres", "faces_on"), [(0.15, False), (0.5, True)])
def test_a_single_step_and_a_person_who_faces_on_do_not_turn(metres: float, faces_on: bool) -> None:
    habits = draw_person(PRESETS["adt"], "S000", np.random.default_rng(1)).habits
    goal = BasePose(metres, 0.0, 0.0)
    segment = plan_segment(habits, 1.0, BasePose(0.0, 0.0, 0.0), goal, 0.0, faces_on=faces_on)
    assert segment is not None
    assert segment.turn_into == 0.0


"""Who acts where, and on which side of the split."""


def castings(count: int, world: Literal["default", "large"] = "default") -> list[tuple[int, int, str]]:
    """Room, person and split of some recordings."""
    source = Source(3, "adt", world)
    return [assign(source, index) for index in range(count)]


@pytest.mark.parametrize("world", ["default", "large"])
def test_no_test_person_and_no_test_room_occurs_in_training(world: Literal["default", "large"]) -> None:
    drawn = castings(600, world)
    for kind in (0, 1):
        test = {casting[kind] for casting in drawn if casting[2] == "test"}
        assert not test & {casting[kind] for casting in drawn if casting[2] != "test"}


def test_validation_people_do_not_train() -> None:
    drawn = castings(600)
    people = {split: {person for _, person, own in drawn if own == split} for split in ("train", "validation")}
    assert not people["validation"] & people["train"]


def test_thirty_percent_are_test_recordings() -> None:
    share = sum(split == "test" for _, _, split in castings(1000)) / 1000
    assert share == pytest.approx(0.30, abs=0.04)


def test_a_small_world_has_24_people_and_12_rooms() -> None:
    drawn = castings(600)
    assert len({person for _, person, _ in drawn}) == 24
    assert len({room for room, _, _ in drawn}) == 12


@pytest.mark.parametrize("lag", [-0.06, 0.03])
def test_the_head_begins_to_turn_a_lag_after_the_eyes(lag: float) -> None:
    times = np.arange(0.0, 4.0, 1 / 480)
    eye = np.tile([0.0, 1.6, 0.0], (times.size, 1))
    look = Look(2.0, 3.5, np.array([2.0, 1.6, 2.0]), is_goal=True, reach=0)

    def half_way(head_lag: float) -> float:
        person = draw_person(ADT, "x", rng("head"))
        person = replace(person, habits=replace(person.habits, head_lag=head_lag))
        plan = Plan(ADT, person, Room("", (0.0, 0.0), (), ()), False, BasePose(0.0, 0.0, 0.0), (), (), ())
        yaw = [
            move_head(plan, GazePlan(looks, (), ()), np.zeros(times.size), eye, times, rng("tremor")).yaw
            for looks in ((), (look,))
        ]
        moved = yaw[1] - yaw[0]  # without the tremor
        return float(times[np.argmax(moved > moved.max() / 2)])

    assert half_way(lag) - half_way(0.0) == pytest.approx(lag, abs=1 / 240)


def test_eyes_turn_no_farther_than_eyes_can() -> None:
    times = np.arange(0.0, 2.0, 1 / 120)
    still = Head(np.zeros(times.size), np.zeros(times.size))
    look = Look(0.5, 1.8, np.array([3.0, 0.0, 0.0]), is_goal=True, reach=0)  # 90 degrees to the left
    gaze = move_eyes((look,), still, np.zeros((times.size, 3)), times, rng("eyes"))
    assert np.rad2deg(np.arctan2(gaze[:, 0], gaze[:, 2])).max() == pytest.approx(45.0)
