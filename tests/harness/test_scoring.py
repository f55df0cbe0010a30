"""Motions are scored window by window as by hand; generated gaze is scored beside the head and never ranked."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.board import collect_runs, export, make_leaderboard
from prbench.cli import main
from prbench.contract import Condition
from prbench.engine import InProcess
from prbench.errors import PredictionsError
from prbench.harness import planning
from prbench.harness.conditions import derangement
from prbench.harness.planning import select
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import Predictions
from prbench.harness.run_folder.record import RunRecord
from prbench.harness.run_folder.scores import read_scores
from prbench.harness.run_folder.summary import DatasetAgreement
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from prbench.harness.scoring import ScoringRules, score_selection
from prbench.metrics import GAZE_METRICS, METRICS_OF_MOTIONS, GazeRays, MotionBatch, ScoringTargets
from prbench.metrics import score as score_by_hand
from prbench.protocol.manifests import load_protocol
from prbench.viewing.view import ViewRequest, scenes_of
from tests.fakes import fake_dataset, fake_sequence
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


BY_GAZE = ("prime_success_gaze", "prime_success_gaze_arrival")
LOOKS = """from prbench.contract import Gaze
            origin = joints[:, :, 15] + (0.0, 0.0, 0.1)
            goal = np.zeros((len(batch), 3)) if batch.goal_location is None else batch.goal_location
            # At the goal from 1.5 s on, ever slower; before that, up.
            frames = np.arange(joints.shape[1])
            share = np.clip((frames - 20) / 10, 0, 1)[None, :, None] ** 0.5
            to_goal = goal[:, None] - origin
            direction = share * to_goal / np.linalg.norm(to_goal, axis=-1, keepdims=True)
            direction += (1 - share) * np.array([0.0, 1.0, 0.0])
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            return Motions(joints, n_frames, None, Gaze(origin, direction))"""


@pytest.fixture
def seeing(install) -> None:
    """A method whose noise has eyes that look at the goal."""
    install("made", adapter_source(body=LOOKS, attributes="gaze = True"))


def seen_request(table, out, **changes) -> RunRequest:
    wanted = {"method": "made", "condition": Condition.GOAL_LOCATION, "data": (table.folder,), "out": out}
    return RunRequest(**{**wanted, "batch_size": 4, **changes})


def test_gaze_is_scored_beside_the_head_and_the_run_is_marked(table, tmp_path, seeing):
    report = run_method(seen_request(table, tmp_path / "run"))
    summary = report.summaries[0]
    assert RunRecord.read(tmp_path / "run").method.gaze
    assert summary.gaze
    assert summary.remarks == ["¶ gaze generated with the head, beyond the study; never ranked"]
    assert summary.mark.startswith("✗ the motions are certainly wrong"), "the method draws noise"
    assert summary.metric("prime_success").mean < 0.5
    for name in BY_GAZE:
        assert summary.metric(name).mean == 1.0
        assert summary.metric(name).sequences == 15
    assert Predictions.open(tmp_path / "run/synthetic-adt/predictions").has_gaze


def test_a_view_shows_the_gaze_of_each_motion(table, tmp_path, seeing):
    run_method(seen_request(table, tmp_path / "run"))
    wanted = ViewRequest(out=tmp_path / "view.png", runs=(tmp_path / "run",), data=(table.folder,), limit=1)
    (scene,) = scenes_of(wanted)
    recorded, generated = scene.motions
    assert recorded.gaze is not None
    assert generated.gaze is not None
    assert np.allclose(generated.gaze.origin, generated.joints[:, 15] + (0, 0, 0.1), atol=1e-5)
    assert np.allclose(np.linalg.norm(generated.gaze.direction, axis=-1), 1.0, atol=1e-5)


def test_another_process_sends_the_same_gaze(table, tmp_path, seeing):
    run_method(seen_request(table, tmp_path / "here"))
    run_method(seen_request(table, tmp_path / "apart", isolate=True))
    assert (tmp_path / "here/synthetic-adt/scores.parquet").read_bytes() == (
        tmp_path / "apart/synthetic-adt/scores.parquet"
    ).read_bytes()


def test_a_finished_run_with_gaze_is_verified_and_keeps_the_rays_of_its_motions(table, tmp_path, seeing):
    for _ in range(2):  # the second finds everything, and holds scores and summary against the motions
        run_method(seen_request(table, tmp_path / "run"))
    predictions = Predictions.open(tmp_path / "run/synthetic-adt/predictions")
    rows = predictions.motions(predictions.ids[:2], 0)
    assert rows.gaze is not None
    assert np.allclose(rows.gaze[:, 0], rows.values[:, 15] + (0, 0, 0.1), atol=1e-5)


def test_agreement_counts_the_sequences_whose_recorded_gaze_decides(tmp_path, seeing, monkeypatch):
    def with_gaps(index: int, **settings):
        sequence = fake_sequence(index, **settings)
        return replace(sequence, gaze_valid=np.full(len(sequence.joints), index % 3 > 0))

    monkeypatch.setattr("tests.fakes.fake_sequence", with_gaps)
    run_method(seen_request(fake_dataset(tmp_path / "data", 60), tmp_path / "run"))
    scores = read_scores(tmp_path / "run/synthetic-adt/scores.parquet")
    ids = set(scores["sequence_id"].to_pylist())
    agreement = DatasetAgreement.read(tmp_path / "run/synthetic-adt")
    counted = {rate.metric: rate.sequences for rate in agreement.rates}
    assert counted["prime_success"] == len(ids)
    assert 0 < counted["prime_success_gaze"] < len(ids)


def test_methods_without_gaze_are_scored_by_their_head_alone(table, tmp_path, install):
    install("made", adapter_source())
    summary = run_method(seen_request(table, tmp_path / "run")).summaries[0]
    assert not summary.gaze
    assert summary.remarks == []
    assert all(summary.metric(name) is None for name in BY_GAZE)


def test_a_leaderboard_shows_it_as_a_row_of_its_own_and_ranks_it_nowhere(table, tmp_path, seeing):
    run_method(seen_request(table, tmp_path / "runs/eyes"))
    board = make_leaderboard(collect_runs([tmp_path / "runs"]))
    (row,) = board.tables[0].rows
    assert row.ranks == {}
    assert "| made ✗ ¶ |" in export(board, "md")
    assert "¶ gaze generated with the head" in export(board, "csv")
    assert json.loads(export(board, "json"))["tables"][0]["rows"][0]["record"]["method"]["gaze"] is True


def test_finished_motions_with_gaze_are_scored_like_those_of_a_run(table, tmp_path, seeing, capsys):
    run_method(seen_request(table, tmp_path / "run"))
    parts = shutil.copytree(tmp_path / "run/synthetic-adt/predictions", tmp_path / "handed-in")
    assert main(["score", str(parts), "--data", str(table.folder), "--condition", "goal-loc", "--json"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)["report"]
    found = entry["scores"]
    values = {metric["metric"]: metric["mean"] for metric in found["metrics"]}
    assert found["gaze"] is True
    assert values["prime_success_gaze"] == 1.0


def test_finished_gaze_from_elsewhere_than_the_head_is_refused(table, tmp_path, seeing):
    run_method(seen_request(table, tmp_path / "run"))
    part = sorted((tmp_path / "run/synthetic-adt/predictions").iterdir())[0]
    rows = pq.read_table(part)
    moved = [[[x, y + 1.0, z] for x, y, z in frames] for frames in rows["gaze_origin"].to_pylist()]
    place = rows.schema.get_field_index("gaze_origin")
    pq.write_table(rows.set_column(place, rows.field(place), pa.array(moved, rows.field(place).type)), part)
    finished = ScoreRequest(predictions=tmp_path / "run/synthetic-adt/predictions", data=(table.folder,))
    with pytest.raises(PredictionsError, match=r"gaze, frame 0: expected eyes within 0\.3 m of the head joint"):
        score_predictions(finished)
