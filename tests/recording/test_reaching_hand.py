"""Which hand reached: sources, distances and doubt, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import N_JOINTS, WRISTS
from prbench.recording.streams import BodyStream, HandStream, reaching_hand, wrists_at

PLACE = np.zeros(3)


def at(side, distance: float, source="tracked"):
    return side, (np.array([distance, 0.0, 0.0]), source)


@pytest.mark.parametrize(
    ("wrists", "hand"),
    [
        ((), None),  # nothing is known
        ((at("left", 0.19),), "left"),
        ((at("left", 0.21),), None),  # the hand that nobody saw may be nearer
        ((at("left", 0.39), at("right", 0.60)), "left"),
        ((at("left", 0.41), at("right", 0.60)), None),  # neither is there
        ((at("left", 0.125), at("right", 0.10)), "right"),
        ((at("left", 0.115), at("right", 0.10)), None),  # closer to each other than places are exact
    ],
)
def test_the_nearest_wrist_counts_where_it_is_near_and_clearly_nearer(wrists, hand) -> None:
    assert reaching_hand(dict(wrists), PLACE)[0] == hand


def test_the_source_is_that_of_the_nearest_wrist() -> None:
    wrists = dict((at("left", 0.5), at("right", 0.1, "body")))
    assert reaching_hand(wrists, PLACE) == ("right", "body")


def _tracked(side, x: float, unseen: tuple[float, float] = (0.0, 0.0)) -> HandStream:
    times = np.arange(0, 10, 0.1)
    valid = (times < unseen[0]) | (times > unseen[1])
    return HandStream(side, "wrist", times, np.tile([x, 0.0, 0.0], (len(times), 1, 1)), valid)


def _body(left: float, right: float) -> BodyStream:
    times = np.arange(0, 10, 1 / 30)
    joints = np.zeros((len(times), N_JOINTS, 3))
    joints[:, WRISTS, 0] = [left, right]
    return BodyStream(times, joints, np.ones(len(times), dtype=bool))


def test_a_wrist_is_the_tracked_one_and_the_bodys_only_where_tracking_lost_it() -> None:
    hands = (_tracked("right", 2.0), _tracked("left", 1.0, unseen=(4.9, 5.2)))
    wrists = wrists_at(hands, _body(1.1, 2.1), 5.05)
    found = [(side, source, position[0]) for side, (position, source) in wrists.items()]
    assert found == [("left", "body", pytest.approx(1.1)), ("right", "tracked", pytest.approx(2.0))]


def test_a_wrist_that_neither_source_knows_is_left_out() -> None:
    hands = (_tracked("left", 1.0, unseen=(4.9, 5.2)), _tracked("right", 2.0))
    assert list(wrists_at(hands, None, 5.05)) == ["right"]
    assert wrists_at((), _body(1.0, 2.0), 11.0) == {}, "after the end of the body"


def test_other_contact_points_are_no_wrists() -> None:
    fingers = HandStream("left", "middle_finger_base", np.arange(3.0), np.zeros((3, 1, 3)), np.ones(3, dtype=bool))
    assert wrists_at((fingers,), None, 1.0) == {}
