"""A recording of rerun, read back with rerun: where the joints, the gaze, the goal and the sensors are, and when."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.geometry.skeleton import BONES
from prbench.sequences import SequenceTable
from prbench.viewing.exporting.export import ExportRequest, export_motion
from prbench.viewing.exporting.rrd import TIMELINE, write
from tests.viewing.replay.scenes import a_scene
from tests.viewing.test_review import made

# With version 0.22, which the official reader of Aria asks for; 0.41 reads in another way.
rerun = pytest.importorskip("rerun", reason="rerun-sdk is not installed (pip install 'prbench[rerun]')")
frames = pytest.importorskip("rerun.dataframe", reason="this version of rerun-sdk has no rerun.dataframe")


def _read(path, entity: str, column: str) -> tuple[np.ndarray, list]:
    """Times, seconds, and values of one component."""
    view = frames.load_recording(str(path)).view(index=TIMELINE, contents=f"/{entity}")
    found = view.select(columns=[TIMELINE, f"/{entity}:{column}"]).read_all()
    times = found[0].to_numpy().astype("timedelta64[ns]").astype(float) / 1e9
    return times, found[1].to_pylist()


def test_joints_gaze_goal_and_moments_are_where_the_scene_has_them(tmp_path):
    scene = a_scene("a method, goal-loc", with_eyes=True)
    request = ExportRequest(form="rrd", data=(tmp_path,), out=tmp_path / "a.rrd")
    write(scene, request.out, {"licence": "ours"}, request)
    for entity, motion in zip(("ground_truth", "a_method_goal_loc"), scene.motions, strict=True):
        times, places = _read(tmp_path / "a.rrd", f"{entity}/joints", "Position3D")
        np.testing.assert_allclose(times, scene.times, atol=1e-6)
        np.testing.assert_allclose(places, motion.joints, atol=1e-5)
        _, strips = _read(tmp_path / "a.rrd", f"{entity}/bones", "LineStrip3D")
        np.testing.assert_allclose(strips[0], motion.joints[0][np.array(BONES)], atol=1e-5)
    _, looks = _read(tmp_path / "a.rrd", "a_method_goal_loc/gaze", "LineStrip3D")
    np.testing.assert_allclose(looks[3][0][0], scene.motions[1].gaze.origin[3], atol=1e-5)
    times, moments = _read(tmp_path / "a.rrd", "moments", "Text")
    assert [(text, time) for (text,), time in zip(moments, times)] == [
        ("prime", pytest.approx(scene.prime_time)),
        (scene.action, pytest.approx(scene.event_time)),
    ]
    view = frames.load_recording(str(tmp_path / "a.rrd")).view(index=TIMELINE, contents="/**")
    static = view.select_static().read_all().to_pydict()
    assert json.loads(static["/about:Text"][0][0]) == {"licence": "ours"}
    np.testing.assert_allclose(static["/goal/location:Position3D"][0], [scene.goal.location], atol=1e-5)


def test_the_streams_of_the_recording_stand_beside_the_motion(tmp_path):
    place = made("adt")
    table = SequenceTable.open(place / "table")
    name = table.scalars()["sequence_id"].to_pylist()[0]
    request = ExportRequest(
        form="rrd", data=(place / "table",), sequences=(name,), recordings=place / "raw", out=tmp_path / "a.rrd"
    )
    export_motion(request)
    chunk = next(table.chunks(ids=frozenset({name})))
    times, places = _read(tmp_path / "a.rrd", "recording/body", "Position3D")
    # The table's frames lie between the samples of the suit.
    moved = np.interp(np.arange(chunk.n_frames[0]) / 20, times, [pose[21][0] for pose in places])
    np.testing.assert_allclose(moved, chunk.joints[:, 21, 0], atol=0.01)
    times, looks = _read(tmp_path / "a.rrd", "recording/gaze", "LineStrip3D")
    assert times.min() >= 0
    assert len(looks) > 10
    other = replace(request, recordings=place / "table", out=tmp_path / "b.rrd")
    with pytest.raises(InputFileError, match="expected"):
        export_motion(other)
    assert not (tmp_path / "b.rrd").exists()
