"""Which folders are ADT recordings, which of their files are taken, and rules of the format that seldom show."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.readers.adt import find_recordings, read_readings, read_recording
from prbench.readers.adt import synthetic as layout
from prbench.readers.aria_mps.files import read_trajectory
from prbench.readers.aria_mps.format import trajectory_rows
from prbench.recording import Recording
from tests.readers.conftest import still_life


def _recording(folder: Path) -> Recording:
    return read_recording(find_recordings(folder)[0])


def _change_metadata(folder: Path, **changes: object) -> None:
    path = folder / "metadata.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize("nobody", ["", "NONE", None])
def test_nobody_is_no_twin(folder, nobody) -> None:
    office = folder.rename(folder.with_name("Office_release_clean"))  # comes after "NONE" in the alphabet
    _change_metadata(office, concurrent_sequence=nobody)
    assert _recording(office).split_group == "Office_release_clean"


def two_wearers(root: Path) -> None:
    """The still life with a second person one metre aside, as two recordings."""
    first = still_life()
    (person,) = first.skeletons
    aside = np.add(person.joints, (1.0, 0, 0))
    people = (person, replace(person, name="Skeleton_C", skeleton_id=78, serial="S2", joints=aside))
    layout.write(replace(first, skeletons=people, concurrent="party_M2"), root / "party_M1")
    layout.write(replace(first, serial="S2", skeletons=people, concurrent="party_M1"), root / "party_M2")


def test_two_wearers_share_a_split_and_see_each_other(tmp_path) -> None:
    two_wearers(tmp_path)
    one, two = (read_recording(found) for found in find_recordings(tmp_path))
    assert [one.recording_id, two.recording_id] == ["party_M1", "party_M2"]
    assert one.split_group == two.split_group == "party_M1"
    assert (one.participant_id, two.participant_id) == ("T", "C")
    assert [other.person_id for other in one.other_people] == ["Skeleton_C"]
    for mine, others in zip(two.hands, one.other_people[0].hands, strict=True):
        assert others.points == pytest.approx(mine.points)


def test_without_an_entry_for_the_wearer_everybody_is_somebody_else(folder) -> None:
    _change_metadata(folder, serial="S9")
    recording = _recording(folder)
    assert recording.body is None
    assert recording.hands == ()
    assert recording.pose_source == "none"
    assert [person.person_id for person in recording.other_people] == ["Skeleton_T"]
    assert any("no skeleton belongs to the wearer" in message for message in recording.messages)


def test_one_damaged_metadata_file_hides_no_other_recording(folder) -> None:
    shutil.copytree(folder, folder.with_name("damaged"))
    (folder.with_name("damaged") / "metadata.json").write_text('{"subtours": [')
    damaged, sound = find_recordings(folder.parent)
    assert read_recording(sound).recording_id == "still_life"
    with pytest.raises(InputFileError, match=r"damaged/metadata\.json: expected valid JSON"):
        read_recording(damaged)


def test_rows_without_a_world_need_no_pose_and_the_longest_world_is_kept(folder) -> None:
    path = folder / "aria_trajectory.csv"
    header, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    cells[0][0] = "UNDEFINED_ROW"
    cells[0][3:10] = [""] * 7
    for row in cells[-5:]:
        row[0] = "another-world"
    path.write_text("\n".join([header, *(",".join(row) for row in cells)]) + "\n")
    trajectory = read_trajectory(path)
    assert len(trajectory.time_us) == len(rows) - 6
    assert len(trajectory.graph_uids) == 2
    assert np.isfinite(trajectory.position).all()
    assert any("6 poses of the glasses without a world" in message for message in _recording(folder).messages)


def test_a_body_outside_the_tracked_time_is_without_ground_truth(readings, tmp_path) -> None:
    poses = readings.glasses
    kept = np.arange(6, 25)  # tracking begins late and ends early
    late = replace(readings, glasses=trajectory_rows(poses, kept))
    layout.write(late, tmp_path / "late")
    recording = _recording(tmp_path)
    for stream in (recording.body, *recording.hands):
        assert stream is not None
        inside = (stream.times > recording.span[0] - 0.002) & (stream.times < recording.span[1] + 0.002)
        assert 0 < inside.sum() < len(inside)
        assert (stream.valid == inside).all()
    assert any("48 of 121 body frames lie outside the tracked time" in message for message in recording.messages)


@pytest.mark.parametrize("token", ["NaN", "null"])
def test_joints_that_are_no_numbers_cost_their_frame_only(folder, token) -> None:
    path = folder / "Skeleton_T.json"
    content = json.loads(path.read_text())
    content["frames"][7]["joints"][8] = ["?", "?", "?"]
    path.write_text(json.dumps(content).replace('"?"', token))
    recording = _recording(folder)
    assert recording.body is not None
    assert np.flatnonzero(~recording.body.valid).tolist() == [7]
    assert np.isfinite(recording.body.joints).all()


@pytest.mark.parametrize(("step_ms", "bridged"), [(49.9, True), (51.0, False)])
def test_poses_of_the_glasses_are_never_bridged_over_more_than_50_ms(readings, tmp_path, step_ms, bridged) -> None:
    time_us = readings.glasses.time_us.copy()
    time_us[11:] += round(step_ms * 1000) - int(time_us[11] - time_us[10])
    gaze_us = time_us - 3
    gaze_us[11] = time_us[10] + 20_000
    moved = replace(
        readings, glasses=replace(readings.glasses, time_us=time_us), gaze=replace(readings.gaze, time_us=gaze_us)
    )
    layout.write(moved, tmp_path / "gap")
    assert bool(_recording(tmp_path).gaze.valid[11]) is bridged


def test_gaze_of_the_release_comes_first_then_the_personalised_one(folder) -> None:
    gaze = folder / "eyegaze.csv"
    lines = gaze.read_text().splitlines()
    services = folder / "mps" / "eye_gaze"
    services.mkdir(parents=True)

    def with_pitch(value: str) -> str:
        rows = [line.split(",") for line in lines[1:]]
        return "\n".join([lines[0], *(",".join([row[0], row[1], value, *row[3:]]) for row in rows)]) + "\n"

    (services / "general_eye_gaze.csv").write_text(with_pitch("0.1"))
    (services / "personalized_eye_gaze.csv").write_text(with_pitch("0.2"))
    (found,) = find_recordings(folder)
    assert read_readings(found).gaze.pitch[0] == 0.0
    gaze.unlink()
    (found,) = find_recordings(folder)
    assert read_readings(found).gaze.pitch[0] == 0.2
    (services / "personalized_eye_gaze.csv").unlink()
    (found,) = find_recordings(folder)
    assert read_readings(found).gaze.pitch[0] == 0.1


@pytest.mark.parametrize(
    ("end", "accepted"),
    [
        ("0.123456", True),
        ("-0.123456", True),
        ("12.1234567", True),
        ("-3.5049e-05", True),
        ("0.12345", False),
        ("-1", False),
        ("3.50491234", False),  # its exponent may be lost
        ("3.5049e-0", False),
    ],
)
def test_without_a_last_line_break_a_number_must_not_depend_on_what_may_be_missing(folder, end, accepted) -> None:
    path = folder / "eyegaze.csv"
    cells = path.read_text().rstrip("\n").split(",")
    path.write_text(",".join([*cells[:-1], end]))
    if accepted:
        assert read_readings(find_recordings(folder)[0]).gaze.pitch_range[-1, 1] == pytest.approx(float(end))
        return
    with pytest.raises(InputFileError, match=r"eyegaze\.csv, last line: .*append one line break"):
        _recording(folder)
    path.write_text(path.read_text() + "\n")
    assert len(_recording(folder).gaze.times) == 31


def test_a_cut_column_that_is_not_read_does_no_harm(folder) -> None:
    path = folder / "eyegaze.csv"
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([f"{header},session_uid", *(f"{row},f787755b" for row in rows)])[:-4])
    assert _recording(folder).gaze.valid.all()


def test_recordings_of_hot3d_are_not_taken_for_its_own(folder) -> None:
    (folder.parent / "P0003_c701bd11").mkdir()
    (folder.parent / "P0003_c701bd11" / "metadata.json").write_text(json.dumps({"headset": "Aria"}))
    assert [found.recording_id for found in find_recordings(folder.parent)] == ["still_life"]


def test_a_few_wild_angles_are_no_degrees(readings, tmp_path) -> None:
    wild = readings.gaze.yaw.copy()
    wild[:5] = 3.0
    layout.write(replace(readings, gaze=replace(readings.gaze, yaw=wild)), tmp_path / "seq")
    assert len(read_readings(find_recordings(tmp_path)[0]).gaze.yaw) == len(wild)
