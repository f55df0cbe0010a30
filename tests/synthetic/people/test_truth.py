"""The truth record against what can be seen in the motion itself, and the slow loop that judges priming."""

from __future__ import annotations

import ast
from math import inf, sqrt
from pathlib import Path

import numpy as np
import pytest

import prbench.synthetic
from prbench.geometry.shapes import near_miss, slab_test
from prbench.geometry.skeleton import PARENTS, WRISTS, Joint, rotation_matrices
from prbench.synthetic.people.truth import first_sight, meets_box, passing_distance, slab_interval
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent


def object_of(performance: Performance, event: TrueEvent) -> ObjectMotion:
    return next(item for item in performance.objects if item.object_id == event.object_id)


def moves(performance: Performance) -> list[tuple[TrueEvent, ObjectMotion]]:
    pairs = [(event, object_of(performance, event)) for event in performance.events]
    return [(event, item) for event, item in pairs if len(item.position) > 1]


def test_a_pick_is_when_the_object_has_moved_a_millimetre_and_a_put_when_it_last_had(adt_120: Performance) -> None:
    step = 1.0 / adt_120.rate
    for event, item in moves(adt_120):
        away = np.linalg.norm(item.position - event.goal, axis=1)
        before = away[(adt_120.times > event.event_time - 0.25) & (adt_120.times < event.event_time - step)]
        after = away[(adt_120.times < event.event_time + 0.25) & (adt_120.times > event.event_time + step)]
        resting, moving = (before, after) if event.action == "pick" else (after, before)
        assert resting.max() <= 0.001 < moving.min()


def test_picks_and_puts_take_turns_and_the_put_follows_its_pick(adt_120: Performance) -> None:
    actions = [event.action for event in adt_120.events]
    assert actions == ["pick", "put"] * (len(actions) // 2) + ["pick"] * (len(actions) % 2)
    for pick, put in zip(adt_120.events[::2], adt_120.events[1::2], strict=False):
        assert pick.object_id == put.object_id
        assert pick.event_time < put.event_time


def test_an_object_at_rest_keeps_every_bit_of_its_pose(adt_120: Performance) -> None:
    for event, item in moves(adt_120):
        if event.action == "put":
            rest = adt_120.times >= event.event_time + 0.2
            assert len(np.unique(item.position[rest], axis=0)) == 1
            assert len(np.unique(item.rotation[rest], axis=0)) == 1
        else:
            rest = adt_120.times < event.contact_time  # a short, slow lift takes long to its first millimetre
            assert len(np.unique(item.position[rest], axis=0)) == 1


def test_a_carried_object_stays_in_the_hand_and_level_at_both_ends(adt_120: Performance) -> None:
    for event, item in moves(adt_120):
        side = int(event.hand == "right")
        held = item.held_by == side
        distance = np.linalg.norm(item.position - adt_120.finger_bases[:, side], axis=1)[held]
        assert np.ptp(distance) < 0.04
        assert item.rotation[-1, [1, 3]] == pytest.approx(0.0, abs=1e-12)


def test_boxes_are_world_aligned_around_the_goal(adt_120: Performance) -> None:
    for event in adt_120.events:
        assert (event.box_min + event.box_max) / 2 == pytest.approx(event.goal)
        assert np.all(event.box_max > event.box_min)


def ray_meets_box(origin: np.ndarray, direction: np.ndarray, event: TrueEvent) -> bool:
    """The same question answered by walking along the ray in steps of two millimetres."""
    points = origin + np.arange(0.0, 8.0, 0.002)[:, None] * direction
    outside = np.maximum(np.maximum(event.box_min - points, points - event.box_max), 0.0)
    return bool(np.linalg.norm(outside, axis=1).min() < 0.002)


def test_a_hit_is_the_first_time_that_the_gaze_meets_the_box(adt_120: Performance) -> None:
    hits = [event for event in adt_120.events if event.prime_kind == "hit" and event.prime_first == event.prime_time]
    assert hits
    for event in hits:
        frame = int(np.searchsorted(adt_120.times, event.prime_time - 1e-9))
        look = range(frame, frame + 12)
        assert any(ray_meets_box(adt_120.eye[i], adt_120.gaze[i], event) for i in look)
        start = int(np.searchsorted(adt_120.times, event.event_time - 10.0))
        assert not any(ray_meets_box(adt_120.eye[i], adt_120.gaze[i], event) for i in range(start, frame, 6))


def test_limb_rotations_turn_the_y_axis_along_the_bone(adt_120: Performance) -> None:

    for child in (Joint.LEFT_KNEE, Joint.RIGHT_ANKLE, Joint.LEFT_ELBOW, Joint.RIGHT_WRIST):
        parent = PARENTS[child]
        bone = adt_120.joints[:, child] - adt_120.joints[:, parent]
        along = rotation_matrices(adt_120.rotations[:, parent])[..., 1]
        assert along == pytest.approx(bone / np.linalg.norm(bone, axis=1, keepdims=True), abs=1e-9)
    hand = rotation_matrices(adt_120.rotations[:, WRISTS[0]])[..., 1]
    length = np.linalg.norm(adt_120.finger_bases[:, 0] - adt_120.joints[:, WRISTS[0]], axis=1, keepdims=True)
    assert adt_120.finger_bases[:, 0] == pytest.approx(adt_120.joints[:, WRISTS[0]] + length * hand)


def test_fixations_follow_one_another_without_gaps(adt_120: Performance) -> None:
    starts = np.array([fixation.start for fixation in adt_120.fixations])
    ends = np.array([fixation.end for fixation in adt_120.fixations])
    assert starts[0] == 0.0
    assert ends[:-1] == pytest.approx(starts[1:])


def test_gaze_stays_on_a_goal_while_it_is_fixated(adt_120: Performance) -> None:
    errors = []
    for fixation in adt_120.fixations:
        settled = (adt_120.times > fixation.start + 0.25) & (adt_120.times < fixation.end)
        if fixation.kind == "goal" and settled.any():
            offset = fixation.target - adt_120.eye[settled]
            cosine = (offset * adt_120.gaze[settled]).sum(axis=1) / np.linalg.norm(offset, axis=1)
            errors.extend(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    assert np.median(errors) < 1.0  # the drift is 0.3 deg on either axis


"""The slow loop that judges priming: rays worked by hand, and the curation's vectorised rays as the second opinion."""


LOW = [-1.0, -1.0, -1.0]


HIGH = [1.0, 1.0, 1.0]


RATE = 120.0


def test_a_ray_enters_and_leaves_a_box_by_hand() -> None:
    assert slab_interval([0.0, 0.0, -3.0], [0.0, 0.0, 1.0], LOW, HIGH) == (2.0, 4.0)
    assert slab_interval([0.0, 0.0, 3.0], [0.0, 0.0, 1.0], LOW, HIGH) == (-4.0, -2.0)
    assert slab_interval([1.001, 0.0, -3.0], [0.0, 0.0, 1.0], LOW, HIGH) == (inf, -inf)


def test_a_hit_needs_the_box_in_front_and_some_extent() -> None:
    assert meets_box([0.0, 0.0, -3.0], [0.0, 0.0, 1.0], LOW, HIGH)
    assert meets_box([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], LOW, HIGH)
    assert not meets_box([0.0, 0.0, 3.0], [0.0, 0.0, 1.0], LOW, HIGH)
    assert meets_box([1.0, 0.0, -3.0], [0.0, 0.0, 1.0], LOW, HIGH)  # along a face
    assert not meets_box([0.0, 3.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


def test_the_distance_is_measured_towards_the_centre_by_hand() -> None:
    assert passing_distance([1.5, 0.0, -3.0], [0.0, 0.0, 1.0], LOW, HIGH) == pytest.approx(0.5)
    # The closest point is (1.5, 1.2, 0); towards the centre the box begins where x = 1.
    expected = sqrt(1.5**2 + 1.2**2) * (1 - 1 / 1.5)
    assert passing_distance([1.5, 1.2, -3.0], [0.0, 0.0, 1.0], LOW, HIGH) == pytest.approx(expected)
    assert passing_distance([0.0, 0.0, -3.0], [0.0, 0.0, 1.0], LOW, HIGH) == 0.0
    assert passing_distance([1.5, 0.0, 3.0], [0.0, 0.0, 1.0], LOW, HIGH) == inf
    point = [0.0, 0.0, 0.0]
    assert passing_distance([-1.0, 0.04, 0.0], [1.0, 0.0, 0.0], point, point) == pytest.approx(0.04)
    assert passing_distance([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], point, point) == 0.0


def _rays(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random rays; some along one or two axes, some from the corners and planes of a grid."""
    origins = rng.uniform(-3.0, 3.0, (count, 3))
    origins[::4] = np.round(origins[::4])
    directions = rng.normal(size=(count, 3))
    directions[::5, 0] = 0.0
    directions[::7, 1:] = 0.0
    directions[~directions.any(axis=1)] = (0.0, 0.0, -1.0)
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _boxes(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random boxes; some with corners on a grid, some flat, some points."""
    low = rng.uniform(-3.0, 3.0, (count, 3))
    low[::3] = np.round(low[::3])
    sizes = rng.uniform(0.02, 3.0, (count, 3))
    sizes[::3] = np.ceil(sizes[::3])
    sizes[1::5, 1] = 0.0
    sizes[2::5] = 0.0
    return low, low + sizes


@pytest.mark.parametrize("seed", range(3))
def test_the_loop_agrees_with_the_rays_of_the_curation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    origins, directions = _rays(rng, 90)
    low, high = _boxes(rng, 30)
    hits = slab_test(origins, directions, low, high)
    passed = near_miss(origins, directions, low, high)
    distances = np.where(passed.along >= 0, passed.distance, inf)
    for ray, (origin, direction) in enumerate(zip(origins.tolist(), directions.tolist(), strict=True)):
        for box, corners in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
            near, far = slab_interval(origin, direction, *corners)
            if hits.near[ray, box] < hits.far[ray, box]:
                assert (near, far) == pytest.approx((hits.near[ray, box], hits.far[ray, box]), abs=1e-12)
            # Ties in the last bit (a ray through an edge) may fall either way; everything else may not.
            if abs(near - far) > 1e-12 and abs(far) > 1e-12:
                assert meets_box(origin, direction, *corners) == hits.hit[ray, box]
            if abs(passed.along[ray, box]) > 1e-12:
                found = passing_distance(origin, direction, *corners)
                assert found == pytest.approx(distances[ray, box], abs=1e-12)


def _look(seconds_on_box: tuple[float, float], *, distance: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fifteen seconds of gaze that rests on (or beside) the box around the origin for one stretch only."""
    times = np.arange(round(15.0 * RATE)) / RATE
    eye = np.tile([0.0, 0.0, -2.0], (len(times), 1))
    gaze = np.tile([0.0, 1.0, 0.0], (len(times), 1))
    begin, end = seconds_on_box
    on = (times >= begin - 1e-9) & (times < end - 1e-9)
    gaze[on] = (0.0, 0.0, 1.0)
    eye[on, 0] = 0.1 + distance if distance else 0.0
    return times, eye, gaze


BOX = (np.array([-0.1, -0.1, -0.1]), np.array([0.1, 0.1, 0.1]))


@pytest.mark.parametrize(
    ("span", "distance", "lasting", "first", "kind"),
    [
        ((8.0, 9.0), 0.0, 8.0, 8.0, "hit"),
        ((8.0, 9.0), 0.03, 8.0, 8.0, "near_miss"),
        ((8.0, 8.0 + 4 / RATE), 0.0, None, 8.0, None),  # 33 ms: a saccade that sweeps across
        ((8.0, 9.0), 0.06, None, None, None),
        ((2.0, 3.0), 0.0, None, None, None),  # before the ten seconds
        ((13.0, 14.0), 0.0, None, None, None),  # after the event
    ],
)
def test_the_first_look_that_lasts_fifty_milliseconds(
    span: tuple[float, float], distance: float, lasting: float | None, first: float | None, kind: str | None
) -> None:
    seen = first_sight(*_look(span, distance=distance), *BOX, event_time=13.0 - 1e-6)
    assert (seen.lasting, seen.first, seen.kind) == (lasting, first, kind)


@pytest.mark.parametrize(
    ("span", "distance", "marginal"),
    [
        ((8.0, 9.0), 0.0, False),
        ((8.0, 9.0), 0.02, False),
        ((8.0, 9.0), 0.048, True),  # within 5 mm of the near-miss border
        ((8.0, 9.0), 0.053, True),
        ((8.0, 9.0), 0.06, False),
        ((8.0, 8.04), 0.0, True),
        ((2.0, 4.0), 0.0, True),  # already seen when the window begins
        ((12.97, 14.0), 0.0, True),
    ],
)
def test_looks_that_noise_could_change_are_marginal(span, distance, marginal) -> None:
    assert first_sight(*_look(span, distance=distance), *BOX, event_time=13.0).marginal is marginal


def test_the_synthetic_truth_shares_no_code_with_what_it_judges() -> None:
    folder = Path(prbench.synthetic.__file__).parents[1]
    for path in (*folder.glob("synthetic/**/*.py"), *folder.glob("readers/*/synthetic*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            judged = [name for name in names if name.startswith(("prbench.geometry.shapes", "prbench.curation"))]
            assert not judged, f"{path.relative_to(folder)} imports {judged}"
