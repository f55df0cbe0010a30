"""Prime Success (arrival) and the fixed angle: worked cases, frame 0, the window's start, and bodies that stare."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.metrics import score
from prbench.metrics.prime_success import prime_success
from tests.metrics.motions import CONSTANTS, batch, looking, standing, targets
from tests.metrics.test_prime_success import A

EDGE = np.rad2deg(np.arcsin(0.125))  # the ray passes 25 cm beside a goal at 2 m


def readings(motion: np.ndarray, **where) -> dict[str, int]:
    found = score(batch(motion), batch(motion), targets(**where), CONSTANTS)
    names = {"equation": "prime_success", "arrival": "prime_success_arrival", "onset": "prime_success_onset"}
    return {reading: int(found[metric].value[0]) for reading, metric in names.items()}


@pytest.mark.parametrize(
    ("angles", "equation", "arrival", "onset"),
    [
        pytest.param(A, 1, 1, 1, id="A: turns in and settles"),
        pytest.param((0,) * 7, 0, 0, 0, id="B: looks there from the start, motionless"),
        pytest.param((20, 15, 10, 5, 0, -5, -10), 0, 0, 0, id="C: sweeps over at constant speed"),
        pytest.param((180, 181, 180, 180, 179, 180, 180), 0, 0, 0, id="D: looks away"),
        pytest.param((6, 5, 4, 4, 4, 4, 4), 1, 0, 0, id="E: never off target"),
        pytest.param((12, 5, 12, 5, 3, 3, 3), 1, 1, 1, id="F: glances, leaves, comes back"),
        pytest.param((0, 0.03, 0, 0, 0.03, 0, 0), 1, 0, 0, id="G: stares with a tremor"),
        pytest.param((40, 5, 4, 3, 3, 3, 3), 1, 1, 0, id="H: off target in frame 0 alone"),
        pytest.param((4, 4, 3, 3, 3, 3, 40), 1, 0, 0, id="I: off target only afterwards"),
    ],
)
def test_worked_cases(angles: tuple[float, ...], equation: int, arrival: int, onset: int) -> None:
    assert readings(looking(angles)) == {"equation": equation, "arrival": arrival, "onset": onset}


@pytest.mark.parametrize("seed", range(20))
def test_a_body_that_stares_arrives_nowhere_however_it_trembles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    trembling = looking(np.zeros(60)) + rng.normal(0, 1e-4, (60, 22, 3))  # 0.1 mm, every joint
    for prime_time in (0.0, 0.5, 1.5, 2.9):
        assert readings(trembling, prime_time=prime_time)["arrival"] == 0
    assert readings(trembling, prime_time=1.5)["equation"] == 1, "which is why the arrival is asked for"


@pytest.mark.parametrize(("settles", "expected"), [(20, 1), (21, 0)])
def test_the_window_reaches_one_second_back_and_no_frame_farther(settles: int, expected: int) -> None:
    angles = np.full(30, 3.0)
    angles[0] = 40.0
    angles[settles - 1 :] = 2.0  # the only deceleration is at frame `settles`
    found = readings(looking(angles), prime_time=2.0)  # frames from 20 on are candidates
    assert (found["equation"], found["arrival"]) == (1, expected)


@pytest.mark.parametrize(("fps", "settles", "expected"), [(30.0, 30, 1), (30.0, 31, 0), (25.0, 25, 1), (25.0, 26, 0)])
def test_the_window_is_a_second_at_every_frame_rate(fps: float, settles: int, expected: int) -> None:
    angles = np.full(40, 3.0)
    angles[0] = 40.0
    angles[settles - 1 :] = 2.0
    found = readings(looking(angles), prime_time=2.0, fps=fps)
    assert (found["equation"], found["arrival"]) == (1, expected)


def test_frames_of_another_sequence_are_no_frames_before() -> None:
    motion = looking((4, 4, 3, 3, 3, 3, 3))
    where = targets(2)
    apart = batch(looking((180,) * 7), motion)
    # The frames of the neighbour, which looks away, lie right before those of the second body.
    assert prime_success(apart, where, CONSTANTS, variant="arrival").tolist() == [0, 0]


@pytest.mark.parametrize(("beyond", "expected"), [(5e-7, 0), (2e-6, 1)])
def test_a_ray_on_the_threshold_is_not_off_target(beyond: float, expected: int) -> None:
    first = np.rad2deg(np.arcsin((0.25 + beyond) / 2))
    found = readings(looking((first, 5, 4, 4, 4, 4, 4)))
    assert (found["equation"], found["arrival"]) == (1, expected)


def test_a_frame_without_head_direction_is_no_look_elsewhere() -> None:
    motion = looking((6, 90, 4, 4, 4, 4, 4))  # case E, but for frame 1, in which the shoulders turn away
    assert readings(motion)["arrival"] == 1
    motion[1, Joint.HEAD] = motion[1, Joint.NECK]
    found = score(batch(motion), batch(motion), targets(), CONSTANTS)
    assert found["prime_success_arrival"].value == 0
    assert found["prime_success_onset"].value == found["prime_success"].value, "there, it is off target"
    assert found["prime_success_arrival"].flag == ["degenerate_head_frames"]


def test_flags_of_the_equation_do_not_depend_on_how_far_an_arrival_looks_back() -> None:
    motion = looking(np.full(40, 3.0))
    motion[3, Joint.HEAD] = motion[3, Joint.NECK]
    found = score(batch(motion), batch(motion), targets(prime_time=1.4), CONSTANTS)  # candidates from frame 8 on
    assert found["prime_success"].flag == [None]
    seen = score(batch(motion), batch(motion), targets(prime_time=1.25), CONSTANTS)  # from 5 on, speeds from 3 on
    assert seen["prime_success"].flag == ["degenerate_head_frames"]


@pytest.mark.parametrize(("distance", "flag"), [(0.26, True), (0.2999, True), (0.3001, False), (0.6, False)])
def test_an_arrival_from_the_edge_is_counted(distance: float, flag: bool) -> None:
    first = np.rad2deg(np.arcsin(distance / 2))
    motion = looking((first, 5, 4, 4, 4, 4, 4))
    values = score(batch(motion), batch(motion), targets(), CONSTANTS)["prime_success_arrival"]
    assert values.value == 1
    assert values.flag == (["arrived_from_the_edge"] if flag else [None])


def test_a_ray_that_trembles_across_the_edge_still_earns_it_and_is_flagged() -> None:
    motion = looking((EDGE + 0.01, EDGE - 0.01, EDGE - 0.012, EDGE - 0.012, EDGE - 0.012, EDGE - 0.012))
    values = score(batch(motion), batch(motion), targets(), CONSTANTS)["prime_success_arrival"]
    assert (values.value, values.flag) == (1, ["arrived_from_the_edge"])


def angle(angles, **where) -> int:
    return int(prime_success(batch(looking(angles)), targets(**where), CONSTANTS, variant="angle")[0])


@pytest.mark.parametrize(("metres", "equation", "fixed"), [(0.6, 1, 0), (4.0, 0, 1)])
def test_a_fixed_angle_is_wider_than_25_cm_far_away_and_narrower_nearby(metres, equation, fixed) -> None:
    degrees = {0.6: (23, 22, 21.5, 21.5, 21.5, 21.5), 4.0: (12, 11, 10.5, 10.5, 10.5, 10.5)}[metres]
    goal = (0.0, 1.6, metres)
    assert readings(looking(degrees), goal=goal)["equation"] == equation
    assert angle(degrees, goal=goal) == fixed


@pytest.mark.parametrize(("degrees", "expected"), [(15.0, 1), (15.00001, 1), (15.0001, 0), (14.99, 1)])
def test_fifteen_degrees_lie_inside(degrees: float, expected: int) -> None:
    assert angle((20, 16, degrees, degrees, degrees)) == expected


def test_a_goal_behind_is_at_no_small_angle() -> None:
    assert angle((180, 181, 180, 180, 179, 180, 180)) == 0


def test_standing_still_earns_no_reading() -> None:
    assert set(readings(standing(40)).values()) == {0}
