"""Damaged and incomplete sequences of a release: everything is named, nothing is dropped in silence."""

from __future__ import annotations

import json
import pickle
import re

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.release.importing import import_release
from prbench.release.reading import ImportOptions
from tests.release.releases import ROWS, Style, change_targets, imported, table_of, write_release

KEY = "0000000003"
NUMPY = "an array as np.save writes it"
DEEP = json.loads("[" * 90 + "1" + "]" * 90)


def entry(**changes):
    """Change fields of one entry; a field that becomes ``...`` goes."""

    def change(entries):
        entries[KEY] = {name: value for name, value in (entries[KEY] | changes).items() if value is not ...}

    return lambda release: change_targets(release, change)


def array(kind, change):
    def spoil(release):
        path = release / kind / f"{KEY}.npy"
        np.save(path, change(np.load(path)), allow_pickle=True)

    return spoil


def content(change):
    def spoil(release):
        path = release / "motions" / f"{KEY}.npy"
        path.write_bytes(change(path.read_bytes()))

    return spoil


def with_nan(motion):
    motion[4, 7, 1] = np.nan
    return motion


LEFT_OUT = {
    "no motion": (lambda release: (release / "motions" / f"{KEY}.npy").unlink(), "no file in motions"),
    "truncated": (content(lambda data: data[:-100]), r"motion: expected [\d,]+ bytes \(shape"),
    "empty file": (content(lambda data: b""), NUMPY),
    "a page of HTML": (content(lambda data: b"<html>" * 99), NUMPY),
    "objects": (array("motions", lambda _: np.array([{"a": 1}], dtype=object)), "found Python objects"),
    "integers": (array("motions", lambda m: m.astype(np.int32)), "float32 or float64"),
    "24 joints": (array("motions", lambda m: np.zeros((9, 24, 3), np.float32)), r"shape \(N, 22, 3\)"),
    "flat": (array("motions", lambda m: m.reshape(len(m), 66)), r"shape \(N, 22, 3\)"),
    "one frame": (array("motions", lambda m: m[:1]), "2 frames or more"),
    "NaN": (array("motions", with_nan), "found NaN"),
    "no heading": (array("motions", lambda m: np.zeros_like(m)), "has no heading"),
    "no goal": (entry(goal_location=...), "three finite numbers, found nothing"),
    "NaN goal": (entry(goal_location=[float("nan"), 0, 0]), "three finite numbers"),
    "a deep goal": (entry(goal_location=DEEP), "three finite numbers"),
    "no such subset": (entry(subset="holdout"), "train or test, found 'holdout'"),
    "prime after the end": (entry(primed_frame=5000), "primed frame"),
    "prime before the start": (entry(primed_frame=-1), "primed frame"),
    "half a frame": (entry(primed_frame=40.5), "primed frame"),
    "no prime": (entry(primed_frame=None), "expected a number"),
}
BAD_GAZE = {
    "no gaze": (lambda release: (release / "gazes" / f"{KEY}.npy").unlink(), "no file in gazes"),
    "short gaze": (array("gazes", lambda g: g[:-5]), "found .*: no gaze"),
    "gaze of a frame less": (array("gazes", lambda g: g[:-1]), "found .*: no gaze"),
    "zero gaze": (array("gazes", lambda g: g * 0), "no frame has a unit vector"),
    "flat gaze": (array("gazes", lambda g: g[:, :2]), r"shape \(N, 3\)"),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_a_sequence_that_cannot_be_used_is_left_out_and_named(name, tmp_path) -> None:
    spoil, message = LEFT_OUT[name]
    assert imported(tmp_path, spoil=spoil).left_out == 1
    table = table_of(tmp_path)
    assert table.scalars().num_rows == len(ROWS) - 1
    (left_out,) = table.info.quarantine
    assert left_out.recording_id == f"sequence {KEY}"
    assert re.search(message, left_out.message)
    assert table.info.counts.recordings_failed == 1
    failed = [row["recording_id"] for row in table.recordings().to_pylist() if row["status"] == "failed"]
    assert failed == [f"sequence {KEY}"]
    with pytest.raises(InputFileError, match=KEY):
        imported(tmp_path / "strict", spoil=spoil, options=ImportOptions(on_error="fail"))
    assert not (tmp_path / "strict" / "table").exists()


@pytest.mark.parametrize("name", BAD_GAZE)
def test_a_sequence_with_bad_gaze_is_kept_without_it(name, tmp_path) -> None:
    spoil, message = BAD_GAZE[name]
    report = imported(tmp_path, spoil=spoil)
    assert report.left_out == 0
    (problem,) = report.problems
    assert problem.sequence == KEY
    assert re.search(message, problem.problem)
    assert not next(table_of(tmp_path).chunks()).take([3]).frames("gaze_valid").any()


def test_gaze_lengths_near_one_are_made_one_and_others_invalid(tmp_path) -> None:
    factors = np.array([1.1, 1.5, np.nan, 0.0])
    directions = {row.sequence_id: row.gaze_direction.copy() for row in ROWS}
    for each in directions.values():
        each[:4] *= factors[:, None]
    assert imported(tmp_path, gaze=lambda row: directions[row.sequence_id]).problems == []
    chunk = next(table_of(tmp_path).chunks()).take([0])
    assert chunk.frames("gaze_valid")[:5].tolist() == [True, False, False, False, True]
    np.testing.assert_allclose(np.linalg.norm(chunk.frames("gaze_direction"), axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(chunk.frames("gaze_direction")[0], ROWS[0].gaze_direction[0], atol=1e-6)


def test_files_without_entries_and_keys_without_numbers_are_named(tmp_path) -> None:
    def further_files(release):
        np.save(release / "motions" / "0000000099.npy", ROWS[0].joints)
        (release / "motions" / "readme.txt").write_text("hello")

    names = ["first", "1", "2", "3", "4", "5"]
    report = imported(tmp_path, style=Style(key=lambda index: names[index]), spoil=further_files)
    assert [(each.sequence, each.problem) for each in report.problems] == [
        ("first", "an entry without a motion: its key holds no number"),
        ("0000000000", "a motion without an entry in target_information.json"),
        ("0000000099", "a motion without an entry in target_information.json"),
    ]


@pytest.mark.parametrize("link", ["file", "folder", "dataset", "targets"])
def test_no_path_is_followed_out_of_the_release(link, tmp_path) -> None:
    release = write_release(tmp_path / "release")
    outside = tmp_path / "outside"
    outside.mkdir()
    inner = tmp_path / "root" / "synthetic-adt"
    inner.parent.mkdir()
    moved = release
    if link != "dataset":
        release.rename(inner)
        names = {"file": f"motions/{KEY}.npy", "folder": "motions", "targets": "target_information.json"}
        moved = inner / names[link]
    moved.rename(outside / moved.name)
    (inner if link == "dataset" else moved).symlink_to(outside / moved.name)
    with pytest.raises(InputFileError, match="a path that leads out of it"):
        import_release(tmp_path / "root", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_key_is_never_a_path(tmp_path) -> None:
    def spoil(release):
        change_targets(release, lambda entries: entries | {"../../etc/0000000003": entries.pop(KEY)})

    assert imported(tmp_path, spoil=spoil).left_out == 0


def test_nothing_is_unpickled(tmp_path) -> None:
    marker = tmp_path / "executed"

    class Bomb:
        def __reduce__(self):
            return (marker.write_text, ("boom",))

    def spoil(release):
        (release / "motions" / f"{KEY}.npy").write_bytes(pickle.dumps(Bomb()))
        np.save(release / "gazes" / f"{KEY}.npy", np.array([Bomb()], dtype=object), allow_pickle=True)

    imported(tmp_path, spoil=spoil)
    assert not marker.exists()


@pytest.mark.parametrize("lie", ["(200000000000, 22, 3), }", "(200000000000, 22, 3)   ", "(-2, -22, 3), }         "])
def test_a_header_that_claims_more_than_the_file_holds_takes_no_memory(lie, tmp_path) -> None:
    def spoil(release):
        path = release / "motions" / f"{KEY}.npy"
        np.save(path, np.zeros((2, 22, 3), np.float32))
        honest = path.read_bytes()
        path.write_bytes(honest.replace(b"(2, 22, 3), }           ", lie.encode()))
        assert path.read_bytes() != honest

    assert imported(tmp_path, spoil=spoil).left_out == 1


def test_a_field_of_another_kind_in_one_entry_does_no_harm(tmp_path) -> None:
    usual = {"units": "m", "fps": 20, "action": "pick", "video": "v", "hand": "left"}
    unlike = {"units": ["m"], "fps": {}, "action": [1], "video": {"a": 1}, "hand": 7, "text_prompt": 5}
    assert imported(tmp_path, fields=usual, spoil=entry(**unlike)).left_out == 0
    row = table_of(tmp_path).scalars().to_pylist()[3]
    assert (row["action"], row["hand"], row["text"], row["recording_id"]) == ("unknown", None, "", "unknown-test")


@pytest.mark.parametrize(
    ("text", "action"),
    [
        ("The person picks up a cup.", "pick"), ("A person puts the cup down", "put"), ("someone places it", "put"),
        ("picks/puts an object", "unknown"), ("walks around", "unknown"), ("she grabbed the pan", "pick"),
        ("returning the bowl", "put"), ("sets down the tray", "put"), ("output device", "unknown"),
    ],
)  # fmt: skip
def test_actions_are_read_from_prompts(text, action, tmp_path) -> None:
    imported(tmp_path, ROWS[:1], fields={"action": None, "text_prompt": text})
    assert table_of(tmp_path).scalars()["action"].to_pylist() == [action]
