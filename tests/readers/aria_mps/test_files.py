"""Files of the Machine Perception Services: found by name, preferred, refused, wherever they lie."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from prbench.errors import InputFileError
from prbench.readers import files
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import (
    UNREADABLE,
    find_mps_files,
    read_gaze_angles,
    read_mps,
    read_near,
    read_size_and_camera,
    read_trajectory,
    read_wrists,
)
from prbench.readers.aria_mps.synthetic import sense_mps, write_mps
from prbench.readers.files import Source
from prbench.readers.found import InputFile, RecordingFiles
from prbench.synthetic.people import perform
from tests.comparing import differences
from tests.readers.mps_files import OTHER_WORLD, WORLD, trajectory_lines, write_lines, zipped


@pytest.fixture(scope="module")
def readings() -> mps.MpsReadings:
    return sense_mps(perform("hd-epic", seed=3, index=1, n_events=1, provocations={}), start_us=7_000_000_321)


@pytest.fixture
def root(readings, tmp_path) -> Path:
    """All files of one recording, ready to be damaged."""
    write_mps(readings, tmp_path / "mps")
    return tmp_path / "mps"


def found(root: Path) -> RecordingFiles:
    return RecordingFiles("test", "recording", root, find_mps_files(root))


def as_read(readings: mps.MpsReadings) -> mps.MpsReadings:
    """The palms are written, and not read."""
    return replace(readings, wrists=replace(readings.wrists, palm=None))


def archived(root: Path, *, folder: str = "mps_P01_vrs") -> Path:
    """The files in a zip archive instead of a folder."""
    archive = root.parent / "mps_P01_vrs.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as opened:
        for path in sorted(root.rglob("*.*")):
            opened.write(path, f"{folder}/{path.relative_to(root).as_posix()}")
    shutil.rmtree(root)
    return archive


def test_every_role_is_found(root) -> None:
    files = {file.role: file for file in find_mps_files(root)}
    assert set(files) == {
        "trajectory", "gaze", "calibration", "wrists", "slam_summary", "gaze_summary", "hand_summary",
    }  # fmt: skip
    assert files["gaze_summary"].path == root / "eye_gaze" / "summary.json"
    assert files["trajectory"].size == (root / "slam" / "closed_loop_trajectory.csv").stat().st_size


def test_what_was_written_is_read_thinned(root, readings) -> None:
    assert list(differences(read_mps(found(root), thin=False), as_read(readings))) == []
    assert list(differences(read_mps(found(root)), mps.thinned(as_read(readings)))) == []
    assert len(mps.thinned(readings).trajectory.time_us) < len(readings.trajectory.time_us) / 8


@pytest.mark.parametrize("inside", [False, True], ids=["the archive", "a folder with the archive"])
def test_an_archive_reads_as_its_folder_would_and_leaves_nothing_on_the_disk(root, readings, inside) -> None:
    archive = archived(root)
    files = found(archive.parent if inside else archive)
    assert all(file.path == archive and file.member for file in files.files)
    assert list(differences(read_mps(files), mps.thinned(as_read(readings)))) == []
    assert list(archive.parent.iterdir()) == [archive]


def test_old_names_and_the_samples_folders(samples) -> None:
    files = {file.role: file.path for file in find_mps_files(samples / "mps" / "mps_sample")}
    assert files["trajectory"].parent.name == "trajectory"
    assert files["gaze"].name == "generalized_eye_gaze.csv"
    hot3d = {file.role: file.path for file in find_mps_files(samples / "hot3d/Aria/P0003_c701bd11/mps")}
    assert hot3d["gaze"].name == "personalized_eye_gaze.csv"
    assert hot3d["slam_summary"].parent.name == "slam"


def test_personalized_gaze_is_preferred_and_told(root) -> None:
    gaze = root / "eye_gaze"
    assert read_mps(found(root)).gaze_kind == "personalized"
    (gaze / "personalized_eye_gaze.csv").rename(gaze / "generalized_eye_gaze.csv")
    assert read_mps(found(root)).gaze_kind == "general"
    shutil.copy(gaze / "generalized_eye_gaze.csv", gaze / "calibrated_eye_gaze.csv")
    assert read_mps(found(root)).gaze_kind == "personalized"


def test_the_usual_folder_wins_over_a_copy_elsewhere(root) -> None:
    (root / "a_copy").mkdir()
    shutil.copy(root / "slam" / "closed_loop_trajectory.csv", root / "a_copy")
    files = {file.role: file.path for file in find_mps_files(root)}
    assert files["trajectory"].parent.name == "slam"


def test_what_is_optional_may_be_missing(root) -> None:
    shutil.rmtree(root / "hand_tracking")
    for path in root.rglob("*.json*"):
        path.unlink()
    readings = read_mps(found(root))
    assert (readings.wrists, readings.glasses_size, readings.device_from_rgb) == (None, None, None)
    assert readings.messages == ()


def _summary(root: Path, folder: str, status: str) -> None:
    content = {"SomeOperator": {"status": status, "message": "it rained", "warnings": [], "errors": []}}
    (root / folder / "summary.json").write_text(json.dumps(content))


def test_hands_that_their_services_call_an_error_are_left_out_with_a_word(root) -> None:
    _summary(root, "hand_tracking", "ERROR")
    readings = read_mps(found(root))
    assert readings.wrists is None
    assert any("hands are not used" in message for message in readings.messages)


@pytest.mark.parametrize("folder", ["slam", "eye_gaze", "hand_tracking"])
def test_warnings_are_kept(root, folder) -> None:
    _summary(root, folder, "WARNING")
    readings = read_mps(found(root))
    assert readings.wrists is not None
    assert readings.messages == (f"{folder}: SomeOperator warns (it rained)",)


def test_a_damaged_archive_is_refused(root) -> None:
    archive = archived(root)
    content = bytearray(archive.read_bytes())
    place = content.find(b"closed_loop_trajectory.csv") + 5_000
    content[place : place + 40] = bytes(40)
    archive.write_bytes(content)
    with pytest.raises(InputFileError, match=r"closed_loop_trajectory\.csv: expected a file that can be unpacked"):
        read_mps(found(archive))
    archive.write_bytes(content[: len(content) // 2])
    with pytest.raises(InputFileError, match="a whole zip archive"):
        find_mps_files(archive)
    assert [file.role for file in find_mps_files(archive.parent)] == [f"{UNREADABLE}{archive.name}"]
    with pytest.raises(InputFileError, match="a whole zip archive"):
        read_mps(found(archive.parent))


def test_gaze_of_the_three_schemas_reads_from_archives_too(samples, tmp_path) -> None:
    for name in ("mps_sample/eye_gaze/eyegaze.csv", "mps_sample/eye_gaze_vergence/generalized_gaze.csv",
                 "mps_sample_gen2/eye_gaze/general_eye_gaze.csv"):  # fmt: skip
        path = samples / "mps" / name
        with zipfile.ZipFile(tmp_path / "gaze.zip", "w") as archive:
            archive.write(path, "x/gaze.csv")
        packed = read_gaze_angles(InputFile("", tmp_path / "gaze.zip", 0, "x/gaze.csv"))
        assert list(differences(packed, read_gaze_angles(path))) == []


def test_wrists_of_the_sample(samples, reference_values) -> None:
    expected = reference_values["mps-wrist-count"]["expect"]
    for name in ("wrist_and_palm_poses.csv", "wrist_and_palm_poses_v2.csv"):
        wrists = read_wrists(samples / "mps/mps_sample/hand_tracking" / name)
        seen = np.isfinite(wrists.wrist).all(axis=2)
        assert len(wrists.time_us) == expected["rows"]
        assert seen.sum(axis=0).tolist() == [expected["left"], expected["right"]]
        assert (seen == (wrists.confidence > 0)).all()  # -1 in a neighbouring column deceives nobody


def test_a_wrist_of_the_sample(samples, reference_values) -> None:
    expected = reference_values["mps-wrist-109"]["expect"]
    wrists = read_wrists(samples / "mps/mps_sample/hand_tracking/wrist_and_palm_poses.csv")
    assert wrists.time_us[109] == expected["timestamp_us"]
    assert wrists.confidence[109, 1] == pytest.approx(expected["confidence"], abs=1e-6)
    assert wrists.wrist[109, 1] == pytest.approx(expected["wrist_device"], abs=1e-6)


def test_large_glasses_are_recognised(readings, tmp_path) -> None:
    write_mps(replace(readings, glasses_size="DVT-L"), tmp_path, only={mps.CALIBRATION})
    assert read_size_and_camera(tmp_path / "slam" / "online_calibration.jsonl")[0] == "DVT-L"
    assert [path.name for path in tmp_path.rglob("*.*")] == ["online_calibration.jsonl"]


START = 5_000_000_000


def steady(n: int = 3000, step: int = 1000) -> np.ndarray:
    return START + np.arange(n, dtype=np.int64) * step


def chosen(source: Source, gaze_us: np.ndarray) -> mps.AriaTrajectory:
    """The independent way: read everything, then choose."""
    whole = read_trajectory(source)
    wanted = mps.wanted_times_us(gaze_us, int(whole.time_us[0]), int(whole.time_us[-1]))
    return mps.trajectory_rows(whole, mps.rows_around(whole.time_us, wanted))


def require_same(found: mps.AriaTrajectory, expected: mps.AriaTrajectory) -> None:
    for name in ("time_us", "position", "rotation", "quality"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("search")


STEPS = st.lists(st.sampled_from([1, 7, 998, 1000, 1002, 1179, 60_000, 2_000_000]), min_size=0, max_size=400)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    steps=STEPS,
    wanted=st.lists(st.integers(-5_000, 3_000_000), max_size=60),
    exactly=st.lists(st.integers(0, 400), max_size=60),
    block=st.sampled_from([600, 2_000, 2**20]),
    end=st.sampled_from(["\n", "\r\n"]),
    last_end=st.sampled_from(["\n", "\n\n\n"]),
    archived=st.booleans(),
)
def test_the_same_rows_as_reading_all_of_them(folder, steps, wanted, exactly, block, end, last_end, archived) -> None:
    times = START + np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)
    path = write_lines(folder / "t.csv", trajectory_lines(times), end=end, last_end=last_end)
    gaze_us = np.sort(
        np.append(START + np.array(wanted, dtype=np.int64), times[np.array(exactly, dtype=int) % len(times)])
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "_BLOCK", block)
        found = read_near(zipped(path) if archived else path, gaze_us)
    require_same(found, chosen(path, gaze_us))


@pytest.mark.parametrize("archived", [False, True], ids=["plain", "zipped"])
def test_uneven_steps_gaps_and_lengths_in_a_longer_file(folder, archived, monkeypatch) -> None:
    monkeypatch.setattr(files, "_BLOCK", 2**14)
    rng = np.random.default_rng(4)
    steps = np.where(rng.random(20_000) < 0.001, 400_000, rng.integers(1, 1180, 20_000))
    path = write_lines(folder / "long.csv", trajectory_lines(START + np.cumsum(steps)))
    gaze_us = START + np.arange(0, 12_000_000, 99_991)
    found = read_near(zipped(path) if archived else path, gaze_us)
    require_same(found, chosen(path, gaze_us))
    assert len(found.time_us) < 2500


def test_rows_on_both_sides_by_hand(folder) -> None:
    path = write_lines(folder / "hand.csv", trajectory_lines(np.array([10, 20, 30, 40, 50, 60])))
    assert read_near(path, np.array([34, 41])).time_us.tolist() == [10, 30, 40, 50, 60]
    assert read_near(path, np.array([20])).time_us.tolist() == [10, 20, 60]
    assert mps.rows_around(np.array([10, 20, 30]), np.array([34, 20, -7])).tolist() == [0, 1, 2]


def test_the_grid_begins_with_the_trajectory_and_covers_its_end() -> None:
    wanted = mps.wanted_times_us(np.array([START - 5, START + 40_000, START + 10**9]), START, START + 100_000)
    assert (wanted - START).tolist() == [0, 33_333, 40_000, 66_667, 100_000]
    assert mps.wanted_times_us(np.array([], dtype=np.int64), START, START + 5).max() >= START + 5
    later = mps.wanted_times_us(np.array([START + 40_000]), START, START + 100_000, from_us=START + 40_000)
    assert (later - START).tolist() == [66_667, 100_000]


def test_rows_without_a_world_or_of_a_shorter_one_are_left_out(folder) -> None:
    worlds = [WORLD] * 2000 + [mps.UNDEFINED_GRAPH] * 400 + [OTHER_WORLD] * 600
    path = write_lines(folder / "worlds.csv", trajectory_lines(steady(), worlds=worlds))
    thin = read_near(path, np.array([START + 500]))
    assert thin.graph_uids == (WORLD, OTHER_WORLD)
    assert thin.time_us.max() < START + 2_000_000
    assert thin.left_out > 0


def test_quoted_text_is_read_too(folder) -> None:
    lines = trajectory_lines(steady(50))
    quoted = [lines[0], *(line.replace(WORLD, f'"{WORLD}"', 1) for line in lines[1:])]
    path = write_lines(folder / "quoted.csv", quoted)
    assert read_near(path, steady(50)).time_us.tolist() == steady(50).tolist()
