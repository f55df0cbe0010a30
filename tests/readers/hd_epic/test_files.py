"""Finding and reading HD-EPIC in the shapes that users have it in.

Sources: docs/specification/hd-epic.md#folder-tree, docs/specification/hd-epic.md#clock and
docs/specification/hd-epic.md#pitfalls-and-bad-input.
"""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import pytest

from prbench.errors import InputFileError, RecordingUnusable
from prbench.readers import reader_for
from prbench.readers.found import RecordingFiles
from prbench.readers.hd_epic import annotations
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.annotations import read_video_clock
from tests.comparing import differences
from tests.readers.defects import change_json
from tests.readers.hd_epic_copies import FIRST, SECOND, annotation, time_file, write_copy


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return write_copy(tmp_path_factory.mktemp("hd-epic") / "root")


@pytest.fixture
def root(whole, tmp_path) -> Path:
    return shutil.copytree(whole, tmp_path / "root")


def _found(root: Path, video: str = FIRST, **options: str) -> RecordingFiles:
    return {each.recording_id: each for each in reader_for("hd-epic", options).find(root)}[video]


def _read(root: Path, video: str = FIRST, **options: str):
    return reader_for("hd-epic", options).read(_found(root, video, **options))


def _slam_archive(root: Path) -> Path:
    (path,) = root.glob("HD-EPIC/SLAM-and-Gaze/*/SLAM/multi/0.zip")
    return path


def test_archives_and_folders_read_the_same(root) -> None:
    zipped = _read(root)
    for path in sorted(root.glob("HD-EPIC/SLAM-and-Gaze/**/*.zip")):
        with zipfile.ZipFile(path) as archive:
            archive.extractall(path.parent)
        path.unlink()
    assert not list(differences(zipped, _read(root)))


def test_an_archive_unpacked_into_a_folder_of_its_own_name_is_found(root) -> None:
    zipped, path = _read(root), next(root.glob(f"HD-EPIC/SLAM-and-Gaze/*/GAZE_HAND/mps_{FIRST}_vrs.zip"))
    with zipfile.ZipFile(path) as archive:
        archive.extractall(path.with_suffix(""))  # mps_X_vrs/mps_X_vrs/eye_gaze
    path.unlink()
    assert not list(differences(zipped, _read(root)))


def test_the_trajectory_of_the_videos_own_archive_has_another_world_and_is_not_used(root) -> None:
    path = next(root.glob(f"HD-EPIC/SLAM-and-Gaze/*/GAZE_HAND/mps_{FIRST}_vrs.zip"))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(f"mps_{FIRST}_vrs/slam/closed_loop_trajectory.csv", "no trajectory at all\n")
    file = next(file for file in _found(root).files if file.role == "trajectory")
    assert file.path == _slam_archive(root).resolve()


def test_the_two_videos_without_published_gaze_are_skipped_with_the_reason(root) -> None:
    video = "P02-20240210-113925"
    own = root / "HD-EPIC" / "Videos" / "P02"
    own.mkdir()
    shutil.copy(time_file(root, FIRST), own / f"{video}{hd_epic.TIME_SUFFIX}")
    with pytest.raises(RecordingUnusable, match="no eye gaze is published"):
        _read(root, video)


@pytest.mark.parametrize("with_trajectory", [True, False])
def test_a_video_aligned_by_other_means_is_read_if_it_has_a_trajectory_and_else_skipped(root, with_trajectory) -> None:
    archive = _slam_archive(root)
    other = archive.parents[2] / hd_epic.OTHER_SLAM_FOLDER / f"{FIRST}.zip"
    other.parent.mkdir(parents=True)
    if with_trajectory:
        shutil.move(archive, other)
    else:
        with zipfile.ZipFile(other, "w") as written:
            written.writestr("images.txt", "COLMAP")
    change_json(archive.with_name(hd_epic.SLAM_MAP_FILE), lambda content: content.clear())
    if with_trajectory:
        assert _read(root).head.valid.any()
    else:
        assert "by other means than SLAM" in str(_found(root).skip_reason)
        with pytest.raises(RecordingUnusable, match="by other means than SLAM"):
            _read(root)


def test_both_spellings_of_the_priming_folder(root) -> None:
    one, other = (root / hd_epic.ANNOTATIONS_FOLDER / name for name in hd_epic.PRIMING_FOLDERS)
    before = _read(root)
    one.rename(other)
    assert not list(differences(before, _read(root)))
    shutil.rmtree(other)
    assert all(event.published_priming is None for event in _read(root).annotated_events)


def test_annotations_elsewhere_are_named_by_an_option(root, tmp_path) -> None:
    before = _read(root)
    shutil.move(root / hd_epic.ANNOTATIONS_FOLDER, tmp_path / "elsewhere")
    with pytest.raises(InputFileError, match="--option annotations=DIR"):
        _read(root)
    assert not list(differences(before, _read(root, annotations=str(tmp_path / "elsewhere"))))


def test_annotations_are_opened_once_for_all_videos_and_anew_when_they_change(root, monkeypatch) -> None:
    opened: list[str] = []
    decode = annotations.decode_json
    monkeypatch.setattr(annotations, "decode_json", lambda path, form: opened.append(path.name) or decode(path, form))
    _read(root), _read(root, SECOND), _read(root)
    of_all_videos = [name for name in opened if name.endswith("_info.json")]
    assert sorted(of_all_videos) == ["assoc_info.json", "mask_info.json", "priming_info.json"]
    change_json(annotation(root, hd_epic.MASKS_FILE), lambda content: content.pop(FIRST))
    assert {event.location is None for event in _read(root).annotated_events} == {True}


TIMES = "mp4_time_ns,relative_vrs_device_time_ns,vrs_device_time_ns\n"


def _times(path: Path, *device: str) -> Path:
    path.write_text(TIMES + "".join(f"{i * 33.3},{i},{value}\n" for i, value in enumerate(device)))
    return path


def test_times_with_a_decimal_point_are_read(tmp_path) -> None:
    clock, _ = read_video_clock(_times(tmp_path / "t.csv", "1000.0", "2000.0"), None)
    assert clock.device_ns.tolist() == [1000, 2000]


def test_rows_are_compared_with_the_frames_of_the_log(tmp_path) -> None:
    log = tmp_path / "log.json"
    log.write_text('{"num_mp4_frames": 5, "num_skipped_frames": 0}')
    _, remarks = read_video_clock(_times(tmp_path / "t.csv", "100", "200"), log)
    assert remarks == ("t.csv has 2 rows for a video of 5 frames: it may be truncated",)
