"""Priming alone: when gaze first met the places of somebody's own events, without a dataset or a body.

The rule is that of every build (:func:`prbench.curation.priming.find_prime`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.curation.events import Decision, Place
from prbench.curation.priming import Rays, find_prime, gaze_rays
from prbench.errors import UsageError
from prbench.files.bounded import require
from prbench.geometry.timelines import require_overlap
from prbench.protocol.manifests import CurationConstants, load_manifest, load_protocol
from prbench.readers.found import InputFile, RecordingFiles
from prbench.recording import Recording

if TYPE_CHECKING:
    from prbench.readers.own import format as own


@dataclasses.dataclass(frozen=True)
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
    box_min: tuple[float, ...]
    box_max: tuple[float, ...]


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
        prime = (found.time, found.kind, time - found.time, found.uncertainty) if primed else (None, None, None, None)
        distance = found.distance if primed else found.value
        margin = None if distance is None else constants.near_miss_distance - distance
        asked = (name, action, time, "primed" if primed else "not_primed")
        about: Any = (*asked, *prime, margin, found.confidence, tuple(low.tolist()), tuple(high.tolist()))
        events.append(PrimedEvent(*about))
    return events


def read_files(files: Mapping[str, Path], about: own.About) -> Recording:
    """Read gaze, objects and events as the tables of a plain recording (docs/own-recordings.md).

    Objects without poses stand still: their boxes are those of the world. Without a table of events, that of the
    objects is one: a row for each event, with its box or point.

    Args:
        files: CSV or Parquet file of each table, by the table's name.
        about: Units and axes.

    Raises:
        InputFileError: naming file, line and column of what does not fit.
        StreamsDoNotOverlap: if the streams share no instant.
    """
    # Late: arrays alone need no pandas.
    from prbench.readers.own.files import Table, read_readings
    from prbench.readers.own.to_recording import recording_from_tables

    if "events" not in files:
        files = {"events" if name == "objects" else name: path for name, path in files.items()}
    for name in ("gaze", "events"):
        if name not in files:
            raise UsageError(f"--{name} FILE is needed, and --objects FILE where the events do not say places.")
    listed = tuple(InputFile(f"{name}{path.suffix}", path, 0) for name, path in files.items())
    found = RecordingFiles("own", "files", Path(), listed)
    readings = read_readings(found, about)
    objects = readings.tables.get("objects")
    if objects is not None and "object_poses" not in readings.tables:
        ids = objects.columns["object_id"]
        still = Table(objects.path, {"object_id": ids, **dict.fromkeys(("time", "x", "y", "z"), np.zeros(len(ids)))})
        readings = dataclasses.replace(readings, tables={**readings.tables, "object_poses": still})
    recording = recording_from_tables(readings, load_manifest("own"), found)
    require(files["events"], *((False, entry.key, entry.expected, entry.found, "") for entry in recording.unreadable))
    require(files["events"], (recording.annotated_events, "", "an event or more", "none", ""))
    for event in recording.annotated_events:
        expected = "a place: a point, a box, or an object with a box"
        require(files["events"], (event.location is not None, event.native_key, expected, "none", ""))
    return recording


def prime_recording(recording: Recording, constants: CurationConstants) -> list[PrimedEvent]:
    """Prime the events that a recording lists, each of which has a place."""
    events = recording.annotated_events
    boxes = [[event.location] * 2 if event.box_min is None else [event.box_min, event.box_max] for event in events]
    corners = np.array(boxes, dtype=np.float64).reshape(-1, 2, 3)
    times = np.array([event.event_time for event in events])
    names = [event.object_name for event in events]
    return prime_events(gaze_rays(recording, "eye"), corners, times, names, [each.action for each in events], constants)
