"""``prbench build-tracks``: from suits, glasses and wristbands to tracks, and what is told about bad input."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from prbench.cli.main import main
from prbench.geometry.skeleton import PARENTS, Joint, forward_kinematics, rotation_matrices
from prbench.protocol.manifests import load_manifest
from prbench_adapters.corpora.nymeria.tracks import cut, joint_rotations, segment_from_joint
from prbench_adapters.corpora.synthetic import synthesize_corpus_tree
from prbench_benchmarks.three_points.batch import DEVICES, Condition
from prbench_benchmarks.three_points.table import GIVEN, TracksTable, tracked_batch
from tests.adapters.corpora.suits import walking_suit, write_arrays
from tests.shared import made_once


def tree():
    """Four sequences, of which the last is long enough to be aligned."""
    return made_once("tracks-tree", lambda path: synthesize_corpus_tree("nymeria", path, recordings=4, seed=11))


def build(out, *more, root=None, devices="synthetic"):
    return main(
        ["build-tracks", "nymeria", "--root", str(root or tree()), "--devices", devices, "--out", str(out), *more]
    )


def rows(folder):
    """Maps each track's id to its chunk of one row."""
    return {chunk.sequence_ids[0]: chunk for chunk in TracksTable.open(folder).chunks(rows=1)}


@pytest.fixture(scope="module")
def tracks():
    def make(path):
        assert build(path) == 0

    return made_once("tracks-synthetic", make)


def test_kinematics_of_the_rotations_are_the_measured_joints(tracks):
    for chunk in rows(tracks).values():
        joints = chunk.joints.astype(np.float64)
        local = rotation_matrices(chunk.frames("rotations").reshape(-1, 22, 4).astype(np.float64))
        offsets = chunk.vectors("offsets").reshape(22, 3).astype(np.float64)
        found, turned = forward_kinematics(offsets, joints[:, 0], local, PARENTS)
        assert np.abs(found - joints).max() < 1e-4
        assert chunk.numbers("kinematic_deviation")[0] < 1e-4
        # Joint frames are level in the T-pose: arms to the sides, legs down.
        assert offsets[Joint.LEFT_ELBOW] == pytest.approx([np.linalg.norm(offsets[Joint.LEFT_ELBOW]), 0, 0], abs=1e-3)
        assert offsets[Joint.RIGHT_KNEE] == pytest.approx([0, -np.linalg.norm(offsets[Joint.RIGHT_KNEE]), 0], abs=1e-3)
        # Synthetic devices are the joints themselves.
        assert chunk.frames("device_position").reshape(-1, 3, 3) == pytest.approx(joints[:, DEVICES], abs=1e-6)
        head = rotation_matrices(chunk.frames("device_rotation").reshape(-1, 3, 4).astype(np.float64))
        assert head == pytest.approx(turned[:, DEVICES], abs=1e-4)


def test_people_are_split_and_tracks_are_long_enough_and_not_too_long(tracks):
    table = TracksTable.open(tracks)
    short = table.scalars().to_pylist()
    splits = {}
    for row in short:
        assert splits.setdefault(row["participant_id"], row["split"]) == row["split"]
        assert 60 <= row["n_frames"] <= 3600
    assert table.info.counts.tracks == len(short) == 5
    assert (table.info.dataset, table.info.devices, table.info.fps) == ("synthetic-nymeria-suit", "synthetic", 60.0)


def test_real_devices_are_moved_to_the_joints_that_carry_them(tmp_path, tracks, capsys):
    assert build(tmp_path / "t", "--fps", "30", devices="real") == 3
    told = capsys.readouterr().err
    assert "at least 60 s are needed. Without them, devices are synthetic alone" in told
    assert "found no trajectory" in told
    for name, chunk in rows(tmp_path / "t").items():
        assert "_invented_adt" in name
        joints = chunk.joints
        valid = chunk.frames("device_valid")
        apart = np.linalg.norm(chunk.frames("device_position").reshape(-1, 3, 3) - joints[:, DEVICES], axis=-1)
        assert valid.mean() > 0.99
        assert apart[:, 0].max() < 1e-5  # the body goes where its head is the glasses'
        assert np.median(apart[:, 1:][valid[:, 1:]]) < 0.02
        # The body is the suit's, in another world: distances within it stay.
        like = name.replace("/real/", "/synthetic/")
        whole = rows(tracks)
        begun = max(key for key in whole if key <= like)  # ids end with the frame of 240 a second that comes first
        skipped = (int(like[-8:]) - int(begun[-8:])) // 4
        chunks = ((joints, 1), (whole[begun].joints[skipped:], 2))  # at 30 and at 60 frames a second
        tall, as_tall = (np.linalg.norm(each[::step, 15] - each[::step, 0], axis=-1)[:900] for each, step in chunks)
        assert tall == pytest.approx(as_tall, abs=1e-3)


def test_a_wristband_that_is_missing_is_masked_and_told(tmp_path):
    root = tmp_path / "tree"
    shutil.copytree(tree(), root)
    shutil.rmtree(next(root.glob("*_invented_adt*")) / "recording_lwrist")
    build(tmp_path / "t", root=root, devices="real")
    for chunk in rows(tmp_path / "t").values():
        assert chunk.frames("device_valid").mean(axis=0)[1] == 0.0
        batch = tracked_batch(chunk, Condition.HEAD_WRISTS)
        assert not batch.position[:, :, 1].any()
        assert batch.valid[0, 10:-10, 2].all()


def test_a_tracker_knows_the_head_alone_under_its_condition(tracks):
    chunk = next(TracksTable.open(tracks).chunks(rows=2, columns=GIVEN))
    batch = tracked_batch(chunk, Condition.HEAD)
    assert not batch.valid[:, :, 1:].any()
    assert not batch.position[:, :, 1:].any()
    assert (batch.rotation[:, :, 1:] == [1, 0, 0, 0]).all()
    assert batch.valid[0, : batch.n_frames[0], 0].all()
    assert batch.position.base is None


@pytest.mark.parametrize("turned", [0.0, 0.7, 3.0])
def test_a_suit_whose_t_pose_is_told_and_one_whose_is_not(turned):
    suit = walking_suit(600)
    about_up = np.array([np.cos(turned / 2), 0.0, 0.0, np.sin(turned / 2)])
    told = type(suit)(
        suit.time_us, suit.position, np.tile(about_up, (600, 23, 1)), suit.tpose, np.tile(about_up, (23, 1))
    )
    for each, heading in ((suit, 0.0), (told, turned)):
        from_joint = segment_from_joint(each, synthetic=False)
        upright = joint_rotations(each, np.array([0, 5]), from_joint, load_manifest("nymeria"))
        forward = [np.cos(heading), 0.0, -np.sin(heading)]  # x of the suit's world is where it walks
        assert upright[..., 1] == pytest.approx(np.broadcast_to([0.0, 1.0, 0.0], (2, 22, 3)), abs=1e-9)
        assert upright[..., 2] == pytest.approx(np.broadcast_to(forward, (2, 22, 3)), abs=1e-9)


def test_gaps_are_never_bridged_and_long_stretches_are_cut_evenly():
    joined = np.ones(1999, dtype=bool)
    joined[[99, 100, 700]] = False
    assert list(cut(joined, 60.0, 700.0)) == [(0, 100), (101, 701), (701, 1350), (1350, 2000)]


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"segment_qWXYZ": np.zeros((1200, 88))}, "segment_qWXYZ: expected numbers of the shape (1200, 92)"),
        ({"segment_tXYZ": np.zeros((1199, 69))}, "segment_tXYZ: expected numbers of the shape (1200, 69)"),
        ({"frameRate": np.array([60])}, "frameRate: expected 240"),
    ],
)
def test_files_that_do_not_fit_are_left_out_by_name(tmp_path, capsys, changed, said):
    folder = tmp_path / "tree" / "20230607_s0_james_johnson_act0_e72nhq" / "body"
    folder.mkdir(parents=True)
    write_arrays(folder / "xdata.npz", walking_suit(), **changed)
    assert build(tmp_path / "t", root=tmp_path / "tree") == 3
    assert said in capsys.readouterr().err
    info = json.loads((tmp_path / "t" / "tracks.json").read_text())
    assert info["counts"]["tracks"] == 0


def test_another_rate_is_refused(tmp_path, capsys):
    assert build(tmp_path / "t", "--fps", "20") == 2
    assert "--fps: expected 30 or 60, found 20" in capsys.readouterr().err
