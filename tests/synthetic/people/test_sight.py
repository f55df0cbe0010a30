"""The slow loop that judges priming: rays worked by hand, and the curation's vectorised rays as the second opinion."""

from __future__ import annotations

import ast
from math import inf, sqrt
from pathlib import Path

import numpy as np
import pytest

import prbench.synthetic
from prbench.geometry.shapes import near_miss, slab_test
from prbench.synthetic.people.truth import first_sight, meets_box, passing_distance, slab_interval

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
