"""MP4: the film of ``prbench view``, or gaze and goal drawn onto the egocentric video; one sequence a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from jaxtyping import Float, UInt8

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import require
from prbench.geometry.cameras import MODELS, Points
from prbench.geometry.skeleton import rotation_matrices, transform_points
from prbench.geometry.timelines import covered, nearest_index
from prbench.readers.files import decode_json
from prbench.readers.hd_epic.annotations import read_video_clock
from prbench.readers.hd_epic.format import TIME_SUFFIX
from prbench.recording import PoseStream
from prbench.viewing.figures import BOX_EDGES
from prbench.viewing.replay.film import film_scenes, film_writer
from prbench.viewing.replay.scene import BOX_COLOUR, GAZE_COLOUR, Scene, rgb
from prbench.viewing.review import recording_of

if TYPE_CHECKING:
    from prbench.viewing.exporting.export import ExportRequest

Places = Float[np.ndarray, "_ 2"]  # pixels
_CAMERA = "camera-rgb"
_LARGEST_ANGLE = np.deg2rad(60.0)  # from the optical axis; the lens shows less, its polynomial means nothing beyond
_SAME_INSTANT = 0.1  # seconds between a picture and a gaze sample of it
_LONGEST_STEP = 0.05  # seconds between two poses of the camera
_NO_GOAL = 1.0  # metres along the gaze, where no goal says how far to look
_DOTS = np.linspace(0, 1, 60)[:, None, None]  # along each edge of the box, which a lens bends


class _Camera(msgspec.Struct):
    """One camera of ``device_calibration.json``."""

    model_name: str
    projection_params: list[float]
    image_size: tuple[int, int]


class _Calibration(msgspec.Struct):
    cameras: dict[str, _Camera]


def write(scene: Scene, path: Path, about: Mapping[str, Any], request: ExportRequest) -> None:  # noqa: ARG001
    """Write the film of a scene, which shows the notice of its dataset, or draw onto the video that is named.

    The video lies as projectaria_tools writes it from VRS: turned upright, with ``NAME_mp4_to_vrs_time_ns.csv`` beside
    it. The goal's box is drawn, and gaze at the goal's distance; a frame marks the quarter second around prime time.

    Raises:
        UsageError: if something is missing that the video needs.
        InputFileError: if the video, its times, the calibration or the recording cannot be read, or do not fit.
    """
    if request.video is None:
        film_scenes([scene], path, lambda *_: None)
        return
    if request.calibration is None or request.recordings is None:
        raise UsageError("--video: needs --root DIR, and --calibration FILE (device_calibration.json), too.")
    import imageio_ffmpeg

    video = request.video
    remedy = "VRS is not decoded here: projectaria_tools' vrs_to_mp4 writes the video and its times."
    require(video, (video.is_file() and video.suffix.lower() == ".mp4", "", "a video (.mp4)", "no such file", remedy))
    seconds = read_video_clock(video.with_name(f"{video.stem}{TIME_SUFFIX}"), None)[0].device_ns / 1e9
    inside = np.flatnonzero((seconds >= scene.start_time) & (seconds <= scene.start_time + scene.event_time))
    expected = f"pictures from {scene.start_time:.2f} s on, of {scene.recording_id}"
    require(video, (inside.size > 0, "", expected, f"{seconds[0]:.2f} to {seconds[-1]:.2f} s", ""))
    camera = decode_json(request.calibration, _Calibration).cameras.get(_CAMERA)
    usable = camera is not None and len(camera.projection_params) == MODELS.get(camera.model_name, (0,))[0]
    expected = f"{_CAMERA} with a model of {', '.join(MODELS)}"
    require(request.calibration, (usable, "cameras", expected, "another or none", ""))
    assert camera is not None
    try:
        meta = next(imageio_ffmpeg.read_frames(str(video)))
    except (OSError, RuntimeError) as error:
        found = str(error).splitlines()[-1]
        raise InputFileError(video, "", expected="a video", found=found, remedy="Copy it again.") from error
    expected = f"pictures of {camera.image_size[1]} x {camera.image_size[0]}, as the calibration has them turned"
    require(video, (meta["size"] == camera.image_size[::-1], "", expected, meta["size"], ""))
    marks = _marks(scene, request, seconds[inside], camera)
    # Half a frame before the first one, so that rounding cannot skip it.
    pictures = imageio_ffmpeg.read_frames(str(video), input_params=["-ss", f"{max(inside[0] - 0.5, 0) / meta['fps']}"])
    next(pictures)
    writer = film_writer(path, meta["size"], meta["fps"])
    for time, (box, gaze) in zip(seconds[inside] - scene.start_time, marks, strict=True):
        content = next(pictures, b"")
        require(video, (content != b"", "", f"{len(inside)} pictures", "fewer", "The video is cut; copy it again."))
        picture = np.frombuffer(content, dtype=np.uint8).reshape(*meta["size"][::-1], 3).copy()
        _paint(picture, box, max(2, len(picture) // 280), BOX_COLOUR)
        _paint(picture, gaze, max(4, len(picture) // 90), GAZE_COLOUR)
        if abs(time - scene.prime_time) <= 0.125:
            for side in (picture[:8], picture[-8:], picture[:, :8], picture[:, -8:]):
                side[:] = rgb(GAZE_COLOUR)
        writer.send(picture.tobytes())
    pictures.close()
    writer.close()


def _marks(
    scene: Scene, request: ExportRequest, seconds: Float[np.ndarray, " n"], camera: _Camera
) -> list[tuple[Places, Places]]:
    """Return where the box's edges and the gaze are in each picture; empty where they, or the camera, are not known."""
    assert request.recordings is not None, "asked for by the caller"
    recording = recording_of(scene.info, scene.recording_id, request.recordings)
    edges = np.empty((0, 3))
    goal = None
    if scene.goal is not None:
        goal = transform_points(scene.world_from_canonical, scene.goal.location[None])[0]
        one, other = np.swapaxes(scene.goal.box_corners[np.array(BOX_EDGES)], 0, 1)
        edges = transform_points(scene.world_from_canonical, (one + _DOTS * (other - one)).reshape(-1, 3))
    gaze = recording.gaze
    sample = nearest_index(gaze.times, seconds)
    looks = gaze.valid[sample] & (np.abs(gaze.times[sample] - seconds) <= _SAME_INSTANT)
    far = _NO_GOAL if goal is None else np.linalg.norm(goal - gaze.origin[sample], axis=1, keepdims=True)
    tips = gaze.origin[sample] + far * gaze.direction[sample]
    stream = recording.camera
    posed = covered(stream.times, stream.valid, seconds, max_gap=_LONGEST_STEP)
    marks = []
    for second, tip, look, known in zip(seconds, tips, looks, posed, strict=True):
        box = _seen(edges[: len(edges) * known], stream, second, camera)
        marks.append((box, _seen(tip[None][: int(known & look)], stream, second, camera)))
    return marks


def _seen(points: Points, stream: PoseStream, second: float, camera: _Camera) -> Places:
    """Return the pixels (x, y) of world points in the upright picture of one moment, those outside left out."""
    position, rotation = stream.pose_at(np.array([second]))
    local = (points - position[0]) @ rotation_matrices(rotation)[0]
    local = local[local[:, 2] >= np.cos(_LARGEST_ANGLE) * np.linalg.norm(local, axis=1)]
    u, v = MODELS[camera.model_name][1](local, np.array(camera.projection_params)).T
    return np.column_stack([camera.image_size[1] - 1 - v, u])  # turned clockwise by a quarter


def _paint(picture: UInt8[np.ndarray, "h w 3"], pixels: Places, radius: int, colour: str) -> None:
    """Draw discs, as far as they lie within the picture."""
    around = np.mgrid[-radius : radius + 1, -radius : radius + 1].reshape(2, -1).T
    disc = around[np.linalg.norm(around, axis=1) <= radius]
    x, y = (np.rint(pixels).astype(int)[:, None] + disc).reshape(-1, 2).T
    within = (x >= 0) & (y >= 0) & (x < picture.shape[1]) & (y < picture.shape[0])
    picture[y[within], x[within]] = rgb(colour)
