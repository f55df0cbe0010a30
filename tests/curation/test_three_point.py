"""Bodies from head and wrists: what an estimator is given, what is masked, and which files readers take."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prbench.cli.main import main
from prbench.curation.poses import three_point
from prbench.curation.poses.three_point import MEAN_HEAD_HEIGHT, bend_arms, estimated_body, mean_offsets, wearer_size
from prbench.entry_points import POSE_ESTIMATORS, load_built_in
from prbench.errors import InputFileError
from prbench.geometry.skeleton import PARENTS, Joint, bone_lengths, rotation_matrices
from prbench.readers import reader_for
from prbench.recording import ESTIMATED, HandStream, PoseStream
from prbench.synthetic.write_tree import synthesize_tree
from tests.cli.reports import refused, reported
from tests.readers.own.plain import write_plain
from tests.shared import made_once

THREE = {"poses": "three-point"}


class Hanging:
    """Hangs the mean body below the head, and notes what it was given."""

    def __init__(self) -> None:
        self.provenance = {"licence": "none", "weights_sha256": "0"}

    def estimate(self, times, position, rotation, valid, rotation_valid, offsets):
        self.given = (times, position, rotation, valid, rotation_valid, offsets)
        body = np.zeros((22, 3))
        for joint in range(1, 22):
            body[joint] = body[PARENTS[joint]] + offsets[joint]
        joints = position[:, :1] + (body - body[Joint.HEAD])
        joints[~valid[:, 0]] = np.nan
        return joints


def tree(dataset: str) -> Path:
    return made_once(
        f"three-point-{dataset}",
        lambda path: synthesize_tree(dataset, path, recordings=1, seed=4, n_events=1, estimates=dataset == "adt"),
    )


@pytest.fixture
def estimator(monkeypatch) -> Hanging:
    made = Hanging()
    monkeypatch.setattr(three_point, "load_built_in", lambda *_, **__: lambda _: made)
    return made


def recording_of(dataset: str):
    reader = reader_for(dataset, THREE)
    return reader.read(reader.find(tree(dataset))[0])


def copied(dataset: str, tmp_path: Path) -> Path:
    return Path(shutil.copytree(tree(dataset), tmp_path / dataset))


@pytest.mark.parametrize("dataset", ["hd-epic", "hot3d", "adt"])
def test_the_command_makes_bodies_that_the_reader_takes_under_their_own_name(dataset, estimator, tmp_path, capsys):
    root = copied(dataset, tmp_path)
    (outcome,) = reported(["poses", "three-point", "--root", str(root)], capsys)
    assert outcome.state == "made"
    reader = reader_for(dataset, THREE)
    (found,) = reader.find(root)
    recording = reader.read(found)
    assert recording.pose_source == "three-point" in ESTIMATED
    assert any("licence none" in text and "weights_sha256 0" in text for text in recording.messages)
    head = recording.head.pose_at(recording.body.times)
    expected = head[0] - rotation_matrices(head[1]) @ three_point.EYE_IN_HEAD
    np.testing.assert_allclose(recording.body.joints[:, Joint.HEAD], expected, atol=1e-4)
    table = tmp_path / "table"
    assert (
        main(["build-dataset", dataset, "--root", str(root), "--out", str(table), "--option", "poses=three-point"]) == 0
    )
    assert {path.name for path in (root / "three-point").iterdir()} == {f"{found.recording_id}.npz"}


def test_own_recordings_without_a_body_table_get_bodies_too(estimator, tmp_path, capsys):
    root = write_plain(tmp_path / "own", recording_of("adt"), without=("body",))
    (outcome,) = reported(["poses", "three-point", "--root", str(root), "--dataset", "own"], capsys)
    assert outcome.state == "made", outcome.message
    reader = reader_for("own", THREE)
    (found,) = reader.find(root)
    assert reader.read(found).pose_source == "three-point"
    (plain,) = reader_for("own").find(root)
    assert reader_for("own").read(plain).body is None


def test_without_a_file_there_is_no_body_and_the_message_says_how_to_make_one():
    recording = recording_of("adt")
    assert recording.body is None
    assert recording.pose_source == "none"
    assert any("prbench poses three-point" in text for text in recording.messages)


def test_the_same_recording_gives_the_same_bytes(estimator, tmp_path, capsys):
    root = copied("hot3d", tmp_path)
    files = []
    for _ in range(2):
        reported(["poses", "three-point", "--root", str(root)], capsys)
        files.append(next((root / "three-point").iterdir()).read_bytes())
    assert files[0] == files[1]


def standing(n: int = 300) -> object:
    """A recording of a head that stands still at 1.5 m for 10 s, with wrists 10 times a second."""
    times = np.arange(n) / 30.0
    head = PoseStream(times, np.tile([0.0, 1.5, 0.0], (n, 1)), np.tile([1.0, 0, 0, 0], (n, 1)), np.ones(n, bool))
    tenth = np.arange(n // 3) / 10.0
    at = np.tile([[[0.3, 1.2, 0.2]]], (len(tenth), 1, 1))
    hands = tuple(HandStream(side, "wrist", tenth, at, np.ones(len(tenth), bool)) for side in ("left", "right"))
    return replace(recording_of("adt"), head=head, hands=hands)


def test_gaps_of_more_than_a_tenth_of_a_second_are_masked_and_never_bridged():
    recording = standing()
    seen = np.ones(300, bool)
    seen[100:104] = False  # 0.167 s
    seen[200:202] = False  # 0.1 s
    left = replace(recording.hands[0], valid=np.arange(100) != 50)
    estimator = Hanging()
    changed = replace(recording, head=replace(recording.head, valid=seen), hands=(left, recording.hands[1]))
    arrays, _ = estimated_body(changed, estimator, 0.0)
    *_, valid, rotation_valid, _ = estimator.given
    assert np.flatnonzero(~valid[:, 0]).tolist() == [100, 101, 102, 103]
    assert np.flatnonzero(~arrays["valid"]).tolist() == [100, 101, 102, 103]
    assert set(np.flatnonzero(~valid[:296, 1])) == set(range(148, 153))  # but for frames beside a sample
    assert valid[:-3, 2].all()
    assert not rotation_valid[:, 1:].any()


def test_a_long_recording_is_estimated_in_pieces_without_a_seam(monkeypatch):
    recording = recording_of("hd-epic")
    network = load_built_in(POSE_ESTIMATORS, "avatarposer")(None)
    whole, _ = estimated_body(recording, network, 0.0)
    monkeypatch.setattr(three_point, "_PIECE", 100)
    pieces, _ = estimated_body(recording, network, 0.0)
    assert len(whole["times"]) > 200
    np.testing.assert_array_equal(pieces["valid"], whole["valid"])
    np.testing.assert_allclose(pieces["joints"], whole["joints"], atol=1e-4)


def test_wrists_at_five_hertz_are_known_beside_their_samples_alone():
    recording = standing()
    slow = [replace(hand, times=hand.times * 2, points=hand.points, valid=hand.valid) for hand in recording.hands]
    estimator = Hanging()
    estimated_body(replace(recording, hands=tuple(slow)), estimator, 0.0)
    assert np.flatnonzero(estimator.given[3][:60, 1]).tolist() == list(range(0, 60, 6))


@pytest.mark.parametrize(
    ("height", "floor", "scale", "found"),
    [
        (1.60, None, 1.60 / MEAN_HEAD_HEIGHT, 0.0),
        (1.60, 0.2, 1.40 / MEAN_HEAD_HEIGHT, 0.2),
        (1.10, None, 1.0, 0.0),  # sits
        (0.05, None, 1.0, 0.05 - MEAN_HEAD_HEIGHT),  # a world that begins at the head
        (0.05, -1.5, 1.55 / MEAN_HEAD_HEIGHT, -1.5),
    ],
)
def test_size_and_floor_of_the_wearer(height, floor, scale, found):
    heights = np.append(np.full(99, height), 2.5)  # one jump does not make a giant
    assert wearer_size(heights, floor)[:2] == pytest.approx((scale, found))


def test_the_mean_adult_stands_as_high_as_its_constant_says():
    body = np.zeros((22, 3))
    for joint in range(1, 22):
        body[joint] = body[PARENTS[joint]] + mean_offsets(1.0)[joint]
    assert body[Joint.HEAD, 1] - body[:, 1].min() == pytest.approx(MEAN_HEAD_HEIGHT, abs=2e-4)
    assert np.allclose(body[Joint.LEFT_WRIST] * (-1, 1, 1), body[Joint.RIGHT_WRIST])


def test_arms_end_at_measured_wrists_and_bones_keep_their_lengths():
    times = np.arange(4) / 30.0
    joints = Hanging().estimate(times, np.zeros((4, 3, 3)), None, np.ones((4, 3), bool), None, mean_offsets(1.0))
    before = joints.copy()
    near = joints[:, Joint.LEFT_SHOULDER] + (0.1, -0.2, 0.3)
    position = np.stack([joints[:, Joint.HEAD], near, joints[:, Joint.RIGHT_SHOULDER] + (0.0, 0.0, 3.0)], axis=1)
    valid = np.ones((4, 3), bool)
    valid[3, 1] = False
    bend_arms(joints, position, valid)
    np.testing.assert_allclose(joints[:3, Joint.LEFT_WRIST], near[:3], atol=1e-9)
    np.testing.assert_allclose(bone_lengths(joints), bone_lengths(before), rtol=2e-3)
    np.testing.assert_array_equal(joints[3, Joint.LEFT_WRIST], before[3, Joint.LEFT_WRIST])
    towards = joints[:, Joint.RIGHT_WRIST] - joints[:, Joint.RIGHT_SHOULDER]  # out of reach: stretched towards it
    assert (towards[:, 2] / np.linalg.norm(towards, axis=1) > 0.999).all()


def _change(path: Path, **changed) -> None:
    with np.load(path) as archive:
        arrays = {key: archive[key] for key in archive.files}
    np.savez(path, **{key: value for key, value in (arrays | changed).items() if value is not None})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda path: _change(path, joints=None), "an array 'joints'"),
        (lambda path: _change(path, joints=np.zeros((5, 22, 3))), "joints: expected finite"),
        (lambda path: _change(path, times=np.zeros(7)), "times: expected increasing seconds"),
        (lambda path: _change(path, valid=np.zeros(3)), "valid: expected"),
        (lambda path: _change(path, about=np.array("{")), "about: expected JSON"),
        (lambda path: path.write_bytes(path.read_bytes()[:200]), "npz"),
        (lambda path: _change(path, joints=np.load(path)["joints"] + np.float32(1.0)), "heads within 0.3 m"),
    ],
)
def test_damaged_and_foreign_files_are_refused_with_their_place(change, says, estimator, tmp_path, capsys):
    root = copied("hot3d", tmp_path)
    reported(["poses", "three-point", "--root", str(root)], capsys)
    (path,) = (root / "three-point").iterdir()
    change(path)
    reader = reader_for("hot3d", THREE)
    with pytest.raises(InputFileError, match=r"three-point.*\.npz") as error:
        reader.read(reader.find(root)[0])
    assert says in str(error.value)
    (again,) = reported(["poses", "three-point", "--root", str(root)], capsys)
    assert again.state == "made"
    assert reader.read(reader.find(root)[0]).body is not None


def test_wrong_usage_is_answered(estimator, tmp_path, capsys):
    root = str(tree("adt"))
    words = ["poses", "three-point", "--root", root]
    refused([*words, "--dataset", "mogaze"], capsys, code=2, message="no option 'poses'")
    refused([*words, "--option", "floors=1"], capsys, code=2, message="floor")
    refused([*words, "--config", "x.toml"], capsys, code=2, message="are egoallo's")
    refused(["poses", "egoallo", "--root", root, "--option", "floor=1"], capsys, code=2, message="is three-point's")
    assert reported([*words, "--recordings", "nobody*"], capsys) == []


def test_an_unknown_estimator_is_answered_with_those_that_are_installed(capsys):
    words = ["poses", "three-point", "--root", str(tree("adt")), "--option", "estimator=avatarposr"]
    refused(words, capsys, code=2, message="Did you mean 'avatarposer'?")


def test_provenance_stands_in_the_file(estimator, tmp_path, capsys):
    root = copied("hot3d", tmp_path)
    reported(["poses", "three-point", "--root", str(root), "--option", "floor=0"], capsys)
    about = json.loads(str(np.load(next((root / "three-point").iterdir()))["about"]))
    assert about.keys() == {"estimator", "prbench", "licence", "weights_sha256", "weights", "floor", "size"}
