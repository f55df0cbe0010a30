"""Find when somebody's hand holds an object, by the manifest's rule.

Source: docs/specification/curation.md#in-hand-segmentation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench.curation.contact import close_to, contact_distance, contact_streams, held_segments, require_surfaces
from prbench.curation.rest import Departure, Track, find_departure, placed_in_gap, windowed_speed
from prbench.protocol.manifests import InHandRule
from prbench.recording import HandStream, ObjectTrack, Recording


@dataclass(frozen=True)
class Holding:
    """One object taken from a rest, moved, and brought to another rest."""

    track: ObjectTrack
    pick: Departure | None
    """The pick; None where the object was in hand, or moving, when the recording began."""
    put: Departure | None
    """The put; None where it is in hand when the recording ends, or where it never comes to rest."""
    vanished: float | None
    """Last time at which it was surely held, seconds, where it never comes to rest afterwards; else None."""
    displacement: float
    """Largest distance from its rest, metres."""


def find_holdings(recording: Recording, rule: InHandRule) -> list[Holding]:
    """Every holding of every movable object by the wearer or by somebody else, objects in the recording's order.

    Slides shorter than ``rule.smallest_displacement`` are nudges and left out. Without a stream of the rule's contact
    point on the wearer's hands nothing can be said, and nothing is found.

    Raises:
        UsageError: for a rule about surfaces where no object has one.
    """
    require_surfaces(recording, rule)
    hands = contact_streams(recording, rule)
    if not recording.hand_streams(rule.contact):
        return []
    found: list[Holding] = []
    for track in recording.objects:
        if track.movable and _moves(track, rule):
            found.extend(_holdings_of(track, hands, rule))
    return found


def _moves(track: ObjectTrack, rule: InHandRule) -> bool:
    """Return True if the centre of the box can have moved far enough at all: a cheap upper bound."""
    if np.count_nonzero(track.valid) < 2:
        return False
    lever = float(np.linalg.norm((track.box_min + track.box_max) / 2))
    # Two orientations whose quaternions are d apart differ by an angle of at most pi d.
    farthest = _diameter(track.position, track.valid) + np.pi * _diameter(track.rotation, track.valid) * lever
    return farthest >= rule.smallest_displacement


def _diameter(rows: Float[np.ndarray, "n k"], valid: Bool[np.ndarray, " n"]) -> float:
    """Upper bound of the distance between any two valid rows: twice the half diagonal of a cube around the first."""
    rows = rows if valid.all() else rows[valid]
    return 2 * float(np.sqrt(rows.shape[1]) * np.abs(rows - rows[0]).max())


def _holdings_of(track: ObjectTrack, hands: tuple[HandStream, ...], rule: InHandRule) -> list[Holding]:
    samples = _samples(track, rule)
    distances = [
        contact_distance(hand, track, rule, samples.times, samples.position, samples.rotation) for hand in hands
    ]
    close = np.any([close_to(distance, samples.times, rule) for distance in distances], axis=0)
    moving = samples.speed > rule.moving_speed
    still = samples.speed < rule.moving_speed / 2
    staying = close | ~still  # what never came to rest was not put down
    segments = held_segments(
        close & moving,
        staying,
        samples.times,
        minimum_duration=rule.minimum_duration,
        join_gap=rule.join_gap,
    )
    n = len(samples.times)
    # A put is a pick seen backwards in time, so one search serves both.
    backwards = samples.reversed()
    floors = np.concatenate(([0], segments[:-1, 1])) if len(segments) else segments[:, 0]
    ceilings = np.concatenate((segments[1:, 0], [n])) if len(segments) else segments[:, 0]
    found = []
    for (start, stop), floor, ceiling in zip(segments.tolist(), floors.tolist(), ceilings.tolist(), strict=True):
        pick = find_departure(samples, still, start, stop, floor=floor, tolerance=rule.rest_tolerance)
        put = find_departure(
            backwards, still[::-1], n - stop, n - start, floor=n - ceiling, tolerance=rule.rest_tolerance
        )
        put = None if put is None else put.reversed()
        displacement = _displacement(samples.centre[start:stop], pick or put)
        if displacement < rule.smallest_displacement:
            continue
        held_before = bool(staying[:start].all())
        held_after = bool(staying[stop:].all())
        found.append(
            Holding(
                track=track,
                pick=None if pick is None or held_before else placed_in_gap(pick, hands, rule.distance),
                put=None if put is None or held_after else placed_in_gap(put, hands, rule.distance),
                vanished=float(samples.times[stop - 1]) if put is None and not held_after else None,
                displacement=displacement,
            )
        )
    return found


def _samples(track: ObjectTrack, rule: InHandRule) -> Track:
    times, position, rotation = (column[track.valid] for column in (track.times, track.position, track.rotation))
    middle = (track.box_min + track.box_max) / 2
    centre = position + Rotation.from_quat(rotation, scalar_first=True).apply(middle)
    return Track(
        times, centre, position, rotation, windowed_speed(times, centre, window=rule.moving_window), rule.moving_window
    )


def _displacement(centre: Float[np.ndarray, "n 3"], rest: Departure | None) -> float:
    """Largest distance of the held object, smoothed over three samples, from its rest; metres."""
    # One jump of the tracker must not make a nudge look like a displacement.
    if len(centre) >= 3:
        centre = (centre[:-2] + centre[1:-1] + centre[2:]) / 3
    origin = centre[0] if rest is None else rest.centre
    return float(np.linalg.norm(centre - origin, axis=1).max())
