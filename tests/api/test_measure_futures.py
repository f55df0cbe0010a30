"""`prbench.measure_futures`: the scores that a run has of a window, and arrays that are refused."""

from __future__ import annotations

import numpy as np
import pytest

import prbench
from prbench.harness.benchmark import load_benchmark
from prbench.harness.run_folder import RunFolder, read_scores
from prbench.harness.run_folder.predictions import read_part
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.scoring import SimilarPasts
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.benchmarks.motion_prediction.windows import walking, write
from tests.fakes import STANDING

RECORDED = STANDING + 0.02 * np.arange(60)[:, None, None] * np.array([0.0, 0.0, 1.0])
PREDICTED = np.stack([RECORDED + 0.1, RECORDED - 0.2])


def test_the_scores_are_those_of_a_run_on_the_window(tmp_path):
    folder = write(tmp_path / "windows", walking("a", 150), walking("c", 150, split="train", number=1))
    out = tmp_path / "run"
    prbench.run("nearest-past", benchmark="motion-prediction", condition="pose", data=folder, samples=5, out=out)
    table = WindowsTable.open(folder)
    batch, truth = next(table.batches(Condition.POSE, table.chosen(split="test")))
    window = 2
    name = truth.window_ids[window]
    run = RunFolder.open(out, any_benchmark=True)
    files = run.dataset(run.record.tables[0].dataset)
    predicted = read_part(files.part(0), truth.window_ids, samples=5, joints=22)[window]
    # Batches come in the frame of each window's last pose, in which the canonical variant of MMADE compares futures.
    rules = load_prediction_protocol().evaluation
    similar = SimilarPasts.of(table, table.chosen(split="test"), closer_than=rules.similar_past)
    place = similar.places[name]
    others = [each for each in similar.canonical_sets[place] if each != place]
    assert others
    measures = prbench.measure_futures(
        predicted,
        truth.joints[window],
        last_observed=batch.observed_joints[window, -1],
        fps=30,
        similar_futures=truth.joints[others],
    )
    scores = read_scores(files.scores).to_pylist()
    expected = {row["metric"]: row["value"] for row in scores if row["sequence_id"] == name}
    for metric in ("mmade", "mmfde", "similar_pasts"):
        expected[metric] = expected.pop(f"{metric}_canonical")
    assert dict(measures) == pytest.approx(expected, abs=1e-5)
    assert measures["ade"] == expected["ade"]
    assert measures.left_out == {"wrist_to_goal": "needs goal", "pelvis_at_event": "needs goal"}


def test_what_is_not_given_is_left_out_and_text_shows_the_main_metrics():
    measures = prbench.measure_futures(PREDICTED, RECORDED, goal=RECORDED[-1, 20])
    at_event = {name: value / np.sqrt(3) for name, value in measures.items() if "_to_goal" in name or "_at_" in name}
    assert at_event == pytest.approx(
        {
            "wrist_to_goal": 0.1,
            "wrist_to_goal_mean": 0.15,
            "wrist_to_goal_recorded": 0.0,
            "pelvis_at_event": 0.1,
            "pelvis_at_event_mean": 0.15,
        }
    )
    assert measures["mpjpe"] == pytest.approx(0.1 * np.sqrt(3))
    assert measures.left_out["ade@0.5s"] == "needs fps"
    assert measures.left_out["bone_error_percent"] == "needs last_observed"
    assert "MMADE left out: needs similar_futures" in repr(measures)
    assert "joint/" not in repr(measures)
    assert set(measures) <= {info.id for info in load_benchmark("motion-prediction").metrics}


def test_horizons_end_with_their_frame():
    drifting = (RECORDED + 0.01 * np.arange(1, 61)[:, None, None] * np.array([1.0, 0.0, 0.0]))[None]
    measures = prbench.measure_futures(drifting, RECORDED, fps=30)
    for seconds, frames in ((0.5, 15), (1, 30), (2, 60)):
        assert measures[f"fde@{seconds}s"] == pytest.approx(0.01 * frames * np.sqrt(22))
        assert measures[f"ade@{seconds}s"] == pytest.approx(0.01 * (frames + 1) / 2 * np.sqrt(22))


NAN = np.where(np.arange(60)[:, None, None] == 7, np.nan, RECORDED)


@pytest.mark.parametrize(
    ("predicted", "recorded", "given", "message"),
    [
        (PREDICTED[0], RECORDED, {}, r"predicted: expected \(k, 60, 22, 3\), .* found the shape \(60, 22, 3\)"),
        (PREDICTED[:, :50], RECORDED, {}, r"found the shape \(2, 50, 22, 3\)"),
        (PREDICTED, RECORDED[0], {}, r"recorded: expected \(frames, joints, 3\), found the shape \(22, 3\)"),
        (PREDICTED[:, :, :19], RECORDED[:, :19], {}, r"expected 21 \(mogaze21\), 22 .* joints, found 19"),
        (1000 * PREDICTED, 1000 * RECORDED, {}, "predicted: .* positions are in millimetres. Multiply .* by 0.001"),
        (PREDICTED, 1000 * RECORDED, {}, "recorded: .* positions are in millimetres"),
        (np.stack([NAN, RECORDED]), RECORDED, {}, r"predicted\[0, 7, 0, 0\]: expected finite positions, found nan"),
        (PREDICTED, RECORDED, {"goal": [0.0, 1.0]}, r"goal: expected the shape \(3\), found \(2,\)"),
        (PREDICTED, RECORDED, {"similar_futures": RECORDED}, r"similar_futures: expected the shape \(m, 60, 22, 3\)"),
        (PREDICTED, RECORDED, {"fps": 0}, "fps: expected frames per second above 0, found 0"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(predicted, recorded, given, message):
    with pytest.raises(prbench.PrbenchError, match=message):
        prbench.measure_futures(predicted, recorded, **given)
