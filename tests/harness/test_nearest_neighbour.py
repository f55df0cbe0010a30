"""Retrieval of training motions, and recorded motion through another frame rate."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from prbench.errors import TableError
from prbench.geometry.skeleton import bone_lengths
from prbench.harness import controls
from prbench.harness.conditions import ConditionSource
from prbench.harness.controls import control_motions
from prbench.harness.planning import plan_batches, select
from prbench.harness.run import run_method
from prbench.harness.run_folder import read_scores
from prbench.sequences import SequenceTable
from tests.fakes import fake_dataset
from tests.harness.test_run import request


def retrieved(table: SequenceTable, split: str = "test", batch_size: int = 4) -> dict[str, np.ndarray]:
    selection = select(table, split=split, limit=None)
    plan = plan_batches(selection.n_frames, batch_size)
    made = control_motions("nearest-neighbour", selection, ConditionSource.read(selection), plan)
    return {
        selection.sequence_ids[row]: batch.joints[i, : batch.n_frames[i]]
        for rows, batch in zip(plan, made, strict=True)
        for i, row in enumerate(rows)
    }


def tasks(table: SequenceTable, split: str) -> dict[str, tuple[np.ndarray, np.ndarray, str, np.ndarray]]:
    """First pose, goal, recording and motion of each sequence, read in a slow loop."""
    found = {}
    for chunk in table.chunks(split=split):
        for i, name in enumerate(chunk.sequence_ids):
            motion = chunk.joints[chunk.offsets[i] : chunk.offsets[i + 1]]
            found[name] = motion[0], chunk.vectors("goal_location")[i], chunk.strings("recording_id")[i], motion
    return found


def nearest(wanted, known) -> str:
    pose, goal, recording, _ = wanted
    distances = {
        name: np.linalg.norm(its_pose - pose, axis=1).mean() + np.linalg.norm(its_goal - goal)
        for name, (its_pose, its_goal, its_recording, _) in known.items()
        if its_recording != recording
    }
    return min(distances, key=lambda name: (distances[name], name))


@pytest.mark.parametrize("split", ["test", "train"])
def test_the_motion_of_the_most_similar_training_task_is_laid_on_the_goal(table, split):
    known = tasks(table, "train")
    made = retrieved(table, split)
    for name, wanted in tasks(table, split).items():
        _, goal, recording, motion = wanted
        _, its_goal, its_recording, its_motion = known[nearest(wanted, known)]
        assert its_recording != recording
        assert len(made[name]) == len(motion)
        # Only the speed of the body changes: its ends are the same body, turned and moved over the ground.
        for frame in (0, -1):
            assert np.allclose(bone_lengths(made[name][frame]), bone_lengths(its_motion[frame]), atol=1e-5)
            assert np.allclose(made[name][frame, :, 1], its_motion[frame, :, 1], atol=1e-6)
        # What the retrieved wrist left between itself and its goal, over the ground, it leaves here.
        left = np.linalg.norm((made[name][-1, 21] - goal)[[0, 2]])
        assert left == pytest.approx(np.linalg.norm((its_motion[-1, 21] - its_goal)[[0, 2]]), abs=1e-5)


def test_batches_leave_no_trace(table):
    one = retrieved(table, batch_size=1)
    together = retrieved(table, batch_size=64)
    assert all(np.array_equal(one[name], together[name]) for name in one)


def test_without_training_sequences_of_another_recording_it_says_so(tmp_path, monkeypatch):
    everything = fake_dataset(tmp_path / "table", 4)
    monkeypatch.setattr(controls, "_TRAINING", "validation")
    with pytest.raises(TableError, match="of another recording than rec003"):
        retrieved(everything, "validation")
    one = fake_dataset(tmp_path / "one", 2)
    with pytest.raises(TableError, match="expected training sequences, which nearest-neighbour retrieves from"):
        retrieved(one)
    monkeypatch.undo()
    with pytest.raises(TableError, match="of another recording than rec000"):
        retrieved(one, "train")


def test_its_run_carries_the_notice_of_recorded_motion(tmp_path):
    table = fake_dataset(tmp_path / "table", 8)
    msgspec.structs.replace(table.info, redistribution="none").write(table.folder)
    run_method(request(table, tmp_path / "out", "nearest-neighbour"))
    run_method(request(table, tmp_path / "recorded", "ground-truth"))
    notices = [(tmp_path / run / "NOTICE.txt").read_text() for run in ("out", "recorded")]
    assert notices[0] == notices[1]
    assert "prime_success_gaze" not in read_scores(tmp_path / "out/scores.parquet")["metric"].to_pylist()


def test_a_round_trip_through_its_own_rate_changes_nothing_and_through_another_little(table):
    selection = select(table, split="test", limit=None)
    plan = plan_batches(selection.n_frames, 4)
    source = ConditionSource.read(selection)
    names = ("ground-truth", "ground-truth-20fps", "ground-truth-30fps")
    made = [list(control_motions(name, selection, source, plan)) for name in names]
    for recorded, same, other in zip(*made, strict=True):
        assert np.array_equal(recorded.n_frames, other.n_frames)
        for i, n_frames in enumerate(recorded.n_frames):
            assert np.array_equal(recorded.joints[i, :n_frames], same.joints[i, :n_frames])
            off = np.abs(recorded.joints[i, :n_frames] - other.joints[i, :n_frames])
            # 20 to 30 frames per second and back: every second frame is hit exactly, the others lie between two.
            assert off[::2].max() < 1e-5
            steps = np.abs(np.diff(recorded.joints[i, :n_frames], axis=0)).max()
            assert 0 < off.max() < steps
