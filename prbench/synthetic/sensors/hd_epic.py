"""The sensors and annotators of HD-EPIC (docs/specification/synthetic-recordings.md#sensors, rows "hd-epic").

Poses, gaze and hands come from the Machine Perception Services, bodies from EgoAllo, places and times of events from
people who looked at the video. Everything is rounded to the files' resolution, so that files and memory agree.
"""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass

import numpy as np

from prbench.readers.aria_mps.format import MpsReadings
from prbench.readers.egoallo.format import EgoAlloOutput
from prbench.readers.hd_epic import format as hd_epic
from prbench.synthetic.egoallo import sense_egoallo
from prbench.synthetic.people.truth import seen_again
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.sensors.aria_mps import gaze_bias as aria_gaze_bias
from prbench.synthetic.sensors.aria_mps import sense_mps, uid_of
from prbench.synthetic.sensors.errors import Sensing, Switches, device_start_us
from prbench.synthetic.sensors.hd_epic_annotations import Sighting, masks_of, synthetic_priming

_GAZE_PERIOD = 0.1
"""Seconds."""
_STEP_JITTER_US = 2
_GAZE_KIND = "general"
"""HD-EPIC has no personalized gaze."""

_CLOCK_JITTER_NS = 400  # of an image's time stamp
_REPEATED = 0.002  # share of the frames
_SKIPPED = 0.001
_TIME_NOISE = 0.060  # s
_SHORTEST_TRACK = 0.05  # s; noise never turns a movement around
_ANNOTATED = ("sequence", "not_primed", "too_short", "minimum_movement", "no_location", "tracking_lost")
_SECONDS = 3  # decimals


@dataclass(frozen=True)
class SensedVideo:
    """Content of the files of one video."""

    readings: hd_epic.HdEpicReadings
    """With whole MPS readings and without body."""
    bodies: tuple[EgoAlloOutput, ...]


def sense(performance: Performance, *, noise: float = 1.0, switches: Switches | None = None) -> SensedVideo:
    """Return what glasses, body estimate and annotators say about a performance.

    Args:
        performance: The truth.
        noise: Multiplies every error: its size, or how often it happens; 0 for ideal sensors.
        switches: Which errors are on; all if None.
    """
    sensing = Sensing(performance, noise, switches or Switches())
    start_us = device_start_us(performance)
    glasses = sense_mps(
        performance,
        start_us=start_us,
        noise=noise,
        switches=switches,
        gaze_kind=_GAZE_KIND,
        step_jitter_us=_STEP_JITTER_US,
    )
    glasses = _in_world_of(performance.person.participant_id, glasses)
    clock = sense_video_clock(sensing)
    tracks = _annotated_tracks(sensing, clock)
    readings = hd_epic.HdEpicReadings(
        video=performance.recording_id,
        participant_id=performance.person.participant_id,
        clock=clock,
        tracks=tracks,
        priming=synthetic_priming(performance, tracks),
        glasses=glasses,
        body=None,
    )
    bodies = sense_egoallo(performance, glasses.trajectory, noise=noise, switches=switches, start_us=start_us)
    return SensedVideo(readings, bodies)


def _in_world_of(participant_id: str, glasses: MpsReadings) -> MpsReadings:
    """Move a video into the world that all videos of one participant share."""
    uid = uid_of(f"kitchen of {participant_id}")
    return dataclasses.replace(glasses, trajectory=dataclasses.replace(glasses.trajectory, graph_uids=(uid,)))


def gaze_bias(performance: Performance, *, noise: float, switches: Switches) -> tuple[float, float]:
    """Return the recording's constant gaze error, yaw and pitch, radians."""
    return aria_gaze_bias(performance, noise=noise, switches=switches, gaze_kind=_GAZE_KIND)


def known_events(performance: Performance) -> tuple[TrueEvent, ...]:
    """Return the events as HD-EPIC can know them: places are points, gaze comes ten times a second.

    People annotate what is lifted and put down again: no doors and drawers, no touches, nothing that somebody else
    does, and no movement that the video does not see through.
    """
    ends = [event for movement in movements(performance) for event in movement]
    return tuple(
        seen_again(event, performance, event.goal, event.goal, gaze_period=_GAZE_PERIOD)
        for event in sorted(ends, key=lambda event: event.event_time)
    )


def movements(performance: Performance) -> list[tuple[TrueEvent, TrueEvent]]:
    """Return every pick with the put of the same object that follows it."""
    ordered = sorted(performance.events, key=lambda event: event.event_time)
    known = [event for event in ordered if event.expected in _ANNOTATED]
    pairs = []
    for pick in (event for event in known if event.action == "pick"):
        after = [e for e in known if e.object_id == pick.object_id and e.event_time > pick.event_time]
        if after and after[0].action == "put":
            pairs.append((pick, after[0]))
    return pairs


def association_id(object_id: str) -> str:
    """Return sixteen hexadecimal digits for an object of a performance."""
    return hashlib.sha256(f"association {object_id}".encode()).hexdigest()[:16]


def sense_video_clock(sensing: Sensing) -> hd_epic.VideoClock:
    """Return the device time of every frame: the image nearest to a regular time line, some twice, some skipped."""
    n = len(sensing.times(hd_epic.FPS))
    scale = sensing.strength("video_clock")
    rng = sensing.generator("video-clock")
    jitter = rng.uniform(-_CLOCK_JITTER_NS, _CLOCK_JITTER_NS, n) * scale
    image = np.arange(n)
    repeated = rng.random(n) < _REPEATED * scale
    skipped = rng.random(n) < _SKIPPED * scale
    shown = np.maximum.accumulate(np.clip(image - repeated + skipped, 0, n - 1))
    since_start = np.rint(np.arange(n) * 1e9 / hd_epic.FPS + jitter).astype(np.int64)
    return hd_epic.VideoClock(device_start_us(sensing.performance) * 1000 + since_start[shown])


def _annotated_tracks(sensing: Sensing, clock: hd_epic.VideoClock) -> tuple[hd_epic.ObjectTrack, ...]:
    """Return one track a movement: the pick, and the put that ends it."""
    performance = sensing.performance
    rng = sensing.generator("annotated-times")
    device_start = device_start_us(performance) / 1e6 - performance.times[0]
    last = (len(clock.device_ns) - 1) / hd_epic.FPS - _SHORTEST_TRACK
    tracks = []
    for number, (pick, put) in enumerate(movements(performance)):
        shift = rng.normal(0.0, _TIME_NOISE, 2) * sensing.strength("annotated_times")
        device = device_start + np.array([pick.event_time, put.event_time]) + shift
        seconds = np.clip(clock.frames(device) / hd_epic.FPS, 0.0, last)
        start, end = (float(value) for value in np.round(seconds, _SECONDS))
        track = hd_epic.ObjectTrack(
            track_id=_identifier(performance, f"track {number}"),
            object_id=association_id(pick.object_id),
            name=pick.object_name.replace("_", " "),
            start=start,
            end=max(end, start + _SHORTEST_TRACK),
            masks=(),
        )
        sightings = (Sighting("start", track.start, pick), Sighting("end", track.end, put))
        tracks.append(masks_of(sensing, track, sightings))
    return tuple(sorted(tracks, key=lambda track: (track.start, track.end, track.object_id, track.track_id)))


def _identifier(performance: Performance, what: str) -> str:
    return hashlib.sha256(f"{performance.recording_id} {what}".encode()).hexdigest()[:16]
