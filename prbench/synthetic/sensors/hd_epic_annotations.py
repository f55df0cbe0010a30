"""Masks of HD-EPIC's movements: where an object lies at the start and the end, as annotators and depth tell it."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.axes import Y_UP_FROM_Z_UP
from prbench.readers.hd_epic import format as hd_epic
from prbench.skeleton import transform_points
from prbench.synthetic.egoallo import NATIVE_FROM_WORLD
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.sensors.errors import Sensing, sensor_generator
from prbench.timelines import interpolate

_POINT_NOISE = 0.020  # m an axis
_MISSING = 0.05  # share
_MIDDLE_MASK = 0.01  # share of the movements that have a third mask
_REVERSED = 0.3  # share of the movements whose masks are listed backwards
_FIXTURE_REACH = 0.8  # m
_METRES = 6  # decimals
_PIXELS = 2


@dataclass(frozen=True)
class Sighting:
    """One end of a movement."""

    side: Literal["start", "end"]
    seconds: float
    """Of the video, as annotated."""
    event: TrueEvent


def masks_of(sensing: Sensing, track: hd_epic.ObjectTrack, sightings: Sequence[Sighting]) -> hd_epic.ObjectTrack:
    """Return the track with its masks: one at either end, rarely none or a third, listed in either order."""
    performance = sensing.performance
    rng = sensing.generator(f"masks-{track.track_id}")
    points = rng.normal(0.0, _POINT_NOISE, (2, 3)) * sensing.strength("annotated_points")
    lost = rng.random(2) < _MISSING * sensing.strength("mask_losses")
    has_middle, is_reversed = rng.random(2) < (_MIDDLE_MASK, _REVERSED)
    masks = [
        _mask(performance, track, sighting, sighting.event.goal + offset)
        for sighting, offset, missing in zip(sightings, points, lost, strict=False)
        if not missing
    ]
    if has_middle and track.end - track.start > 1.0 and len(masks) == 2:
        masks.append(_middle(performance, track, sightings[0].event, masks))
    return dataclasses.replace(track, masks=tuple(masks[::-1] if is_reversed else masks))


def _mask(
    performance: Performance, track: hd_epic.ObjectTrack, sighting: Sighting, point: Float[np.ndarray, "3"]
) -> hd_epic.ObjectMask:
    frame = round(sighting.seconds * hd_epic.FPS)
    return hd_epic.ObjectMask(
        mask_id=_mask_id(track, sighting.side),
        frame=frame,
        location=np.round(transform_points(NATIVE_FROM_WORLD, point), _METRES),
        box_px=_box(performance, sighting.event, frame),
        fixture=_fixture(performance, sighting.event.goal),
    )


def _middle(
    performance: Performance, track: hd_epic.ObjectTrack, event: TrueEvent, ends: Sequence[hd_epic.ObjectMask]
) -> hd_epic.ObjectMask:
    """Draw a mask somewhere in between, in the hand."""
    frame = round((track.start + track.end) / 2 * hd_epic.FPS)
    known = [mask.location for mask in ends if mask.location is not None]
    return hd_epic.ObjectMask(
        mask_id=_mask_id(track, "middle"),
        frame=frame,
        location=np.round(np.mean(known, axis=0), _METRES),
        box_px=_box(performance, event, frame),
        fixture=None,
    )


def _mask_id(track: hd_epic.ObjectTrack, what: str) -> str:
    return hashlib.sha256(f"{track.track_id} {what}".encode()).hexdigest()[:16]


def _box(performance: Performance, event: TrueEvent, frame: int) -> Float[np.ndarray, "4"]:
    """Return a box in the middle of the image, as large as the object appears from the eyes."""
    eye = interpolate(performance.times, performance.eye, performance.times[:1] + frame / hd_epic.FPS)[0]
    moving = next((each for each in performance.objects if each.object_id == event.object_id), None)
    half = 0.05 if moving is None else float(moving.half_extents.mean())
    pixels = half * hd_epic.FOCAL_LENGTH / max(float(np.linalg.norm(event.goal - eye)), 0.1)
    centre = hd_epic.IMAGE_SIZE / 2
    return np.round(np.array([centre - pixels, centre - pixels, centre + pixels, centre + pixels]), _PIXELS)


def _fixture(performance: Performance, goal: Float[np.ndarray, "3"]) -> str | None:
    """Return the piece of furniture whose top is nearest below."""
    furniture = [each for each in performance.objects if len(each.position) == 1]
    distances = [float(np.linalg.norm(each.position[0] - goal)) for each in furniture]
    if not distances or min(distances) > _FIXTURE_REACH:
        return None
    number = int(np.argmin(distances))
    return f"{performance.person.participant_id}_{furniture[number].category.replace(' ', '_')}.{number + 1:03d}"


_WINDOW = 300  # frames
_NEAR = 0.10  # m
_IN_VIEW = np.cos(np.deg2rad(50.0))  # half of the camera's field of view
_FORGOTTEN = 0.02  # share of the events that the file does not mention


def synthetic_priming(
    performance: Performance, tracks: Sequence[hd_epic.ObjectTrack]
) -> tuple[hd_epic.PublishedSide, ...]:
    """Return one entry for every end of a movement that has a mask, but for a few."""
    rng = sensor_generator(performance, "published-priming")
    entries = []
    for number, track in enumerate(tracks):
        forgotten = rng.random(2) < _FORGOTTEN
        start = round(track.start * hd_epic.FPS)
        end = round(track.end * hd_epic.FPS)
        for mask in track.masks:
            if mask.location is None or mask.frame not in (start, end) or forgotten[int(mask.frame == end)]:
                continue
            is_start = mask.frame == start
            first = max(start - _WINDOW, 0) if is_start else max(end - _WINDOW, start)
            primed = _first_look(performance, mask, first)
            key = f"{number}/{'start' if is_start else 'end'}"
            entries.append(hd_epic.PublishedSide(key, is_start, mask.frame, mask.location, primed))
    return tuple(sorted(entries, key=lambda entry: (int(entry.key.split("/")[0]), not entry.is_start)))


def _first_look(performance: Performance, mask: hd_epic.ObjectMask, first: int) -> int:
    """Return the frame of the first look, or -1, or -2 for an event that is not tested."""
    assert mask.location is not None
    goal = transform_points(Y_UP_FROM_Z_UP, mask.location)
    if not _in_view(performance, goal, mask.frame):
        return hd_epic.EXCLUDED
    for frame in range(first, mask.frame + 1):
        row = _row(performance, frame)
        towards = goal - performance.eye[row]
        along = float(towards @ performance.gaze[row])
        beside = float(np.linalg.norm(towards - along * performance.gaze[row]))
        if along > 0 and beside <= _NEAR:
            at_once = frame == first and mask.frame - first == _WINDOW
            return hd_epic.EXCLUDED if at_once else frame
    return hd_epic.NOT_PRIMED


def _in_view(performance: Performance, goal: np.ndarray, frame: int) -> bool:
    row = _row(performance, frame)
    w, x, y, z = performance.head_rotation[row]
    forward = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    towards = goal - performance.eye[row]
    return bool(towards @ forward >= _IN_VIEW * np.linalg.norm(towards))


def _row(performance: Performance, frame: int) -> int:
    """Return the row of the performance nearest to a video frame."""
    return min(round(frame / hd_epic.FPS * performance.rate), len(performance.times) - 1)
