"""Prime time: when gaze first meets the place of an event (*Prime and Reach*, equations 1 to 7).

With the option ``--occlusion``, for which the paper does not ask, a look counts only if nothing stands between the eye
and the place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.curation.events import Decision, Place
from prbench.geometry.shapes import TriangleMesh, near_miss, slab_test
from prbench.geometry.timelines import interpolate
from prbench.protocol.manifests import CurationConstants
from prbench.recording import ObjectTrack, Occluder, PublishedPriming, Recording

OcclusionMode = Literal["off", "mark", "require"]
"""``mark``: primes stay, those through a mesh are reported; ``require``: only unobstructed looks prime."""

MARGIN = 0.02
"""Metres before the place within which a mesh is no obstacle: what the place lies on or in (choice)."""


class Surroundings:
    """Every mesh of a recording, with the tracks of those that move.

    Raises:
        MissingExtraError: if the recording has meshes, and Open3D is not installed.
    """

    def __init__(self, recording: Recording) -> None:
        self._meshes = [(occluder, TriangleMesh(occluder.vertices, occluder.faces)) for occluder in recording.occluders]
        self._tracks: Mapping[str, ObjectTrack] = {track.object_id: track for track in recording.objects}

    def obstacles(
        self,
        times: Float[np.ndarray, " n"],
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
        reach: Float[np.ndarray, " n"],
        *,
        but: str,
    ) -> tuple[str, ...]:
        """Name of the first mesh on the way of each look; empty where the way is free.

        Args:
            times: When each look happens, seconds; objects stand where they stood then.
            origins: Eyes, world, metres.
            directions: Unit vectors.
            reach: Distance from the eye to the place that is looked at; the last 2 cm before it are free.
            but: Id of the object that is looked at, which does not hide itself.
        """
        nearest = reach - MARGIN
        names = np.full(len(times), "", dtype=object)
        for occluder, mesh in self._meshes:
            if occluder.object_id == but:
                continue
            local_origins, local_directions = self._in_frame_of(occluder, times, origins, directions)
            distance = mesh.first_hit(local_origins, local_directions, nearest)
            closer = distance < nearest
            nearest = np.where(closer, distance, nearest)
            names[closer] = occluder.name
        return tuple(names)

    def _in_frame_of(
        self,
        occluder: Occluder,
        times: Float[np.ndarray, " n"],
        origins: Float[np.ndarray, "n 3"],
        directions: Float[np.ndarray, "n 3"],
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        track = None if occluder.object_id is None else self._tracks.get(occluder.object_id)
        if track is None:
            return origins, directions
        position, rotation = track.pose_at(times)
        back = Rotation.from_quat(rotation, scalar_first=True).inv()
        return back.apply(origins - position), back.apply(directions)


@dataclass(frozen=True)
class View:
    """The surroundings as one event's looks meet them."""

    surroundings: Surroundings
    object_id: str
    """The object of the event."""
    required: bool
    """True if only unobstructed looks prime."""
    rays: tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]
    """The gaze samples: times, origins and directions."""

    def obstacles(self, samples: Int[np.ndarray, " k"], reach: Float[np.ndarray, " k"]) -> tuple[str, ...]:
        """See :meth:`Surroundings.obstacles`, for some of the gaze samples."""
        times, origins, directions = (part[samples] for part in self.rays)
        return self.surroundings.obstacles(times, origins, directions, reach, but=self.object_id)


def occlusion_remarks(recording: Recording, mode: OcclusionMode, through: Sequence[str]) -> tuple[str, ...]:
    """Return the report's remarks about occlusion in a recording.

    Args:
        recording: The recording.
        mode: What was asked for.
        through: For every primed event the mesh that it was primed through, empty for none.
    """
    if mode == "off":
        return ()
    if not recording.occluders:
        return ("no meshes, so no look was tested for occlusion",)
    marked = sum(bool(name) for name in through)
    return (f"{marked} of {len(through)} primed events are primed through a mesh",) if marked else ()


_PrimeKind = Literal["hit", "near_miss", "published"]
RAY_ORIGINS = ("eye", "camera")
PUBLISHED_STAGE = "published priming"
OCCLUSION_STAGE = "occlusion"
_SLACK = 1e-9  # seconds


@dataclass(frozen=True)
class Prime:
    """The first look at the place."""

    time: float
    kind: _PrimeKind
    distance: float
    """Distance by which the ray passes the box, metres; 0 for a hit, NaN where the dataset told the time only."""
    uncertainty: float
    """Time since the valid gaze sample before it (else until the one after it), seconds: the look began in between."""
    through: str = ""
    """Name of the mesh that stood between the eye and the place; empty where none did, or nobody asked."""


def gaze_rays(recording: Recording, origin: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), origins (n, 3) and directions (n, 3) of all valid gaze samples, world frame, metres.

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
    times: Float[np.ndarray, " n"],
    origins: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
    place: Place,
    event_time: float,
    constants: CurationConstants,
    view: View | None = None,
) -> Prime | Decision:
    """The first gaze sample in ``[event_time - priming_window, event_time]`` that hits or nearly misses the box.

    Where the constants ask for looks that last, it is the first sample of the first look that does.

    Args:
        times: Times of valid gaze samples, seconds, increasing.
        origins: Ray origins, metres.
        directions: Unit vectors.
        place: Box of the event, same frame.
        event_time: Seconds.
        constants: Window and near-miss distance.
        view: What can stand between the eye and the place; None = nothing is asked.

    Returns:
        The prime, or a decision ``not_primed`` whose value is the smallest distance at which a ray passed in front of
        the wearer (None if there was no valid gaze at all); at the stage ``occlusion`` the number of looks, all of
        which something obstructed.
    """
    # Equation 1: only looks in the window before the event can prime it; both ends belong to it.
    first = int(np.searchsorted(times, event_time - constants.priming_window, side="left"))
    stop = int(np.searchsorted(times, event_time, side="right"))
    window = slice(first, stop)
    rays = origins[window], directions[window]
    box = place.box_min[None], place.box_max[None]
    slabs = slab_test(*rays, *box)
    hit = slabs.hit[:, 0]
    misses = near_miss(*rays, *box)
    # A ray that points away passes the box behind the eye, which is no look at it.
    distance = np.where(hit, 0.0, np.where(misses.along[:, 0] >= 0, misses.distance[:, 0], np.inf))
    seen = hit | misses.within(constants.near_miss_distance)[:, 0]
    if constants.minimum_prime > 0:
        longest_gap = constants.largest_interpolated_gap
        seen = in_lasting_look(times[window], seen, shortest=constants.minimum_prime, longest_gap=longest_gap)
    primed = np.flatnonzero(seen)
    if len(primed) == 0:
        nearest = float(distance.min(initial=np.inf))
        value = nearest if np.isfinite(nearest) else None
        return Decision("not_primed", "priming", value, constants.near_miss_distance)
    index = int(primed[0])
    through = ""
    if view is not None:
        reach = np.where(hit, np.maximum(slabs.near[:, 0], 0.0), misses.along[:, 0])
        looks = primed if view.required else primed[:1]
        obstacles = view.obstacles(looks + first, reach[looks])
        if view.required and all(obstacles):
            return Decision("not_primed", OCCLUSION_STAGE, float(len(looks)))
        chosen = obstacles.index("") if view.required else 0
        index = int(looks[chosen])
        through = obstacles[chosen]
    sample = first + index
    # The look began somewhere between the sample before and this one.
    before = max(sample - 1, 0)
    after = min(sample + 1, len(times) - 1)
    spacing = times[sample] - times[before] if sample > 0 else times[after] - times[sample]
    return Prime(
        time=float(times[sample]),
        kind="hit" if hit[index] else "near_miss",
        distance=float(distance[index]),
        uncertainty=float(spacing),
        through=through,
    )


def in_lasting_look(
    times: Float[np.ndarray, " n"], seen: Bool[np.ndarray, " n"], *, shortest: float, longest_gap: float
) -> Bool[np.ndarray, " n"]:
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


def published_prime(published: PublishedPriming | None) -> Prime | Decision:
    """Return the dataset's own prime of an event (``--priming published``).

    Returns:
        The prime; or a decision at the stage ``published priming``: ``not_primed``, ``excluded_by_dataset`` (it was
        never tested), or ``not_published`` (nothing in the dataset's file belongs to this event).
    """
    if published is None:
        return Decision("not_published", PUBLISHED_STAGE)
    if published.outcome == "excluded":
        return Decision("excluded_by_dataset", PUBLISHED_STAGE)
    if published.outcome == "not_primed" or published.prime_time is None:
        return Decision("not_primed", PUBLISHED_STAGE)
    return Prime(published.prime_time, "published", float("nan"), published.uncertainty)
