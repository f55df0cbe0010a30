"""Prime time: when gaze first meets the place of an event (*Prime and Reach*, equations 1 to 7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from prbench.curation.confidence import GAZE_PAUSE, beyond, unbroken
from prbench.curation.events import Decision, Place
from prbench.geometry.shapes import ray_distances
from prbench.geometry.timelines import interpolate
from prbench.protocol.manifests import CurationConstants
from prbench.recording import Recording

Times = Float[np.ndarray, " n"]
Vectors = Float[np.ndarray, "n 3"]
Seen = Bool[np.ndarray, " n"]
Rays = tuple[np.ndarray, np.ndarray, np.ndarray]  # times, origins and directions of valid gaze samples

RAY_ORIGINS = ("eye", "camera")
PUBLISHED_STAGE = "published priming"
_SLACK = 1e-9  # seconds
_LOOK = 0.5  # seconds around the prime that are one look, for its confidence


@dataclass(frozen=True)
class Prime:
    """The first look at the place.

    Attributes:
        distance: Distance by which the ray passes the box, metres; 0 for a hit, NaN where the dataset told the time
            only.
        uncertainty: Time since the valid gaze sample before it (else until the one after it), seconds: the look began
            in between.
        confidence: Chance that the look is one, and the first, from 0 to 1.
    """

    time: float
    kind: Literal["hit", "near_miss", "published"]
    distance: float
    uncertainty: float
    confidence: float = 1.0


def gaze_rays(recording: Recording, origin: str) -> Rays:
    """Return times (n,), origins (n, 3) and directions (n, 3) of all valid gaze samples, world frame, metres.

    Args:
        recording: The recording.
        origin: ``eye`` = central pupil frame, where the direction is defined; ``camera`` = the scene camera's centre,
            as the paper words it (5.8 cm away on Aria glasses, docs/specification/aria-mps.md#open-choices).
    """
    gaze = recording.gaze
    camera = recording.camera
    times = gaze.times[gaze.valid]
    origins = gaze.origin[gaze.valid]
    if origin == "camera" and camera.valid.any():
        origins = interpolate(camera.times[camera.valid], camera.position[camera.valid], times)
    return times, origins, gaze.direction[gaze.valid]


def find_prime(
    times: Times, origins: Vectors, directions: Vectors, place: Place, event_time: float, constants: CurationConstants
) -> Prime | Decision:
    """Return the first gaze sample in ``[event_time - priming_window, event_time]`` that hits or nearly misses the box.

    Where the constants ask for looks that last, it is the first sample of the first look that does.

    Args:
        times: Times of valid gaze samples, seconds, increasing.
        origins: Ray origins, metres.
        directions: Unit vectors.
        place: Box of the event, same frame.
        event_time: Seconds.
        constants: Window and near-miss distance.

    Returns:
        The prime, or a decision ``not_primed`` whose value is the smallest distance at which a ray passed in front of
        the wearer (None if there was no valid gaze at all).
    """
    # Equation 1: only looks in the window before the event can prime it; both ends belong to it.
    first = int(np.searchsorted(times, event_time - constants.priming_window, side="left"))
    window = slice(first, int(np.searchsorted(times, event_time, side="right")))
    distances, hits = ray_distances(origins[window], directions[window], place.box_min[None], place.box_max[None])
    distance = distances[:, 0]
    hit = hits[:, 0]
    seen = distance <= constants.near_miss_distance
    if constants.minimum_prime > 0:
        longest_gap = constants.largest_interpolated_gap
        seen = in_lasting_look(times[window], seen, shortest=constants.minimum_prime, longest_gap=longest_gap)
    primed = np.flatnonzero(seen)
    limit = constants.near_miss_distance
    begin = max(event_time - constants.priming_window, float(times[:1].max(initial=-np.inf)))
    if len(primed) == 0:
        nearest = float(distance.min(initial=np.inf))
        value = nearest if np.isfinite(nearest) else None
        gap = float(np.diff([begin, *times[window], event_time]).max())
        confidence = beyond(nearest - limit) * unbroken(gap, usual=GAZE_PAUSE)
        return Decision("not_primed", "priming", value, limit, confidence)
    index = int(primed[0])
    sample = first + index
    # How clearly the look met the place, and how clearly all looks before it missed.
    look, rest = np.searchsorted(times[window], [times[sample] - _LOOK, times[sample] + _LOOK])
    missed = float(distance[:look].min(initial=np.inf)) - limit
    met = limit - float(distance[index:rest].min())
    gap = float(np.diff([begin, *times[first : sample + 1]]).max())
    # The look began somewhere between the sample before and this one.
    before = max(sample - 1, 0)
    after = min(sample + 1, len(times) - 1)
    spacing = times[sample] - times[before] if sample > 0 else times[after] - times[sample]
    kind = "hit" if hit[index] else "near_miss"
    confidence = beyond(met) * beyond(missed) * unbroken(gap, usual=GAZE_PAUSE)
    return Prime(float(times[sample]), kind, float(distance[index]), float(spacing), confidence)


def in_lasting_look(times: Times, seen: Seen, *, shortest: float, longest_gap: float) -> Seen:
    """Keep the samples of looks that last (docs/specification/curation.md#prime-time).

    A look is a run of gaze samples that all meet the place. It ends at a sample that does not, and where valid samples
    lie further apart than ``longest_gap``: nobody knows where the eye was in between.

    Args:
        times: Times of valid gaze samples, seconds, increasing.
        seen: True where the sample meets the place.
        shortest: Seconds from a look's first sample to its last.
        longest_gap: Seconds.

    Returns:
        True for the samples of looks that last at least ``shortest``.
    """
    if not seen.any():
        return seen
    is_apart = np.diff(times, prepend=times[:1]) > longest_gap
    begins = seen & (is_apart | ~np.concatenate([[False], seen[:-1]]))
    look_of = np.cumsum(begins) - 1
    first_of = times[np.flatnonzero(begins)]
    rows = np.flatnonzero(seen)
    last_of = np.full(len(first_of), -np.inf)
    np.maximum.at(last_of, look_of[rows], times[rows])
    # A nanosecond of slack: times of gaze samples are rounded, and 0.1 s of 30 Hz must count as 0.1 s.
    lasting = last_of - first_of >= shortest - _SLACK
    return seen & lasting[np.maximum(look_of, 0)]
