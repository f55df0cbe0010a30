"""Feet that carry a body, by hand: contact, support, dragging, steps and balance; and gliders, which none carries."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import TOES, Joint
from prbench.metrics.batch import ScoringPair
from prbench.metrics.footing import footing_numbers
from prbench.metrics.plausible import body_numbers, broken_limits
from tests.metrics.motions import CONSTANTS, FPS, batch, standing, targets, turned

FEET = ([Joint.LEFT_ANKLE, TOES[0]], [Joint.RIGHT_ANKLE, TOES[1]])
ANKLES = [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]
BODY = [joint for joint in Joint if joint not in FEET[0] + FEET[1]]


def pair(motion: np.ndarray, fps: float = FPS) -> ScoringPair:
    motions = batch(motion)
    return ScoringPair(motions, motions, targets(fps=fps))


def numbers(motion: np.ndarray, fps: float = FPS) -> dict[str, float]:
    return {name: float(value[0]) for name, value in footing_numbers(pair(motion, fps), CONSTANTS).items()}


def flags(motion: np.ndarray) -> set[str]:
    found = broken_limits(body_numbers(pair(motion), CONSTANTS), CONSTANTS.plausible, CONSTANTS.threshold_tolerance)
    return {name for name, mask in found.items() if mask[0]}


def glide(speed: float, n: int = 41) -> np.ndarray:
    """A standing body that moves to +Z as a whole."""
    return standing(n) + (speed / FPS * np.arange(n))[:, None, None] * np.array([0.0, 0.0, 1.0])


def walk(speed: float = 1.0, n: int = 61, step: int = 7, lift: float = 0.1) -> np.ndarray:
    """A body that moves evenly while one foot stands and the other one swings, each for ``step`` frames."""
    motion = glide(speed, n)
    times = np.arange(n)
    for side, foot in enumerate(FEET):
        since = times - side * step
        swings = (since // step) % 2 == 0
        phase = np.where(swings, since % step / step, 0.0)
        landed = (since // step + 1) // 2
        motion[:, foot, 2] = standing(1)[0, foot, 2] + ((landed + phase) * 2 * step * speed / FPS)[:, None]
        motion[:, foot, 1] += (lift * np.sin(np.pi * phase))[:, None] * [1.0, 0.6]  # the heel leaves first
    return motion


def test_a_body_that_stands_is_carried_and_one_that_walks_is() -> None:
    still = numbers(standing(30))
    assert (still["support"], still["drag"], still["slides"], still["step_rate"]) == (1, 0, 0, 0)
    assert still["lower_toe"] == pytest.approx(0.02)
    found = numbers(walk())
    assert (found["support"], found["drag"], found["unsupported_speed"]) == (1, 0, 0)
    assert found["travel_speed"] == pytest.approx(1.0)
    assert found["step_rate"] == 3, "within a second"
    assert flags(walk()) - {"changing_bones"} == set()


@pytest.mark.parametrize(("speed", "support", "slides"), [(0.15, 1, 0), (0.3, 1, 1), (1.0, 0, 1)])
def test_a_body_that_glides_drags_its_feet_at_any_speed(speed: float, support: int, slides: int) -> None:
    found = numbers(glide(speed, 101))
    assert (found["support"], found["slides"]) == (support, slides)
    assert (found["drag"], found["flight"]) == pytest.approx((1.0, 1 - support))
    assert found["unsupported_speed"] == pytest.approx(0.0 if support else speed)
    assert "sliding_feet" in flags(glide(speed, 101))


def test_noise_and_a_single_step_are_no_dragging() -> None:
    assert numbers(glide(0.049))["drag"] == 0
    assert numbers(glide(0.25, 11))["drag"] == pytest.approx(0.25), "12.5 cm of the 50 that count"


def test_contact_is_by_ankle_or_toe_with_one_limit() -> None:
    heels = glide(1.0)
    heels[:, list(TOES), 1] = 0.053
    heels[:, ANKLES, 1] = 0.045
    assert numbers(heels)["slides"] == 1, "the ankles touch"
    assert flags(heels) >= {"floating", "sliding_feet", "unsupported"}
    for height, floats in ((0.03, False), (0.0301, True), (0.05, True)):
        hover = glide(1.0)
        hover[1:, :, 1] += height - 0.02
        assert ("floating" in flags(hover)) == floats
        assert "unsupported" in flags(hover)
    tiptoe = standing(10)
    tiptoe[:, ANKLES, 1] = 0.16
    tiptoe[:, list(TOES), 1] = 0.03
    assert flags(tiptoe) - {"changing_bones", "overbent"} == set()


def test_feet_that_step_in_place_or_jump_carry_nobody() -> None:
    marching = walk(0.8)
    marching[:, FEET[0] + FEET[1], 2] = glide(0.8, 61)[:, FEET[0] + FEET[1], 2]
    assert flags(marching) >= {"sliding_feet", "unsupported"}
    # Each foot stands for two frames, and is two frames further on in the next one.
    jumping = glide(1.5, 61)
    for side, foot in enumerate(FEET):
        frame = (np.arange(61) + side) // 2 * 2
        jumping[:, foot, 2] = standing(1)[0, foot, 2] + (frame * 1.5 / FPS)[:, None]
    assert numbers(jumping)["support"] == 1
    assert flags(jumping) >= {"hurried_steps", "sliding_feet"}


def test_a_swing_takes_its_time_and_no_landing_is_that_of_another_sequence() -> None:
    assert numbers(walk())["swing_time"] == pytest.approx(0.35)
    assert numbers(walk(0.05))["swing_time"] == np.inf, "3.5 cm are a shuffle"
    assert numbers(walk(step=3))["swing_time"] == pytest.approx(0.15)
    assert "hurried_steps" in flags(walk(step=3))
    lifts = walk()[:6]
    lands = walk()[8:]
    together = footing_numbers(ScoringPair(batch(lifts, lands), batch(lifts, lands), targets(2)), CONSTANTS)
    assert together["swing_time"].tolist() == [np.inf, numbers(lands)["swing_time"]]


@pytest.mark.parametrize(("degrees", "flagged"), [(25.0, False), (35.0, True), (-170.0, True)])
def test_a_body_turns_by_steps_and_not_on_flat_feet(degrees: float, flagged: bool) -> None:
    motion = turned(standing(81), np.deg2rad(np.linspace(0, degrees, 81))[:, None])
    assert numbers(motion)["pivot"] == pytest.approx(abs(degrees))
    assert (flags(motion) == {"sliding_feet"}) == flagged
    lifted = motion.copy()
    lifted[:, FEET[0] + FEET[1], 1] += 0.05
    assert numbers(lifted)["pivot"] == 0


def test_a_foot_rolls_over_the_floor_where_a_body_walks() -> None:
    rolls = numbers(walk())["foot_roll"]
    low = np.arctan2(0.08 - 0.02, 0.12)  # of the first pose
    high = np.arctan2(0.08 - 0.02 + 0.04 * np.sin(3 / 7 * np.pi), 0.12)
    assert rolls == pytest.approx(np.rad2deg(high - low))
    assert numbers(walk(n=10))["foot_roll"] == np.inf, "the pelvis goes 45 cm"
    flat = walk()
    flat[:, TOES[0], 1] = flat[:, Joint.LEFT_ANKLE, 1] - 0.06
    flat[:, TOES[1], 1] = flat[:, Joint.RIGHT_ANKLE, 1] - 0.06
    assert numbers(flat)["foot_roll"] == pytest.approx(0.0)
    assert "rigid_feet" in flags(flat) - flags(walk())


def shifted(by: float, n: int = 10) -> np.ndarray:
    motion = standing(n)
    motion[:, BODY, 0] += by
    return motion


def test_a_body_stands_over_its_feet() -> None:
    # Winter 2009: feet have 2.9 % of the mass, and ankles 43.3 % of that of the shanks, 9.3 %.
    moves = 1 - 2 * (0.0145 + 0.433 * 0.0465)
    assert numbers(shifted(0.0))["imbalance"] == 0
    assert numbers(shifted(0.3))["imbalance"] == pytest.approx(0.3 * moves - 0.1)
    assert "off_balance" in flags(shifted(0.4))
    walking = shifted(0.4) + glide(0.3, 10) - standing(10)
    assert numbers(walking)["imbalance"] == 0
    assert numbers(walking)["overhang"] == numbers(shifted(0.4))["overhang"] == numbers(shifted(0.4))["imbalance"]


def test_who_sits_leans_as_far_as_the_seat_carries() -> None:
    seated = shifted(0.4, 40)
    seated[:, Joint.PELVIS, 1] = 0.5  # of a leg of 0.77 m
    assert numbers(seated)["imbalance"] == 0
    risen = seated.copy()
    risen[20:, Joint.PELVIS, 1] = 0.9
    slid = seated.copy()
    slid[20:, Joint.PELVIS, 0] += 0.3
    down = seated.copy()
    down[:20, Joint.PELVIS, 1] = 0.9
    for motion in (risen, slid, down):
        assert numbers(motion)["imbalance"] > 0.25
    together = footing_numbers(ScoringPair(batch(risen, seated), batch(risen, seated), targets(2)), CONSTANTS)
    assert (together["imbalance"] > 0.25).tolist() == [True, False], "sequences do not influence one another"


def test_rates_are_those_of_the_clock() -> None:
    twice = numbers(walk(), 2 * FPS)
    assert (twice["travel_speed"], twice["step_rate"]) == (pytest.approx(2.0), 6)
