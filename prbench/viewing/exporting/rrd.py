"""Recordings of rerun (extra ``rerun``): motions, gaze, goal and moments on one timeline, and the sensors' streams."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from prbench.errors import MissingExtraError
from prbench.geometry.skeleton import invert_rigid, transform_points
from prbench.recording import Recording
from prbench.viewing.figures import BOX_EDGES
from prbench.viewing.replay.scene import BOX_COLOUR, GAZE_COLOUR, Scene, bone_segments, head_rays, rays, rgb
from prbench.viewing.review import recording_of

if TYPE_CHECKING:
    from prbench.viewing.exporting.export import ExportRequest

TIMELINE = "time"  # seconds after the first frame
_RAY = 3.0  # metres
_STREAM_RATE = 60.0  # samples a second; trackers at 1 kHz say no more to the eye
_AFTER = 1.0  # seconds of the streams after the event


def write(scene: Scene, path: Path, about: dict[str, Any], request: ExportRequest) -> None:
    """Write a scene, metres, Y up, canonical frame; the streams of its recording stand below ``recording``.

    Args:
        scene: The sequence; its goal is left out where it has none.
        path: The file.
        about: What is said of the motions; stands in the entity ``about``.
        request: Says where the recordings are.

    Raises:
        InputFileError: if the recording cannot be read.
        MissingExtraError: if rerun-sdk is not installed.
    """
    try:
        import rerun as rr
    except ModuleNotFoundError as error:
        raise MissingExtraError("rerun-sdk", "rerun", "writing a recording of rerun") from error
    new: Any = getattr(rr, "new_recording", rr.RecordingStream)  # its name before and after version 0.23
    stream = new("prbench", recording_id=scene.sequence_id)
    stream.save(path)

    def at(seconds: float) -> None:
        if hasattr(stream, "set_time_seconds"):  # before version 0.23
            stream.set_time_seconds(TIMELINE, seconds)
        else:
            stream.set_time(TIMELINE, duration=seconds)

    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    stream.log("about", rr.TextDocument(msgspec.json.format(msgspec.json.encode(about)).decode()), static=True)
    if scene.goal is not None:
        edges = scene.goal.box_corners[np.array(BOX_EDGES)]
        stream.log("goal/box", rr.LineStrips3D(edges, colors=rgb(BOX_COLOUR)), static=True)
        place = rr.Points3D([scene.goal.location], radii=0.015, colors=rgb(BOX_COLOUR), labels="goal")
        stream.log("goal/location", place, static=True)
    for moment, name in ((scene.prime_time, "prime"), (scene.event_time, scene.action)):
        at(moment)
        stream.log("moments", rr.TextLog(name))
    for motion in scene.motions:
        entity = re.sub(r"[^a-z0-9]+", "_", motion.label.lower())
        heads = head_rays(motion.joints, scene.head_tilt_deg, scene.goal_location, _RAY)
        gaze = motion.gaze
        looks = None if gaze is None else rays(gaze.origin, gaze.direction, scene.goal_location, _RAY)
        for frame, seconds in enumerate(scene.times):
            at(seconds)
            bones = bone_segments(motion.joints[frame])
            stream.log(f"{entity}/bones", rr.LineStrips3D(bones, radii=0.015, colors=rgb(motion.colour)))
            stream.log(f"{entity}/joints", rr.Points3D(motion.joints[frame], radii=0.02, colors=rgb(motion.colour)))
            stream.log(f"{entity}/head_ray", rr.LineStrips3D([heads[frame]], colors=rgb(motion.colour)))
            if looks is not None and gaze is not None:
                shown = [looks[frame]] if gaze.valid[frame] else []
                stream.log(f"{entity}/gaze", rr.LineStrips3D(shown, colors=rgb(GAZE_COLOUR)))
    if request.recordings is not None:
        recording = recording_of(scene.info, scene.recording_id, request.recordings)
        for entity, seconds, points in _streams(scene, recording):
            at(seconds)
            is_ray = entity.endswith("gaze")
            stream.log(entity, rr.LineStrips3D([points], colors=rgb(GAZE_COLOUR)) if is_ray else rr.Points3D(points))
    stream.flush()
    stream.disconnect()


def _streams(scene: Scene, recording: Recording) -> list[tuple[str, float, np.ndarray]]:
    """Return the entity, the time after the first frame and the points of every sample of the sensors around a scene.

    A gaze sample has both ends of its ray; all points are in the scene's canonical frame.
    """
    gaze = recording.gaze
    found = [("gaze", gaze, np.stack([gaze.origin, gaze.origin + _RAY * gaze.direction], axis=1))]
    found += [("head", recording.head, recording.head.position[:, None])]
    found += [("camera", recording.camera, recording.camera.position[:, None])]
    if recording.body is not None:
        found += [("body", recording.body, recording.body.joints)]
    found += [(f"{hand.side}_{hand.contact}", hand, hand.points) for hand in recording.hands]
    found += [(f"objects/{each.object_id}", each, each.position[:, None]) for each in recording.objects]
    canonical_from_world = invert_rigid(scene.world_from_canonical)
    samples = []
    for name, stream, points in found:
        # What was seen once stands still.
        times = stream.times - scene.start_time if len(stream.times) > 1 else np.zeros(len(stream.times))
        inside = np.flatnonzero(stream.valid & (times >= 0) & (times <= scene.event_time + _AFTER))
        # Of each sixtieth of a second the first sample.
        _, first = np.unique(np.floor(times[inside] * _STREAM_RATE), return_index=True)
        for row in inside[first]:
            placed = transform_points(canonical_from_world, points[row])
            samples.append((f"recording/{name}", float(times[row]), placed))
    return samples
