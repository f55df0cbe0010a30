"""Controls: the recorded motion, constant timing, and other sequences' goals."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from prbench.contract import Condition, Motions
from prbench.errors import TableError
from prbench.geometry.skeleton import BONES, WRISTS, Joint, bone_lengths, head_forward
from prbench.harness import controls, planning
from prbench.harness.conditions import ConditionSource
from prbench.harness.controls import control_motions
from prbench.harness.planning import plan_batches, select
from prbench.harness.run import run_method
from prbench.harness.run_folder import Predictions, read_scores
from prbench.harness.scripted import SCRIPTED_CONTROLS, ScriptedStart
from prbench.sequences import SequenceTable
from tests import fakes
from tests.fakes import STANDING, fake_dataset, smooth_motion
from tests.harness.test_run import request

TILT = 7.4


def means(report) -> dict[str, float]:
    return {metric.metric: metric.mean for metric in report.summaries[0].metrics}


def test_recorded_motion_scores_without_error_and_reaches_its_own_wrist(table, tmp_path):
    scored = means(run_method(request(table, tmp_path / "out", "ground-truth", samples=2)))
    assert scored["goal_mpjpe"] == scored["mpjpe"] == scored["location_error"] == 0.0
    assert scored["reach_wrist"] == 1.0
    assert "prime_success_gaze" in scored


@pytest.mark.parametrize("window", [4, 7, 1024])
def test_recorded_motion_is_that_of_the_table_whatever_the_window(table, monkeypatch, window):
    monkeypatch.setattr(planning, "WINDOW", window)
    selection = select(table, split="test", limit=None)
    plan = plan_batches(selection.n_frames, 3)
    truth = {}
    for chunk in table.chunks(split="test"):
        for i, name in enumerate(chunk.sequence_ids):
            truth[name] = chunk.joints[chunk.offsets[i] : chunk.offsets[i + 1]]
    motions = list(control_motions("ground-truth", selection, ConditionSource.read(selection), plan))
    assert len(motions) == len(plan)
    for rows, batch in zip(plan, motions):
        for i, row in enumerate(rows):
            assert np.array_equal(batch.joints[i, : batch.n_frames[i]], truth[selection.sequence_ids[row]])


def test_gaze_is_scored_for_recorded_motion_only(table, tmp_path):
    assert "prime_success_gaze" not in means(run_method(request(table, tmp_path / "out", "scripted")))


def test_recorded_motion_against_other_goals_drops_and_leaves_out_what_ignores_the_goal(table, tmp_path):
    own = means(run_method(request(table, tmp_path / "own", "ground-truth")))
    other = means(run_method(request(table, tmp_path / "other", "ground-truth", control="shuffled-goal")))
    assert other["reach_success"] < 0.7 * own["reach_success"]
    assert not other.keys() & {"goal_mpjpe", "mpjpe", "location_error", "reach_wrist"}
    assert other["foot_skating"] == own["foot_skating"]
    mine, others = (Predictions.open(tmp_path / run / "synthetic-adt/predictions") for run in ("own", "other"))
    ids = [name for chunk in table.chunks(split="test", columns=[]) for name in chunk.sequence_ids]
    assert np.array_equal(mine.motions(ids, 0).values, others.motions(ids, 0).values)


def test_a_method_that_follows_its_goal_drops_under_shuffled_goals_but_is_scored_on_its_own(table, tmp_path):
    own = means(run_method(request(table, tmp_path / "own", "scripted")))
    other = means(run_method(request(table, tmp_path / "other", "scripted", control="shuffled-goal")))
    assert own["reach_success"] == 1.0
    assert other["reach_success"] < 0.7
    assert "goal_mpjpe" in other


def test_a_method_that_ignores_its_goal_scores_the_same_under_shuffled_goals(table, tmp_path):
    run_method(request(table, tmp_path / "own", "static"))
    run_method(request(table, tmp_path / "other", "static", control="shuffled-goal"))
    own, other = (read_scores(tmp_path / run / "synthetic-adt/scores.parquet") for run in ("own", "other"))
    assert own.equals(other)


@pytest.mark.parametrize("condition", Condition)
@pytest.mark.parametrize("method", ["ground-truth", "scripted"])
def test_controls_run_under_any_condition_with_the_same_scores(table, tmp_path, method, condition):
    run_method(request(table, tmp_path / "out", method, condition=condition, limit=4))
    run_method(request(table, tmp_path / "none", method, limit=4))
    scores = [read_scores(tmp_path / run / "synthetic-adt/scores.parquet") for run in ("out", "none")]
    assert scores[0].equals(scores[1])


def goals_around(n: int = 40) -> np.ndarray:
    generator = np.random.default_rng(0)
    angle, distance = generator.uniform(-np.pi, np.pi, n), generator.uniform(0.3, 3.0, n)
    return np.stack([distance * np.sin(angle), generator.uniform(0.2, 1.9, n), distance * np.cos(angle)], axis=1)


def scripted(goals: np.ndarray, n_frames=101, fps=20.0, start=STANDING):
    given = ScriptedStart(np.tile(start, (len(goals), 1, 1)), goals, np.full(len(goals), TILT))
    n_frames = np.full(len(goals), n_frames)
    return Motions(SCRIPTED_CONTROLS["scripted"](given, n_frames, fps).astype(np.float32), n_frames)


def ray_distance(joints: np.ndarray, goals: np.ndarray) -> np.ndarray:
    forward, _ = head_forward(joints, TILT)
    to_goal = goals - joints[:, Joint.HEAD]
    along = np.maximum((to_goal * forward).sum(axis=1), 0.0)
    return np.linalg.norm(to_goal - along[:, None] * forward, axis=1)


def test_the_scripted_body_starts_with_the_first_frame():
    joints = scripted(goals_around()).joints
    assert np.allclose(joints[:, :20], STANDING, atol=1e-6)


@pytest.mark.parametrize("fps", [20.0, 30.0])
def test_the_scripted_body_faces_the_goal_at_two_seconds_and_not_before(fps):
    goals = goals_around()
    goals = goals[np.hypot(goals[:, 0], goals[:, 2]) > 0.5]
    joints = scripted(goals, n_frames=151, fps=fps).joints
    assert ray_distance(joints[:, round(2.0 * fps)], goals).max() < 0.03
    behind = goals[:, 2] < 0
    assert ray_distance(joints[behind, round(1.4 * fps)], goals[behind]).min() > 0.25


def test_a_head_beside_the_pelvis_still_faces_the_goal():
    goals = goals_around()
    goals = goals[np.hypot(goals[:, 0], goals[:, 2]) > 0.5]
    leaning = STANDING + np.outer(STANDING[:, 1], [0.12, 0.0, 0.05])
    joints = scripted(goals, start=leaning).joints
    assert ray_distance(joints[:, 40], goals).max() < 0.03


def test_the_scripted_body_slows_down_as_it_arrives():
    joints = scripted(np.array([[2.0, 1.2, 0.5]])).joints[0]
    forward, _ = head_forward(joints, TILT)
    speed = np.arccos(np.clip((forward[1:] * forward[:-1]).sum(axis=1), -1, 1))[20:40]
    assert speed.argmax() in (9, 10)
    assert (np.diff(speed[10:]) < 0).all()


def test_a_wrist_of_the_scripted_body_ends_on_the_goal_and_the_other_arm_stays_with_the_body():
    goals = goals_around()
    final = scripted(goals).joints[:, -1]
    distances = np.linalg.norm(final[:, WRISTS] - goals[:, None], axis=-1)
    assert distances.min(axis=1).max() < 1e-5
    lengths = bone_lengths(final) / bone_lengths(STANDING)
    arms = [i for i, (_, child) in enumerate(BONES) if child in (18, 19, 20, 21)]
    assert np.allclose(np.delete(lengths, arms, axis=1), 1.0, atol=1e-4)


def test_arms_keep_their_bones_where_the_goal_is_within_reach():
    goals = np.array([[1.5, 1.25, 1.0], [-0.2, 1.3, 0.35], [0.0, 1.5, 3.0]])
    joints = scripted(goals).joints
    assert np.allclose(bone_lengths(joints) / bone_lengths(STANDING), 1.0, atol=1e-3)


def test_the_scripted_body_stands_before_the_goal_and_moves_smoothly():
    goals = goals_around()
    joints = scripted(goals).joints
    stand = np.linalg.norm((joints[:, -1, 0] - goals)[:, [0, 2]], axis=1)
    walked = np.hypot(goals[:, 0], goals[:, 2]) > 0.45
    assert np.allclose(stand[walked], 0.45, atol=1e-5)
    assert np.allclose(joints[~walked, -1, 0], STANDING[0], atol=1e-6)
    assert (
        np.linalg.norm(np.diff(joints, n=2, axis=1), axis=-1).max() < 0.08
    )  # 32 m/s²; half a turn in one second is brisk


def test_the_scripted_body_turns_with_the_world():
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    goals = goals_around(10)
    own = scripted(goals).joints
    turned = scripted(goals @ turn.T, start=STANDING @ turn.T).joints
    assert np.allclose(own @ turn.T, turned, atol=1e-5)


def test_a_short_sequence_still_reaches():
    goals = goals_around(8)
    final = scripted(goals, n_frames=41).joints[:, -1]
    assert np.linalg.norm(final[:, WRISTS] - goals[:, None], axis=-1).min(axis=1).max() < 1e-5


@pytest.fixture
def canonical_table(tmp_path, monkeypatch):
    """Made-up sequences whose first pelvis stands over the origin, as that of every built table does."""

    def centred(name: str, n_frames: int) -> np.ndarray:
        joints = smooth_motion(name, n_frames)
        return joints - joints[0, Joint.PELVIS] * np.array([1, 0, 1], dtype=np.float32)

    monkeypatch.setattr(fakes, "smooth_motion", centred)
    return fakes.fake_dataset(tmp_path / "canonical", 24)


def test_recorded_motion_through_the_features_scores_nearly_the_same(canonical_table, tmp_path):
    own = means(run_method(request(canonical_table, tmp_path / "own", "ground-truth")))
    resampled = means(run_method(request(canonical_table, tmp_path / "resampled", "ground-truth-resampled")))
    assert own.keys() == resampled.keys()
    assert "prime_success_gaze" in resampled
    assert 0.0 < resampled["mpjpe"] < 1e-6  # another motion, but hardly
    assert max(abs(own[name] - resampled[name]) for name in own) < 1e-5


def test_recorded_motion_through_the_features_keeps_every_frame(canonical_table):
    selection = select(canonical_table, split="test", limit=None)
    source = ConditionSource.read(selection)
    plan = plan_batches(selection.n_frames, 4)
    truth, resampled = (
        list(control_motions(name, selection, source, plan)) for name in ("ground-truth", "ground-truth-resampled")
    )
    for recorded, decoded in zip(truth, resampled, strict=True):
        assert np.array_equal(recorded.n_frames, decoded.n_frames)
        assert np.abs(recorded.ragged() - decoded.ragged()).max() < 1e-6


def test_recorded_motion_through_the_features_is_recorded_motion_under_shuffled_goals(table, tmp_path):
    own, resampled = (
        means(run_method(request(table, tmp_path / name, name, control="shuffled-goal")))
        for name in ("ground-truth", "ground-truth-resampled")
    )
    assert own.keys() == resampled.keys()
    assert "goal_mpjpe" not in resampled


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
    notices = [(tmp_path / run / "synthetic-adt/NOTICE.txt").read_text() for run in ("out", "recorded")]
    assert notices[0] == notices[1]
    assert "prime_success_gaze" not in read_scores(tmp_path / "out/synthetic-adt/scores.parquet")["metric"].to_pylist()


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
