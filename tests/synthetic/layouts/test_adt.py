"""Native ADT files: what is written comes back, in both layouts."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from prbench.readers.adt import find_recordings, read_readings, read_recording
from prbench.readers.adt import format as adt
from prbench.readers.adt import synthetic as layout
from prbench.readers.adt.synthetic import LAYOUT, sense
from tests.comparing import differences


@pytest.fixture(scope="module")
def readings(performance) -> adt.AdtReadings:
    return _first_seconds(sense(performance, noise=5.0))  # bad frames, blinks and losses included


def _first_seconds(readings: adt.AdtReadings, seconds: float = 4.0) -> adt.AdtReadings:
    """The beginning of a recording: quick to write."""
    end_us = int(readings.glasses.time_us[0] + seconds * 1e6)

    def cut(stream: Any, times: np.ndarray, end: int) -> Any:
        kept = times <= end
        columns = {field.name: getattr(stream, field.name) for field in fields(stream)}
        return replace(stream, **{k: v[kept] for k, v in columns.items() if np.shape(v)[:1] == kept.shape})

    return replace(
        readings,
        glasses=cut(readings.glasses, readings.glasses.time_us, end_us),
        gaze=cut(readings.gaze, readings.gaze.time_us, end_us),
        objects=tuple(
            cut(entry, entry.time_ns, end_us * 1000) if entry.dynamic else entry for entry in readings.objects
        ),
        skeletons=tuple(cut(person, person.time_ns, end_us * 1000) for person in readings.skeletons),
    )


def test_files_and_memory_give_the_same_recording_bit_for_bit(readings, tmp_path) -> None:
    layout.write(readings, tmp_path / readings.recording_id)
    (found,) = find_recordings(tmp_path)
    from_files = read_recording(found)
    from_memory = replace(LAYOUT.recording(readings), dataset="adt")
    assert list(differences(from_files, from_memory)) == []


def test_two_writings_give_the_same_bytes(readings, tmp_path) -> None:
    for name in ("first", "second"):
        layout.write(readings, tmp_path / name)
    for path in (tmp_path / "first").iterdir():
        assert path.read_bytes() == (tmp_path / "second" / path.name).read_bytes(), path.name


def test_the_twin_with_the_smaller_id_names_the_split_group(readings, tmp_path) -> None:
    for twin, group in (("A_before", "A_before"), ("Z_after", readings.recording_id)):
        layout.write(replace(readings, concurrent=twin), tmp_path / twin / readings.recording_id)
        (found,) = find_recordings(tmp_path / twin)
        assert read_recording(found).split_group == group


def test_without_a_skeleton_there_is_no_body_and_nothing_is_refused(readings, tmp_path) -> None:
    layout.write(replace(readings, skeletons=()), tmp_path / "alone")
    recording = read_recording(find_recordings(tmp_path / "alone")[0])
    assert recording.body is None
    assert recording.hands == ()
    assert recording.pose_source == "none"
    assert recording.participant_id == "unknown"


def test_a_skeleton_without_glasses_is_somebody_else(readings, tmp_path) -> None:
    stranger = replace(readings.skeletons[0], serial="NONE", name="Skeleton_C")
    layout.write(replace(readings, skeletons=(stranger,)), tmp_path / "stranger")
    recording = read_recording(find_recordings(tmp_path / "stranger")[0])
    assert recording.body is None
    assert [person.person_id for person in recording.other_people] == ["Skeleton_C"]


def test_readings_survive_the_text(readings, tmp_path) -> None:
    layout.write(readings, tmp_path / readings.recording_id)
    back = read_readings(find_recordings(tmp_path)[0])
    # Gravity and world frames, which the file holds, are not sensed.
    back = replace(back, glasses=replace(back.glasses, up=np.zeros(3), graph_uids=()))
    markers_are_not_read = tuple(replace(person, markers=None) for person in readings.skeletons)
    assert list(differences(back, replace(readings, skeletons=markers_are_not_read))) == []


@pytest.mark.parametrize("name", ["aria_trajectory.csv", "eyegaze.csv", "3d_bounding_box.csv", "scene_objects.csv"])
def test_columns_stand_in_the_order_of_the_release(readings, tmp_path, samples, name) -> None:
    layout.write(readings, tmp_path / "written")
    real = (samples / "adt" / "aria_digital_twin_test_data" / name).read_text().splitlines()[0]
    assert (tmp_path / "written" / name).read_text().splitlines()[0] == real


@pytest.mark.parametrize(
    "name", ["metadata.json", "instances.json", "skeleton_aria_association.json", "Skeleton_T.json"]
)
def test_json_files_have_the_keys_of_the_release(readings, tmp_path, samples, name) -> None:
    (person,) = readings.skeletons
    layout.write(replace(readings, skeletons=(replace(person, name="Skeleton_T"),)), tmp_path / "written")
    real = json.loads((samples / "adt" / "aria_digital_twin_test_data" / name).read_text())
    assert _shape(json.loads((tmp_path / "written" / name).read_text())) == _shape(real)


def _shape(value: Any) -> Any:
    """Keys and kinds of a JSON value: of a list its first entry, of objects by id the first."""
    if isinstance(value, list):
        return [_shape(value[0])] if value else []
    if isinstance(value, dict):
        return {
            ("id" if key[:1].isdigit() or key[:5] == "SYNTH" else key): _shape(entry) for key, entry in value.items()
        }
    return float if isinstance(value, float) else type(value)
