from __future__ import annotations

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from prbench.errors import AdapterError, RedistributionError, UsageError
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.future_page import FutureStage, lanes_of, n_frames_of
from prbench_benchmarks.motion_prediction.table import FILE_NAME
from prbench_benchmarks.motion_prediction.view import FuturesRequest, view_futures
from tests.benchmarks.motion_prediction.windows import walking, write


@pytest.fixture(scope="module")
def windows(tmp_path_factory):
    runs = [walking(f"r{n}", 110, number=n, split="train" if n > 1 else "test") for n in range(4)]
    return write(tmp_path_factory.mktemp("windows") / "w", *runs)


@pytest.fixture(scope="module")
def shown(windows, tmp_path_factory):
    out = tmp_path_factory.mktemp("view") / "fan.svg"
    conditions = (Condition.POSE, Condition.POSE_GAZE)
    methods = ("nearest-past",)
    request = FuturesRequest(windows=windows, out=out, methods=methods, conditions=conditions, samples=3)
    return out, view_futures(request).windows


def test_every_predictor_has_a_row_and_says_what_it_scored(shown):
    out, (window,) = shown
    text = out.read_text()
    assert [fan.label for fan in window.fans] == ["nearest-past, pose", "nearest-past, pose+gaze"]
    for fan in window.fans:
        assert f"{fan.label}: 3 futures, {fan.score}" in text
    assert "Synthetic" in text  # "people" may stand in the next line


def test_futures_are_drawn_where_the_body_stands(shown):
    _, (window,) = shown
    for fan in window.fans:
        assert np.linalg.norm(fan.joints[:, 0, 0] - window.observed[-1, 0], axis=-1).max() < 0.2


def test_a_window_is_never_its_own_nearest_past(windows, tmp_path):
    request = FuturesRequest(
        windows=windows, out=tmp_path / "f.svg", methods=("nearest-past",), window_ids=("r2/0/sliding/0",)
    )
    (window,) = view_futures(request).windows
    assert not np.allclose(window.fans[0].joints[0, : len(window.recorded)], window.recorded, atol=1e-4)


def test_all_futures_leave_from_the_observed_body_in_the_player(shown):
    _, (window,) = shown
    nodes = {}

    def add(name, positions=None, **_):
        nodes[name] = SimpleNamespace(points=positions)
        return nodes[name]

    scene = SimpleNamespace(add_frame=add, add_line_segments=add, add_icosphere=add, add_label=add)
    stage = FutureStage(SimpleNamespace(scene=scene), 0, window)  # type: ignore[arg-type]
    bones = len(window.joint_set.bones)
    assert n_frames_of(window) == 75
    stage.set_frame(14)
    futures = nodes["/window_0/fan_0/futures"].points.reshape(3, bones, 2, 3)
    assert np.allclose(futures, nodes["/window_0/fan_0/observed"].points.reshape(1, bones, 2, 3))
    stage.set_frame(74)
    futures = nodes["/window_0/fan_1/futures"].points.reshape(3, bones, 2, 3)
    parents = [parent for parent, _ in window.joint_set.bones]
    down = np.array([0.0, -window.floor, 0.0])
    assert np.allclose(futures[:, :, 0], window.fans[1].joints[:, -1, parents] + lanes_of(window)[1] + down, atol=1e-5)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"out": "fan.mp4"}, "png, .svg or .html"),
        ({"samples": 0}, "one sample"),
        ({"methods": ("a", "b"), "weights": "w"}, "belongs to one method"),
        ({"methods": tuple("abcdefg")}, "at most 6 predictors"),
    ],
)
def test_a_wrong_request_says_what_is_expected(wrong, message):
    given = {"windows": "w", "out": "fan.png", "methods": ("zero-velocity",)} | wrong
    with pytest.raises(UsageError, match=message):
        FuturesRequest(**given)


def test_too_many_rows_are_refused_before_anything_is_predicted(windows, tmp_path):
    methods = ("zero-velocity", "constant-velocity", "nearest-past")
    request = FuturesRequest(windows=windows, out=tmp_path / "f.png", methods=methods, limit=5)
    with pytest.raises(UsageError, match="at most 12 rows"):
        view_futures(request)


def test_recorded_motion_that_a_licence_keeps_is_not_drawn(windows, tmp_path):
    kept = tmp_path / "kept"
    kept.mkdir()
    for path in windows.iterdir():
        (kept / path.name).write_bytes(path.read_bytes())
    info = msgspec.json.decode((kept / FILE_NAME).read_bytes())
    (kept / FILE_NAME).write_bytes(msgspec.json.encode(info | {"redistribution": "none"}))
    with pytest.raises(RedistributionError, match="--permission synthetic-walks"):
        view_futures(FuturesRequest(windows=kept, out=tmp_path / "f.svg", methods=("zero-velocity",)))


def test_weights_that_are_not_there_and_unknown_methods_are_refused(windows, tmp_path):
    out = tmp_path / "f.svg"
    missing = FuturesRequest(windows=windows, out=out, methods=("x",), weights=tmp_path / "w.safetensors")
    with pytest.raises(UsageError, match="found neither"):
        view_futures(missing)
    with pytest.raises(AdapterError, match="Did you mean 'zero-velocity'"):
        view_futures(FuturesRequest(windows=windows, out=out, methods=("zero-velocty",)))
