"""Runs of the benchmark of three points: scores, resuming, refusals, a board, and the study's tables."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from prbench.cli.main import main
from prbench.errors import AdapterError, UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import RunFolder, read_scores
from prbench.protocol.published import printed_rows
from prbench_benchmarks.three_points.batch import Bodies, Condition, ask
from prbench_benchmarks.three_points.standing import Standing
from prbench_benchmarks.three_points.table import GIVEN, TracksTable, tracked_batch
from tests.benchmarks.three_points.test_tracks import build
from tests.harness.test_run import reproducible_bytes
from tests.shared import made_once


@pytest.fixture(scope="module")
def tracks():
    return made_once("tracks-synthetic", build)


def run(tracks, out, *more, condition="head+wrists"):
    given = ["--benchmark", "three-points", "--method", "standing", "--condition", condition, "--split", "train"]
    return main(["run", *given, "--data", str(tracks), "--out", str(out), *more])


def scores_of(folder):
    return RunFolder.open(folder, any_benchmark=True).dataset("synthetic-nymeria-suit").scores


@pytest.fixture(scope="module")
def runs(tracks):
    def make(path):
        for condition in Condition:
            assert run(tracks, path / condition.value, condition=condition.value) == 0

    return made_once("tracks-runs", make)


def test_wrists_are_met_where_they_are_known_and_only_there(runs):
    scores = {each: read_scores(scores_of(runs / each.value)).to_pylist() for each in Condition}
    means = {
        each: {
            name: np.mean([row["value"] for row in rows if row["metric"] == name]) for name in ("mpjpe", "mpjpe_hands")
        }
        for each, rows in scores.items()
    }
    assert means[Condition.HEAD_WRISTS]["mpjpe_hands"] < 1.0 < means[Condition.HEAD]["mpjpe_hands"]
    assert means[Condition.HEAD_WRISTS]["mpjpe"] < means[Condition.HEAD]["mpjpe"] < 40.0


def test_a_run_resumes_and_neither_workers_nor_interruption_leave_a_trace(runs, tracks, tmp_path):
    again = tmp_path / "again"
    assert run(tracks, again, "--batch-size", "8", "--workers", "2") == 0
    assert reproducible_bytes(again) == reproducible_bytes(runs / "head+wrists")
    scores_of(again).unlink()
    assert run(tracks, again) == 0
    assert reproducible_bytes(again) == reproducible_bytes(runs / "head+wrists")


def test_each_body_depends_on_its_own_track_alone(tracks):
    chunk = next(TracksTable.open(tracks).chunks(rows=4, columns=GIVEN))
    batch = tracked_batch(chunk, Condition.HEAD_WRISTS)
    whole = ask(Standing(), batch, seed=0).joints
    alone = ask(Standing(), batch.rows(1, 2), seed=5).joints[0]
    n = int(batch.n_frames[1])
    assert np.array_equal(whole[1, :n], alone[:n])
    head = alone[:n, 15] - batch.position[1, :n, 0]
    assert np.abs(head).max() < 1e-5


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (np.zeros(3), "expected prbench_benchmarks.three_points.batch.Bodies, found ndarray"),
        (Bodies(joints=np.zeros((1, 2, 22, 3))), "expected joints of shape"),
        (None, "found NaN or infinity"),
    ],
)
def test_an_answer_that_is_none_is_refused(tracks, answer, said):
    batch = tracked_batch(next(TracksTable.open(tracks).chunks(rows=1, columns=GIVEN)), Condition.HEAD)

    class Wrong(Standing):
        def track(self, batch, *, seed):
            return Bodies(joints=np.full((*batch.position.shape[:2], 22, 3), np.nan)) if answer is None else answer

    with pytest.raises(AdapterError, match=said):
        ask(Wrong(), batch, seed=0)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"samples": 2}, "--samples"),
        ({"isolate": True}, "--isolate"),
        ({"method": "cmd:python track.py"}, "--method cmd"),
        ({"method": "ground-truth"}, "--method ground-truth"),
        ({"split": "test", "sequences": ("n00003/synthetic/00000000",)}, "expected a case of split 'test'"),
    ],
)
def test_what_the_benchmark_does_not_have_is_refused_by_name(tracks, given, said):
    asked = {"method": "standing", "data": (tracks,), "condition": "head", "batch_size": 8, "samples": 1} | given
    with pytest.raises(UsageError, match=said):
        run_method(RunRequest(benchmark="three-points", **asked))


def test_an_edited_table_is_refused(tracks, tmp_path, capsys):
    shutil.copytree(tracks, tmp_path / "t")
    info = json.loads((tmp_path / "t" / "tracks.json").read_text())
    info["counts"]["tracks"] = 9
    (tmp_path / "t" / "tracks.json").write_text(json.dumps(info))
    assert run(tmp_path / "t", tmp_path / "r") == 4
    assert "counts.tracks: expected 5" in capsys.readouterr().err


def test_runs_stand_on_a_board_and_beside_the_printed_rows(runs, tracks, tmp_path, capsys):
    assert main(["leaderboard", "export", str(runs / "head"), "--data", str(tracks), "--format", "csv"]) == 0
    shown = capsys.readouterr()
    assert "mpjpe_hands" in shown.out
    assert "unverified" not in shown.err
    out = tmp_path / "study.csv"
    assert main(["study", "three-points", str(runs), "--with-published", "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "measured" in shown
    assert "printed in Table 4 of Nymeria" in shown
    lines = out.read_text().splitlines()
    assert sum("standing" in line for line in lines) == 2 * 6
    assert sum("published: Nymeria, Table 3" in line for line in lines) == 15
    assert RunFolder.open(runs / "head", any_benchmark=True).record.benchmark == "three-points"
    assert load_benchmark("three-points").recording_key("a/b/real/00000000") == "a/b"


def test_the_printed_share_of_the_lower_body_is_impossible_in_one_row_alone():
    """Mean = share * lower + (1 - share) * upper, with 8 of 22 joints in the one and the pelvis in neither."""
    shares = {}
    for row in printed_rows("prbench_benchmarks.three_points.published", "tables"):
        key = (row["table"], row["dataset"], row["method"], row["devices"])
        shares.setdefault(key, {})[row["metric"]] = float(row["value"])
    for key, row in shares.items():
        share = (row["mpjpe"] - row["mpjpe_upper"]) / (row["mpjpe_lower"] - row["mpjpe_upper"])
        odd = key[1:3] == ("Nymeria", "BoDiffusion")
        assert (share < 0.3) is odd, key


def test_commands_that_it_does_not_have_say_so(runs, tracks, tmp_path, capsys):
    asked = ["--benchmark", "three-points", "--data", str(tracks), "--condition", "head", "--out", str(tmp_path / "c")]
    assert main(["export-conditions", *asked]) == 2
    assert "three-points does not have files of conditions" in capsys.readouterr().err
    assert main(["view", str(runs / "head"), "--data", str(tracks), "--out", str(tmp_path / "v.png")]) == 2
    assert "three-points does not have pictures" in capsys.readouterr().err
