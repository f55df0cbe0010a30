"""Priming alone: when gaze first met the places of somebody's own events, without a dataset or a body.

The rule is that of every build (:func:`prbench.curation.priming.find_prime`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.curation.events import Decision, Place
from prbench.curation.priming import Rays, find_prime
from prbench.errors import UsageError
from prbench.geometry.timelines import require_overlap
from prbench.protocol.manifests import CurationConstants, load_protocol


@dataclass(frozen=True, eq=False)
class PrimedEvent:
    """One event and the first look at its place.

    Attributes:
        object_name: Name of the object.
        action: Name of the action; empty where none was given.
        event_time: Seconds on the clock of the gaze.
        outcome: ``primed`` or ``not_primed``.
        prime_time: Time of the first look in the window before the event, seconds; None where there was none.
        prime_kind: How gaze met the box: ``hit`` or ``near_miss``; None where it did not.
        prime_gap: Time from the prime to the event, seconds.
        prime_time_uncertainty: Time since the valid gaze sample before the prime, seconds: the look began in between.
        prime_margin: Near-miss distance minus the distance at which gaze passed the box, metres; negative by what was
            lacking, None without valid gaze in the window.
        event_confidence: Chance that the answer is right, from 0 to 1.
        box_min: Lower corner of the box, metres.
        box_max: Upper corner of the box, metres.
    """

    object_name: str
    action: str
    event_time: float
    outcome: str
    prime_time: float | None
    prime_kind: str | None
    prime_gap: float | None
    prime_time_uncertainty: float | None
    prime_margin: float | None
    event_confidence: float
    box_min: Float[np.ndarray, "3"]
    box_max: Float[np.ndarray, "3"]


def constants_of(**given: float | None) -> CurationConstants:
    """Return the protocol's constants, with other values of some where these are given.

    Args:
        given: A priming window (seconds) or near-miss distance (metres), or None, by the constant's name.

    Raises:
        UsageError: for a number that is not above 0.
    """
    changed = {name: value for name, value in given.items() if value is not None}
    for name, value in changed.items():
        if not 0 < value < np.inf:
            raise UsageError(f"{name.replace('_', ' ')}: expected a number above 0, found {value:g}.")
    return msgspec.structs.replace(load_protocol().curation, **changed)


def prime_events(
    rays: Rays,
    boxes: Float[np.ndarray, "m 2 3"],
    event_times: Float[np.ndarray, " m"],
    objects: Sequence[str],
    actions: Sequence[str],
    constants: CurationConstants,
) -> list[PrimedEvent]:
    """Prime events by equations 1 to 7 of *Prime and Reach*.

    Args:
        rays: Times, origins and unit directions of valid gaze samples; seconds, increasing, and metres.
        boxes: Lower and upper corner of each event's box, world-aligned, metres; equal corners are a point.
        event_times: Seconds.
        objects: Name of each event's object.
        actions: Name of each event's action.
        constants: Window and near-miss distance.

    Raises:
        StreamsDoNotOverlap: if no window before an event shares an instant with the gaze.
    """
    if len(event_times) and len(rays[0]):
        asked = (float(event_times.min()) - constants.priming_window, float(event_times.max()))
        require_overlap({"gaze": (float(rays[0][0]), float(rays[0][-1])), "events": asked}, recording="priming")
    events = []
    for (low, high), time, name, action in zip(boxes, event_times.tolist(), objects, actions, strict=True):
        found = find_prime(*rays, Place((low + high) / 2, low, high), time, constants)
        primed = not isinstance(found, Decision)
        prime = (found.time, found.kind, time - found.time, found.uncertainty) if primed else (None,) * 4
        distance = found.distance if primed else found.value
        margin = None if distance is None else constants.near_miss_distance - distance
        about = (name, action, time, "primed" if primed else "not_primed", *prime, margin)
        events.append(PrimedEvent(*about, found.confidence, low, high))
    return events
