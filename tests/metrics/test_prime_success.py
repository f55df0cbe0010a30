"""Prime Success: the worked cases A to I, its readings, the edges of the window, and its laws."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import numpy as np
import pytest

from prbench.geometry.skeleton import Joint, head_forward
from prbench.metrics import GazeRays, score
from prbench.metrics.prime_success import prime_success
from prbench.metrics.prime_success_gaze import prime_success_gaze
from prbench.metrics.ray_track import candidate_frames, head_track, ray_distance
from tests.metrics.motions import CONSTANTS, FPS, batch, looking, random_problem, standing, targets

A = (40, 25, 12, 5, 3, 3, 3, 3)


E = (6, 5, 4, 4, 4, 4, 4)
GLANCE = (40, 25, 12, 5, 3, 3, 12, 25)


def readings(seen, **changes) -> tuple[int, int, int]:
    """Equation, arrival and onset of one motion, or of a body that looks at so many degrees in each frame."""
    motion = batch(seen if np.ndim(seen) > 1 else looking(seen))
    thresholds = {name: value for name, value in changes.items() if hasattr(CONSTANTS, name)}
    constants = msgspec.structs.replace(CONSTANTS, **thresholds)
    where = targets(**{name: value for name, value in changes.items() if name not in thresholds})
    found = score(motion, motion, where, constants)
    names = ("prime_success", "prime_success_arrival", "prime_success_onset")
    return tuple(int(found[name].value[0]) for name in names)


@pytest.mark.parametrize(
    ("angles", "changes", "expected"),
    [
        pytest.param(A, {}, (1, 1, 1), id="A: turns in and settles"),
        pytest.param((0,) * 7, {}, (0, 0, 0), id="B: looks there from the start, motionless"),
        pytest.param((20, 15, 10, 5, 0, -5, -10), {}, (0, 0, 0), id="C: sweeps over at constant speed"),
        pytest.param((180, 181, 180, 180, 179, 180, 180), {}, (0, 0, 0), id="D: looks away"),
        pytest.param(E, {}, (1, 0, 0), id="E: never off target"),
        pytest.param((12, 5, 12, 5, 3, 3, 3), {}, (1, 0, 1), id="F: glances, leaves, comes back"),
        pytest.param((0, 0.03, 0, 0, 0.03, 0, 0), {}, (1, 0, 0), id="G: stares with a tremor"),
        pytest.param((40, 5, 4, 3, 3, 3, 3), {}, (1, 0, 0), id="H: off target in frame 0 alone"),
        pytest.param((4, 4, 3, 3, 3, 3, 40), {}, (1, 0, 0), id="I: off target only afterwards"),
        pytest.param(E, {"prime_distance": 0.15}, (1, 0, 1), id="E: has an onset at a smaller distance"),
        pytest.param(A, {"prime_time": 1.15}, (1, 1, 1), id="frame 3 is the first candidate"),
        pytest.param(A, {"prime_time": 1.2}, (1, 1, 0), id="frame 4 is"),
        pytest.param(A, {"prime_time": 1.25}, (1, 1, 0), id="frame 5 is"),
        pytest.param(A, {"prime_time": 1.3}, (0, 0, 0), id="no frame is"),
        pytest.param(A[:6], {}, (1, 1, 1), id="frames 3, 4 and 5 are on target"),
        pytest.param(A[:5], {}, (0, 0, 0), id="the end cuts the stay off"),
        pytest.param(GLANCE, {"prime_duration": 0.1}, (1, 1, 1), id="stays for three frames"),
        pytest.param(GLANCE, {"prime_duration": 0.101}, (0, 0, 0), id="four are asked for"),
    ],
)
def test_worked_cases(angles, changes, expected: tuple[int, int, int]) -> None:
    assert readings(angles, **changes) == expected


def test_distances_and_speeds_of_case_a() -> None:
    motion, where = batch(looking(A)), targets()
    candidates = candidate_frames(motion.n_frames, where.prime_time, where.fps_of_sequence, CONSTANTS)
    track = head_track(motion, candidates, where.goal_location, where.head_tilt_deg, where.fps_of_sequence, CONSTANTS)
    assert track.row_of_frame_0[0] == 0
    np.testing.assert_allclose(track.distance[:5], [1.2856, 0.8452, 0.4158, 0.1743, 0.1047], atol=5e-5)
    np.testing.assert_allclose(np.rad2deg(track.speed[1:]), [300, 260, 140, 40, 0, 0, 0], atol=1e-6)


def test_a_prime_time_without_candidates_is_flagged() -> None:
    motion = batch(looking(A), looking(A))
    values = score(motion, motion, targets(2, prime_time=(1.3, 1.25)), CONSTANTS)["prime_success"]
    assert values.value.tolist() == [0, 1]
    assert values.flag == ["no_candidate_frames", None]


@pytest.mark.parametrize("variant", ["equation", "arrival", "onset", "angle"])
def test_rounding_of_a_constant_sweep_is_no_deceleration(variant) -> None:
    sweeps = [looking(20 - speed * np.arange(30)) for speed in np.linspace(0.05, 6, 40)]
    assert not prime_success(batch(*sweeps), targets(40, prime_time=0.7), CONSTANTS, variant=variant).any()


def test_each_sequence_has_the_stay_of_its_own_frame_rate() -> None:
    slow_down = (12, 12, 5, 3, 0)  # 0, 140, 40 and 60 degrees a second: the two turns after frame 2 are the slower ones
    where = targets(2, fps=np.array([20.0, 30.0]))
    motions = batch(looking(slow_down), looking(A))
    assert prime_success(motions, where, CONSTANTS, variant="onset").tolist() == [1, 1]


def test_three_frames_of_stay_at_25_frames_per_second() -> None:
    where = targets(2, fps=np.array([20.0, 25.0]))
    frames = candidate_frames(np.array([8, 8]), where.prime_time, where.fps_of_sequence, CONSTANTS)
    assert frames.hold.tolist() == [2, 3]
    assert frames.last.tolist() == [5, 4]


def test_a_goal_behind_the_head_is_as_far_as_the_head() -> None:
    origin, forward = np.array([[0, 1.6, 0.0]]), np.array([[0, 0, 1.0]])
    assert ray_distance(origin, forward, np.array([[0, 1.6, -2.0]])) == pytest.approx(2.0)
    assert ray_distance(origin, forward, np.array([[0.3, 1.6, 2.0]])) == pytest.approx(0.3)


def test_a_degenerate_head_is_off_target_and_flagged() -> None:
    motion = looking(A)
    motion[5, Joint.HEAD] = motion[5, Joint.NECK]  # in every stay: frames 3 to 5, 4 to 6, 5 to 7
    values = score(batch(motion), batch(motion), targets(), CONSTANTS)["prime_success"]
    assert values.value.tolist() == [0]
    assert values.flag == ["degenerate_head_frames"]


def test_smoothing_the_joints_first_removes_a_tremor() -> None:
    tremor = [4 + (-1) ** t * (1 + 0.2 * (t % 3)) for t in range(20)]
    smoothing = msgspec.structs.replace(CONSTANTS, head_smoothing=2.0)
    motion, where = batch(looking(tremor)), targets(prime_time=0.5)
    assert prime_success(motion, where, CONSTANTS) == 1
    track = head_track(
        motion,
        candidate_frames(np.array([20]), where.prime_time, where.fps_of_sequence, smoothing),
        where.goal_location,
        where.head_tilt_deg,
        where.fps_of_sequence,
        smoothing,
    )
    assert np.nanmax(track.speed) < np.deg2rad(2 * FPS) / 3  # the tremor itself turns 2 degrees a frame or more


@pytest.mark.parametrize("seed", range(3))
def test_success_grows_with_distance_and_window(seed: int) -> None:
    predicted, _, where = random_problem(seed, np.random.default_rng(seed).integers(2, 120, 60))

    def at(distance: float, window: float, variant) -> np.ndarray:
        constants = msgspec.structs.replace(CONSTANTS, prime_distance=distance, prime_window=window)
        return prime_success(predicted, where, constants, variant=variant)

    by_distance = np.stack([at(d, 1.0, "equation") for d in np.linspace(0, 1, 11)])
    assert (np.diff(by_distance, axis=0) >= 0).all()
    assert by_distance[0].sum() < by_distance[-1].sum()
    for variant in ("equation", "onset", "angle"):
        by_window = np.stack([at(0.4, w, variant) for w in (0, 0.25, 0.5, 0.75, 1, 1.25)])
        assert (np.diff(by_window, axis=0) >= 0).all()
        assert by_window[0].sum() < by_window[-1].sum()


def slow_prime_success(joints, goal, tilt, prime_time, fps, constants, variant) -> float:
    """The definition of docs/specification/metrics.md#prime-success, frame by frame."""
    n, hold = len(joints), int(np.ceil(constants.prime_duration * fps - 1e-9))
    forward, bad = head_forward(joints, tilt)
    offset = goal - joints[:, Joint.HEAD]
    near = [v - max(float(v @ h), 0) * h for v, h in zip(offset, forward, strict=True)]
    within = [np.linalg.norm(d) <= constants.prime_distance for d in near]
    if variant == "angle":
        cosine = [v @ h / np.linalg.norm(v) for v, h in zip(offset, forward, strict=True)]
        within = [np.rad2deg(np.arccos(c)) <= constants.prime_angle_deg for c in cosine]
    on = [w and not b for w, b in zip(within, bad, strict=True)]
    turn = [np.arctan2(np.linalg.norm(np.cross(g, h)), g @ h) * fps for g, h in pairwise(forward)]
    speed = [np.nan, *turn]
    for t in range(2, n - hold):
        if abs(t / fps - prime_time) > constants.prime_window + 1e-9 or not all(on[t : t + hold + 1]):
            continue
        slower = speed[t] - speed[t - 1] < -constants.deceleration_tolerance
        if variant in ("equation", "angle") and slower:
            return 1.0
        before = [s for s in range(t) if (t - s) / fps <= constants.prime_window + 1e-9]
        away = [np.linalg.norm(d) > constants.prime_distance + constants.arrival_margin for d in near]
        away = [a and not b for a, b in zip(away, bad, strict=True)]
        left = max((s for s in before if s >= hold and all(away[s - hold : s + 1])), default=-1)
        stayed = any(all(on[s - hold : s + 1]) for s in before if hold <= s < left)
        if variant == "arrival" and slower and left >= 0 and not stayed:
            return 1.0
        if variant == "onset" and t >= hold and not on[t - 1]:
            change = np.mean(speed[t + 1 : t + hold + 1]) - np.mean(speed[t - hold + 1 : t + 1])
            if change < -constants.deceleration_tolerance:
                return 1.0
    return 0.0


@pytest.mark.parametrize("variant", ["equation", "arrival", "onset", "angle"])
@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_the_definition_frame_by_frame(seed: int, variant) -> None:
    lengths = np.random.default_rng(seed).integers(2, 200, 80)
    predicted, _, where = random_problem(seed, lengths)
    fps = np.where(np.arange(80) % 3 == 0, 30.0, 20.0)
    where = targets(80, goal=where.goal_location, prime_time=where.prime_time, tilt=where.head_tilt_deg, fps=fps)
    constants = msgspec.structs.replace(CONSTANTS, prime_distance=0.4, prime_angle_deg=35.0)
    expected = [
        slow_prime_success(predicted.values[a:b], goal, 7.4, time, rate, constants, variant)
        for a, b, goal, time, rate in zip(
            predicted.first, predicted.last + 1, where.goal_location, where.prime_time, fps, strict=True
        )
    ]
    assert 0 < sum(expected) < 80
    assert prime_success(predicted, where, constants, variant=variant).tolist() == expected


def gaze_of(motion: np.ndarray, valid=None) -> GazeRays:
    direction, _ = head_forward(motion, 0.0)
    return GazeRays(motion[:, Joint.HEAD], direction, np.ones(len(motion), bool) if valid is None else valid)


def test_gaze_that_follows_the_head_succeeds_where_the_head_does() -> None:
    for angles in (A, (0,) * 7, (20, 15, 10, 5, 0, -5, -10), (6, 5, 4, 4, 4, 4, 4)):
        motion = looking(angles)
        where = targets(gaze=gaze_of(motion))
        for variant in ("equation", "arrival"):
            by_head = prime_success(batch(motion), where, CONSTANTS, variant=variant)
            assert prime_success_gaze(batch(motion), where, CONSTANTS, variant=variant) == by_head


def test_an_invalid_gaze_sample_is_off_target_and_hides_the_turn() -> None:
    motion = looking(A)
    for lost, expected in [(4, 0), (5, 0), (6, 1), (2, 1), (0, 1)]:
        valid = np.arange(len(A)) != lost
        assert prime_success_gaze(batch(motion), targets(gaze=gaze_of(motion, valid)), CONSTANTS) == expected, lost


def test_the_turn_out_of_an_invalid_gaze_sample_is_no_deceleration() -> None:
    motion = looking(A[:6])  # only a stay from frame 3 on fits in
    for lost, expected in [(0, 1), (1, 0), (2, 0)]:
        valid = np.arange(6) != lost
        assert prime_success_gaze(batch(motion), targets(gaze=gaze_of(motion, valid)), CONSTANTS) == expected, lost


def test_gaze_is_scored_only_where_it_is_handed_in() -> None:
    motion = batch(looking(A))
    assert "prime_success_gaze" not in score(motion, motion, targets(), CONSTANTS)
    gaze = gaze_of(looking(A))
    assert score(motion, motion, targets(gaze=gaze), CONSTANTS)["prime_success_gaze"].value == 1
    with pytest.raises(ValueError, match="no gaze"):
        score(motion, motion, targets(), CONSTANTS, metrics=["prime_success_gaze"])


def test_a_single_frame_is_refused() -> None:
    with pytest.raises(ValueError, match="sequence 1: expected 2 frames or more, found 1"):
        prime_success(batch(standing(5), standing(1)), targets(2), CONSTANTS)


@pytest.mark.parametrize("seed", range(20))
def test_a_body_that_stares_arrives_nowhere_however_it_trembles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    trembling = looking(np.zeros(60)) + rng.normal(0, 1e-4, (60, 22, 3))  # 0.1 mm, every joint
    for prime_time in (0.0, 0.5, 1.5, 2.9):
        assert readings(trembling, prime_time=prime_time)[1] == 0
    assert readings(trembling, prime_time=1.5)[0] == 1, "which is why the arrival is asked for"


@pytest.mark.parametrize(
    ("fps", "settles", "expected"), [(20.0, 23, 1), (20.0, 24, 0), (30.0, 33, 1), (30.0, 34, 0), (25.0, 29, 0)]
)
def test_the_window_reaches_one_second_back_at_every_frame_rate(fps: float, settles: int, expected: int) -> None:
    angles = np.full(40, 3.0)
    angles[:4] = 40.0
    angles[settles - 1 :] = 2.0  # the only deceleration is at frame `settles`
    assert readings(angles, prime_time=2.0, fps=fps)[:2] == (1, expected)


def test_frames_of_another_sequence_are_no_frames_before() -> None:
    motion = looking((4, 4, 3, 3, 3, 3, 3))
    where = targets(2)
    apart = batch(looking((180,) * 7), motion)
    # The frames of the neighbour, which looks away, lie right before those of the second body.
    assert prime_success(apart, where, CONSTANTS, variant="arrival").tolist() == [0, 0]


@pytest.mark.parametrize(("beyond", "expected"), [(-0.01, 0), (5e-7, 0), (2e-6, 1), (0.3, 1)])
def test_an_arrival_comes_from_farther_than_the_margin(beyond: float, expected: int) -> None:
    first = np.rad2deg(np.arcsin((0.30 + beyond) / 2))
    assert readings((first, first, first, 5, 4, 4, 4, 4))[:2] == (1, expected)


@pytest.mark.parametrize("away", [2, 3, 8])
@pytest.mark.parametrize(("before", "expected"), [(0, 1), (2, 1), (3, 0), (20, 0)])
def test_a_ray_that_nods_off_the_goal_and_back_does_not_arrive(before: int, away: int, expected: int) -> None:
    angles = [3.0] * before + [35.0] * away + [5.0] + [3.0] * 20
    expected *= away > 2  # a look elsewhere is longer than the stay of three frames that is asked for
    assert readings(angles, prime_time=(before + away) / FPS)[1] == expected


def test_a_frame_without_head_direction_is_no_look_elsewhere() -> None:
    motion = looking((90, 90, 90, 4, 4, 3, 3, 3))
    assert readings(motion)[1] == 1
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


def angle(angles, **where) -> int:
    return int(prime_success(batch(looking(angles)), targets(**where), CONSTANTS, variant="angle")[0])


@pytest.mark.parametrize(("metres", "equation", "fixed"), [(0.6, 1, 0), (4.0, 0, 1)])
def test_a_fixed_angle_is_wider_than_25_cm_far_away_and_narrower_nearby(metres, equation, fixed) -> None:
    degrees = {0.6: (23, 22, 21.5, 21.5, 21.5, 21.5), 4.0: (12, 11, 10.5, 10.5, 10.5, 10.5)}[metres]
    goal = (0.0, 1.6, metres)
    assert readings(degrees, goal=goal)[0] == equation
    assert angle(degrees, goal=goal) == fixed


@pytest.mark.parametrize(("degrees", "expected"), [(15.0, 1), (15.00001, 1), (15.0001, 0), (14.99, 1)])
def test_fifteen_degrees_lie_inside(degrees: float, expected: int) -> None:
    assert angle((20, 16, degrees, degrees, degrees)) == expected
