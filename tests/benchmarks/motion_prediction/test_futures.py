from __future__ import annotations

import msgspec
import numpy as np
import pytest

from prbench.cli.main import main
from prbench.errors import RedistributionError, RunError, UsageError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.viewing.view import ViewRequest, view
from prbench_benchmarks.motion_prediction.table import FILE_NAME, WindowsTable
from tests.benchmarks.motion_prediction.windows import walking, write


@pytest.fixture(scope="module")
def windows(tmp_path_factory):
    runs = [walking(f"r{n}", 125, number=n, split="train" if n > 1 else "test") for n in range(4)]
    return write(tmp_path_factory.mktemp("windows") / "w", *runs)


@pytest.fixture(scope="module")
def runs(windows, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for condition in ("pose", "pose+gaze"):
        asked = {"benchmark": "motion-prediction", "condition": condition, "samples": 3}
        out = folder / condition
        run_method(RunRequest(method="nearest-past", data=(windows,), out=out, **asked))  # type: ignore[arg-type]
    return folder / "pose", folder / "pose+gaze"


@pytest.fixture(scope="module")
def shown(windows, runs, tmp_path_factory):
    out = tmp_path_factory.mktemp("view") / "fan.svg"
    return out, view(ViewRequest(runs=runs, data=(windows,), out=out, limit=1)).scenes


def test_every_run_has_a_row_and_says_what_it_scored(shown):
    out, (window,) = shown
    text = out.read_text()
    assert [fan.label for fan in window.motions] == ["nearest-past, pose", "nearest-past, pose+gaze"]
    for fan in window.motions:
        assert f"{fan.label}: 3 futures, {fan.score}" in text
    assert "Synthetic" in text  # "people" may stand in the next line


def test_futures_are_drawn_where_the_body_stands(shown):
    _, (window,) = shown
    for fan in window.motions:
        assert np.linalg.norm(fan.joints[:, 0, 0] - window.observed[-1, 0], axis=-1).max() < 0.2


def test_the_command_tells_the_scores_of_one_window(windows, runs, tmp_path, capsys):
    name = WindowsTable.open(windows).windows["window_id"].to_pylist()[0]
    out = tmp_path / "f.png"
    assert main(["view", str(runs[0]), "--data", str(windows), "--sequence", name, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"{name}: Synthetic people.\n  nearest-past, pose: ADE " in said
    assert out.is_file()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"out": "fan.mp4"}, ".svg"),
        ({"sample": 1}, "no --sample"),
        ({"data": ()}, "one --data DIR"),
        ({"limit": 7}, "1 to 12 rows"),
    ],
)
def test_a_wrong_request_says_what_is_expected(wrong, message, windows, runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=message):
        view(ViewRequest(**({"runs": runs, "data": (windows,), "out": "fan.png"} | wrong)))


def test_recorded_motion_that_a_licence_keeps_is_not_drawn(windows, runs, tmp_path):
    kept = tmp_path / "kept"
    kept.mkdir()
    for path in windows.iterdir():
        (kept / path.name).write_bytes(path.read_bytes())
    info = msgspec.json.decode((kept / FILE_NAME).read_bytes())
    (kept / FILE_NAME).write_bytes(msgspec.json.encode(info | {"redistribution": "none"}))
    with pytest.raises(RedistributionError, match="--permission synthetic-walks"):
        view(ViewRequest(runs=runs, data=(kept,), out=tmp_path / "f.svg"))


def test_a_run_on_other_windows_is_refused(runs, tmp_path):
    other = write(tmp_path / "w", walking("a", 110))
    with pytest.raises(RunError, match="other windows"):
        view(ViewRequest(runs=runs, data=(other,), out=tmp_path / "f.svg"))
