"""Predictors that run elsewhere: windows out, futures in, and the scores of a run."""

from __future__ import annotations

import json

import numpy as np
import pytest

from prbench.cli import main
from prbench.errors import InputFileError, PredictionsError, RedistributionError, UsageError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench_benchmarks.motion_prediction.offline import export_windows, read_windows, score_futures
from prbench_benchmarks.motion_prediction.predictors import ConstantVelocity
from tests.benchmarks.motion_prediction.windows import walking, write

K = 5


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return write(tmp_path_factory.mktemp("w") / "table", walking("a", 150), walking("b", 135, number=2))


@pytest.fixture(scope="module")
def exported(table, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "windows.npz"
    export_windows(data=(table,), condition="pose+gaze", out=out, samples=K)
    return out


@pytest.fixture
def answer(exported, tmp_path):
    """Write a file of futures; ``change`` may spoil its arrays."""

    def write_futures(change=None, name: str = "mine.npz"):
        with np.load(exported) as given:  # as a stranger reads it, with NumPy alone
            ids = given["opaque_id"]
        _, batch = read_windows(exported)
        joints = ConstantVelocity().predict(batch, n_samples=K, seed=0).joints
        arrays = {"opaque_id": ids[::-1].copy(), "joints": joints[::-1].copy()}
        if change is not None:
            change(arrays)
        np.savez(tmp_path / name, **arrays)
        return tmp_path / name

    return write_futures


def score(futures, exported, table, **changes):
    return score_futures(futures, exported, (table,), **changes)


def test_futures_of_a_file_score_as_in_a_run(table, exported, answer, tmp_path):
    asked = RunRequest(
        benchmark="motion-prediction",
        method="constant-velocity",
        condition="pose+gaze",
        data=(table,),
        samples=K,
        batch_size=16,
        out=tmp_path / "run",
    )
    expected = {each.metric: (each.mean, each.low) for each in run_method(asked).summaries[0].metrics}
    summary, _ = score(answer(), exported, table, out=tmp_path / "scores")
    assert {each.metric: (each.mean, each.low) for each in summary.metrics} == expected
    stored = [next((tmp_path / name).rglob("scores.parquet")).read_bytes() for name in ("run", "scores")]
    assert stored[0] == stored[1]
    record = json.loads((tmp_path / "scores" / "run.json").read_text())
    assert (record["method"]["kind"], record["method"]["name"], record["device"]) == ("file", "mine", "offline")


def test_the_file_names_neither_data_nor_future(exported, table):
    with np.load(exported) as arrays:
        assert set(arrays) == {"prbench_windows", "opaque_id", "key", "observed_joints", "gaze", "gaze_valid"}
        text = str(arrays["prbench_windows"])
        assert arrays["observed_joints"].shape[1:] == (15, 22, 3)
        assert list(arrays["opaque_id"]) == sorted(arrays["opaque_id"])
    assert not any(word in text for word in ("walks", str(table), "sliding"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.update(joints=a["joints"][:, :, 1:]), r"mine\.npz: expected futures of shape"),
        (lambda a: a["joints"].__setitem__((0, 0, 0, 0, 0), np.nan), "expected finite positions"),
        (lambda a: a["opaque_id"].__setitem__(0, "0" * 16), "missing 1 .*unknown 1 "),
        (lambda a: a["opaque_id"].__setitem__(0, a["opaque_id"][1]), "repeated 1 "),
        (lambda a: a.pop("joints"), "expected an array 'joints'"),
    ],
)
def test_what_is_wrong_with_futures_is_told(table, exported, answer, change, message):
    with pytest.raises(PredictionsError, match=message):
        score(answer(change), exported, table)


def test_the_windows_must_be_those_of_the_table(table, exported, answer, tmp_path):
    other = write(tmp_path / "other", walking("c", 150))
    with pytest.raises(PredictionsError, match="found those of another table"):
        score(answer(), exported, other)
    with np.load(exported) as given:
        arrays = dict(given)
    arrays["observed_joints"] = arrays["observed_joints"] + np.float32(0.001)
    np.savez(tmp_path / "changed.npz", **arrays)
    with pytest.raises(PredictionsError, match="The file was changed"):
        score(answer(), tmp_path / "changed.npz", table)
    with pytest.raises(InputFileError, match="a file of windows"):
        score(answer(), answer(), table)


def test_names_and_formats_are_refused(table, exported, answer, tmp_path):
    with pytest.raises(UsageError, match="method of prbench itself"):
        score(answer(name="humanmac.npz"), exported, table)
    with pytest.raises(UsageError, match=r"ends in \.npz"):
        export_windows(data=(table,), condition="pose", out=tmp_path / "w.parquet")
    with pytest.raises(UsageError, match="found 2"):
        export_windows(data=(table, table), condition="pose", out=tmp_path / "w.npz")


def test_the_commands_go_round(table, answer, tmp_path, capsys):
    out = tmp_path / "windows.npz"
    given = ["--benchmark", "motion-prediction", "--data", str(table)]
    assert main(["export-conditions", *given, "--condition", "pose+gaze", "--samples", "5", "--out", str(out)]) == 0
    assert "windows" in capsys.readouterr().out
    assert main(["score", str(answer()), *given, "--conditions", str(out), "--out", str(tmp_path / "scores")]) == 0
    printed = capsys.readouterr().out
    assert " ADE " in printed
    assert "Bone" not in printed, "the others wait behind --all"
    assert main(["leaderboard", "export", str(tmp_path / "scores"), "--out", str(tmp_path / "board")]) == 0
    capsys.readouterr()
    assert main(["score", str(answer()), *given]) == 2
    assert "--conditions FILE" in capsys.readouterr().err
    assert main(["export-conditions", *given, "--condition", "goal-loc", "--out", str(out)]) == 2
    assert "expected one of the benchmark motion-prediction" in capsys.readouterr().err


def test_terms_that_keep_recordings_are_kept(monkeypatch, table, tmp_path):
    monkeypatch.setattr("prbench.sequences.dataset_info._known", lambda _terms: "none")
    with pytest.raises(RedistributionError):
        export_windows(data=(table,), condition="pose", out=tmp_path / "w.npz")
