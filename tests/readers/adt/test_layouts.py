"""Which folders are recordings of Aria Digital Twin, and which gaze file is taken."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from prbench.errors import InputFileError
from prbench.readers.adt import find_recordings, read_readings
from prbench.readers.adt.synthetic import write
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.people import perform


@pytest.fixture(scope="module")
def readings():
    return layout_for("adt").sense(perform("adt", seed=11, index=3, n_events=1, provocations={}))


def test_a_recording_that_lost_its_metadata_is_found_and_says_so(tmp_path, readings):
    write(readings, tmp_path / "seq")
    (tmp_path / "seq" / "metadata.json").unlink()
    (found,) = find_recordings(tmp_path)
    with pytest.raises(InputFileError, match=r"metadata\.json"):
        read_readings(found)


def test_recordings_of_hot3d_are_not_taken_for_its_own(tmp_path, readings):
    write(readings, tmp_path / "seq")
    (tmp_path / "P0003_c701bd11").mkdir()
    (tmp_path / "P0003_c701bd11" / "metadata.json").write_text(json.dumps({"headset": "Aria"}))
    assert [found.recording_id for found in find_recordings(tmp_path)] == ["seq"]


def test_a_few_wild_angles_are_no_degrees(tmp_path, readings):
    wild = readings.gaze.yaw.copy()
    wild[:5] = 3.0
    write(replace(readings, gaze=replace(readings.gaze, yaw=wild)), tmp_path / "seq")
    (found,) = find_recordings(tmp_path)
    assert len(read_readings(found).gaze.yaw) == len(wild)
