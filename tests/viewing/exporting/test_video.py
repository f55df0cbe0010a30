"""Gaze and goal on synthetic pictures of a video: the pixels are known, and so is which picture is which."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prbench.errors import InputFileError, UsageError
from prbench.readers.hd_epic.format import TIME_SUFFIX
from prbench.viewing.exporting import mp4
from prbench.viewing.exporting.export import ExportRequest
from prbench.viewing.replay.film import film_writer
from prbench.viewing.replay.scene import BOX_COLOUR, GAZE_COLOUR, rgb
from tests.curation import scenes
from tests.viewing.replay.scenes import a_scene

ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed (pip install 'prbench[view]')")
SIZE = (240, 320)  # of the upright picture; the sensor's is 320 x 240
FIRST = 45  # picture of the first frame: the clock begins at 1 s, the scene at 2.5 s
SCENE = replace(a_scene(), start_time=2.5)
GOAL = SCENE.goal.location


@pytest.fixture
def request_(tmp_path, monkeypatch) -> ExportRequest:
    """A video whose pictures grow brighter, and a camera that stands at the eyes and looks along +Z."""
    writer = film_writer(tmp_path / "v.mp4", SIZE, 30.0)
    for picture in range(180):
        writer.send(bytes([20 + picture]) * (3 * SIZE[0] * SIZE[1]))
    writer.close()
    times = "".join(f"{1e9 + picture / 30 * 1e9:.0f}\n" for picture in range(180))
    (tmp_path / f"v{TIME_SUFFIX}").write_text(f"vrs_device_time_ns\n{times}")
    camera = {"model_name": "LINEAR", "projection_params": [200, 200, 160, 120], "image_size": [320, 240]}
    (tmp_path / "c.json").write_text(json.dumps({"cameras": {"camera-rgb": camera}}))
    recording = scenes.scene(gaze=scenes.gaze(scenes.clock(30), [(0.0, 99.0, GOAL)]))
    monkeypatch.setattr(mp4, "recording_of", lambda *_: recording)
    return ExportRequest(
        form="mp4", data=(tmp_path,), recordings=tmp_path, out=tmp_path / "o.mp4",
        video=tmp_path / "v.mp4", calibration=tmp_path / "c.json",
    )  # fmt: skip


def _pictures(path: Path) -> np.ndarray:
    meta, *pictures = ffmpeg.read_frames(str(path))
    return np.array([np.frombuffer(each, np.uint8).reshape(*meta["size"][::-1], 3) for each in pictures]).astype(int)


def test_gaze_and_the_goals_box_lie_on_their_pixels_in_every_picture(request_):
    mp4.write(SCENE, request_.out, {}, request_)
    pictures = _pictures(request_.out)
    assert len(pictures) == 91  # 3 s with both ends
    grey = pictures[:, 160, 60].mean(axis=1)
    assert np.abs(np.median(grey - np.arange(91) - 20 - FIRST)) < 0.7  # each picture in its place
    # By hand: before the camera the goal is at (0.1, -0.6, 1.95), so at (170.3, 58.5) of the sensor, whose picture is
    # turned clockwise: (239 - 58.5, 170.3). A near corner of the box is at (0.05, -0.65, 1.9): (239 - 51.6, 165.3).
    for picture in pictures[[0, 45, 90]]:
        assert np.abs(picture[170, 180] - rgb(GAZE_COLOUR)).max() < 40
        assert np.abs(picture[165, 187] - rgb(BOX_COLOUR)).max() < 60
        assert np.ptp(picture[100, 100]) < 12  # nothing else is drawn
    framed = [index for index, picture in enumerate(pictures) if np.abs(picture[2, 120] - rgb(GAZE_COLOUR)).max() < 40]
    assert framed == list(range(57, 64))  # 0.125 s before and after prime time, 2.0 s


def test_without_gaze_and_behind_the_camera_nothing_is_drawn(request_, monkeypatch):
    behind = replace(SCENE, goal=replace(SCENE.goal, box_corners=SCENE.goal.box_corners * [1, 1, -1]))
    gaze = scenes.gaze(scenes.clock(30), [])
    unseen = replace(gaze, valid=np.zeros(len(gaze.times), dtype=bool))
    monkeypatch.setattr(mp4, "recording_of", lambda *_: scenes.scene(gaze=unseen))
    mp4.write(behind, request_.out, {}, request_)
    assert np.ptp(_pictures(request_.out)[5][20:-20, 20:-20], axis=-1).max() < 12


@pytest.mark.parametrize("kept", [0, 100])
def test_a_damaged_video_is_told(kept, request_):
    request_.video.write_bytes(request_.video.read_bytes()[:kept])
    with pytest.raises(InputFileError, match="expected a video"):
        mp4.write(SCENE, request_.out, {}, request_)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"calibration": None}, "--calibration FILE"),
        ({"video": Path("video.vrs")}, "VRS is not decoded here"),
    ],
)
def test_what_the_video_needs_is_told(changes, message, request_):
    with pytest.raises((InputFileError, UsageError), match=message):
        mp4.write(SCENE, request_.out, {}, replace(request_, **changes))


@pytest.mark.parametrize(
    ("start", "camera", "message"),
    [
        (70.0, {}, "pictures from 70.00 s on.*found 1.00 to 6.97 s"),
        (2.5, {"image_size": [1408, 1408]}, "pictures of 1408 x 1408"),
        (2.5, {"model_name": "SPHERICAL"}, "a model of FISHEYE624, LINEAR"),
        (2.5, {"projection_params": [1, 2, 3]}, "a model of FISHEYE624, LINEAR"),
    ],
)
def test_a_video_that_does_not_fit_is_refused(start, camera, message, request_):
    known = json.loads(request_.calibration.read_text())
    known["cameras"]["camera-rgb"] |= camera
    request_.calibration.write_text(json.dumps(known))
    with pytest.raises(InputFileError, match=message):
        mp4.write(replace(SCENE, start_time=start), request_.out, {}, request_)
