"""Mend what is wrong with the clocks and units of a recording: ``--shift`` and ``--scale``, before it is curated.

Gaze, and hands where the glasses track them, were measured from the head. They are taken into its axes at their old
times and back into the world at their new ones.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench.errors import UsageError, did_you_mean
from prbench.geometry.timelines import covered
from prbench.recording import AnnotatedEvent, GazeStream, PoseStream, Recording, reaching_hand, wrists_at

STREAMS = ("gaze", "camera", "head", "body", "hands", "objects")
Numbers = tuple[tuple[str, float], ...]
SAME_PLACE = 0.02  # metres from the head within which a gaze ray was made of this very pose of it
_LONGEST_POSE_STEP = 0.05  # seconds; readers bridge no longer gap of the glasses
_FARTHEST_SHIFT = 1e6  # seconds


def stream_numbers(given: Mapping[str, object], option: str) -> Numbers:
    """Return numbers by stream, those for every recording first, from what a command line or a program says.

    Args:
        given: Texts or numbers by name of a stream; ``GLOB:stream`` means the recordings whose ids match.
        option: ``shift`` (seconds) or ``scale`` (factors above 0).

    Raises:
        UsageError: for a name that is no stream, with the nearest one, and for what is no such number.
    """
    known = STREAMS if option == "shift" else STREAMS[1:]  # gaze has no length
    wanted = "seconds, such as -5.0" if option == "shift" else "a factor above 0, such as 0.001"
    found = {}
    for name, text in given.items():
        stream = name.rpartition(":")[2]
        if stream not in known:
            hint = did_you_mean(stream, known)
            raise UsageError(f"--{option}: expected one of {', '.join(known)}, found '{stream}'.{hint}")
        try:
            found[name] = float(str(text))
        except ValueError:
            found[name] = np.nan
        if not abs(found[name]) <= _FARTHEST_SHIFT or (option == "scale" and found[name] <= 0):
            raise UsageError(f"--{option} {name}: expected {wanted}, found '{text}'.")
    return tuple(sorted(found.items(), key=lambda item: (":" in item[0], item)))


def _meant(numbers: Numbers, recording_id: str) -> dict[str, float]:
    """Return the numbers by stream that are meant for one recording."""
    named = [(*name.rpartition(":")[::2], number) for name, number in numbers]
    return {stream: number for glob, stream, number in named if fnmatch.fnmatchcase(recording_id, glob or "*")}


def named_streams(recording_id: str, *options: Numbers) -> set[str]:
    """Return the streams of a recording that the user has named, if only by ``gaze=0``: they vouch for these."""
    return {stream for numbers in options for stream in _meant(numbers, recording_id)}


def mended(recording: Recording, shift: Numbers, scale: Numbers) -> Recording:
    """Return a recording with streams moved in time and positions multiplied.

    A place that a reader took from an object's track is read from the moved track; the events of a dataset without
    tracks move as ``objects``. Hands of events are found again.

    Args:
        recording: What a reader yields.
        shift: Seconds that are added to the times of a stream.
        scale: Factor on the positions of a stream; boxes of objects keep their size.
    """
    shifts = _meant(shift, recording.recording_id)
    scales = _meant(scale, recording.recording_id)
    if not shifts and not scales:
        return recording
    later = dict.fromkeys(STREAMS, 0.0) | shifts
    factor = dict.fromkeys(STREAMS, 1.0) | scales

    def moved(stream: Any, name: str, places: str = "position") -> Any:
        points = getattr(stream, places) * factor[name]
        return replace(stream, times=stream.times + later[name], **{places: points})

    old = recording.head
    head = moved(old, "head")
    hands = [moved(hand, "hands", "points") for hand in recording.hands]
    if recording.hands_from_glasses:
        for place, hand in enumerate(recording.hands):
            origin, turn, _ = _poses(old, hand.times)
            local = turn.inv().apply(hand.points[:, 0] - origin) * factor["hands"]
            origin, turn, posed = _poses(head, hands[place].times)
            points = (turn.apply(local) + origin)[:, None]
            hands[place] = replace(hands[place], points=points, valid=hand.valid & posed)
    body = None if recording.body is None else moved(recording.body, "body", "joints")
    objects = tuple(moved(track, "objects") for track in recording.objects)
    streams = {"head": head, "body": body, "hands": tuple(hands), "objects": objects}
    streams |= {"camera": moved(recording.camera, "camera")}
    streams |= {"gaze": _moved_gaze(recording.gaze, old, head, later["gaze"])}
    # Ends of files tell nothing where clocks are moved.
    new = replace(recording, **streams, shortfalls=() if shifts else recording.shortfalls)
    if shifts.keys() | scales.keys() <= {"gaze", "camera"}:
        return new  # events have no share in these
    moves = (new, later["objects"], factor["objects"])
    return replace(new, annotated_events=tuple(_moved_event(event, *moves) for event in recording.annotated_events))


def _poses(
    head: PoseStream, times: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 3"], Rotation, Bool[np.ndarray, " n"]]:
    """Return where the head is, how it is turned, and where that is known."""
    origin, rotation = head.pose_at(times)
    posed = covered(head.times, head.valid, times, max_gap=_LONGEST_POSE_STEP, tolerance=1e-3)
    return origin, Rotation.from_quat(rotation, scalar_first=True), posed


def rides(gaze: GazeStream, head: PoseStream) -> bool:
    """Return True for gaze rays that were made of these poses of the head: they begin where it is."""
    if not (head.valid.any() and gaze.valid.any()):
        return False
    apart = np.linalg.norm(gaze.origin - head.pose_at(gaze.times)[0], axis=1)
    return float(np.median(apart[gaze.valid])) <= SAME_PLACE


def _moved_gaze(gaze: GazeStream, old: PoseStream, head: PoseStream, later: float) -> GazeStream:
    if not rides(gaze, old):
        return replace(gaze, times=gaze.times + later)
    _, turn, were_posed = _poses(old, gaze.times)
    local = turn.inv().apply(gaze.direction)
    # A row outside of the tracked time may be measured; one that was not looks straight ahead (readers).
    measured = gaze.valid | (~were_posed & (local[:, 2] < 1 - 1e-12))
    origin, turn, posed = _poses(head, gaze.times + later)
    return GazeStream(gaze.times + later, origin, turn.apply(local), measured & posed)


def _moved_event(event: AnnotatedEvent, new: Recording, later: float, factor: float) -> AnnotatedEvent:
    track = next((each for each in new.objects if each.object_id == event.object_id), None)
    if track is not None and (later, factor) != (0.0, 1.0):
        low, high = track.world_box(*track.pose_at(np.array([event.event_time])))
        event = replace(event, location=(low[0] + high[0]) / 2, box_min=low[0], box_max=high[0])
    elif track is None and event.location is not None:
        places = ("location", "box_min", "box_max")
        scaled = {name: place * factor for name in places if (place := getattr(event, name)) is not None}
        event = replace(event, event_time=event.event_time + later, **scaled)
    if event.location is None or event.hand_source not in (None, "tracked", "body"):
        return event
    tracked = new.hands if new.hands_from_glasses else ()  # elsewhere wrists are the body's
    hand, source = reaching_hand(wrists_at(tracked, new.body, event.event_time), event.location)
    return replace(event, hand=hand, hand_source=source)
