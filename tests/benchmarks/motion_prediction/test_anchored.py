from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.geometry.skeleton import transform_points
from prbench.sequences.table import SequenceTable
from prbench_benchmarks.motion_prediction.anchored import anchors, build_anchored_windows
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.predictors import NearestPast, ZeroVelocity
from prbench_benchmarks.motion_prediction.scoring import score_predictor
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.fakes import fake_dataset, fake_sequence


@pytest.fixture(scope="module")
def tables(tmp_path_factory) -> tuple[SequenceTable, WindowsTable]:
    folder = tmp_path_factory.mktemp("anchored")

    def looking_about(index, **more):
        row = fake_sequence(index, n_frames={0: 48, 1: 50}.get(index), **more)
        frames = np.arange(row.n_frames)
        directions = np.stack([np.sin(frames / 9), 0 * frames, np.cos(frames / 9)], axis=1)
        return dataclasses.replace(row, gaze_direction=directions, gaze_valid=frames % 7 > 0)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.fakes.fake_sequence", looking_about)
        fake_dataset(folder / "table", 6)
    build_anchored_windows(folder / "table", folder / "windows")
    return SequenceTable.open(folder / "table"), WindowsTable.open(folder / "windows")


def test_the_last_observed_frame_is_the_prime_or_lies_before_the_event(tables):
    sequences, table = tables
    chunk = next(sequences.chunks())
    joints = np.split(chunk.joints, chunk.offsets[1:-1])
    prime = dict(zip(chunk.sequence_ids, chunk.numbers("prime_frame").astype(int), strict=True))
    lasts = {}
    for batch, truth in table.batches(Condition.POSE, table.chosen(with_excluded=True), frame="room"):
        for row, name in enumerate(truth.window_ids):
            sequence, anchor, start = name.rsplit("/", 2)
            place = chunk.sequence_ids.index(sequence)
            last = int(start) + 9
            lasts.setdefault(anchor, []).append((last, prime[sequence], len(joints[place]) - 1))
            room_from_canonical = chunk.vectors("world_from_canonical")[place].reshape(4, 4)
            expected = transform_points(room_from_canonical, joints[place][last].astype(np.float64))
            np.testing.assert_allclose(batch.observed_joints[row, -1], expected, atol=1e-5)
    assert all(last == of_prime for last, of_prime, _ in lasts["prime"])
    assert all(last == event - 20 for last, _, event in lasts["event-1"])


def test_gaze_is_that_of_a_tenth_of_a_second_before(tables):
    sequences, table = tables
    chunk = next(sequences.chunks())
    looks = np.split(chunk.frames("gaze_direction"), chunk.offsets[1:-1])
    seen = np.split(chunk.frames("gaze_valid"), chunk.offsets[1:-1])
    compared = 0
    for batch, truth in table.batches(Condition.POSE_GAZE, table.chosen(with_excluded=True), frame="room"):
        for row, name in enumerate(truth.window_ids):
            sequence, _, start = name.rsplit("/", 2)
            place = chunk.sequence_ids.index(sequence)
            frames = np.arange(int(start), int(start) + 10) - 2  # at 20 frames a second
            there = (frames >= 0) & seen[place][np.maximum(frames, 0)].astype(bool)
            np.testing.assert_array_equal(batch.gaze_valid[row], there)
            np.testing.assert_allclose(batch.gaze[row][there], looks[place][frames[there]], atol=1e-6)
            compared += int(there.sum())
    assert compared > 100


def test_a_predictor_is_not_told_when_the_event_happens(tables):
    _, table = tables
    asked = {batch.n_future for batch, _ in table.batches(Condition.POSE, table.chosen(with_excluded=True), size=2)}
    scored = set(table.windows["n_scored"].to_pylist())
    assert asked == {40}
    assert len(scored) > 1
    assert min(scored) >= 10


def test_a_window_has_all_its_observed_frames_and_half_a_second_to_come(tables):
    _, table = tables
    ids = table.windows["window_id"].to_pylist()
    anchored = {
        n: [name.rsplit("/", 2)[1:] for name in ids if f"/obj{index}/" in name] for index, n in ((0, 48), (1, 50))
    }
    # The prime is frame 40; the half second up to 2 s before the event begins with frame n - 50.
    assert anchored[48] == [["event-1.5", "8"], ["event-1", "18"], ["event-0.5", "28"]]
    assert anchored[50] == [["event-2", "0"], ["event-1.5", "10"], ["event-1", "20"], ["event-0.5", "30"]]


def test_nearest_pasts_hold_their_pose_after_the_event(tables):
    _, table = tables
    batches = list(table.batches(Condition.POSE, table.chosen(anchor="event-1", with_excluded=True)))
    predictor = NearestPast().remember(batches)
    batch, truth = batches[0]
    futures = predictor.predict(batch, n_samples=1, seed=0).joints[:, 0]
    assert set(truth.n_scored.tolist()) == {20}
    np.testing.assert_allclose(futures[:, :20], truth.joints[:, :20], atol=1e-5)
    np.testing.assert_array_equal(futures[:, 20:], np.repeat(futures[:, 19:20], 20, axis=1))


def test_the_goal_is_scored_where_the_event_is_reached(tables):
    _, table = tables
    chosen = table.chosen(anchor="event-1", with_excluded=True)
    scores = score_predictor(ZeroVelocity(), table, Condition.POSE, chosen, n_samples=1)
    assert np.isfinite(scores.columns["wrist_to_goal"]).all()
    assert scores.columns["wrist_to_goal"] == scores.columns["wrist_to_goal_mean"]
    assert np.isfinite(scores.columns["ade@1s"]).all()
    assert np.isnan(scores.columns["ade@1.5s"]).all()


def test_windows_of_some_anchors_alone_can_be_built(tables, tmp_path):
    _, table = tables
    source = table.folder.parent / "table"
    build_anchored_windows(source, tmp_path / "w", only=("event-1", "prime"))
    some = WindowsTable.open(tmp_path / "w")
    assert set(some.windows["anchor"].to_pylist()) == {"event-1", "prime"}
    assert some.info.options["anchors"] == "prime, event-1"
    wanted = [name for name in table.windows["window_id"].to_pylist() if name.split("/")[-2] in ("event-1", "prime")]
    assert some.windows["window_id"].to_pylist() == wanted
    with pytest.raises(UsageError, match="--anchor event-3: expected some of prime, event-2"):
        build_anchored_windows(source, tmp_path / "w", only=("event-3",))
    assert anchors() == ("prime", "event-2", "event-1.5", "event-1", "event-0.5")
