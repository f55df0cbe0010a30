"""Windows, training and tracking: laws, the kinematics of the core as oracle, and a training of six steps."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from prbench.cli import main
from prbench.errors import InputFileError, TableError, UsageError
from prbench.geometry.skeleton import PARENTS, Joint, forward_kinematics
from prbench_adapters.three_points import features
from prbench_adapters.three_points.regressor import Regressor, RegressorConfiguration
from prbench_adapters.three_points.tracker import LearnedTracker, load_tracker
from prbench_adapters.three_points.training import TracksDataset, TrackTask, hidden
from prbench_adapters.training.weights import Weights
from prbench_benchmarks.three_points.batch import Condition, TrackedBatch

RANDOM = np.random.default_rng(7)
SMALL = {"width": 16, "heads": 2, "layers": 2, "feed_forward": 16, "hidden": 16, "window": 8}
OFFSETS = np.vstack([np.zeros(3), RANDOM.uniform(-0.4, 0.4, (21, 3))])
WRISTS = [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]


def smooth_body(n=50):
    """Joints and world rotations of a body that moves smoothly, and its local rotations."""
    keys = RANDOM.normal(size=(3, 66)) * 0.3
    angles = np.array([np.interp(np.arange(n), [0, n // 2, n], each) for each in keys.T]).T.reshape(-1, 3)
    local = Rotation.from_rotvec(angles).as_matrix().reshape(n, 22, 3, 3)
    root = np.cumsum(RANDOM.normal(size=(n, 3)) * 0.01, axis=0) + np.array([0.5, 0.9, -2.0])
    return *forward_kinematics(OFFSETS, root, local, PARENTS), local


def devices(joints, world, n):
    chosen = [Joint.HEAD, *WRISTS]
    quaternions = Rotation.from_matrix(world[:, chosen].reshape(-1, 3, 3)).as_quat(scalar_first=True)
    return joints[:, chosen], quaternions.reshape(n, 3, 4), np.ones((n, 3), dtype=bool), np.ones((n, 3), dtype=bool)


class Knows:
    """Answers with given rotations: what is left are rates, gaps and kinematics."""

    def __init__(self, local):
        self.local, self.configuration, self.calls = local, RegressorConfiguration(**SMALL), []

    def parameters(self):
        yield torch.zeros(1)

    def rotations(self, rows, seed):
        self.calls.append((len(rows), seed))
        return torch.from_numpy(self.local[: len(rows)]).float()


def tracker_of(network):
    return LearnedTracker("any", Weights(None, {}, {}, ""), network)


@pytest.fixture(scope="module")
def regressor():
    torch.manual_seed(0)
    return Regressor(RegressorConfiguration(**SMALL)).eval().requires_grad_(False)


def test_kinematics_are_those_of_the_core():
    joints, _, local = smooth_body()
    found = features.joints_under_head(torch.tensor(local), torch.tensor(OFFSETS), torch.tensor(joints[:, Joint.HEAD]))
    np.testing.assert_allclose(found, joints, atol=1e-12)


def test_windows_do_not_tell_where_in_the_room_and_which_way_somebody_stands():
    joints, world, _ = smooth_body()
    turn = Rotation.from_euler("y", 2.0).as_matrix()
    seen = []
    for place, rotation in ((joints, world), (joints @ turn.T + [3.0, 0.0, -1.0], turn @ world)):
        rows = features.track_values(*devices(place, rotation, 50), 60.0)
        seen.append(features.in_head_frame(features.windows_ending_at(rows, torch.tensor([3, 30]), 8)))
    torch.testing.assert_close(seen[0][0], seen[1][0], atol=1e-4, rtol=0)
    assert not torch.allclose(seen[0][1], seen[1][1])
    assert (seen[0][0][0, :4] == 0).all()  # before the first frame nothing was measured
    assert (seen[0][0][0, 4:, :18] != 0).all()
    head = seen[0][0][:, -1, 36:39]
    torch.testing.assert_close(head[:, [0, 2]], torch.zeros(2, 2))
    np.testing.assert_allclose(head[:, 1], joints[[3, 30], Joint.HEAD, 1], atol=1e-6)


def test_what_is_not_measured_is_zero_and_nothing_else_changes():
    joints, world, _ = smooth_body()
    whole = features.track_values(*devices(joints, world, 50), 60.0)
    position, rotation, valid, turned = devices(joints, world, 50)
    valid[20, 1], turned[30, 2] = False, False
    position[20, 1] = 1e9
    rows = features.track_values(position, rotation, valid, turned, 60.0)
    lost = torch.isnan(rows) & ~torch.isnan(whole)
    assert lost.sum(dim=1)[[20, 21, 30, 31]].tolist() == [18, 9, 12, 6]  # a change needs both of its frames
    assert lost.sum() == 45
    assert torch.equal(rows[~torch.isnan(rows)], whole[~torch.isnan(rows)])


def test_hidden_devices_are_hidden_whole_and_the_head_only_before_a_track_begins():
    windows = torch.ones(4000, 12, 54)
    shown = hidden(windows, torch.Generator().manual_seed(1))
    assert torch.equal(shown, hidden(windows, torch.Generator().manual_seed(1)))
    head, left, right = (shown[:, :, 36 + 3 * each] for each in range(3))
    assert (head[:, -1] == 1).all()
    assert ((head.diff(dim=1) >= 0).all(dim=1)).all()
    without = ((left + right).sum(dim=1) == 0).float().mean()
    assert 0.33 < without < 0.4
    assert 0.08 < ((left > 0) != (right > 0)).any(dim=1).float().mean() < 0.2
    assert torch.equal(shown[:, :, 3 * 12], head)
    turned = shown[:, :, 6] > left  # a rotation is never known without its position
    assert not turned.any()
    assert 0.1 < ((left > 0) & (shown[:, :, 6] == 0)).any(dim=1).float().mean() < 0.2


@pytest.mark.parametrize("fps", [60.0, 30.0])
def test_true_rotations_give_the_true_body_at_either_rate(fps):
    joints, world, local = smooth_body(61)
    step = int(60 / fps)
    position, rotation, *masks = devices(joints, world, 61)
    times = 5.0 + np.arange(0, 61, step) / 60.0
    given = (position[::step], rotation[::step], *(mask[::step] for mask in masks))
    found = tracker_of(Knows(local)).estimate(times, *given, OFFSETS)
    np.testing.assert_allclose(found, joints[::step], atol=1e-5)


def test_where_the_head_is_not_known_there_is_no_body_and_a_track_begins_anew():
    joints, world, local = smooth_body()
    position, rotation, valid, turned = devices(joints, world, 50)
    valid[10:13, 0], turned[20, 0] = False, False
    network = Knows(local)
    found = tracker_of(network).estimate(np.arange(50) / 60.0, position, rotation, valid, turned, OFFSETS, seed=3)
    assert np.flatnonzero(np.isnan(found).any(axis=(1, 2))).tolist() == [10, 11, 12, 20]
    assert network.calls == [(10, 3), (7, 3), (29, 3)]
    valid[:, 0] = False
    none = tracker_of(network).estimate(np.arange(50) / 60.0, position, rotation, valid, turned, OFFSETS)
    assert np.isnan(none).all()


def test_pieces_of_a_long_track_leave_no_seam(regressor, monkeypatch):
    joints, world, _ = smooth_body()
    given = (np.arange(50) / 60.0, *devices(joints, world, 50), OFFSETS)
    whole = tracker_of(regressor).estimate(*given)
    monkeypatch.setattr("prbench_adapters.three_points.tracker._PIECE", 15)
    np.testing.assert_allclose(tracker_of(regressor).estimate(*given), whole, atol=1e-5)
    assert np.ptp(whole, axis=0).max() > 0.01


def test_a_track_is_a_function_of_its_own_row(regressor):
    joints, world, _ = smooth_body()
    arrays = [*(np.stack([each, each[::-1]]) for each in devices(joints, world, 50)), np.stack([OFFSETS, OFFSETS])]
    names = ("position", "rotation", "valid", "rotation_valid", "offsets")

    def tracked(rows):
        about = {"n_frames": np.array([50, 30])[rows], "key": tuple(rows), "fps": 60.0}
        given = {name: each[rows] for name, each in zip(names, arrays, strict=True)}
        return tracker_of(regressor).track(TrackedBatch(condition=Condition.HEAD_WRISTS, **about, **given), seed=0)

    both = tracked([0, 1]).joints
    np.testing.assert_array_equal(both[1], tracked([1]).joints[0])
    assert np.isnan(both[1, 30:]).all()
    assert np.isfinite(both[0]).all()


@pytest.mark.parametrize(("method", "other"), [("avatarposer", "bodiffusion"), ("bodiffusion", "avatarposer")])
def test_six_steps_of_training_make_a_tracker(tracks, tmp_path, method, other):
    arguments = ["train", "--method", method, "--config", "smoke", "--data", str(tracks)]
    assert main([*arguments, "--out", str(tmp_path / "a"), "--set", "validation.every=0"]) == 0
    tracker = load_tracker(method, tmp_path / "a", options={}, device="cpu")
    assert set(tracker.provenance) == {"weights_sha256", "licence"}
    assert tracker.provenance["licence"]
    with pytest.raises(InputFileError, match="header entry 'kind'"):
        load_tracker(other, tmp_path / "a", options={}, device="cpu")


def test_bodiffusion_takes_as_many_steps_as_it_is_told(tracks, tmp_path):
    arguments = ["train", "--method", "bodiffusion", "--config", "smoke", "--data", str(tracks)]
    assert main([*arguments, "--out", str(tmp_path), "--set", "training.steps=1"]) == 0
    told = {"options": {"steps": "5"}, "device": "cpu"}
    assert load_tracker("bodiffusion", tmp_path, **told).network.configuration.sampling_steps == 5
    with pytest.raises(ValueError, match="from 1 to 8, found '9'"):
        load_tracker("bodiffusion", tmp_path, options={"steps": "9"}, device="cpu")
    with pytest.raises(ValueError, match="unknown option 'steps'"):
        load_tracker("avatarposer", tmp_path, **told)


def test_windows_of_training_are_the_recorded_bodies(tracks):
    data = TracksDataset([tracks], split="train", window=8, fps=60.0)
    batch = data.collate([data[place, epoch] for place, epoch in ((0, 0), (0, 1), (len(data) - 1, 0))])
    local = features.matrices_of_columns(batch.rotations[:, -1])
    joints = features.joints_under_head(local, batch.offsets, batch.head[:, -1])
    wrists = batch.features[:, -1, 39:45].unflatten(-1, (2, 3))
    torch.testing.assert_close(joints[:, WRISTS], wrists, atol=1e-4, rtol=0)
    assert not torch.equal(batch.features[0], batch.features[1])
    assert len(data.spread(5)) == 5


def test_tables_that_do_not_fit_are_refused(tracks):
    with pytest.raises(UsageError, match="expected 30 frames/s"):
        TracksDataset([tracks], split="train", window=8, fps=30.0)
    with pytest.raises(TableError, match="expected tracks of 8 frames in split 'nowhere'"):
        TracksDataset([tracks], split="nowhere", window=8, fps=60.0)
    with pytest.raises(UsageError, match=r"\[model\]: .*'heads'"):
        TrackTask("avatarposer").items([tracks], "train", {"width": 15}, 0)
