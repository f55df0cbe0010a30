"""Distances from a hand to an object's box, origin or surface (the manifest's in-hand rule), as masks over time."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.curation.rest import Departure
from prbench.errors import UsageError
from prbench.geometry.meshes import TriangleMesh
from prbench.geometry.timelines import covered, interpolate
from prbench.protocol.manifests import InHandRule
from prbench.recording import HandStream, ObjectTrack, Recording
from prbench.recording.streams import Side

_SLACK = 1e-6  # seconds; times are computed, so equality needs room
_LONGEST_HAND_GAP = 1.0
"""Seconds; hand samples further apart are not interpolated. Long enough that a holding survives the stretches of
implausible poses that a noisy suit gives: who holds something before and after holds it in between."""
_LONGEST_UNSEEN = 2.0
"""Seconds; a hand that is close to an object on both sides of a stretch without measurements never left it (hands leave
the view of the glasses while they carry something)."""
_VERTICES_AT_ONCE = 200_000
"""Bounds the memory that meshes of hands need."""


def runs(mask: Bool[np.ndarray, " n"]) -> Int[np.ndarray, "k 2"]:
    """First index and end (exclusive) of every run of True, in order."""
    edges = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)])


def held_segments(
    held: Bool[np.ndarray, " n"],
    staying: Bool[np.ndarray, " n"],
    times: Float[np.ndarray, " n"],
    *,
    minimum_duration: float,
    join_gap: float,
) -> Int[np.ndarray, "k 2"]:
    """Holdings from raw per-sample evidence (docs/specification/curation.md#in-hand-segmentation).

    Neighbouring runs of ``held`` that are at most ``join_gap`` apart are one piece; pieces shorter than
    ``minimum_duration`` are dropped (debounce); two that are left are joined where every sample between them is
    ``staying`` (hysteresis: it takes more to begin a holding than to go on with one).

    Args:
        held: Samples at which the object is surely held: a hand is close and the object moves.
        staying: Samples that do not end a holding: the hand stays close.
        times: Strictly increasing, seconds.
        minimum_duration: Shortest piece that counts, seconds.
        join_gap: Longest interruption that is bridged whatever happens in it, seconds.

    Returns:
        First index and end (exclusive) of each holding, in order, without overlap.
    """
    pieces = runs(held)
    pieces = _joined(pieces, times[pieces[1:, 0]] - times[pieces[:-1, 1] - 1] <= join_gap + _SLACK)
    pieces = pieces[times[pieces[:, 1] - 1] - times[pieces[:, 0]] >= minimum_duration - _SLACK]
    # Counts of samples that end a holding; equal counts on both sides of a gap mean none in it.
    left_before = np.concatenate(([0], np.cumsum(~staying)))
    return _joined(pieces, left_before[pieces[1:, 0]] == left_before[pieces[:-1, 1]])


def _joined(pieces: Int[np.ndarray, "k 2"], together: Bool[np.ndarray, " gaps"]) -> Int[np.ndarray, "m 2"]:
    """Pieces with the gaps between them closed where ``together`` says so; one entry a gap."""
    if len(pieces) == 0:
        return pieces
    return np.column_stack(
        [pieces[np.concatenate(([True], ~together)), 0], pieces[np.concatenate((~together, [True])), 1]]
    )


def contact_streams(recording: Recording, rule: InHandRule) -> tuple[HandStream, ...]:
    """The contact points of the rule: the wearer's, then everybody else's."""
    others = (hand for person in recording.other_people for hand in person.hands if hand.contact == rule.contact)
    return (*recording.hand_streams(rule.contact), *others)


def require_surfaces(recording: Recording, rule: InHandRule) -> None:
    """Refuse a rule about surfaces where no object has one.

    Raises:
        UsageError: saying how to get them.
    """
    if rule.target == "surface" and all(track.surface is None for track in recording.objects):
        raise UsageError(
            f"{recording.recording_id}: the in-hand rule measures distances to the objects' surfaces, and the recording"
            " was read without them. Add `--option meshes=true`."
        )


def contact_distance(
    hand: HandStream,
    track: ObjectTrack,
    rule: InHandRule,
    times: Float[np.ndarray, " n"],
    position: Float[np.ndarray, "n 3"],
    rotation: Float[np.ndarray, "n 4"],
) -> Float[np.ndarray, " n"]:
    """Distance of the hand's nearest contact point to the object at given poses, metres; inf where unmeasured.

    An object without surface stands in with its box where the rule asks for surfaces.
    Where no point is within ``rule.distance`` of the box, the distance to the box is given: the surface is not nearer.

    Args:
        hand: Contact points of one hand.
        track: The object, for its box and its surface.
        rule: What counts: the oriented box, the origin, the surface.
        times: Seconds, any order.
        position: Position of the object at ``times``.
        rotation: Its orientation, w x y z.

    Raises:
        MissingExtraError: if the rule asks for a surface, and Open3D is not installed.
    """
    measured = covered(hand.times, hand.valid, times, max_gap=_LONGEST_HAND_GAP)
    if not measured.any():
        return np.full(len(times), np.inf)
    surface = None
    if rule.target == "surface" and track.surface is not None:
        surface = TriangleMesh(track.surface.vertices, track.surface.faces)
    sampled = hand.times[hand.valid], hand.points[hand.valid]
    rows = max(1, _VERTICES_AT_ONCE // hand.points.shape[1])
    nearest = [
        _nearest(interpolate(*sampled, times[part]), track, rule, position[part], rotation[part], surface)
        for part in (slice(start, start + rows) for start in range(0, len(times), rows))
    ]
    return np.where(measured, np.concatenate(nearest), np.inf)


def close_to(
    distance: Float[np.ndarray, " n"], times: Float[np.ndarray, " n"], rule: InHandRule
) -> Bool[np.ndarray, " n"]:
    """Samples at which one hand is close: nearer than the rule's distance, or unseen between two such samples.

    Args:
        distance: Of that hand; inf where it was not measured.
        times: Seconds.
        rule: The distance.
    """
    close = distance < rule.distance
    for start, stop in runs(~np.isfinite(distance)):
        inside = start > 0 and stop < len(times)
        if inside and close[start - 1] and close[stop] and times[stop] - times[start - 1] <= _LONGEST_UNSEEN:
            close[start:stop] = True
    return close


def nearest_hand(
    hands: tuple[HandStream, ...], track: ObjectTrack, rule: InHandRule, time: float, pose: Departure
) -> tuple[Side | None, float]:
    """The side of the hand nearest to an object at one instant, and its distance; (None, inf) if none is measured."""
    at = np.array([time])
    distances = [
        float(contact_distance(hand, track, rule, at, pose.position[None], pose.rotation[None])[0]) for hand in hands
    ]
    if not distances or not np.isfinite(min(distances)):
        return None, float("inf")
    nearest = int(np.argmin(distances))
    return hands[nearest].side, distances[nearest]


def _nearest(
    points: Float[np.ndarray, "n k 3"],
    track: ObjectTrack,
    rule: InHandRule,
    position: Float[np.ndarray, "n 3"],
    rotation: Float[np.ndarray, "n 4"],
    surface: TriangleMesh | None,
) -> Float[np.ndarray, " n"]:
    """Distance of the nearest of ``k`` points to the object, metres."""
    offset = points - position[:, None]
    if rule.target == "origin":
        return np.linalg.norm(offset, axis=-1).min(axis=1)
    object_from_world = Rotation.from_quat(rotation, scalar_first=True).as_matrix().transpose(0, 2, 1)
    local = np.einsum("nij,nkj->nki", object_from_world, offset)
    distance = np.linalg.norm(np.maximum(np.maximum(track.box_min - local, local - track.box_max), 0.0), axis=-1)
    if surface is not None:
        # The box holds the surface, so a point outside its reach needs no look at triangles.
        near = distance < rule.distance
        distance[near] = surface.distance(local[near])
    return distance.min(axis=1)
