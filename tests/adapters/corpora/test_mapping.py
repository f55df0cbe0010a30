"""The report on the mapping of suits to 22 joints: what is wrong is named with its place, and fits decide with data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import XSENS_SEGMENTS, Joint, z_up
from prbench.protocol.manifests import load_manifest
from prbench_adapters.corpora.nymeria.format import SMPL_FILE, Suit
from tests.adapters.corpora.suits import walking_suit, write_arrays
from tests.cli.reports import refused, reported
from tests.representation.converters.bodies import person_rotations, write_body_model

NAME = "20230607_s0_james_johnson_act0_e72nhq"
FOREARM, HAND, TOE = (XSENS_SEGMENTS.index(name) for name in ("L_Forearm", "L_Hand", "R_Toe"))


def placed(root: Path, suit: Suit, **changed) -> Path:
    folder = root / NAME / "body"
    folder.mkdir(parents=True, exist_ok=True)
    return write_arrays(folder / "xdata.npz", suit, **changed)


def study(root: Path, capsys, *words: str, code: int = 0):
    return reported(["study", "nymeria-mapping", "--root", str(root), *words], capsys, code=code)


def numbers(table, row: int) -> dict[str, float]:
    return {cell.metric: cell.value for cell in table.blocks[0].rows[row].cells}


def test_a_sound_suit_has_constant_bones_equal_sides_and_a_level_floor(tmp_path, capsys) -> None:
    placed(tmp_path, walking_suit(6000))
    report = study(tmp_path, capsys)
    assert report.failed == {}
    found = numbers(report.tables[0], 0)
    assert found["bone off by"] < 1e-3
    assert found["left - right"] < 1e-3
    assert found["drift"] == pytest.approx(0.0, abs=1e-3)
    assert found["head above foot"] > 1.3


def test_the_worst_bone_is_named_with_its_frame(tmp_path, capsys) -> None:
    suit = walking_suit(6000)
    along = suit.position[0, HAND] - suit.position[0, FOREARM]
    suit.position[5123, HAND] += 0.004 * along / np.linalg.norm(along)
    placed(tmp_path, suit)
    report = study(tmp_path, capsys, code=1)
    assert report.failed[NAME].startswith("corrupt: left_wrist is 4.0 mm off its length in frame 5123")


def test_sides_floor_and_drift_are_told(tmp_path, capsys) -> None:
    suit = walking_suit(7200)
    suit.position[:, TOE, 0] += 0.010
    suit.position[..., 2] += 0.5 + np.repeat([0.0, 0.02, 0.03], 2400)[:, None]
    placed(tmp_path, suit)
    still = numbers(study(tmp_path, capsys).tables[0], 0)
    floor = suit.position[:, :, 2].min()
    assert still["drift"] == pytest.approx(3.0, abs=1e-3)
    assert still["floor"] == pytest.approx(floor + 0.02, abs=1e-5)
    assert 1.0 < still["left - right"] < 10.5


def test_lost_positions_and_rotations_are_counted(tmp_path, capsys) -> None:
    suit = walking_suit(3000)
    suit.position[100:110, 3] = np.nan
    suit.rotation[2000:2007, 6] = 0.0
    placed(tmp_path, suit)
    report = study(tmp_path, capsys)
    said = " ".join(report.tables[0].notes)
    assert "10 frames without a position" in said
    assert "7 frames with a segment without rotation" in said


def with_fit(root: Path, *, mapping: str = "anatomical", **changed) -> Path:
    """A suit of a moving person, and an SMPL fit of the same motion in a world of its own; the model's path."""
    joints, rotations = person_rotations(240)
    joints, rotations = (np.concatenate([each] * 20) for each in (joints, rotations))
    suit = walking_suit(len(joints))
    points = np.zeros((len(joints), len(XSENS_SEGMENTS), 3))
    for joint, segment in enumerate(load_manifest("nymeria").body.joint_mapping):
        points[:, XSENS_SEGMENTS.index(segment)] = joints[:, joint]
    points[:, 0] = joints[:, [Joint.LEFT_HIP, Joint.RIGHT_HIP]].mean(axis=1)
    if mapping == "named":  # a suit whose segments lie one joint lower than SMPL's trunk
        points[:, :5] = np.concatenate([joints[:, [0, 3, 6, 9]], joints[:, 9:10]], axis=1)
    placed(root, replace(suit, position=z_up(points)))
    rest = write_body_model(root / "SMPL_NEUTRAL.npz", joints=24)
    turn = Rotation.from_euler("xyz", (40, 130, -20), degrees=True).as_matrix()
    world = rotations.copy()
    world[:, 0] = turn @ rotations[:, 0]
    pose = Rotation.from_matrix(world.reshape(-1, 3, 3)).as_rotvec().reshape(len(world), 66)
    arrays = {
        "timestamps": suit.time_us,
        "global_orient": pose[:, :3],
        "body_pose": np.pad(pose[:, 3:], ((0, 0), (0, 6))),
        "transl": joints[:, 0] @ turn.T + (3.0, 1.0, -2.0) - rest[0],
        "betas": np.zeros((len(joints), 10)),
    }
    np.savez(root / NAME / "body" / SMPL_FILE, **{**arrays, **changed})
    return root / "SMPL_NEUTRAL.npz"


@pytest.mark.parametrize(("mapping", "other"), [("anatomical", "named"), ("named", "anatomical")])
def test_the_variant_whose_joints_are_those_of_the_fit_is_nearest(tmp_path, capsys, mapping, other) -> None:
    model = with_fit(tmp_path, mapping=mapping)
    report = study(tmp_path, capsys, "--smpl", str(model))
    *joints, trunk = (numbers(report.tables[1], row) for row in range(23))
    assert max(each[f"{mapping} p95"] for each in joints) < 0.1
    assert trunk[f"{mapping} p50"] < 0.1 < 3.0 < trunk[f"{other} p50"]


TIMES = walking_suit(4800).time_us


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"body_pose": np.zeros((700, 69))}, "body_pose: expected the shape (4800, 69), found (700, 69)"),
        ({"timestamps": TIMES + 60_000_000}, "expected 100 times of the suit, found 0"),
        ({"timestamps": TIMES[::-1]}, "expected increasing"),
        ({"transl": np.random.default_rng(0).normal(size=(4800, 3)) * 100}, "not in metres"),
        ({"transl": np.full((4800, 3), np.nan)}, "finite"),
    ],
)
def test_fits_that_do_not_fit_are_refused(tmp_path, capsys, changed, says) -> None:
    model = with_fit(tmp_path, **changed)
    assert says in study(tmp_path, capsys, "--smpl", str(model), code=1).failed[NAME]


def test_bad_suits_and_wrong_usage_are_answered(tmp_path, capsys) -> None:
    suit = walking_suit(600)
    placed(tmp_path, suit, segment_tXYZ=suit.position[:500].reshape(500, -1))
    assert "segment_tXYZ: expected numbers of the shape (600, 69)" in study(tmp_path, capsys, code=1).failed[NAME]
    placed(tmp_path, suit, segment_tXYZ=-suit.position.reshape(600, -1))
    assert "Z up: the head above the feet" in study(tmp_path, capsys, code=1).failed[NAME]
    words = ["study", "nymeria-mapping"]
    refused(words, capsys, code=2, message="name one --root DIR")
    words += ["--root", str(tmp_path), "--smpl", str(tmp_path / "none.npz")]
    refused(words, capsys, code=3, message="expected your own body model, found no such file")
