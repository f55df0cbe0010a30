"""Converts the content of one GIMO segment to a :class:`Recording` (docs/specification/gimo.md).

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
The world is the canonical room: Y up, floor near y = 0, metres of the body
(docs/specification/gimo.md#coordinate-chain).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench import recording as streams
from prbench.errors import InputFileError
from prbench.geometry.skeleton import WRISTS, Joint, transform_points
from prbench.geometry.timelines import covered, interpolate
from prbench.protocol.manifests import Manifest
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.bvh import place_skeleton

_SHORTEST_LOOK = 0.01  # metres; nearer to the eyes a point gives no direction


def recording_from_gimo(readings: gimo.GimoReadings, manifest: Manifest, *, dataset: str) -> streams.Recording:
    """Return the streams in the canonical room from native readings.

    The pose of the glasses is unknown. Gaze rays begin at the head joint and end at the points on the scan.

    Args:
        readings: Content of the native files.
        manifest: Pose source, head tilt and thresholds.
        dataset: Name that the recording carries: the manifest's, or ``synthetic-`` before it.

    Raises:
        InputFileError: if the suit's skeleton does not fit the pelvis track.
    """
    body, body_remarks = _body(readings, manifest)
    source = manifest.body if isinstance(readings.body, gimo.LocalJoints) else manifest.other_bodies["bvh"]
    room_from_scan = readings.transform.room_from_scan()
    events, event_remarks = _events(readings, body, manifest)
    # Gaze points in the room on every frame; short gaps between points are interpolated.
    measured = len(readings.gaze.frames)
    points = np.zeros((len(body.times), 3))
    seen = np.zeros(len(body.times), dtype=bool)
    if measured:
        # 0.1 s at 30 frames a second is 3 frames, also where the product is 2.9999.
        longest = float(int(manifest.thresholds["longest_gaze_gap"] * gimo.FRAME_RATE + 1e-9))
        known = readings.gaze.frames.astype(np.float64)
        asked = readings.segment.frames.astype(np.float64)
        seen = covered(known, np.ones(measured, dtype=bool), asked, max_gap=longest)
        points = interpolate(known, transform_points(room_from_scan, readings.gaze.points), asked)
    origin = body.joints[:, Joint.HEAD]
    apart = np.where(seen[:, None], points - origin, 0.0)
    distance = np.linalg.norm(apart, axis=1)
    valid = seen & body.valid & (distance > _SHORTEST_LOOK)
    # Some unit vector stands where nothing was measured; the mask says so.
    direction = np.where(valid[:, None], apart / np.where(valid, distance, 1.0)[:, None], [0.0, 0.0, 1.0])
    gaze_remark = f"gaze on {measured} of {len(body.times)} frames, {int(seen.sum()) - measured} interpolated"
    return streams.Recording(
        dataset=dataset,
        recording_id=readings.recording_id,
        participant_id="unknown",
        pose_source=source.pose_source,
        head_tilt_deg=source.head_tilt_deg,
        span=(float(body.times[0]), float(body.times[-1])),
        gaze=streams.GazeStream(body.times, origin, direction, valid),
        camera=streams.NO_POSES,
        head=streams.NO_POSES,
        body=body,
        hands=body.wrists(),
        objects=(),
        annotated_events=events,
        split_group=readings.segment.group,
        world_from_source=room_from_scan,
        messages=(*readings.messages, *body_remarks, gaze_remark, *event_remarks),
        unreadable=readings.unreadable,
        video=streams.Video(body.times, readings.segment.frames.astype(np.float64), gimo.FRAME_RATE),
    )


def _body(readings: gimo.GimoReadings, manifest: Manifest) -> tuple[streams.BodyStream, list[str]]:
    """Return the 22 joints on every frame of the segment; short gaps interpolated, long ones invalid."""
    remarks = []
    if isinstance(readings.body, gimo.LocalJoints):
        frames = readings.body.frames
        local = readings.body.joints
    else:
        frames = readings.body.poses.frames
        pelvis = readings.body.poses.pelvis()
        name = f"{readings.segment.scene}/{readings.segment.sequence}/{gimo.SKELETON_FILE}"
        worst = manifest.thresholds["largest_track_error"]
        local, remarks = place_skeleton(readings.body.motion, frames / gimo.FRAME_RATE, pelvis, name, worst)
    wanted = readings.segment.frames
    joints, valid = filled(frames, local, wanted, longest=round(manifest.thresholds["longest_filled_gap"]))
    if missing := len(wanted) - len(frames):
        in_gaps = int((~valid).sum())
        remarks.append(f"{missing} of {len(wanted)} frames have no pose, {in_gaps} in gaps too long to fill")
    in_room = transform_points(readings.transform.room_from_body(), joints)
    return streams.BodyStream(wanted / gimo.FRAME_RATE, in_room, valid), remarks


def filled(
    frames: Int[np.ndarray, " n"], joints: Float[np.ndarray, "n joints 3"], wanted: Int[np.ndarray, " m"], longest: int
) -> tuple[Float[np.ndarray, "m joints 3"], Bool[np.ndarray, " m"]]:
    """Return joints on the wanted frames: interpolated across at most ``longest`` missing ones, else held, invalid."""
    # Between two frames that are n + 1 apart n are missing.
    known = frames.astype(np.float64)
    asked = wanted.astype(np.float64)
    valid = covered(known, np.ones(len(known), dtype=bool), asked, max_gap=longest + 1.0)
    return streams.hold_neighbours(interpolate(known, joints, asked), valid), valid


def _events(
    readings: gimo.GimoReadings, body: streams.BodyStream, manifest: Manifest
) -> tuple[tuple[streams.AnnotatedEvent, ...], list[str]]:
    """Return the picks with the wrist as their place: the dataset knows no objects.

    Source: docs/specification/gimo.md#objects-and-events.
    """
    remarks: list[str] = []
    events = []
    for event in readings.events:
        row = event.frame - readings.segment.start_frame
        hand = event.hand
        if hand is None:
            # The wrist with the longer path in the last moments before the event.
            first = max(row - round(manifest.thresholds["hand_window"] * gimo.FRAME_RATE), 0)
            steps = np.diff(body.joints[first : row + 1][:, WRISTS], axis=0)
            hand = streams.SIDES[int(np.linalg.norm(steps, axis=2).sum(axis=0).argmax())]
        place = body.joints[row, WRISTS[streams.SIDES.index(hand)]] if body.valid[row] else None
        if place is None:
            remarks.append(f"no pose on frame {event.frame}, so its event has no place")
        if event.hand is None:
            remarks.append(f"hand of frame {event.frame} not annotated: the {hand} one moves more before it")
        if event.source == "hint":
            remarks.append(f"event frame {event.frame} is the table's hint, nobody has confirmed it")
        names = (gimo.OBJECT_ID, readings.segment.activity or gimo.OBJECT_ID)
        places = (event.frame / gimo.FRAME_RATE, place, place, place)
        source = "annotated" if event.hand is not None else "movement"
        events.append(streams.AnnotatedEvent(str(event.frame), "pick", *names, *places, hand, None, source))
    return tuple(events), remarks


def published_track(
    readings: gimo.GimoReadings, recording: streams.Recording, manifest: Manifest, *, with_jaw: bool
) -> streams.PublishedTrack:
    """Return the one row of ``dataset.csv`` that a recording is, every frame of it.

    Args:
        readings: Content of the files of the segment.
        recording: Recording that was made of them.
        manifest: The longest gap of poses that is filled.
        with_jaw: Whether the joints are the study's 23 or the 22 of every dataset.

    Raises:
        InputFileError: if the jaw is asked for, and no body model tells where it is.
    """
    assert recording.body is not None
    body = recording.body
    fitted = readings.body
    posed = fitted.frames if isinstance(fitted, gimo.LocalJoints) else fitted.poses.frames
    frames = readings.segment.frames
    has_pose = np.isin(frames, posed)
    joints = body.joints
    if with_jaw:
        if not isinstance(fitted, gimo.LocalJoints) or fitted.jaw is None:
            expected = "a jaw: fitted parameters, and an SMPL-X model with its 23rd joint"
            found = "a body without one"
            remedy = "Build the windows on the 22 joints (--joints smpl22)."
            raise InputFileError(readings.recording_id, "", expected=expected, found=found, remedy=remedy)
        jaw, _ = filled(posed, fitted.jaw[:, None], frames, longest=round(manifest.thresholds["longest_filled_gap"]))
        joints = np.concatenate([joints, transform_points(readings.transform.room_from_body(), jaw)], axis=1)
    # A direction needs both ends of its own frame: a gaze point, and the head that it is seen from.
    measured = recording.gaze.valid & np.isin(frames, readings.gaze.frames) & has_pose
    names = (readings.segment.name, gimo.PUBLISHED_SPLITS[readings.segment.training])
    poses = (body.times, joints, body.valid, body.valid & ~has_pose, body.joints)
    return streams.PublishedTrack(*names, *poses, recording.gaze.direction, measured)
