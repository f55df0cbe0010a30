"""Synthesize and build: what the commands write, and what became of each recording."""

from __future__ import annotations

import pandas as pd
import pytest

import prbench
from prbench.sequences import DatasetInfo


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> prbench.SyntheticRecordings:
    folder = tmp_path_factory.mktemp("building")
    return prbench.synthesize("adt", str(folder / "recordings"), count=2, seed=3, events=4)


@pytest.fixture(scope="module")
def build(recordings, tmp_path_factory) -> prbench.Build:
    return prbench.build_dataset("adt", recordings.folder, tmp_path_factory.mktemp("built") / "table")


def test_synthetic_recordings_tell_what_was_written(recordings):
    frame = recordings.to_pandas()
    assert len(frame) == 2
    assert frame.n_events.tolist() == [4, 4]
    assert all((recordings.folder / name).is_dir() for name in frame.recording_id)
    assert len(recordings.summary.splitlines()) == 2
    assert "<table" in recordings._repr_html_()
    assert "2 synthetic recordings" in repr(recordings)


def test_a_build_tells_what_became_of_everything(build):
    info = DatasetInfo.read(build.folder)
    frame = build.to_pandas()
    assert list(frame) == ["stage", "kept", "dropped", "why"]
    kept = dict(zip(frame.stage, frame.kept, strict=True))
    assert kept["recordings read"] == 2
    assert kept["sequences"] == info.counts.sequences == len(build.table)
    assert build.unread == {}
    assert build.summary.splitlines()[-1].startswith(f"sequences: {info.counts.sequences}")
    assert "from files to sequences" in build._repr_html_()
    assert str(build.folder) in repr(build)


def test_options_are_those_of_the_command(recordings, tmp_path):
    name = recordings.to_pandas().recording_id[1]
    one = prbench.build_dataset(
        "adt",
        str(recordings.folder),
        str(tmp_path / "table"),
        recordings=f"*{name[-12:]}",
        in_hand="wrist",
        ray_origin="camera",
        minimum_movement="pelvis_displacement",
        on_error="fail",
    )
    assert one.table.recordings.to_pandas().recording_id.tolist() == [name]
    options = one.table.info.options
    assert options["in_hand_rule"] == "wrist"
    assert options["ray_origin"] == "camera"
    assert options["minimum_movement"] == "pelvis_displacement"
    assert isinstance(one.table.to_pandas(), pd.DataFrame)


def test_a_damaged_recording_is_named(tmp_path):
    written = prbench.synthesize("adt", tmp_path / "recordings", count=2, events=3)
    first = written.to_pandas().recording_id[0]
    (written.folder / first / "aria_trajectory.csv").unlink()
    build = prbench.build_dataset("adt", written.folder, tmp_path / "table")
    assert list(build.unread) == [first]
    assert first in build._repr_html_()
    assert [note for note in build.notes if note.startswith(f"{first}: failed: ")]


def test_a_build_notes_what_the_command_notes(tmp_path):
    written = prbench.synthesize("adt", tmp_path / "recordings", count=1, events=3)
    name = written.to_pandas().recording_id[0]
    gaze = written.folder / name / "eyegaze.csv"
    lines = gaze.read_text(encoding="utf-8").splitlines(keepends=True)
    gaze.write_text("".join(lines[:40]), encoding="utf-8")  # a second of gaze, and whole lines
    build = prbench.build_dataset("adt", written.folder, tmp_path / "table")
    assert build.unread == {}
    assert [note for note in build.notes if note.startswith(f"{name}: cut short: ")]
    assert [note for note in build.notes if note.startswith(f"{name}: no sequence: of ")]
    assert len(build.table) == 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dataset": "adtt"}, "adtt"),
        ({"dataset": "all"}, "'all' builds several tables"),
        ({"root": "nowhere"}, "nowhere"),
        ({"max_recordings": 0}, "max_recordings: expected a whole number of at least 1, found '0'"),
        ({"minimum_movement": "steps"}, "unknown minimum movement 'steps'"),
        ({"priming": "published"}, "publishes no priming of its own"),
        ({"on_error": "stop"}, "on_error: expected skip or fail, found 'stop'"),
        ({"option": {"nonsense": True}}, "nonsense"),
        ({"option": ["nonsense=1"]}, "option: expected a dict"),
    ],
)
def test_a_build_that_cannot_be_is_refused(recordings, tmp_path, changes, message):
    arguments = {"dataset": "adt", "root": recordings.folder, "out": tmp_path / "table"} | changes
    with pytest.raises(prbench.PrbenchError, match=message):
        prbench.build_dataset(**arguments)
    assert not (tmp_path / "table").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"layout": "adtt"}, "adtt"),
        ({"size": "huge"}, "huge"),
        ({"count": 0}, "count: expected a whole number"),
    ],
)
def test_recordings_that_cannot_be_are_refused(tmp_path, changes, message):
    with pytest.raises(prbench.PrbenchError, match=message):
        prbench.synthesize(**({"layout": "adt", "out": tmp_path / "recordings"} | changes))
