"""From predictions and a table to the long form: against the same metrics called by hand, sequence by sequence."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.engine import InProcess
from prbench.errors import PredictionsError
from prbench.harness import planning
from prbench.harness.conditions import derangement
from prbench.harness.planning import select
from prbench.harness.run import run_method
from prbench.harness.run_folder import Predictions, read_scores
from prbench.harness.scoring import ScoringRules, score_selection
from prbench.metrics import GAZE_METRICS, METRICS_OF_MOTIONS, GazeRays, MotionBatch, ScoringTargets
from prbench.metrics import score as score_by_hand
from prbench.protocol.manifests import load_protocol
from tests.fakes import fake_sequence
from tests.harness.test_run import request
from tests.method_fixtures import adapter_source

SIDES = {"left": 0, "right": 1, None: -1}


def by_hand(name: str, predicted: np.ndarray, *, gaze: bool = False) -> dict[str, float]:
    row = fake_sequence(int(name.split("/obj")[1].split("/")[0]))
    assert row.sequence_id == name
    rays = GazeRays(row.gaze_origin.astype(np.float64), row.gaze_direction, row.gaze_valid) if gaze else None
    targets = ScoringTargets(
        goal_location=row.goal_location[None],
        prime_time=np.array([row.prime_time - row.start_time]),
        hand=np.array([SIDES[row.hand]]),
        head_tilt_deg=np.array([row.head_tilt_deg]),
        fps=row.fps,
        gaze=rays,
    )
    pair = MotionBatch.from_motions([predicted]), MotionBatch.from_motions([row.joints])
    values = score_by_hand(*pair, targets, load_protocol().metrics)
    return {metric: float(column.value[0]) for metric, column in values.items()}


@pytest.mark.parametrize("method", ["ground-truth", "scripted", "made"])
def test_scores_equal_those_of_each_sequence_by_hand(table, tmp_path, monkeypatch, install, method):
    install("made", adapter_source())
    monkeypatch.setattr(planning, "WINDOW", 6)
    run_method(request(table, tmp_path / "out", method))
    predictions = Predictions.open(tmp_path / "out/synthetic-adt/predictions")
    found: dict[str, dict[str, float]] = {}
    for row in read_scores(tmp_path / "out/synthetic-adt/scores.parquet").to_pylist():
        found.setdefault(row["sequence_id"], {})[row["metric"]] = row["value"]
    assert len(found) == 15
    for name, values in found.items():
        assert values == by_hand(name, predictions.motions([name], 0).values, gaze=method == "ground-truth")


def test_recorded_motion_is_scored_against_the_goals_that_were_dealt(table, tmp_path, monkeypatch):
    monkeypatch.setattr(planning, "WINDOW", 6)
    run_method(request(table, tmp_path / "out", "ground-truth", control="shuffled-goal", seed=2))
    selection = select(table, split="test", limit=None)
    order = derangement(selection, seed=2)
    sequences = [fake_sequence(int(name.split("/obj")[1].split("/")[0])) for name in selection.sequence_ids]
    rows = read_scores(tmp_path / "out/synthetic-adt/scores.parquet").to_pylist()
    reached = {row["sequence_id"]: row["value"] for row in rows if row["metric"] == "reach_success"}
    for row, other in zip(sequences, order):
        distance = np.linalg.norm(row.joints[:, [20, 21]] - sequences[other].goal_location, axis=-1).min()
        assert reached[row.sequence_id] == float(distance <= 0.1)


def test_motions_at_the_tables_rate_are_not_scored_as_motions_at_half_of_it(table, tmp_path):
    run_method(request(table, tmp_path / "out", "ground-truth"))
    selection = select(table, split="test", limit=None)
    fps = fake_sequence(0).fps
    rules = ScoringRules(load_protocol().metrics, native_fps=fps / 2)
    found = score_selection(
        selection, tmp_path / "out/synthetic-adt/predictions", samples=[0], rules=rules, engine=InProcess()
    )
    with pytest.raises(PredictionsError, match=f"motions at {fps:g} frames per second where {fps / 2:g} are asked for"):
        list(found)


def test_flags_of_single_sequences_reach_scores_and_summary(table, tmp_path):
    report = run_method(request(table, tmp_path / "out", "ground-truth"))
    rows = read_scores(tmp_path / "out/synthetic-adt/scores.parquet").to_pylist()
    for metric in report.summaries[0].metrics:
        flagged = [
            flag for row in rows if row["metric"] == metric.metric and row["flag"] for flag in row["flag"].split(";")
        ]
        assert metric.flags == {flag: flagged.count(flag) for flag in set(flagged)}
    wanted = {*GAZE_METRICS, *(info.id for info in METRICS_OF_MOTIONS)}
    assert {row["metric"] for row in rows} == wanted
