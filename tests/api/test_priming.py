"""Priming on arrays of one's own: the prime times of a build, and clear words for arrays that do not fit."""

from __future__ import annotations

import dataclasses
import doctest

import numpy as np
import pandas as pd
import pytest

import prbench
from prbench.api import priming
from prbench.curation import curate_recording
from prbench.errors import PrbenchError
from tests.curation.scenes import MANIFEST, PROTOCOL, scene

TIMES = np.arange(0, 6, 0.1)
GOOD = {
    "times": TIMES,
    "origins": np.zeros((60, 3)),
    "directions": np.where(TIMES[:, None] < 3, [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]),
    "boxes": np.array([[[-0.1, -0.1, 1.9], [0.1, 0.1, 2.1]], [[5.0, 0.0, 0.0], [6.0, 1.0, 1.0]]]),
    "event_times": np.array([5.0, 5.5]),
}


def changed(name: str, row: tuple[int, ...] | int, value: float) -> dict[str, np.ndarray]:
    array = GOOD[name].copy()
    array[row] = value
    return GOOD | {name: array}


def test_the_example_of_the_docstring_runs() -> None:
    (example,) = doctest.DocTestFinder(recurse=False).find(priming.prime, "prime", globs={})
    found = doctest.DocTestRunner().run(example)
    assert found.attempted >= 6
    assert found.failed == 0


def test_primes_are_those_of_a_build() -> None:
    recording = scene(body=None)
    rows = [row for row in curate_recording(recording, MANIFEST, PROTOCOL).events if row.location is not None]
    boxes = np.array([[row.box_min, row.box_max] for row in rows])
    stream = recording.gaze
    rays = (stream.times, stream.origin, 3 * stream.direction)
    found = prbench.prime(*rays, boxes, [row.event_time for row in rows], actions=[row.action for row in rows])
    assert len(found) == 2
    for event, row in zip(found, rows, strict=True):
        assert event.prime_time == row.prime_time
        assert (event.prime_kind, event.prime_margin, event.action) == (row.prime_kind, row.prime_margin, row.action)
        assert event.prime_gap == pytest.approx(row.event_time - row.prime_time)
        assert event.prime_time_uncertainty == pytest.approx(1 / 30)
    frame = pd.DataFrame(found)
    assert list(frame.columns) == [field.name for field in dataclasses.fields(prbench.PrimedEvent)]
    assert frame.prime_time.tolist() == [row.prime_time for row in rows]


def test_samples_that_were_not_measured_prime_nothing() -> None:
    lost = TIMES < 4
    hidden = GOOD["directions"].copy()
    hidden[lost] = np.nan
    for given in (GOOD | {"valid": ~lost}, GOOD | {"directions": hidden}):
        first, other = prbench.prime(**given)
        assert (first.prime_time, first.outcome) == (pytest.approx(4.0), "primed")
        assert (other.prime_time, other.outcome) == (None, "not_primed")
        assert other.prime_margin < 0


def test_window_and_near_miss_are_the_users() -> None:
    beside = GOOD | {"boxes": [[0.2, 0.0, 2.0]], "event_times": [5.0]}  # a point, 20 cm beside the ray
    assert prbench.prime(**beside)[0].outcome == "not_primed"
    assert prbench.prime(**beside, near_miss=0.25)[0].prime_time == pytest.approx(3.0)
    assert prbench.prime(**beside, near_miss=0.25, window=1.0)[0].prime_time == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        pytest.param(changed("times", 7, 0.1), r"times\[7\]: expected a time after .*, found 0.1", id="time"),
        pytest.param(changed("directions", 3, 0.0), r"directions\[3\]: expected a direction", id="no length"),
        pytest.param(changed("boxes", (1, 0, 2), 9.0), r"boxes\[1\]: expected a lower and an upper", id="box"),
        pytest.param(changed("boxes", (0, 0, 0), np.nan), r"boxes\[0\]", id="a box without a corner"),
        pytest.param(changed("event_times", 1, np.nan), r"event_times\[1\]: expected a time, found nan", id="event"),
        pytest.param(GOOD | {"origins": np.zeros((59, 3))}, r"origins: expected the shape \(60, 3\)", id="shape"),
        pytest.param(GOOD | {"objects": ["cup"]}, r"objects: expected the shape \(2,\), found \(1,\)", id="names"),
        pytest.param(GOOD | {"origins": "eye"}, "origins: expected numbers, found str", id="kind"),
        pytest.param(GOOD | {"window": 0.0}, "priming window: expected a number above 0, found 0", id="window"),
        pytest.param(GOOD | {"times": 1e3 * TIMES + 1e5}, "do not overlap", id="milliseconds"),
    ],
)
def test_what_does_not_fit_is_named(given, message) -> None:
    with pytest.raises(PrbenchError, match=message):
        prbench.prime(**given)


def test_neither_gaze_nor_events_is_no_error() -> None:
    assert prbench.prime([], np.zeros((0, 3)), np.zeros((0, 3)), [[0, 0, 1]], [1.0])[0].prime_margin is None
    assert prbench.prime(**GOOD | {"boxes": np.zeros((0, 3)), "event_times": []}) == []
