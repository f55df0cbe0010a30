"""Converts the content of one MoGaze recording to a :class:`Recording` (docs/specification/mogaze.md).

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench import recording as streams
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, transform_points
from prbench.protocol.manifests import Manifest
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.format import NULL_LABEL, RATE, SEGMENT_DATASET, Segment

_UNIT_TOLERANCE = 0.1
_TO_WORLD = Y_UP_FROM_Z_UP[:3, :3]
_ROUNDING = 1e-9  # s


def recording_from_mogaze(readings: mogaze.MogazeReadings, manifest: Manifest, *, dataset: str) -> streams.Recording:
    """Return the streams in the world from native readings.

    Args:
        readings: Content of the native files.
        manifest: Joint mapping, thresholds, pose source and head tilt.
        dataset: Name that the recording carries: the manifest's, or ``synthetic-`` before it.
    """
    times = np.arange(len(readings.state)) / mogaze.RATE
    links, turned = mogaze.link_poses(readings.state, mogaze.link_offsets(readings.fixed))
    native_joints = mogaze.body_joints(links, manifest.body.joint_mapping)
    plausible = streams.plausible_body_frames(times, native_joints)
    remarks = []

    # Z up to Y up; the floor is moved to 0 where the lowest toes tell that it lies elsewhere. Toes of implausible
    # frames would tell a floor that is not there.
    world_from_source = np.eye(4)
    world_from_source[:3, :3] = _TO_WORLD
    if plausible.any():
        toes = [mogaze.LINKS.index(name) for name in ("lToe", "rToe")]
        lowest = float(np.percentile(links[plausible][:, toes, 2].min(axis=1), 1.0))
        if abs(lowest) > manifest.thresholds["floor_tolerance"]:
            world_from_source[1, 3] = -lowest
            remarks.append(f"the lowest toes are at {lowest:.2f} m: the floor is moved there")
    joints = streams.hold_neighbours(transform_points(world_from_source, native_joints), plausible)
    body = streams.BodyStream(times, joints, plausible)

    # The goggles' poses, turned as the head is: the goggles' own axes mean nothing.
    goggles = next(each for each in readings.bodies if each.name == mogaze.GOGGLES)
    tracked = seen(goggles.position, goggles.rotation)
    position = streams.hold_neighbours(transform_points(world_from_source, goggles.position), tracked)
    head_link = turned[:, mogaze.LINKS.index("head")]
    known = np.isfinite(head_link).all(axis=(1, 2))
    face = np.array(mogaze.HEAD_FROM_CPF)
    turned = np.where(np.reshape(known, (-1, 1, 1)), head_link, _TO_WORLD.T @ face.T)
    rotation = Rotation.from_matrix(_TO_WORLD @ turned @ face)
    head = streams.PoseStream(times, position, rotation.as_quat(canonical=True, scalar_first=True), tracked & known)
    directions, usable, in_metres = _gaze(readings, goggles, manifest)
    bodies = [each for each in readings.bodies if each is not goggles]
    tracks = tuple(_track(times, each, world_from_source) for each in bodies)
    window = int(manifest.thresholds["rest_window"])
    file = f"{readings.recording_id}_{mogaze.PARTS[3]}.hdf5"
    events, skipped, unusable = annotated_events(readings.segments, tracks, body, window, file)

    # Tell the user what is unusual about these readings.
    if not plausible.all():
        remarks.append(f"{int((~plausible).sum())} of {len(plausible)} body frames are implausible and invalid")
    if not head.valid.all():
        remarks.append(f"the goggles or the head are lost in {int((~head.valid).sum())} of {len(times)} frames")
    if not usable.all():
        remarks.append(f"{int((~usable).sum())} of {len(usable)} gaze samples are invalid")
    if in_metres:
        remarks.append("the gaze points are taken for metres: their median length is below 20")
    if unknown := [track.name for track in tracks if (track.box_min == track.box_max).all()]:
        remarks.append(f"no mesh and no known size, so a point instead of a box: {', '.join(unknown)}")
    return streams.Recording(
        dataset=dataset,
        recording_id=readings.recording_id,
        participant_id=readings.participant_id,
        pose_source=manifest.body.pose_source,
        head_tilt_deg=manifest.body.head_tilt_deg,
        span=(0.0, float(times[-1])),
        gaze=streams.GazeStream(times, head.position, directions, usable),
        camera=head,
        head=head,
        body=body,
        hands=body.wrists(),
        objects=tracks,
        annotated_events=events,
        split_group=readings.recording_id,
        world_from_source=world_from_source,
        messages=(*readings.messages, *remarks, *skipped),
        unreadable=(*readings.unreadable, *unusable),
    )


def seen(position: Float[np.ndarray, "n 3"], rotation: Float[np.ndarray, "n 4"]) -> Bool[np.ndarray, " n"]:
    """Return True for frames in which a body was tracked: finite, with a quaternion of about unit length."""
    return np.isfinite(position).all(axis=1) & (np.abs(np.linalg.norm(rotation, axis=1) - 1) < _UNIT_TOLERANCE)


def _gaze(
    readings: mogaze.MogazeReadings, goggles: mogaze.MogazeBody, manifest: Manifest
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"], bool]:
    """Return the directions in the world, which of them are valid, and whether the gaze points are metres."""
    tracked = seen(goggles.position, goggles.rotation)
    confident = readings.gaze_confidence >= manifest.thresholds["gaze_confidence"]
    points = readings.gaze_points
    known = points[confident & np.isfinite(points).all(axis=1)]
    # No file tells the unit of the gaze points.
    in_metres = len(known) > 0 and np.median(np.linalg.norm(known, axis=1)) < manifest.thresholds["metre_scale"]
    native = np.full(points.shape, np.nan)
    if tracked.any():
        # The files hold quaternions as x y z w, which is SciPy's own order.
        native[tracked] = mogaze.gaze_directions(
            Rotation.from_quat(goggles.rotation[tracked]).as_matrix(),
            Rotation.from_quat(readings.calibration).as_matrix(),
            points[tracked],  # a direction is the same in any unit
        )
    measured = confident & np.isfinite(native).all(axis=1)
    # The last measured frame before each frame is held for a while.
    frames = np.arange(len(measured))
    last = np.maximum.accumulate(np.where(measured, frames, -1))
    source = np.maximum(last, 0)
    recent = (last >= 0) & (frames - last <= int(manifest.thresholds["gaze_hold"] * mogaze.RATE + _ROUNDING))
    usable = measured[source]
    return np.where(usable[:, None], native[source] @ _TO_WORLD.T, (0.0, 0.0, 1.0)), recent & tracked, bool(in_metres)


def _track(
    times: Float[np.ndarray, " n"], body: mogaze.MogazeBody, world_from_source: Float[np.ndarray, "4 4"]
) -> streams.ObjectTrack:
    valid = seen(body.position, body.rotation)
    # x y z w, as in the files; unseen rows, which hold no rotation, become the identity.
    native = Rotation.from_quat(np.where(valid[:, None], body.rotation, (0.0, 0.0, 0.0, 1.0)))
    rotation = (Rotation.from_matrix(_TO_WORLD) * native).as_quat(canonical=True, scalar_first=True)
    rotation = streams.hold_neighbours(rotation, valid) if valid.any() else rotation
    position = streams.hold_neighbours(transform_points(world_from_source, body.position), valid)
    names = (str(body.body_id), body.name, mogaze.kind_of_body(body.name))
    box = (body.box_min, body.box_max)
    return streams.ObjectTrack(*names, times, position, rotation, valid, *box, not mogaze.is_furniture(body.name))


def annotated_events(
    segments: Sequence[Segment], tracks: Sequence[streams.ObjectTrack], body: streams.BodyStream, window: int, file: str
) -> tuple[tuple[streams.AnnotatedEvent, ...], tuple[str, ...], list[streams.UnreadableEntry]]:
    """Return the picks at the start, puts at the end of every segment in which an object moves.

    The place of a pick is the object's last pose before it, that of a put the median pose over the ``window`` frames
    after it, clipped to the next movement.

    Args:
        segments: Entries of ``segmentations`` in the order of the file.
        tracks: Every object, one sample a frame.
        body: The wearer, one sample a frame, whose wrists tell the hand of an event.
        window: Frames.
        file: Name of the file that lists the segments.

    Returns:
        The events in the order of time, remarks, and segments of which no event can be.
    """
    by_name = {track.name: track for track in tracks}
    # The movements of objects: in order, equal neighbours merged, impossible segments left out.
    n_frames = len(body.times)
    remarks = []
    if not segments:
        remarks.append("no segments, so no events")
    unusable = []
    ordered = sorted(enumerate(segments), key=lambda item: item[1].start)
    if [number for number, _ in ordered] != list(range(len(segments))):
        remarks.append("the segments are not in the order of time and are sorted")
    kept: list[Segment] = []
    previous = ""
    reached = 0
    merged = 0
    for number, segment in ordered:
        track = by_name.get(segment.label)
        is_object = segment.label != NULL_LABEL
        reasons = {
            "it ends before it begins": segment.end <= segment.start,
            f"it begins outside of the {n_frames} frames": not 0 <= segment.start < n_frames,
            "no such object is tracked": is_object and track is None,
            "the object is never seen": is_object and track is not None and not track.valid.any(),
        }
        reason = next((text for text, holds in reasons.items() if holds), "")
        if reason:
            place = f"{SEGMENT_DATASET}[{number}], {segment.start} to {segment.end} ({segment.label})"
            expected = f"a segment within the {n_frames} frames, of an object that is seen"
            unusable.append(streams.UnreadableEntry(file, place, expected, reason))
        elif segment.label == previous and segment.start <= reached + 1:
            merged += 1
            if is_object:
                kept[-1] = Segment(kept[-1].start, max(kept[-1].end, segment.end), segment.label)
        elif is_object:
            kept.append(segment)
        if segment.end > segment.start:  # an empty one separates nothing
            previous = segment.label if not reason else ""
            reached = segment.end
    if merged:
        remarks.append(f"{merged} segments with the label of the one before them are merged with it")
    if kept and kept[0].start <= 0:
        remarks.append(f"{kept[0].label} is in hand when the recording begins: no pick")
    if kept and kept[-1].end >= n_frames - 1:
        remarks.append(f"{kept[-1].label} is in hand when the recording ends: no put")
    last = n_frames - 1
    events = []
    for number, carry in enumerate(kept):
        track = by_name[carry.label]
        later = kept[number + 1 :]
        ends = []
        if carry.start > 0:
            ends.append(("pick", carry.start, _resting_before(track, carry.start)))
        if carry.end < last:
            next_movement = min((other.start for other in later), default=last + 1)
            moved_again = min((other.start for other in later if other.label == carry.label), default=last + 1)
            stop = min(carry.end + window, next_movement)
            ends.append(("put", carry.end, _resting_after(track, carry.end, stop, moved_again)))
        for action, frame, (position, rotation) in ends:
            low, high = track.world_box(position[None], rotation[None])
            centre = (low[0] + high[0]) / 2
            hand, source = streams.reaching_hand(streams.wrists_at((), body, frame / RATE), centre)
            about = (f"{number}/{action}", action, track.object_id, track.name, frame / RATE)
            events.append(streams.AnnotatedEvent(*about, centre, low[0], high[0], hand, hand_source=source))
    return tuple(events), tuple(remarks), unusable


def _resting_before(track: streams.ObjectTrack, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the last pose seen up to a frame, else the first one after it."""
    seen = np.flatnonzero(track.valid)
    index = seen[max(int(np.searchsorted(seen, frame, side="right")) - 1, 0)]
    return track.position[index], track.rotation[index]


def _resting_after(
    track: streams.ObjectTrack, frame: int, stop: int, moved_again: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the median pose over ``[frame, stop]``; of an unseen object its next pose at rest or its last."""
    window = np.arange(frame, min(stop, len(track.valid) - 1) + 1)
    window = window[track.valid[window]]
    if len(window) == 0:
        later = np.flatnonzero(track.valid[frame:moved_again])
        if len(later) == 0:
            return _resting_before(track, frame)
        window = later[:1] + frame
    turned = Rotation.from_quat(track.rotation[window], scalar_first=True).mean()
    return np.median(track.position[window], axis=0), turned.as_quat(canonical=True, scalar_first=True)


_STEP = 4  # 120 frames a second become 30.
FEWEST_GAZE = 0.8  # Share of a segment's frames with confident gaze; the segment is left out below.


def published_tracks(
    readings: mogaze.MogazeReadings, recording: streams.Recording, *, least_confidence: float
) -> tuple[streams.PublishedTrack, ...]:
    """Return every row of ``segments`` as a pick or a place, cut to its first and last confident gaze.

    A row without an object in motion is the pick that comes next (``pick_001``), one with an object is the ``place``.
    Rows that end before they begin, and a row like the one before it, are left out.

    Args:
        readings: Content of the files.
        recording: What was made of them.
        least_confidence: Confidence from which on a gaze sample counts.
    """
    links, _ = mogaze.link_poses(readings.state, mogaze.link_offsets(readings.fixed))
    assert recording.body is not None
    body = recording.body
    joints = streams.hold_neighbours(transform_points(recording.world_from_source, links), body.valid)
    confident = recording.gaze.valid & (readings.gaze_confidence >= least_confidence)
    tracks = []
    number = 0
    previous = ""
    for segment in sorted(readings.segments, key=lambda each: each.start):
        repeated = segment.label == previous == NULL_LABEL
        previous = segment.label
        if segment.end <= segment.start or repeated:
            continue
        number += 1
        frames = np.arange(max(segment.start, 0), min(segment.end + 1, len(joints)), _STEP)
        measured = confident[frames]
        if not len(frames) or measured.mean() < FEWEST_GAZE:
            continue
        first, last = np.flatnonzero(measured)[[0, -1]]
        kept = frames[first : last + 1]
        name = f"{'pick' if segment.label == NULL_LABEL else 'place'}_{number:03d}"
        poses = (joints[kept], body.valid[kept], np.zeros(len(kept), dtype=bool), body.joints[kept])
        gaze = (recording.gaze.direction[kept], confident[kept])
        tracks.append(streams.PublishedTrack(name, "", kept / mogaze.RATE, *poses, *gaze))
    return tuple(tracks)
