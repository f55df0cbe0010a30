"""Which folders are recordings of Aria Digital Twin, and which gaze file is taken."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.readers import reader_for
from prbench.readers.adt import find_recordings, read_readings
from prbench.readers.adt.files import AdtOptions
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


def test_personalized_gaze_is_taken_when_asked_for(tmp_path, readings):
    write(readings, tmp_path / "seq")
    write(replace(readings, gaze=replace(readings.gaze, yaw=readings.gaze.yaw + 0.1)), tmp_path / "other")
    folder = tmp_path / "seq" / "mps" / "eye_gaze"
    folder.mkdir(parents=True)
    (tmp_path / "other" / "eyegaze.csv").rename(folder / "personalized_eye_gaze.csv")
    for path in (tmp_path / "other").iterdir():
        path.unlink()
    (tmp_path / "other").rmdir()
    for options, shift in ((AdtOptions(), 0.0), (AdtOptions(gaze="personalized"), 0.1)):
        (found,) = find_recordings(tmp_path, options)
        yaw = read_readings(found, options).gaze.yaw
        np.testing.assert_allclose(yaw, readings.gaze.yaw + shift, atol=1e-9, equal_nan=True)


def test_without_personalized_gaze_the_releases_own_is_taken(tmp_path, readings):
    write(readings, tmp_path / "seq")
    reader = reader_for("adt", {"gaze": "personalized"})
    (found,) = reader.find(tmp_path)
    assert reader.read(found).gaze.valid.any()


def test_a_few_wild_angles_are_no_degrees(tmp_path, readings):
    wild = readings.gaze.yaw.copy()
    wild[:5] = 3.0
    write(replace(readings, gaze=replace(readings.gaze, yaw=wild)), tmp_path / "seq")
    (found,) = find_recordings(tmp_path)
    assert len(read_readings(found).gaze.yaw) == len(wild)
