"""Events while the object was not tracked: the hands tell when in the gap they happened."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from prbench.curation.rest import Departure
from prbench.recording import HandStream
from prbench.timelines import covered, interpolate

LONGEST_SURE_GAP = 0.1
"""Seconds; within a longer gap in the track, interpolation says nothing about when the movement began."""
_SAME_PLACE = 0.003  # metres; how exactly a hand has to come to where it held the object at rest
_RATE = 120.0
_LONGEST_HAND_GAP = 0.1


def placed_in_gap(departure: Departure, hands: tuple[HandStream, ...], distance: float) -> Departure:
    """Put an instant that falls into a tracking gap where the hand says it was.

    A held object moves with the hand that is nearest to it on the far side of the gap, and however it turns, its centre
    stays equally far from that hand. So the object can have been at its rest only while the hand was that far from the
    rest; within that time, it left when the hand's path, shifted to meet the object on the far side, leaves the point
    where it comes nearest to the rest. If the hand never comes that near, up to ``distance``, the middle of the gap is
    given and the departure marked as not placed.

    Args:
        departure: With its gap: from the sample at rest to the one away from it (backwards for a put).
        hands: Contact points that may have held the object.
        distance: Metres.
    """
    rest_time, away_time = departure.gap
    if departure.gap_length <= LONGEST_SURE_GAP:
        return departure
    times = np.linspace(
        away_time, rest_time, int(np.ceil(departure.gap_length * _RATE)) + 1
    )  # from the far side to the rest
    measured = [hand for hand in hands if covered(hand.times, hand.valid, times, max_gap=_LONGEST_HAND_GAP).all()]
    paths = [interpolate(hand.times[hand.valid], hand.points[hand.valid].mean(axis=1), times) for hand in measured]
    if paths:
        path = min(paths, key=lambda path: float(np.linalg.norm(path[0] - departure.first_away)))
        reach = float(np.linalg.norm(path[0] - departure.first_away))
        excess = np.linalg.norm(path - departure.centre, axis=1) - reach
        nearest = max(float(excess.min()), 0.0)
        if nearest < distance:
            apart = np.linalg.norm(departure.first_away + path - path[0] - departure.centre, axis=1)
            apart[excess > nearest + _SAME_PLACE] = np.inf
            return replace(departure, time=float(times[np.flatnonzero(apart <= apart.min() + _SAME_PLACE)[0]]))
    return replace(departure, time=(rest_time + away_time) / 2, placed=False)
