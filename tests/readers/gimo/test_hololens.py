"""HoloLens files of GIMO: axes, clocks, and the direction of the transform to the scan."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.geometry.skeleton import Joint, invert_rigid
from prbench.readers import reader_for
from prbench.readers.gimo.gaze import read_hololens
from tests.readers import gimo_sample as sample

FIRST_TICK = 132_874_000_000_000_123
"""A file time of 2022: 18 digits, which no float64 holds."""
FOLDER = "room1/2022-01-23-080759"
HEAD_IN_ROOM = Rotation.from_euler("y", 0.4)


def write_files(root, *, shift: tuple[float, float, float] = (0.0, 0.0, 0.0), inverted: bool = False):
    """The recorder's files of glasses that sit on the head joint, turned by ``HEAD_IN_ROOM``."""
    readings = sample.readings()
    recording = sample.recording(readings)
    transform = readings.transform
    room_from_glasses_metric = sample.rigid((0.2, -0.4, 0.1), (3.0, 1.0, -2.0))
    scan_from_glasses = np.eye(4)  # rigid in scan units: the glasses' world is in scan units, too
    scan_from_glasses[:3] = room_from_glasses_metric[:3]
    glasses_from_room = np.linalg.inv(transform.room_from_scan() @ scan_from_glasses)
    rotation = Rotation.from_matrix(glasses_from_room[:3, :3] / np.cbrt(np.linalg.det(glasses_from_room[:3, :3])))
    looking = rotation * HEAD_IN_ROOM * Rotation.from_matrix(np.diag([-1.0, 1.0, -1.0]))
    rows, frames = [], []
    for frame in range(recording.body.times.size + 100):
        tick = FIRST_TICK + round(frame / 30 * 1e7)
        joint = recording.body.joints[max(frame - 100, 0), Joint.HEAD] + np.array(shift)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = looking.as_matrix(), glasses_from_room[:3, :3] @ joint + glasses_from_room[:3, 3]
        row = np.zeros(860)
        row[0:16] = pose.ravel()
        row[850] = 1
        row[851:855] = [*(pose[:3, 3] + 0.02 * glasses_from_room[:3, 1]), 1]
        row[855:859] = [*-pose[:3, 2], 0]
        rows.append(f"{tick}," + ",".join(f"{value:.9g}" for value in row))
        frames.append(f"{tick}," + ",".join(f"{value:.9g}" for value in [500.0, 500.0, *pose.ravel()]))
    folder = root / FOLDER
    (folder / "2022_head_hand_eye.csv").write_text("\n".join(rows) + "\n")
    (folder / "2022_pv.txt").write_text("380,214,760,428\n" + "\n".join(frames) + "\n")
    matrix = invert_rigid(scan_from_glasses) if inverted else scan_from_glasses
    (folder / "transform_scene2scene.txt").write_text("\n".join(" ".join(map(repr, row)) for row in matrix.tolist()))


@pytest.fixture
def root(tmp_path):
    return sample.write_root(tmp_path / "GIMO", sample.readings())


def read(root, **options: str):
    reader = reader_for("gimo", options)
    return reader.read(reader.find(root)[0])


@pytest.mark.parametrize("inverted", [False, True])
def test_the_direction_of_the_transform_is_found_and_the_axes_are_ours(root, inverted) -> None:
    write_files(root, inverted=inverted)
    recording = read(root)
    assert recording.head.valid.all()
    np.testing.assert_allclose(recording.head.position, recording.body.joints[:, Joint.HEAD], atol=1e-5)
    forward = Rotation.from_quat(recording.head.rotation, scalar_first=True).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(forward, np.tile(HEAD_IN_ROOM.apply([0, 0, 1]), (len(forward), 1)), atol=1e-5)
    up = Rotation.from_quat(recording.head.rotation, scalar_first=True).apply([0.0, 1.0, 0.0])
    np.testing.assert_allclose(up, np.tile([0.0, 1.0, 0.0], (len(up), 1)), atol=1e-5)
    camera = Rotation.from_quat(recording.camera.rotation, scalar_first=True)
    np.testing.assert_allclose(camera.apply([0.0, 0.0, 1.0]), forward, atol=1e-5)
    np.testing.assert_allclose(camera.apply([0.0, -1.0, 0.0]), up, atol=1e-5)


def test_rays_may_begin_at_the_eyes(root) -> None:
    write_files(root)
    from_head, from_eyes = read(root), read(root, gaze_origin="hololens")
    apart = from_eyes.gaze.origin - from_head.gaze.origin
    np.testing.assert_allclose(apart, np.tile([0.0, 0.02, 0.0], (len(apart), 1)), atol=2e-5)
    assert from_eyes.gaze.valid.all()


@pytest.mark.parametrize("option", ["head", "hololens"])
def test_glasses_far_from_the_head_are_not_believed(root, option) -> None:
    write_files(root, shift=(0.0, 0.9, 0.0))
    if option == "hololens":
        with pytest.raises(InputFileError, match=r"within 0\.5 m of the head joint, found 0\.90 m and"):
            read(root, gaze_origin=option)
        return
    recording = read(root)
    assert recording.head.times.size == 0
    assert any(message.startswith("HoloLens files not used: glasses 0.90 m and") for message in recording.messages)


def test_without_files_there_are_no_glasses(root) -> None:
    recording = read(root)
    assert (recording.head.times.size, recording.camera.times.size) == (0, 0)
    with pytest.raises(InputFileError, match=r"\*_head_hand_eye\.csv, \*_pv\.txt and transform_scene2scene\.txt"):
        read(root, gaze_origin="hololens")


def test_ticks_stay_whole_numbers(root) -> None:
    write_files(root)
    folder = root / FOLDER
    hololens = read_hololens(
        *(folder / n for n in ("2022_head_hand_eye.csv", "2022_pv.txt", "transform_scene2scene.txt"))
    )
    assert hololens.ticks[0] == hololens.video_ticks[0] == FIRST_TICK
    assert hololens.ticks.dtype == np.int64


@pytest.mark.parametrize(
    ("name", "says"), [("2022_head_hand_eye.csv", "rows of 861 numbers"), ("2022_pv.txt", "numbers")]
)
def test_cut_files_are_named(root, name, says) -> None:
    write_files(root)
    path = root / FOLDER / name
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputFileError, match=f"{name}.*{says}"):
        read(root)
