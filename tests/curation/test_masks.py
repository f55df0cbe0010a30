"""Debouncing and joining of boolean masks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prbench.curation.masks import held_segments, runs

TIMES = np.arange(30) / 10


def mask(text: str) -> np.ndarray:
    """``#`` is True."""
    return np.array([letter == "#" for letter in text.ljust(30, ".")])


def segments(held: str, staying: str = "") -> list[list[int]]:
    found = held_segments(mask(held), mask(staying), TIMES, minimum_duration=0.2, join_gap=0.35)
    return found.tolist()


def test_runs_at_both_ends() -> None:
    assert runs(np.array([True, False, True, True])).tolist() == [[0, 1], [2, 4]]


def test_a_piece_of_exactly_the_minimum_counts_and_a_shorter_one_does_not() -> None:
    assert segments("..###") == [[2, 5]]
    assert segments("..##.") == []


def test_a_brief_gap_is_bridged_whatever_happens_in_it() -> None:
    assert segments("####..####") == [[0, 10]]  # 0.3 s from last to first
    assert segments("####...####") == [[0, 4], [7, 11]]


def test_a_long_gap_is_bridged_while_the_hand_stays() -> None:
    assert segments("####.........####", "....#########....") == [[0, 17]]
    assert segments("####.........####", "....####.####....") == [[0, 4], [13, 17]]


def test_three_pieces_of_which_two_belong_together() -> None:
    assert segments("####..####......####") == [[0, 10], [16, 20]]


def test_a_short_slide_beside_a_holding_does_not_lengthen_it() -> None:
    assert segments("##....####", "##########") == [[6, 10]]


def test_a_movement_that_pauses_at_its_beginning_is_one_piece_from_its_beginning() -> None:
    assert segments("##..####") == [[0, 8]]


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.lists(st.booleans(), min_size=60, max_size=60))
def test_time_reversal_changes_nothing(held: list[bool], staying: list[bool]) -> None:
    n = len(held)
    times = np.arange(n) / 10
    one = held_segments(np.array(held), np.array(staying[:n]), times, minimum_duration=0.2, join_gap=0.35)
    other = held_segments(np.array(held[::-1]), np.array(staying[:n][::-1]), times, minimum_duration=0.2, join_gap=0.35)
    assert one.tolist() == (n - other[::-1, ::-1]).tolist()


@pytest.mark.parametrize("held", ["", "#"])
def test_nothing_held_gives_nothing(held: str) -> None:
    assert segments(held) == []
