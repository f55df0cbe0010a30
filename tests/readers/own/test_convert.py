"""Plain recordings out of what other programs wrote."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from prbench.cli import main
from prbench.curation import build_dataset
from prbench.readers import reader_for
from prbench.recording import Recording
from prbench.sequences import SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from tests.shared import made_once

TIMES = np.arange(0, 12, 1 / 30)


def read(folder: Path) -> Recording:
    reader = reader_for("own")
    return reader.read(reader.find(folder)[0])


def converted(capsys: pytest.CaptureFixture, *words: object) -> str:
    assert main(["plain-recording", *map(str, words)]) == 0
    return capsys.readouterr().out


def test_tables_of_any_names_become_a_recording(tmp_path, capsys) -> None:
    # Z up, centimetres, milliseconds; the head (left x, up y, forward z) and the eyes face +y.
    turn = Rotation.from_matrix([[-1, 0, 0], [0, 0, 1], [0, 1, 0]]).as_quat(scalar_first=True)
    about = {"ts": 1000 * TIMES, "x": 10.0 + np.cos(TIMES), "y": 20.0, "z": 160.0}
    pd.DataFrame(about | dict(zip(("qw", "qx", "qy", "qz"), turn))).to_csv(tmp_path / "h.csv", index=False)
    sway = 0.01 * np.sin(TIMES)  # what does not move at all counts as broken
    looks = {"gaze_ms": 1000 * TIMES, "lx": sway, "ly": np.sqrt(1 - sway**2), "lz": 0.0}
    pd.DataFrame(looks).to_parquet(tmp_path / "g.parquet")
    events = {"ts": [6000.0], "action": ["pick"], "object": ["cup"], "x": [10.0], "y": [120.0], "z": [160.0]}
    pd.DataFrame(events).to_csv(tmp_path / "e.csv", index=False)
    names = ["time=ts", "gaze.time=gaze_ms", "dx=lx", "dy=ly", "dz=lz"]
    words = [word for name in names for word in ("--column", name)]
    words += ["--head", tmp_path / "h.csv", "--gaze", tmp_path / "g.parquet", "--events", tmp_path / "e.csv"]
    words += ["--up", "z", "--unit", "cm", "--time-unit", "ms", "--participant", "p07"]
    said = converted(capsys, "csv", *words, "--out", tmp_path / "own" / "kitchen")
    assert "head: 360 rows" in said
    recording = read(tmp_path / "own")
    assert (recording.recording_id, recording.participant_id) == ("kitchen", "p07")
    assert recording.gaze.times == pytest.approx(TIMES)
    assert recording.gaze.origin[0] == pytest.approx([0.11, 1.6, -0.2])
    assert recording.gaze.direction[0] == pytest.approx([0.0, 0.0, -1.0])
    report = build_dataset("own", tmp_path / "own", tmp_path / "table")
    assert [record.status for record in report.records] == ["read"], report.records
    (event,) = SequenceTable.open(tmp_path / "table").events().to_pylist()
    assert event["prime_time"] == 0.0  # looked at all the time
    assert event["outcome"] == "no_body"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--column", "tim=ts"], "--column tim=ts: expected a column of a plain recording and one of the files"),
        (["--column", "time=tss"], "Did you mean 'ts'?"),
        ([], "expected a column 'time'"),
        (["--column", "time=ts", "--column", "dx=word"], "words.csv, line 2"),
    ],
)
def test_what_is_wrong_with_names_is_said(tmp_path, capsys, words, message) -> None:
    path = tmp_path / "words.csv"
    path.write_text("ts,dx,dy,dz,word\n0.0,0,0,1,left\n0.1,0,0,1,right\n")
    assert main(["plain-recording", "csv", "--gaze", str(path), *words, "--out", str(tmp_path / "own")]) != 0
    said = capsys.readouterr().err
    assert message in said or (message == "words.csv, line 2" and "words.csv" in said and "'left'" in said)
    assert not (tmp_path / "own").exists()


def test_a_source_belongs_to_aria_and_rerun_alone(tmp_path, capsys) -> None:
    for words in (["csv", str(tmp_path)], ["aria"], ["rerun"]):
        assert main(["plain-recording", *words, "--out", str(tmp_path / "own")]) == 2
        assert "SOURCE" in capsys.readouterr().err


def test_outputs_of_arias_services_become_the_streams_of_a_reader(tmp_path, capsys) -> None:
    root = made_once("converted-hot3d", lambda place: synthesize_tree("hot3d", place, recordings=1, seed=3, n_events=2))
    reader = reader_for("hot3d")
    found = reader.find(root)[0]
    known = reader.read(found)
    (mps,) = [path for path in found.folder.rglob("mps") if path.is_dir()]
    said = converted(capsys, "aria", mps, "--out", tmp_path / "walk")
    assert "gaze: " in said
    recording = read(tmp_path / "walk")
    assert len(recording.gaze.times) == known.gaze.valid.sum()
    assert recording.gaze.valid.all()
    assert recording.gaze.direction == pytest.approx(known.gaze.direction[known.gaze.valid], abs=1e-9)
    assert recording.gaze.origin == pytest.approx(known.gaze.origin[known.gaze.valid], abs=1e-9)
    query = recording.gaze.times[20:-20:10]
    offset = known.gaze.times[known.gaze.valid][0] - recording.gaze.times[0]  # HOT3D's own clock is another
    position, rotation = recording.head.pose_at(query)
    place, turn = known.head.pose_at(query + offset)
    assert position == pytest.approx(place, abs=1e-3)
    assert np.abs(np.einsum("nk,nk->n", rotation, turn)) == pytest.approx(1.0, abs=1e-5)


def test_a_folder_without_outputs_of_the_services_is_refused(tmp_path, capsys) -> None:
    (tmp_path / "mps").mkdir()
    assert main(["plain-recording", "aria", str(tmp_path / "mps"), "--out", str(tmp_path / "own")]) == 3
    assert "closed_loop_trajectory.csv" in capsys.readouterr().err


def logged(path: Path) -> None:
    """Write a recording of rerun: a head that turns, gaze, a wrist, boxes that move and stand still."""
    rr = pytest.importorskip("rerun", reason="needs the extra rerun")
    stream = getattr(rr, "new_recording", rr.RecordingStream)("test")
    stream.save(path)
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("world/shelf", rr.Boxes3D(centers=[[0, 0, 2]], half_sizes=[[0.1, 0.2, 0.3]]), static=True)
    stream.log("world/cup", rr.Boxes3D(half_sizes=[[0.1, 0.1, 0.1]]), static=True)
    for step in range(30):
        stream.set_time_seconds("t", 10 + step / 30)
        stream.set_time_sequence("frame", step)
        turn = rr.Quaternion(xyzw=Rotation.from_rotvec([0, 0, 0.01 * step]).as_quat())
        stream.log("world/head", rr.Transform3D(translation=[0.1 * step, 0, 1.6], rotation=turn))
        stream.log("world/gaze", rr.Arrows3D(origins=[[0.1 * step, 0, 1.6]], vectors=[[0, 2, 0]] if step else []))
        stream.log("world/left_hand", rr.Points3D([[0.3, 0.1 * step, 1.0]]))
        angle = rr.RotationAxisAngle(axis=[0, 0, 1], radians=0.5)
        stream.log("world/cup", rr.Transform3D(translation=[0, step / 30, 1], rotation=angle))
        stream.log("world/lines/gaze", rr.LineStrips3D([[[0, 0, 1], [0, 0, 4]]]))
    stream.flush()
    stream.disconnect()


def test_a_recording_of_rerun_is_read_back(tmp_path, capsys) -> None:
    path = tmp_path / "walk.rrd"
    logged(path)
    said = converted(capsys, "rerun", path, "--out", tmp_path / "walk")
    assert "head: entity /world/head" in said
    assert "gaze: entity /world/gaze" in said
    recording = read(tmp_path / "walk")
    assert recording.gaze.times == pytest.approx(10 + np.arange(1, 30) / 30, abs=1e-6)  # nothing is seen at first
    assert recording.gaze.origin[2] == pytest.approx([0.3, 1.6, 0.0])  # Z up has become Y up
    assert recording.gaze.direction[2] == pytest.approx([0.0, 0.0, -1.0])
    assert recording.hands[0].points[2, 0] == pytest.approx([0.3, 1.0, -0.2], abs=1e-6)
    cup, shelf = (recording.object(name) for name in ("world.cup", "world.shelf"))
    assert cup.position[15] == pytest.approx([0.0, 1.0, -0.5], abs=1e-6)
    low, high = shelf.world_box(*shelf.pose_at(np.zeros(1)))
    assert (low[0].tolist(), high[0].tolist()) == (pytest.approx([-0.1, 1.7, -0.2]), pytest.approx([0.1, 2.3, 0.2]))
    low, high = cup.world_box(*cup.pose_at(np.array([10.5])))
    side = 0.2 * (np.cos(0.5) + np.sin(0.5))  # of the square around the turned box, seen from above
    assert high[0] - low[0] == pytest.approx([side, 0.2, side], abs=1e-6)


def test_entities_of_rerun_are_named_or_listed(tmp_path, capsys) -> None:
    path = tmp_path / "walk.rrd"
    logged(path)
    converted(capsys, "rerun", path, "--column", "gaze=world/lines/gaze", "--out", tmp_path / "walk")
    assert read(tmp_path / "walk").gaze.direction[0] == pytest.approx([0.0, 1.0, 0.0])
    for column, message in (("gaze=eye", "There are: / (View"), ("timeline=frame", "'frame' of times, found")):
        words = ["plain-recording", "rerun", str(path), "--column", column, "--out", str(tmp_path / "other")]
        assert main(words) == 3
        assert message in capsys.readouterr().err
