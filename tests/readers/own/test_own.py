"""Plain recordings of every unit and axis build the tables of the recordings that they were made from."""

from __future__ import annotations

import re

import msgspec
import numpy as np
import pandas as pd
import pytest

from prbench.cli import main
from prbench.errors import InputFileError
from prbench.protocol.manifests import load_manifest, read_own_manifest
from prbench.readers import reader_for
from prbench.readers.own import format as own
from prbench.readers.own.write import write_recording
from prbench.recording import Recording
from prbench.sequences import SequenceTable
from tests.readers.own.plain import METRES, TREES, tree, write_plain, write_short
from tests.readers.own.plain import recording_of as original

WORLDS = {
    "ours": METRES,
    "z up, mm, ns, xyzw": own.About(
        participant="p01", units=own.Units(length="mm", time="ns"), axes=own.Axes(up="z", quaternion="xyzw")
    ),
    "Unity, gaze in the head": own.About(
        participant="p01", units=own.Units(length="m", time="ms"), axes=own.Axes(up="y", handed="left"),
        gaze=own.GazeFrame(frame="head"),
    ),
    "Unreal": own.About(
        participant="p01", units=own.Units(length="cm", time="us"), axes=own.Axes(up="z", handed="left")
    ),
}  # fmt: skip
ODD = {
    "action": ("grab", "the action 'pick' or 'put', found 'grab'"),
    "object": ("cup_reed", "an object of the recording. Did you mean 'cup_green'?"),
    "time": ("7000.0", "a time from -2.0 to 5.0 s, found 7000.000 s"),
    "x": ("", "numbers in x, y, z, or nothing, found [nan"),
    "y": ("high", "could not convert string to float: 'high'"),
    "hand": ("both", "the hand 'left', 'right' or nothing, found 'both'"),
}
COMPARED = ("action", "object_id", "outcome", "stage", "hand", "event_time", "prime_time", "location", "box_min")


def read_plain(folder) -> Recording:
    reader = reader_for("own")
    (found,) = reader.find(folder)
    return reader.read(found)


def rows_of(folder) -> list[tuple]:
    table = SequenceTable.open(folder).events()
    return sorted(zip(*(table[name].to_pylist() for name in COMPARED), strict=True))


def assert_same_tables(one, other, *, within: float) -> None:
    pairs = list(zip(rows_of(one), rows_of(other), strict=True))
    for mine, theirs in pairs:
        assert mine[:5] == theirs[:5]
        for a, b in zip(mine[5:], theirs[5:]):
            assert (a is None) == (b is None)
            np.testing.assert_allclose(a or 0.0, b or 0.0, rtol=0, atol=within)
    (mine,), (theirs,) = (list(SequenceTable.open(folder).chunks()) for folder in (one, other))
    assert mine.n_frames.tolist() == theirs.n_frames.tolist()
    for name in ("joints", "gaze_origin", "gaze_direction", "head_position"):
        np.testing.assert_allclose(mine.frames(name), theirs.frames(name), rtol=0, atol=within)


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("layout", TREES)
def test_streams_come_back_from_any_units_and_axes(tmp_path, layout, world) -> None:
    recording = original(layout)
    back = read_plain(write_plain(tmp_path, recording, WORLDS[world]))
    pairs = [
        (recording.head, back.head, ("position", "rotation")),
        (recording.gaze, back.gaze, ("origin", "direction")),
    ]
    pairs.append((recording.body, back.body, ("joints",)))
    pairs += [(recording.object(track.object_id), track, ("position", "rotation")) for track in back.objects]
    wrists = [hand for hand in recording.hands if hand.contact == "wrist"]
    pairs += [(one, other, ("points",)) for one, other in zip(wrists, back.hands, strict=True)]
    for one, other, names in pairs:
        kept = one.valid.copy()  # what was not measured is no row
        assert len(other.times) == kept.sum()
        np.testing.assert_allclose(one.times[kept], other.times, rtol=0, atol=1e-9)
        assert other.valid.mean() > 0.99  # without a pose of the head there is no gaze in its axes
        for name in names:
            values = getattr(one, name)[kept][other.valid], getattr(other, name)[other.valid]
            if name == "rotation":  # a quaternion and its negative are the same rotation
                values = tuple(np.abs((each * values[0]).sum(axis=1)) for each in values)
            np.testing.assert_allclose(*values, rtol=0, atol=1e-9)
    for track in back.objects:
        assert track.movable == recording.object(track.object_id).movable
        np.testing.assert_allclose(track.box_max, recording.object(track.object_id).box_max, atol=1e-9)
    for one, other in zip(recording.annotated_events, back.annotated_events, strict=True):
        assert (one.action, one.object_id, one.hand) == (other.action, other.object_id, other.hand)
        np.testing.assert_allclose(one.event_time, other.event_time, rtol=0, atol=1e-9)
        if one.location is not None:
            np.testing.assert_allclose(one.location, other.location, atol=1e-9)


@pytest.mark.parametrize(("layout", "world"), [("adt", "ours"), ("hd-epic", "Unreal"), ("mogaze", "ours")])
def test_a_recording_of_another_layout_gives_the_same_table(tmp_path, layout, world) -> None:
    write_plain(tmp_path / "plain", original(layout), WORLDS[world])
    rule = ["--in-hand", "wrist"] if layout == "adt" else []
    for dataset, root, options in ((layout, tree(layout), rule), ("own", tmp_path / "plain", [])):
        assert main(["build-dataset", dataset, "--root", str(root), "--out", str(tmp_path / dataset), *options]) == 0
    assert_same_tables(tmp_path / layout, tmp_path / "own", within=5e-6)


@pytest.mark.parametrize("column", ODD)
def test_an_odd_row_of_events_loses_itself_alone(tmp_path, column) -> None:
    write_short(tmp_path)
    events = pd.read_csv(tmp_path / "one" / "events.csv", dtype=str, keep_default_na=False)
    events = pd.concat([events, events], ignore_index=True)
    value, told = ODD[column]
    events.loc[0, column] = value
    events.to_csv(tmp_path / "one" / "events.csv", index=False)
    recording = read_plain(tmp_path)
    assert len(recording.annotated_events) == 1
    (odd,) = recording.unreadable
    assert str(odd).startswith("events.csv, line 2: expected")
    assert told in str(odd)


def short_tables(**events) -> dict:
    """Three seconds of a head, and an event."""
    rows = {"time": [0.0, 1.0, 2.0, 3.0], "x": [0.0] * 4, "y": [1.5] * 4, "z": [0.0] * 4}
    return {"head": rows | {"qw": [1.0] * 4, "qx": [0.0] * 4, "qy": [0.0] * 4, "qz": [0.0] * 4},
            "events": {"action": ["pick"], "object": ["cup"], **events}}  # fmt: skip


def test_an_event_is_placed_in_time_by_the_frame_of_a_video(tmp_path) -> None:
    about = msgspec.structs.replace(METRES, units=own.Units(length="m", time="ms"), video=own.Video(start=250, fps=30))
    tables = short_tables(frame=[45])
    tables["head"]["time"] = [0, 1000, 2000, 3000]
    write_recording(tmp_path / "one", about, tables)
    (event,) = read_plain(tmp_path).annotated_events
    assert event.event_time == pytest.approx(0.25 + 45 / 30)
    assert event.location is None


def test_an_event_without_a_place_is_where_its_tracked_object_rests(tmp_path) -> None:
    poses = {
        "time": [0.0, 1.0, 1.5, 2.5],
        "object_id": ["7"] * 4,
        "x": [0.2, 0.2, 0.9, 0.9],
        "y": [1.0] * 4,
        "z": [0.5] * 4,
    }
    box = dict(zip(own.BOX, ([-0.05], [0.0], [-0.05], [0.05], [0.1], [0.05])))
    tables = {"object_poses": poses, "objects": {"object_id": [7], "name": ["cup"], **box}}
    write_recording(tmp_path / "one", METRES, short_tables(time=[1.0]) | tables)
    recording = read_plain(tmp_path)
    (event,) = recording.annotated_events
    assert (event.object_id, event.object_name, recording.objects[0].movable) == ("7", "cup", True)
    np.testing.assert_allclose(event.location, [0.2, 1.05, 0.5])


@pytest.mark.parametrize(
    ("without", "outcome", "told"),
    [
        (("body", "wrists"), "no_body", "sequences need bodies: a body table"),
        (("gaze",), "not_primed", "no valid gaze, so no event can be primed"),
        (("head", "gaze", "body", "wrists", "objects", "object_poses"), "not_primed", "no valid gaze"),
        (("events", "objects", "object_poses"), None, "no events: write an events table"),
    ],
)
def test_a_recording_gets_as_far_as_it_can_and_says_what_it_lacks(tmp_path, capsys, without, outcome, told) -> None:
    write_plain(tmp_path / "plain", original("hd-epic"), without=without)
    out = tmp_path / "table"
    assert main(["build-dataset", "own", "--root", str(tmp_path / "plain"), "--out", str(out)]) == 0
    printed = "".join(capsys.readouterr())
    assert "0 sequences: 1 of 1 recordings were read" in printed
    assert told in printed
    events = SequenceTable.open(out).events()
    assert SequenceTable.open(out).info.redistribution == "none"
    if outcome is None:
        assert len(events) == 0
        return
    assert outcome in events["outcome"].to_pylist()
    assert (outcome == "no_body") == any(events["prime_time"].to_pylist())
    assert main(["explain", events["event_id"][0].as_py(), "--data", str(out)]) == 0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("name = ", "nme = "), "name: expected this key"),
        (('"kitchen"', '"adt"'), "'adt' is a dataset of prbench already"),
        (('"kitchen"', '"The Kitchen"'), "a to z, 0 to 9"),
        (('"none"', '"never"'), "redistribution: expected what is known here: none, non-commercial, yes"),
        (("licence = ", "license = "), "licence: expected this key"),
        (("title = ", "titel = "), "Did you mean 'title'"),
        (("rest_window", "rest_windw"), "Did you mean 'rest_window'"),
    ],
)
def test_a_manifest_that_does_not_fit_is_refused(tmp_path, change, told) -> None:
    file = tmp_path / "kitchen.toml"
    text = (
        'name = "kitchen"\ntitle = "Mine"\nlicence = "mine"\nredistribution = "none"\n[thresholds]\nrest_window = 0.2\n'
    )
    file.write_text(text)
    manifest = read_own_manifest(file)
    assert (manifest.name, manifest.thresholds["rest_window"]) == ("own-kitchen", 0.2)
    assert manifest.thresholds["longest_head_gap"] == load_manifest("own").thresholds["longest_head_gap"]
    file.write_text(text.replace(*change))
    with pytest.raises(InputFileError, match=re.escape(told)):
        read_own_manifest(file)
