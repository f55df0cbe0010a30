"""Outputs of one recording: found, checked against it, joined, and kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.readers.egoallo.bodies import read_bodies, read_output
from prbench.readers.egoallo.files import find_outputs, poses_folder
from prbench.readers.egoallo.format import EgoAlloBody
from prbench.readers.egoallo.to_recording import NO_OUTPUTS
from prbench.readers.found import RecordingFiles
from prbench.recording import PoseStream
from tests.readers.egoallo_files import model, output, rewrite, times_ns, walk, write


@pytest.fixture(autouse=True)
def no_model_in_the_environment(monkeypatch):
    monkeypatch.delenv("PRBENCH_SMPLH_MODEL", raising=False)


@pytest.fixture
def root(tmp_path):
    model(tmp_path / "data")
    return tmp_path / "data"


def _found(root, **options) -> RecordingFiles:
    return RecordingFiles("adt", "rec", root / "rec", find_outputs(root, root / "rec", "rec", **options))


def _body(root, cpf: PoseStream | None = None, **options) -> EgoAlloBody:
    body = read_bodies(_found(root, **options), cpf=cpf or walk())
    assert body is not None
    return body


def test_no_outputs_no_body(root):
    assert _found(root).files == ()
    assert read_bodies(_found(root), cpf=walk()) is None
    assert "prbench poses egoallo" in NO_OUTPUTS


def test_outputs_of_the_first_place_that_has_some(root, tmp_path):
    write(poses_folder(root, "rec"), output(0, 5))
    assert len(_found(root).files) == 2
    write(root / "rec" / "egoallo_outputs", output(0, 6), output(6, 9))
    assert {file.role for file in _found(root).files} == {
        "egoallo/20240101-120000_0-6.npz", "egoallo/20240101-120000_6-9.npz", "smplh_model",
    }  # fmt: skip
    write(poses_folder(root, "rec", tmp_path / "poses"), output(0, 7))
    first = _found(root, poses_root=tmp_path / "poses").files[0]
    assert first.path.parents[2] == tmp_path / "poses"


def test_the_model_named_by_option_then_environment_then_place(root, tmp_path, monkeypatch):
    write(poses_folder(root, "rec"), output())
    assert _found(root).path("smplh_model") == root / "smplh/neutral/model.npz"
    other = model(tmp_path / "other")
    monkeypatch.setenv("PRBENCH_SMPLH_MODEL", str(other))
    assert _found(root).path("smplh_model") == other
    named = model(tmp_path / "named")
    assert _found(root, smplh_model=named).path("smplh_model") == named


def test_windows_are_joined_in_the_order_of_time_and_shared_frames_counted_once(root):
    folder = poses_folder(root, "rec")
    write(folder, output(20, 40, root_height=1.1), output(0, 25, root_height=0.9))
    body = _body(root)
    np.testing.assert_array_equal(body.time_ns, times_ns(0, 40))
    np.testing.assert_allclose(body.joints[:25, 0, 2], 0.9, atol=1e-6)  # the earlier file's frames are kept
    np.testing.assert_allclose(body.joints[25:, 0, 2], 1.1, atol=1e-6)
    assert body.messages == ()


def test_names_of_files_do_not_matter_for_the_order(root):
    folder = poses_folder(root, "rec")
    first = write(folder, output(0, 25, root_height=0.9))
    second = write(folder, output(20, 40, root_height=1.1))
    first.rename(folder / "z.npz")
    second.rename(folder / "a.npz")
    np.testing.assert_allclose(_body(root).joints[:25, 0, 2], 0.9, atol=1e-6)


def test_frames_of_another_phase_do_not_interleave(root):
    folder = poses_folder(root, "rec")
    path = write(folder, output(0, 20), output(10, 30))
    late = folder / "20240101-120000_10-30.npz"
    rewrite(late, timestamps_ns=times_ns(10, 30) + 12_000_000)
    assert path.is_file()
    steps = np.diff(_body(root).time_ns) / 1e6
    assert steps.min() > 20
    assert steps.max() <= 45


def test_a_gap_between_windows_stays_and_is_told(root):
    write(poses_folder(root, "rec"), output(0, 10), output(20, 30))
    body = _body(root)
    assert len(body.time_ns) == 20
    assert body.messages == ("1 gaps of more than 100 ms in the EgoAllo body",)


def test_of_several_samples_the_first_is_taken_and_told(root):
    several = output(samples=3)
    several.world_from_root[1:, :, 4:] += 5.0
    several.world_from_root[1:, :, :4] = several.body_quats[1:, :, 3] = [0.0, 1.0, 0.0, 0.0]  # head down
    several.betas[1:] = 2.0
    write(poses_folder(root, "rec"), several)
    body = _body(root)
    assert body.messages == ("1 of 1 EgoAllo outputs hold several samples; the first is taken",)
    write(poses_folder(root, "rec"), output())
    np.testing.assert_array_equal(body.joints, _body(root).joints)


def test_the_shape_is_averaged_over_time(root):
    wavering = output()
    wavering.betas[0, :, 3] = np.linspace(-1, 3, 12)
    write(poses_folder(root, "rec"), wavering)
    joints = _body(root).joints
    steady = output()
    steady.betas[0, :, 3] = 1.0
    write(poses_folder(root, "rec"), steady)
    np.testing.assert_allclose(joints, _body(root).joints, atol=1e-6)


def test_an_output_of_another_place_or_time_is_refused(root):
    write(poses_folder(root, "rec"), output())
    read_bodies(_found(root), cpf=moved(aside=0.04))
    with pytest.raises(InputFileError, match=r"Ts_world_cpf.*6\.0 cm.*another recording"):
        read_bodies(_found(root), cpf=moved(aside=0.06))
    with pytest.raises(InputFileError, match=r"times of this recording.*belongs to another recording"):
        read_bodies(_found(root), cpf=moved(seconds=60))


def moved(*, aside: float = 0.0, seconds: float = 0.0) -> PoseStream:
    """The glasses of another place or another time."""
    there = walk()
    return replace(there, times=there.times + seconds, position=there.position + np.array([0, aside, 0]))


def test_an_output_within_a_gap_of_the_trajectory_is_kept(root):
    write(poses_folder(root, "rec"), output())
    lost = walk()
    body = read_bodies(
        _found(root),
        cpf=PoseStream(
            np.append(lost.times[0] - 5, lost.times + 60),
            np.vstack([lost.position[:1], lost.position]),
            np.vstack([lost.rotation[:1], lost.rotation]),
            np.append(True, lost.valid),
        ),
    )
    assert body is not None
    np.testing.assert_array_equal(body.joints, _body(root).joints)


def test_without_model_it_is_asked_for(root):
    write(poses_folder(root, "rec"), output())
    (root / "smplh/neutral/model.npz").unlink()
    with pytest.raises(InputFileError, match=r"Extended SMPL\+H model"):
        read_bodies(_found(root), cpf=walk())


@pytest.fixture
def path(tmp_path):
    return write(tmp_path, output())


def test_contacts_and_fingers_may_be_absent_and_quaternions_slightly_long(path):
    rewrite(path, contacts=None, left_hand_quats=None, right_hand_quats=None, frame_nums=None)
    rewrite(path, body_quats=(output().body_quats * np.float32(1.0005)))
    assert len(read_output(path).time_ns) == 12


def test_a_slightly_long_quaternion_is_taken(path):
    rewrite(path, body_quats=(output().body_quats * np.float32(1.0005)))
    assert len(read_output(path).time_ns) == 12
