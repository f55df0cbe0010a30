"""The boxes of what stands still around the person of a recording (docs/specification/scene.md#boxes)."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.geometry.boxes import Boxes, deepest
from prbench.recording import ObjectTrack, Recording
from prbench.sequences.sequence import SceneBox

_STILL = 0.01
"""Metres within which a thing keeps its place through the recording; choice: above the noise of optical tracking."""


def scene_boxes(recording: Recording) -> tuple[SceneBox, ...]:
    """Boxes of furniture and other things that nobody moves, with how far the recorded person comes into each.

    Left out is what the dataset tracks as movable, what has hinges, what changes its place, and boxes without volume.

    Args:
        recording: What a reader yields.
    """
    tracks = [track for track in (*recording.objects, *recording.furniture) if _stands(track, recording)]
    return tuple(_box(track, recording) for track in sorted(tracks, key=lambda track: track.object_id))


def _stands(track: ObjectTrack, recording: Recording) -> bool:
    if track.movable or track.object_id in recording.hinged_objects or not track.valid.any():
        return False
    places = track.position[track.valid]
    return bool((np.ptp(places, axis=0) <= _STILL).all() and (track.box_max > track.box_min).all())


def _box(track: ObjectTrack, recording: Recording) -> SceneBox:
    first = int(np.argmax(track.valid))
    rotation = track.rotation[first]
    turn = Rotation.from_quat(rotation, scalar_first=True)
    centre = track.position[first] + turn.apply((track.box_min + track.box_max) / 2)
    half_extents = (track.box_max - track.box_min) / 2
    box = Boxes(centre[None], turn.as_matrix()[None], half_extents[None], np.array([0, 1]))
    return SceneBox(
        recording_id=recording.recording_id,
        object_id=track.object_id,
        name=track.name,
        category=track.category,
        centre=centre,
        rotation=rotation,
        half_extents=half_extents,
        entered=_entered(box, recording),
    )


def _entered(box: Boxes, recording: Recording) -> float | None:
    if recording.body is None or not recording.body.valid.any():
        return None
    return float(deepest(recording.body.joints[recording.body.valid], box).max())
