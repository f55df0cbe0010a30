"""Pick and put events: found by in-hand segmentation or annotated, each with its place.

Source: docs/specification/curation.md#events.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.curation.confidence import beyond
from prbench.curation.in_hand import LONGEST_SURE_GAP, Departure, Holding, contact_streams, find_holdings, nearest_hand
from prbench.protocol.manifests import InHandRule
from prbench.recording import Action, HandSource, PublishedPriming, Recording, Side, reaching_hand, wrists_at


@dataclass(frozen=True)
class Decision:
    """The outcome of an event, its stage, the number that decided, and how sure that is, from 0 to 1."""

    outcome: str
    stage: str
    value: float | None = None
    threshold: float | None = None
    confidence: float = 1.0


@dataclass(frozen=True)
class Place:
    """The place of an event: for a put, the future resting place. World frame, metres.

    Attributes:
        location: Centre of the box, or the point that the dataset annotates.
        box_min: Lower corner of the world-aligned box; equal to ``box_max`` where only a point is known.
    """

    location: Float[np.ndarray, "3"]
    box_min: Float[np.ndarray, "3"]
    box_max: Float[np.ndarray, "3"]


@dataclass(frozen=True)
class PickPutEvent:
    """One candidate event.

    Attributes:
        hand_source: Source of the hand; None where it is unknown.
        displacement: Distance by which the object moved away from its rest, metres; None where nobody measured it.
        tracking_gap: Length of the gap in the object's track that the event falls into, seconds; None outside such
            gaps.
        published_priming: The dataset's own statement about its priming.
        rejected: The reason why the event is not of this recording, where that is known already.
        primed_anew: True where a person has corrected its time or place: what the dataset publishes is then of another
            event.
        settled: True where a person has accepted or corrected it: no confidence is too small then.
        corrected: What a person has said of it, why and who; None where nobody has.
    """

    event_id: str
    object_id: str
    object_name: str
    action: Action
    event_time: float
    place: Place | None
    hand: Side | None
    hand_source: HandSource | None
    displacement: float | None
    tracking_gap: float | None = None
    published_priming: PublishedPriming | None = None
    rejected: Decision | None = None
    primed_anew: bool = False
    settled: bool = False
    corrected: str | None = None


def find_events(recording: Recording, rule: InHandRule | None) -> tuple[list[PickPutEvent], tuple[str, ...]]:
    """Candidate events in the order of time: the dataset's annotations where it has them, else in-hand segmentation.

    Args:
        recording: What a reader yields.
        rule: When an object is in hand; None for a dataset that annotates its events.

    Returns:
        The events, and remarks that a user should see.
    """
    same = ("object_id", "object_name", "action", "event_time", "hand", "hand_source", "published_priming")
    events = []
    for listed in recording.annotated_events:
        place = None
        if listed.location is not None:
            corners = (listed.location, listed.location)
            if listed.box_min is not None and listed.box_max is not None:
                corners = (listed.box_min, listed.box_max)
            place = Place(listed.location, *corners)
        name = event_id(recording, listed.object_id, listed.action, listed.event_time)
        about: dict[str, Any] = {each: getattr(listed, each) for each in same}
        rejected = Decision("no_location", "location") if place is None else None
        events.append(PickPutEvent(event_id=name, **about, place=place, displacement=None, rejected=rejected))
    holdings = [] if rule is None or recording.annotated_events else find_holdings(recording, rule)
    for holding in holdings:
        assert rule is not None, "holdings are found by a rule"
        # A pick before the recording began, or a put after its end, is none.
        if holding.pick is not None:
            events.append(_event(recording, holding, "pick", holding.pick.time, holding.pick, rule))
        if holding.put is not None:
            events.append(_event(recording, holding, "put", holding.put.time, holding.put, rule))
        elif holding.vanished is not None:
            events.append(_event(recording, holding, "put", holding.vanished, None, rule))
    events.sort(key=lambda event: (event.event_time, event.event_id))
    # One event an id: a dataset that lists one event twice gets a remark, not two sequences.
    unique = list({event.event_id: event for event in reversed(events)}.values())[::-1]
    repeated = len(events) - len(unique)
    remarks = (f"{repeated} events are listed twice, with equal object, action and time",) if repeated else ()
    return unique, remarks


def event_id(recording: Recording, object_id: str, action: Action, event_time: float) -> str:
    """Built from native keys, so that equal inputs give equal ids whatever else is in the build; time in µs."""
    return f"{recording.dataset}/{recording.recording_id}/{object_id}/{action}/{round(event_time * 1e6)}"


def _event(
    recording: Recording, holding: Holding, action: Action, time: float, rest: Departure | None, rule: InHandRule
) -> PickPutEvent:
    """Make an event of a holding; without a rest the object leaves the hand and never comes to rest while tracked."""
    rejected = None
    place = None
    reaching: tuple[Side | None, HandSource | None] = (None, None)
    if rest is None:
        rejected = Decision("no_location", "location")
    else:
        wearer = recording.hand_streams(rule.contact)
        others = contact_streams(recording, rule)[len(wearer) :]
        hand, distance = nearest_hand(wearer, holding.track, rule, time, rest)
        _, other_distance = nearest_hand(others, holding.track, rule, time, rest)
        # An unmeasured hand counts as just touching: another's has to be nearer than that to take the event.
        if other_distance < (distance if np.isfinite(distance) else rule.distance):
            value = distance if np.isfinite(distance) else None
            rejected = Decision("other_wearer", "in_hand", value, other_distance, beyond(distance - other_distance))
        elif rule.drop_hinged and holding.track.object_id in recording.hinged_objects:
            rejected = Decision("excluded_category", "in_hand")
        elif not rest.placed:
            rejected = Decision("tracking_lost", "location", rest.gap_length, LONGEST_SURE_GAP)
        low, high = holding.track.world_box(rest.position[None], rest.rotation[None])
        place = Place((low[0] + high[0]) / 2, low[0], high[0])
        if rejected is None or rejected.outcome != "other_wearer":
            # The hand in contact; where none is, because contact points were lost, the wrists tell.
            if hand is not None and distance <= rule.distance:
                reaching = (hand, "contact")
            else:
                reaching = reaching_hand(wrists_at(recording.hands, recording.body, time), place.location)
    gap = 0.0 if rest is None else rest.gap_length
    lost = gap if gap > LONGEST_SURE_GAP else None
    names = (event_id(recording, holding.track.object_id, action, time), holding.track.object_id, holding.track.name)
    return PickPutEvent(*names, action, time, place, *reaching, holding.displacement, lost, rejected=rejected)
