"""Damaged ADT files: one clear message each, with place, expectation, finding and remedy."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from prbench.errors import InputFileError, PrbenchError, RecordingUnusable, StreamsDoNotOverlap
from prbench.readers import reader_for


def _read(folder: Path) -> None:
    reader = reader_for("adt")
    (found,) = reader.find(folder)
    reader.read(found)


def _edit_line(name: str, line: int, change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    """Change the cells of one line; line 1 is the header."""

    def damage(folder: Path) -> None:
        lines = (folder / name).read_text().splitlines()
        lines[line - 1] = ",".join(change(lines[line - 1].split(",")))
        (folder / name).write_text("\n".join(lines) + "\n")

    return damage


def _set(column: int, value: str) -> Callable[[list[str]], list[str]]:
    return lambda cells: [*cells[:column], value, *cells[column + 1 :]]


def _edit_json(name: str, change: Callable[[dict], None]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        change(content)
        (folder / name).write_text(json.dumps(content))

    return damage


def _cut(name: str, count: int) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:-count])  # type: ignore[return-value]


def _remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def _swap_lines(name: str, first: int, second: int) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        lines = (folder / name).read_text().splitlines()
        lines[first - 1], lines[second - 1] = lines[second - 1], lines[first - 1]
        (folder / name).write_text("\n".join(lines) + "\n")

    return damage


def _keep_header(name: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        (folder / name).write_text((folder / name).read_text().splitlines()[0] + "\n")

    return damage


def _first_joints(content: dict, joints: list) -> None:
    content["frames"][0]["joints"] = joints


def _swap_frames(content: dict) -> None:
    content["frames"][4], content["frames"][5] = content["frames"][5], content["frames"][4]


FILE_DAMAGE = {
    "no objects": (_remove("scene_objects.csv"), ["scene_objects.csv", "no such file", "Download"]),
    "no gaze": (_remove("eyegaze.csv"), ["eyegaze.csv", "no such file"]),
    "no trajectory": (_remove("aria_trajectory.csv"), ["aria_trajectory.csv", "no such file"]),
    "listed skeleton absent": (_remove("Skeleton_T.json"), ["Skeleton_T.json", "no such file"]),
    "csv cut within a line": (_cut("aria_trajectory.csv", 60), ["aria_trajectory.csv", "truncated"]),
    "csv cut within a number": (
        _cut("scene_objects.csv", 2),
        ["scene_objects.csv, last line", "line break", "truncated"],
    ),
    "line with too few cells": (
        _edit_line("scene_objects.csv", 7, lambda cells: cells[:4]),
        ["scene_objects.csv, line 7", "9 columns, got 4", "truncated"],
    ),
    "json cut": (_cut("Skeleton_T.json", 500), ["Skeleton_T.json", "valid JSON", "truncated"]),
    "column renamed": (
        _edit_line("eyegaze.csv", 1, _set(2, "pitch")),
        ["eyegaze.csv, header", "'pitch_rads_cpf'", "yaw_rads_cpf, pitch, depth_m"],
    ),
    "word for a number": (_edit_line("eyegaze.csv", 3, _set(1, "left")), ["eyegaze.csv, line 3", "'left'"]),
    "no time": (_edit_line("eyegaze.csv", 3, _set(0, "")), ["eyegaze.csv, line 3", "tracking_timestamp_us", "nothing"]),
    "NaN in a pose": (_edit_line("aria_trajectory.csv", 5, _set(3, "nan")), ["aria_trajectory.csv, line 5", "finite"]),
    "NaN in an object's pose": (
        _edit_line("scene_objects.csv", 9, _set(4, "")),
        ["scene_objects.csv, line 9", "finite"],
    ),
    "quaternion of another length": (
        _edit_line("scene_objects.csv", 9, _set(5, "0.5")),
        ["scene_objects.csv, line 9", "length 1", "0.5"],
    ),
    "glasses' clock backwards": (
        _swap_lines("aria_trajectory.csv", 10, 11),
        ["aria_trajectory.csv, line 11", "a time after 5000300000 us", "5000266667 us", "backwards"],
    ),
    "gaze clock stands still": (
        _edit_line("eyegaze.csv", 4, _set(0, "5000033330")),
        ["eyegaze.csv, line 4", "a time after 5000033330 us"],
    ),
    "object's clock backwards": (_swap_lines("scene_objects.csv", 20, 21), ["scene_objects.csv, line 21", "backwards"]),
    "object both still and moving": (
        _edit_line("scene_objects.csv", 4, _set(1, "-1")),
        ["scene_objects.csv, line", "one row of time -1", "both"],
    ),
    "body's clock backwards": (_edit_json("Skeleton_T.json", _swap_frames), ["Skeleton_T.json, frame 5", "backwards"]),
    "50 joints": (
        _edit_json("Skeleton_T.json", lambda content: _first_joints(content, [[0.0, 0.0, 0.0]] * 50)),
        ["Skeleton_T.json, frame 0", "51 joints", "150 numbers instead of 153"],
    ),
    "joints of words": (
        _edit_json("Skeleton_T.json", lambda content: _first_joints(content, [["a", "b", "c"]] * 51)),
        ["Skeleton_T.json, joints", "numbers"],
    ),
    "no frames": (
        _edit_json("Skeleton_T.json", lambda content: content["frames"].clear()),
        ["frames of a body", "none"],
    ),
    "no gaze rows": (_keep_header("eyegaze.csv"), ["eyegaze.csv", "gaze rows", "none"]),
    "no poses": (_keep_header("aria_trajectory.csv"), ["aria_trajectory.csv", "at least one pose", "none"]),
    "another clock": (
        _edit_json("metadata.json", lambda content: content.update(gt_time_domain="TIME_CODE")),
        ["metadata.json, gt_time_domain", "'DEVICE_CAPTURE'", "'TIME_CODE'"],
    ),
    "clock not named": (
        _edit_json("metadata.json", lambda content: content.pop("gt_time_domain")),
        ["metadata.json, gt_time_domain", "nothing"],
    ),
    "another up": (
        _edit_line("aria_trajectory.csv", 2, lambda cells: [*cells[:16], "0", "0", "-9.81", *cells[19:]]),
        ["aria_trajectory.csv, gravity columns", "-Y", "[0.0, 0.0, 1.0]"],
    ),
    "object without category": (
        _edit_json("instances.json", lambda content: content["3758151980953788"].pop("category")),
        ["instances.json", "category"],
    ),
    "box without corner": (
        _edit_line("3d_bounding_box.csv", 2, _set(3, "")),
        ["3d_bounding_box.csv, line 2", "corner"],
    ),
    "association damaged": (_cut("skeleton_aria_association.json", 20), ["skeleton_aria_association.json", "JSON"]),
    "metadata damaged": (_cut("metadata.json", 4), ["metadata.json", "JSON"]),
}


@pytest.mark.parametrize("damage", FILE_DAMAGE)
def test_damage_gets_one_message_with_its_place(folder, damage) -> None:
    do, words = FILE_DAMAGE[damage]
    _read(folder)  # it is sound before
    do(folder)
    with pytest.raises(InputFileError) as error:
        _read(folder)
    message = str(error.value)
    assert all(word in message for word in words), message
    assert "expected" in message
    assert "found" in message


def _body_in_microseconds(content: dict) -> None:
    for frame in content["frames"]:
        frame["timestamp_ns"] //= 1000


def test_streams_without_a_common_instant_name_ranges_and_unit(folder) -> None:
    _edit_json("Skeleton_T.json", _body_in_microseconds)(folder)
    with pytest.raises(StreamsDoNotOverlap) as error:
        _read(folder)
    message = str(error.value)
    assert "body 5.000 … 5.001 s" in message
    assert "5,000.0" in message, message
    assert "body would overlap if its times were 1,000 times as large, the step from seconds to milliseconds" in message


def test_a_recording_known_to_be_bad_is_skipped_by_name(folder) -> None:
    bad = folder.with_name("Apartment_release_clean_seq139_M1292")
    shutil.move(folder, bad)
    with pytest.raises(RecordingUnusable, match="damaged IMU data"):
        _read(bad)


def test_errors_survive_a_process_border(folder) -> None:
    import copy

    _keep_header("aria_trajectory.csv")(folder)
    with pytest.raises(PrbenchError) as error:
        _read(folder)
    assert str(copy.copy(error.value)) == str(error.value)  # by __reduce__, as between processes
