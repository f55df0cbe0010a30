"""Odd entries of HD-EPIC's annotation files: each loses itself at most, and is counted and named."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from prbench.readers.hd_epic.annotations import _videos, read_priming, read_tracks, slam_number

VIDEO = "P01-20240101-120000"
TRACKS = {
    "bowl": {"name": "bowl", "tracks": [{"track_id": "t1", "time_segment": [1.0, 2.0], "masks": ["m1", "m2"]}]},
    "jar": {
        "name": "jar",
        "tracks": [
            {"track_id": "t2", "time_segment": [3.0, 4.0], "masks": ["m3"]},
            {"track_id": "t3", "time_segment": [5.0, 6.0], "masks": []},
        ],
    },
}
MASKS = {
    f"m{number}": {"frame_number": 30 * number, "3d_location": [0.0, 1.0, number], "bbox": [0, 0, 1, 1], "fixture": "x"}
    for number in (1, 2, 3)
}
PRIMING = {
    str(number): {
        side: {"frame": 30 * number, "3d_location": [0.0, 1.0, 2.0], "prime_stats": {"frame_primed": 7}}
        for side in ("start", "end")
    }
    for number in range(2)
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("annotations")


def _tracks(folder: Path, tracks: Any = TRACKS, masks: Any = MASKS):
    for name, content in (("assoc_info.json", tracks), ("mask_info.json", masks)):
        (folder / name).write_text(json.dumps({VIDEO: content}))
    _videos.cache_clear()  # files of one size, written within one tick of the disk's clock
    found = read_tracks(folder / "assoc_info.json", folder / "mask_info.json", VIDEO)
    return {track.track_id: track for track in found.tracks}, found.unreadable


def _priming(folder: Path, priming: Any):
    (folder / "priming_info.json").write_text(json.dumps({VIDEO: priming}))
    _videos.cache_clear()
    sides, unreadable = read_priming(folder / "priming_info.json", VIDEO)
    return {side.key: side for side in sides}, unreadable


def _with(content: Any, path: tuple[Any, ...], value: Any) -> Any:
    changed = copy.deepcopy(content)
    place = changed
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return changed


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=4,
)


CONTENT = {"tracks": TRACKS, "masks": MASKS, "priming": PRIMING}
ALL = {"t1", "t2", "t3", "t1/m1", "t1/m2", "t2/m3", "0/start", "0/end", "1/start", "1/end"}
# An entry, what may be lost with it, and places in it.
ENTRIES: list[tuple[str, tuple[Any, ...], set[str], list[tuple[Any, ...]]]] = [
    ("tracks", ("bowl",), {"t1", "t1/m1", "t1/m2"}, [()]),
    (
        "tracks",
        ("jar", "tracks", 0),
        {"t2", "t2/m3"},
        [(), ("track_id",), ("time_segment", 0), ("masks",), ("masks", 0)],
    ),
    ("masks", ("m1",), {"t1/m1"}, [(), ("frame_number",), ("3d_location",), ("3d_location", 1), ("bbox",)]),
    (
        "priming",
        ("1", "end"),
        {"1/end"},
        [(), ("frame",), ("3d_location",), ("prime_stats",), ("prime_stats", "frame_primed")],
    ),
]
PLACES = [(what, (*entry, *inside), lost) for what, entry, lost, places in ENTRIES for inside in places]


@settings(max_examples=300, deadline=None)
@given(anything, st.sampled_from(PLACES))
def test_whatever_stands_in_place_of_one_entry_the_others_are_read(folder, value, place) -> None:
    what, path, may_be_lost = place
    content = CONTENT | {what: _with(CONTENT[what], path, value)}
    tracks, odd = _tracks(folder, content["tracks"], content["masks"])
    sides, odd_sides = _priming(folder, content["priming"])
    masks = {f"{name}/{mask.mask_id}" for name, track in tracks.items() for mask in track.masks}
    assert ALL - {*tracks, *masks, *sides} <= may_be_lost
    assert len(odd) + len(odd_sides) <= 1


@pytest.mark.parametrize(
    ("path", "value", "place", "found"),
    [
        (("bowl",), [1], "bowl", "`array` instead of `object`"),
        (("bowl", "tracks"), {}, "bowl", "`object` instead of `array` at `$.tracks`"),
        (("jar", "tracks", 1), None, "jar/tracks[1]", "`null` instead of `object`"),
        (("jar", "tracks", 1, "time_segment"), ["3.0", 4.0], "jar/tracks[1]", "`str` instead of `float`"),
        (("jar", "tracks", 1, "time_segment"), [True, 4.0], "jar/tracks[1]", "`bool` instead of `float`"),
        (("jar", "tracks", 1, "time_segment"), [float("nan"), 4.0], "jar/tracks[1]", "`null` instead of `float`"),
        (("jar", "tracks", 1, "time_segment"), [9.0, 4.0], "jar/tracks[1]", "an end at 4.0 s before the start"),
        (("jar", "tracks", 1, "track_id"), "t2", "jar/tracks[1]", "'t2' again"),
    ],
)
def test_an_odd_movement_is_named_with_what_was_found(folder, path, value, place, found) -> None:
    _, (entry,) = _tracks(folder, _with(TRACKS, path, value))
    assert (entry.file, entry.key) == ("assoc_info.json", place)
    assert found in entry.found


@pytest.mark.parametrize("name", [None, 7, "", "Schüssel 碗"])
def test_an_object_without_a_name_is_called_by_its_id(folder, name) -> None:
    found, unreadable = _tracks(folder, _with(TRACKS, ("bowl", "name"), name))
    assert found["t1"].name == (name if isinstance(name, str) and name else "bowl")
    assert not unreadable


@pytest.mark.parametrize(
    ("frame", "is_read"), [(30.0, True), (30.5, False), (-30, False), ("30", False), (True, False)]
)
def test_a_frame_is_a_whole_number_with_or_without_a_decimal_point(folder, frame, is_read) -> None:
    found, unreadable = _tracks(folder, masks=_with(MASKS, ("m1", "frame_number"), frame))
    assert [mask.frame for mask in found["t1"].masks] == ([30, 60] if is_read else [60])
    assert [entry.key for entry in unreadable] == ([] if is_read else ["m1"])


@pytest.mark.parametrize("absent", [None, "N/A", "", {}, []])
def test_a_side_that_is_not_there_publishes_nothing(folder, absent) -> None:
    sides, unreadable = _priming(folder, _with(PRIMING, ("1", "end"), absent))
    assert sides.keys() == {"0/start", "0/end", "1/start"}
    assert not unreadable


@pytest.mark.parametrize(
    ("inside", "value"),
    [(("prime_stats",), {}), (("prime_stats",), None), (("frame",), None), (("prime_stats", "frame_primed"), None)],
)
def test_a_side_that_says_half_cannot_be_read(folder, inside, value) -> None:
    sides, (entry,) = _priming(folder, _with(PRIMING, ("1", "end", *inside), value))
    assert len(sides) == 3
    assert (entry.file, entry.key) == ("priming_info.json", "1/end")


def test_whole_numbers_with_a_decimal_point_are_frames_of_the_published_priming_too(folder) -> None:
    odd = {"frame": 60.0, "3d_location": [], "prime_stats": {"frame_primed": -2.0}}
    sides, _ = _priming(folder, _with(PRIMING, ("1", "end"), odd))
    assert (sides["1/end"].frame, sides["1/end"].frame_primed, sides["1/end"].location) == (60, -2, None)


def test_an_odd_number_of_an_archive_loses_its_own_video_alone(folder) -> None:
    numbers = {
        "P01/a.vrs": "0",
        "P01/b.vrs": 7,
        "P01/c.vrs": 3.0,
        "P01/d.vrs": None,
        "P01/e.vrs": {},
        "P01/f.vrs": True,
    }
    (folder / "map.json").write_text(json.dumps(numbers))
    assert slam_number(folder / "map.json") == {"a": "0", "b": "7", "c": "3"}
