"""The pure core of curation: one recording in, its sequences and the story of every candidate event out."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.curation.clipping import Clip, clip
from prbench.curation.confidence import TRACK_PAUSE, beyond, unbroken
from prbench.curation.corrections import DROPPED, Corrections
from prbench.curation.events import Decision, PickPutEvent, find_events
from prbench.curation.options import DEFAULTS, CurationOptions
from prbench.curation.priming import PUBLISHED_STAGE, Prime, Rays, find_prime, gaze_rays
from prbench.errors import RecordingUnusable
from prbench.geometry.shapes import Boxes, deepest
from prbench.geometry.skeleton import WRISTS, Joint, canonical_frame, invert_rigid, transform_points
from prbench.protocol.manifests import BenchmarkProtocol, InHandRule, Manifest
from prbench.recording import Recording, wrists_at
from prbench.sequences.sequence import Event, SceneBox, Sequence
from prbench.sequences.sequence import Recording as RecordingRow
from prbench.sequences.table import body_movement, hand_movement

# Metres within which a thing keeps its place through the recording; choice: above the noise of optical tracking.
_STILL = 0.01
# What both tables of a recording tell of an event in the same words.
_OF_THE_EVENT = ("action", "object_id", "object_name", "hand", "event_time")
# Points of a clip that come into the canonical frame.
_MOVED = ("joints", "previous_joints", "next_joints", "gaze_origin")


def _copied(source: object, *names: str) -> dict[str, Any]:
    """Return attributes that a row of a table takes over as they are."""
    return {name: getattr(source, name) for name in names}


@dataclass(frozen=True)
class CuratedRecording:
    """The result of curating one recording.

    Attributes:
        sequences: Sorted by ``sequence_id``.
        events: Every candidate event, sorted by ``event_id``.
        boxes: What stands still around the person, sorted by ``object_id``.
    """

    sequences: tuple[Sequence, ...]
    events: tuple[Event, ...]
    record: RecordingRow
    boxes: tuple[SceneBox, ...] = ()


def curate_recording(
    recording: Recording,
    manifest: Manifest,
    protocol: BenchmarkProtocol,
    options: CurationOptions = DEFAULTS,
    *,
    split: str = "",
    corrections: Corrections | None = None,
    findings: tuple[str, ...] = (),
) -> CuratedRecording:
    """Find the events of a recording, prime, clip and filter them (docs/specification/curation.md).

    Args:
        recording: What a reader yields.
        manifest: The dataset's in-hand rule.
        protocol: Constants of the path from event to sequence.
        options: What the user chose.
        split: The split, where the recording carries its own (synthetic trees); empty where a build draws it.
        corrections: A person's corrections of its events, applied before these are primed.
        findings: What :func:`prbench.curation.stream_checks.examine_streams` has to tell of the recording.

    Raises:
        UnknownEventError: for a correction of an event that is not found.
        RecordingUnusable: if published priming is asked for and the recording has none.
    """
    rule = manifest.in_hand_rule(options.in_hand)
    events, remarks = find_events(recording, rule)
    if corrections is not None:
        events = corrections.settle(events)
    if options.priming == "published" and not recording.has_published_priming:
        lacks = "--priming published needs the dataset's own priming results, and their file is not there"
        raise RecordingUnusable(f"{recording.recording_id}: {lacks}. Download it too, or leave the option out.")
    rays = gaze_rays(recording, options.ray_origin or protocol.curation.ray_origin)
    sequences = []
    rows = []
    for event in events:
        decision, prime, piece = _follow(recording, event, rays, protocol, options)
        place = event.place
        published = event.published_priming
        known = wrists_at(recording.hands, recording.body, event.event_time)
        wrists = {side: position for side, (position, _) in known.items()}
        confidence = None  # nothing was measured of an event without a place
        if place is not None:
            trust = unbroken(event.tracking_gap or 0.0, usual=TRACK_PAUSE)
            if len(wrists) == 2 and event.hand_source not in ("annotated", "person"):
                left, right = (float(np.linalg.norm(wrist - place.location)) for wrist in wrists.values())
                trust *= beyond(abs(left - right))
            confidence = decision.confidence * (prime.confidence if prime else 1.0) * trust
        doubted = confidence is not None and confidence < options.min_confidence and not event.settled
        sequence = None
        if piece is not None and doubted:
            decision = Decision("low_confidence", "confidence", confidence, options.min_confidence)
        elif piece is not None and prime is not None:
            sequence = _sequence(recording, event, prime, piece, protocol, split)
            sequences.append(sequence)
        margin = None
        if prime is not None and prime.kind != "published":
            margin = protocol.curation.near_miss_distance - prime.distance
        elif decision.stage == "priming" and decision.value is not None and decision.threshold is not None:
            margin = decision.threshold - decision.value
        about = _copied(event, "event_id", "corrected", "hand_source", *_OF_THE_EVENT)
        about |= _copied(decision, "outcome", "stage", "value", "threshold")
        about |= {} if place is None else _copied(place, "location", "box_min", "box_max")
        about |= {"left_wrist": wrists.get("left"), "right_wrist": wrists.get("right")}
        about |= {"prime_time": prime and prime.time, "prime_kind": prime and prime.kind, "prime_margin": margin}
        about |= {"published_priming": published and published.outcome, "event_confidence": confidence}
        about |= {"published_prime_time": published and published.prime_time}
        about |= {"recording_id": recording.recording_id, "sequence_id": sequence and sequence.sequence_id}
        if recording.video is not None:
            about["video"] = recording.video.told({"event": event.event_time, "prime": prime and prime.time})
        rows.append(Event(**about))
    for entry in recording.unreadable:
        name = f"{recording.dataset}/{recording.recording_id}/{entry.file}/unreadable/{entry.key}"
        about: dict[str, Any] = {"event_id": name, "recording_id": recording.recording_id, "unreadable": str(entry)}
        about |= {"object_id": entry.key, "object_name": entry.file, "action": "unknown", "event_time": float("nan")}
        rows.append(Event(**about, outcome="unreadable_entry", stage="in_hand"))
    lacks = _missing_parts(recording, rule, found=bool(events))
    record = RecordingRow(
        **_copied(recording, "recording_id", "participant_id", "shortfalls"),
        split=split,
        split_group=recording.split_group or recording.recording_id,
        status="read",
        duration=recording.span[1] - recording.span[0],
        outcomes=dict(Counter(row.outcome for row in rows)),
        message="; ".join((*recording.shortfalls, *findings, *recording.remarks, *remarks, *lacks)),
        findings=findings,
        lacks=lacks,
    )
    ordered = tuple(sorted(sequences, key=lambda row: row.sequence_id))
    return CuratedRecording(ordered, tuple(sorted(rows, key=lambda row: row.event_id)), record, scene_boxes(recording))


def _follow(
    recording: Recording, event: PickPutEvent, rays: Rays, protocol: BenchmarkProtocol, options: CurationOptions
) -> tuple[Decision, Prime | None, Clip | None]:
    """One event through the stages, until one of them says no."""
    if recording.annotations_alone and (event.rejected is None or event.rejected.outcome != DROPPED):
        return Decision("annotation_only", "location"), None, None
    if event.rejected is not None or event.place is None:
        return event.rejected or Decision("no_location", "location"), None, None
    prime: Prime | Decision
    published = event.published_priming
    if options.priming != "published" or event.primed_anew:
        prime = find_prime(*rays, event.place, event.event_time, protocol.curation)
    elif published is None:
        prime = Decision("not_published", PUBLISHED_STAGE)  # nothing in the dataset's file belongs to this event
    elif published.outcome == "excluded":
        prime = Decision("excluded_by_dataset", PUBLISHED_STAGE)  # it was never tested
    elif published.outcome == "not_primed" or published.prime_time is None:
        prime = Decision("not_primed", PUBLISHED_STAGE)
    else:
        prime = Prime(published.prime_time, "published", float("nan"), published.uncertainty)
    if isinstance(prime, Decision):
        return prime, None, None
    piece = clip(recording, prime_time=prime.time, event_time=event.event_time, protocol=protocol)
    if isinstance(piece, Decision):
        return piece, prime, None
    # Who begins beside the goal hardly moves (*Prime and Reach*, section B.1); metres.
    threshold = protocol.curation.minimum_movement
    if options.minimum_movement == "wrist_to_goal":
        # Distance of the nearer wrist of the first frame to the goal: the protocol's reading of the study.
        value = float(np.linalg.norm(piece.joints[0, WRISTS] - event.place.location, axis=1).min())
    elif options.minimum_movement == "pelvis_displacement":
        value = body_movement(piece.joints)
    else:
        value = event.displacement  # None for annotated events, which the filter then lets pass
    moved = value is None or value >= threshold
    confidence = 1.0 if value is None else beyond(abs(value - threshold))
    decision = Decision("sequence" if moved else "minimum_movement", "filters", value, threshold, confidence)
    return decision, prime, piece if moved else None


def _sequence(
    recording: Recording, event: PickPutEvent, prime: Prime, piece: Clip, protocol: BenchmarkProtocol, split: str
) -> Sequence:
    """One row of the table: the clip in its canonical frame."""
    place = event.place
    assert place is not None, "an event without a place has no prime"
    grid = piece.grid
    preroll = prime.time - grid.start_time
    # The wrist of the event's hand; where that is unknown, the one nearer to the goal in the last frame.
    if event.hand is not None:
        wrist = Joint.LEFT_WRIST if event.hand == "left" else Joint.RIGHT_WRIST
    else:
        wrist = WRISTS[int(np.linalg.norm(piece.joints[-1, WRISTS] - place.location, axis=1).argmin())]
    # The canonical frame is that of the clip's first frame.
    world_from_canonical = canonical_frame(piece.joints)
    canonical_from_world = invert_rigid(world_from_canonical)
    turn = Rotation.from_matrix(canonical_from_world[:3, :3])
    head_position = piece.head_position
    head_rotation = piece.head_rotation
    if head_position is not None and head_rotation is not None:
        head_position = transform_points(canonical_from_world, head_position)
        turned = turn * Rotation.from_quat(head_rotation, scalar_first=True)
        # A quaternion and its negative are the same rotation; the canonical one keeps the bytes of tables equal.
        head_rotation = turned.as_quat(canonical=True, scalar_first=True)
    # What told the hand, and remarks that apply to few sequences only.
    extra = {} if event.hand_source is None else {"hand_source": event.hand_source}
    if event.corrected is not None:
        extra["corrected"] = event.corrected
    if event.tracking_gap is not None:
        extra["placed_in_tracking_gap_of_s"] = f"{event.tracking_gap:.3f}"
    about: dict[str, Any] = {"split": split, "split_group": recording.split_group or recording.recording_id}
    about |= {"prime_time": prime.time, "prime_kind": prime.kind, "prime_time_uncertainty": prime.uncertainty}
    about |= {"preroll": preroll, "prime_frame": round(preroll * grid.fps), "prime_gap": event.event_time - prime.time}
    about |= {"goal_box_world_min": place.box_min, "goal_box_world_max": place.box_max}
    moved = {"goal_location": place.location} | _copied(piece, *_MOVED)
    about |= {name: transform_points(canonical_from_world, points) for name, points in moved.items()}
    return Sequence(
        sequence_id=f"{event.event_id}/{recording.pose_source}",  # one for each source of body poses
        **_copied(recording, "dataset", "recording_id", "participant_id", "pose_source", "head_tilt_deg"),
        **_copied(event, *_OF_THE_EVENT),
        **_copied(grid, "fps", "n_frames", "start_time"),
        **_copied(piece, "previous_source", "next_source", "gaze_valid"),
        **about,
        text=protocol.text[event.action],
        body_movement=body_movement(piece.joints),
        hand_movement=hand_movement(piece.joints, wrist),
        world_from_canonical=world_from_canonical,
        head_position=head_position,
        head_rotation=head_rotation,
        gaze_direction=turn.apply(piece.gaze_direction),  # a direction turns, but does not move
        extra=extra,
    )


def _missing_parts(recording: Recording, rule: InHandRule | None, *, found: bool) -> tuple[str, ...]:
    """Name what a recording lacks to have events (``found`` says if it has some) or sequences."""
    remarks = []
    if recording.annotations_alone:
        return ()
    if recording.body is None:
        remarks.append("no_body: no body poses, so no event can become a sequence")
    if rule is None and not found:
        remarks.append("the dataset lists no pick or put of this recording")
    if rule is not None and not recording.annotated_events:
        if not recording.hand_streams(rule.contact):
            remarks.append(f"no {rule.contact} of the wearer's hands, so no events can be found")
        elif not any(track.movable for track in recording.objects):
            remarks.append("no object that can be moved, so no events can be found")
        elif not found:
            remarks.append("no hand of the wearer took up or put down an object")
    if not recording.gaze.valid.any():
        remarks.append("no valid gaze, so no event can be primed")
    return tuple(remarks)


def scene_boxes(recording: Recording) -> tuple[SceneBox, ...]:
    """Boxes of furniture and other things that nobody moves, with how far the recorded person comes into each.

    Left out is what the dataset tracks as movable, what has hinges, what changes its place, and boxes without volume.

    Args:
        recording: What a reader yields.
    """
    body = recording.body
    boxes = []
    for track in sorted((*recording.objects, *recording.furniture), key=lambda track: track.object_id):
        if track.movable or track.object_id in recording.hinged_objects or not track.valid.any():
            continue
        moved = np.ptp(track.position[track.valid], axis=0)
        if not ((moved <= _STILL).all() and (track.box_max > track.box_min).all()):
            continue
        first = int(np.argmax(track.valid))
        rotation = track.rotation[first]
        turn = Rotation.from_quat(rotation, scalar_first=True)
        centre = track.position[first] + turn.apply((track.box_min + track.box_max) / 2)
        half_extents = (track.box_max - track.box_min) / 2
        entered = None
        if body is not None and body.valid.any():
            box = Boxes(centre[None], turn.as_matrix()[None], half_extents[None], np.array([0, 1]))
            entered = float(deepest(body.joints[body.valid], box).max())
        names = (recording.recording_id, track.object_id, track.name, track.category)
        boxes.append(SceneBox(*names, centre, rotation, half_extents, entered))
    return tuple(boxes)
