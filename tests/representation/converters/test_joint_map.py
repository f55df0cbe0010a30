"""Maps of the user's own: what they must hold, and what happens to the rest."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import InputFileError, UsageError
from prbench.geometry.skeleton import Joint
from prbench.representation.converters import JointMap, joint_map, joint_map_by_names
from prbench.representation.converters.named_skeletons import LIMBS
from tests.representation.converters.bodies import joint_errors, person
from tests.representation.converters.foreign import known_motion
from tests.representation.motions import turned

LIMB_NAMES = [joint.name.lower() for joint in LIMBS]
IDENTITY = {name: name for name in LIMB_NAMES}


def test_a_map_picks_mixes_and_offsets() -> None:
    own = JointMap.of("own", (*LIMB_NAMES, "crown"), {**IDENTITY, "head": "crown - 0.2 @above"})
    source = np.zeros((1, 13, 3))
    source[0, :12] = person(1)[0, list(LIMBS)]
    source[0, 12] = 0.0, 1.8, 0.0
    joints = own.to_22(source)
    hips = (joints[0, Joint.LEFT_HIP] + joints[0, Joint.RIGHT_HIP]) / 2
    shoulders = (joints[0, Joint.LEFT_SHOULDER] + joints[0, Joint.RIGHT_SHOULDER]) / 2
    trunk = np.linalg.norm(shoulders - hips)
    assert joints[0, Joint.HEAD] == pytest.approx(np.array([0.0, 1.8 - 0.2 * trunk, 0.0]))
    assert Joint.HEAD not in own.completed
    assert np.array_equal(joints[0, list(LIMBS)], source[0, :12])


def test_completed_joints_turn_and_move_with_the_body() -> None:
    own = JointMap.of("limbs", LIMB_NAMES, IDENTITY)
    limbs = person()[:, list(LIMBS)].astype(np.float64)
    moved = own.to_22(turned(limbs, 1.1) + np.array([2.0, 0.0, 5.0]))
    assert np.allclose(moved, turned(own.to_22(limbs), 1.1) + np.array([2.0, 0.0, 5.0]))
    assert np.allclose(own.to_22(limbs * 1.2), own.to_22(limbs) * 1.2)


def test_from_the_limbs_alone_every_joint_lies_within_a_few_centimetres() -> None:
    own = JointMap.of("limbs", LIMB_NAMES, IDENTITY)
    truth = known_motion()[0]
    errors = joint_errors(own.to_22(truth[:, list(LIMBS)]), truth)
    assert len(own.completed) == 10
    assert max(errors[joint] for joint in LIMBS) < 1e-6
    assert max(errors.values()) < 0.06


def test_a_foot_that_keeps_its_direction_while_the_trunk_turns_costs_a_few_centimetres_more() -> None:
    """Completed feet point to where the trunk does; no limb says that a foot does not."""
    own = JointMap.of("limbs", LIMB_NAMES, IDENTITY)
    truth = person()  # its trunk turns by 60 degrees, its left foot does not
    errors = joint_errors(own.to_22(truth[:, list(LIMBS)]), truth)
    feet = {Joint.LEFT_FOOT, Joint.RIGHT_FOOT}
    assert max(errors[joint] for joint in Joint if joint not in feet) < 0.06
    assert 0.06 < max(errors[joint] for joint in feet) < 0.08


@pytest.mark.parametrize(
    ("source", "given", "message"),
    [
        (LIMB_NAMES, {**IDENTITY, "haed": "left_hip"}, "'haed' is none of the 22 joints. Did you mean 'head'"),
        (LIMB_NAMES, {**IDENTITY, "head": "left_hipp"}, "head: unknown joint 'left_hipp'. Did you mean 'left_hip'"),
        (LIMB_NAMES, {"left_hip": "left_hip"}, "missing: right_hip, left_knee, right_knee, left_ankle"),
        ([*LIMB_NAMES, "left_hip"], IDENTITY, "named more than once: left_hip"),
        (LIMB_NAMES, {**IDENTITY, "left_hip": "left_hip + 0.1 @up"}, "cannot themselves be offset"),
    ],
)
def test_maps_that_cannot_be_meant_are_refused(source, given, message) -> None:
    with pytest.raises(UsageError, match=message):
        JointMap.of("own", source, given)


def test_whole_millimetres_keep_their_fractions() -> None:
    whole = np.round(person(5)[:, list(LIMBS)] * 1000).astype(np.int64)
    joints = JointMap.of("limbs", LIMB_NAMES, IDENTITY).to_22(whole)
    assert np.allclose(joints / 1000, JointMap.of("limbs", LIMB_NAMES, IDENTITY).to_22(whole / 1000))


def test_another_number_of_joints_is_refused() -> None:
    with pytest.raises(InputFileError, match=r"\(frames, 17, 3\) for the skeleton 'coco-17', found \(5, 18, 3\)"):
        joint_map("coco-17").to_22(np.zeros((5, 18, 3)))


def test_an_unknown_skeleton_is_answered_with_the_nearest() -> None:
    with pytest.raises(UsageError, match="Did you mean 'h36m-17'"):
        joint_map("h36m_17")


@pytest.mark.parametrize(
    "rename",
    [
        lambda joint: "mixamorig:" + joint,
        lambda joint: joint.replace("Left", "Left_").replace("Right", "Right_").lower(),
        lambda joint: "Character1:" + joint,
    ],
)
def test_names_of_animation_software_are_matched_in_any_order(rename) -> None:
    mixamo = joint_map("mixamo")
    order = np.random.default_rng(0).permutation(len(mixamo.source_joints))
    names = [rename(mixamo.source_joints[index]) for index in order]
    source = np.empty((3, 22, 3))
    for target, expression in mixamo.expressions.items():
        source[:, mixamo.source_joints.index(expression.joints[0][0])] = person(3)[:, target]
    assert np.allclose(joint_map_by_names(names).to_22(source[:, order]), person(3))


def test_names_without_limbs_are_refused() -> None:
    with pytest.raises(UsageError, match="missing: left_hip"):
        joint_map_by_names(["Hips", "Spine", "Head"])
