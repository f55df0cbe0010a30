"""Find out if something stands between the eye and a place (option ``--occlusion``; the paper does not ask)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.geometry.meshes import TriangleMesh
from prbench.recording import ObjectTrack, Occluder, Recording

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
