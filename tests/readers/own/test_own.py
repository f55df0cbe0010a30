"""Plain recordings of every unit and axis build the tables of the recordings that they were made from."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.cli import main
from prbench.readers import reader_for
from prbench.readers.own import format as own
from prbench.recording import Recording
from prbench.sequences import SequenceTable
from tests.readers.own.plain import METRES, TREES, tree, write_plain
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
