"""Matching found with true events, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from prbench.checking.verify_synthetic import Spread, match_events
from prbench.sequences.sequence import Event
from prbench.synthetic.performance import TrueEvent
from tests.checking.levels import verification


def true(
    time: float, *, action: str = "pick", name: str = "1", tag: str = "plain", expected: str = "sequence",
    prime: float | None = -3.0, thin: bool = False, hand: str = "left",
) -> TrueEvent:  # fmt: skip
    zero, time = np.zeros(3), float(time)
    prime_time = None if prime is None else time + prime
    return TrueEvent(
        "e", action, tag, name, "cup", hand, time, time, time, zero, zero, zero, prime_time, prime_time, prime_time,
        None, time - 1, time - 1, expected, thin,
    )  # fmt: skip


def found(
    time: float, *, action: str = "pick", name: str = "1", outcome: str = "sequence", prime: float | None = -3.0,
    stage: str = "filters", hand: str | None = "left", **columns,
) -> Event:  # fmt: skip
    point, time = np.array([0.0, 0.0, 0.01]), float(time)
    return Event(
        f"{name}/{action}/{time}", "r", None, name, "cup", action, hand, time,
        None if prime is None else time + prime, None, point, point, point, outcome, stage, None, None,
        **columns,
    )  # fmt: skip


def pairs(true_events: list[TrueEvent], found_events: list[Event]) -> set[tuple[float | None, float | None]]:
    return {
        (m.true.event_time if m.true else None, m.found.event_time if m.found else None)
        for m in match_events(true_events, found_events)
    }


def test_the_nearest_pair_is_matched_first_and_each_event_once() -> None:
    # 10.3 is nearer to 10.4 than to 10.0, so 10.0 has to take 9.8.
    assert pairs([true(10.0), true(10.4)], [found(10.3), found(9.8)]) == {(10.0, 9.8), (10.4, 10.3)}


def test_objects_actions_and_half_a_second_keep_events_apart() -> None:
    assert pairs([true(10.0)], [found(10.0, name="2")]) == {(10.0, None), (None, 10.0)}
    assert pairs([true(10.0)], [found(10.0, action="put")]) == {(10.0, None), (None, 10.0)}
    assert pairs([true(10.0)], [found(10.5)]) == {(10.0, 10.5)}
    assert pairs([true(10.0)], [found(10.51)]) == {(10.0, None), (None, 10.51)}


def test_recall_precision_and_errors_by_hand() -> None:
    matches = match_events(
        [true(10.0), true(20.0), true(30.0), true(40.0)],
        [found(10.1), found(20.0), found(30.3, prime=-3.3), found(50.0)],
    )
    result = verification(matches, recordings=1)
    assert (result.recall, result.precision) == (0.75, 0.75)
    assert result.timing.bias == pytest.approx(0.4 / 3)
    assert result.timing.median == pytest.approx(0.1)
    assert result.prime.largest == pytest.approx(0.1)


def test_priming_recall_and_false_primes_have_their_own_denominators() -> None:
    unseen = {"prime": None, "outcome": "not_primed", "stage": "priming"}
    nothing = {"prime": None, "expected": "not_primed"}
    matches = match_events(
        [true(10), true(20), true(30, **nothing), true(40, **nothing), true(50, **nothing), true(60)],
        [found(10), found(20, **unseen), found(30), found(40, **unseen), found(50, **unseen)],
    )
    result = verification(matches, recordings=1)
    assert result.priming_recall == 0.5, "of the matched events with a prime; the missing one does not count"
    assert result.false_primes == pytest.approx(1 / 3)


def test_thin_and_lost_events_and_what_was_found_of_them_count_nowhere_else() -> None:
    matches = match_events(
        [true(10, thin=True), true(20, tag="lost"), true(30, tag="lost"), true(40)],
        [found(10.2), found(20.3, outcome="tracking_lost", stage="location"), found(40)],
    )
    result = verification(matches, recordings=1)
    assert (result.true_events, result.thin, result.precision) == (1, 1, 1.0)
    assert result.timing.largest == 0.0


def test_hands_are_right_wrong_or_unknown() -> None:
    matches = match_events(
        [true(10), true(20), true(30, hand="right"), true(40)],
        [found(10), found(20, hand=None), found(30), found(40)],
    )
    assert verification(matches, recordings=1).hands == {"right": 2, "wrong": 1, "unknown": 1}


def test_every_sequence_that_is_missing_is_listed_with_its_outcome() -> None:
    unseen = {"prime": None, "outcome": "not_primed", "stage": "priming"}
    matches = match_events([true(10), true(20), true(30), true(40, thin=True)], [found(10), found(20, **unseen)])
    result = verification(matches, recordings=1)
    assert result.expected_sequences == 3
    assert result.missed_sequences == ("e (pick): not_primed", "e (pick): not_found")


def test_what_is_no_event_must_not_be_found() -> None:
    nudge = true(10, tag="nudge", expected="not_an_event")
    assert verification(match_events([nudge], []), recordings=1).recall == 1.0
    result = verification(match_events([nudge], [found(10)]), recordings=1)
    assert (result.recall, result.precision) == (1.0, 0.0)


def test_an_empty_sample_is_nan_not_zero() -> None:
    assert Spread.of([]).n == 0
    assert math.isnan(Spread.of([]).median)
