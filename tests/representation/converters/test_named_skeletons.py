"""Maps of joints: known skeletons give a known motion back, with the errors that the guide states; maps of the user."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from prbench.geometry.skeleton import XSENS_SEGMENTS, Joint, bone_lengths, head_forward
from prbench.protocol.manifests import load_manifest
from prbench.representation import mirror
from prbench.representation.converters import (
    JOINT_MAPS,
    JointMap,
    check_limbs,
    check_sides,
    joint_map,
    joint_map_by_names,
)
from prbench.representation.converters.named_skeletons import LIMBS, parse_expression
from tests.representation.converters.bodies import joint_errors, person
from tests.representation.converters.foreign import known_motion, seen_as
from tests.representation.motions import turned

GUIDE = Path(__file__).parents[3] / "docs" / "wrapping.md"


TILT = 38.3  # degrees, of the person's own neck-head bone


EXACT = {"humanml3d-22", "humanml3d-chains", "xsens-23", "mixamo", *(name for name in JOINT_MAPS if name[:4] == "smpl")}


def head_error(joints: np.ndarray, truth: np.ndarray) -> float:
    """Mean angle between the two head-forward vectors, degrees."""
    found, wanted = head_forward(joints, TILT)[0], head_forward(truth, TILT)[0]
    return float(np.rad2deg(np.arccos(np.clip((found * wanted).sum(axis=-1), -1, 1))).mean())


def measured(skeleton: str) -> tuple[float, float, str, float]:
    """Mean and worst joint error (cm) with the worst joint's name, and the error of the head's direction (degrees)."""
    truth = known_motion()[0]
    joints = JOINT_MAPS[skeleton].to_22(seen_as(skeleton))
    errors = joint_errors(joints, truth)
    worst = max(errors, key=lambda joint: errors[joint])
    mean = float(np.mean(list(errors.values())))
    return 100 * mean, 100 * errors[worst], worst.name.lower(), head_error(joints, truth)


@pytest.mark.parametrize("skeleton", sorted(EXACT))
def test_skeletons_that_have_all_22_joints_lose_nothing(skeleton) -> None:
    assert np.array_equal(JOINT_MAPS[skeleton].to_22(seen_as(skeleton)), known_motion()[0])


@pytest.mark.parametrize("skeleton", sorted(set(JOINT_MAPS) - EXACT))
def test_skeletons_with_fewer_joints_give_a_plausible_person_close_to_the_known_one(skeleton) -> None:
    joints = JOINT_MAPS[skeleton].to_22(seen_as(skeleton))
    truth = known_motion()[0]
    errors = joint_errors(joints, truth)
    assert max(errors[joint] for joint in LIMBS) < 1e-9
    assert max(errors.values()) < 0.05
    check_sides(joints)
    check_limbs(joints)
    lengths, true_lengths = bone_lengths(joints), bone_lengths(truth)
    assert np.all(np.median(lengths, axis=0) > 0.4 * np.median(true_lengths, axis=0))
    assert np.all(np.median(lengths, axis=0) < 2.0 * np.median(true_lengths, axis=0))


@pytest.mark.parametrize("skeleton", sorted(set(JOINT_MAPS) - EXACT))
def test_the_guide_states_what_is_measured(skeleton) -> None:
    row = re.search(rf"^\| `{skeleton}` \|(.*)\|$", GUIDE.read_text(encoding="utf-8"), re.MULTILINE)
    assert row is not None
    cells = [cell.strip() for cell in row[1].split("|")]
    mean, worst, name, angle = measured(skeleton)
    assert cells[-3:] == [f"{mean:.1f}", f"{worst:.1f} ({name})", f"{angle:.0f}"]


def swapped(name: str) -> str:
    """The joint of the other side."""
    for left, right in (("left", "right"), ("Left", "Right"), ("L_", "R_")):
        if left in name and not name.startswith("joint_"):
            return name.replace(left, right)
        if right in name:
            return name.replace(right, left)
    return name


@pytest.mark.parametrize("skeleton", sorted(JOINT_MAPS))
def test_a_mirrored_source_gives_the_mirrored_person(skeleton) -> None:
    """So every left joint of a map is the counterpart of its right one."""
    known = JOINT_MAPS[skeleton]
    names = known.source_joints
    chains = {1: 6, 2: 7, 3: 8, 4: 9, 17: 22, 18: 23, 19: 24, 20: 25}
    other = {index: swapped(name) for index, name in enumerate(names)}
    order = [names.index(other[index]) if other[index] in names else index for index in range(len(names))]
    seen = seen_as(skeleton)
    mirrored = seen[:, order] * np.array([-1.0, 1.0, 1.0])
    if skeleton == "humanml3d-chains":
        assert [names[first].replace("right", "left") for first in chains] == [
            names[second] for second in chains.values()
        ]
    assert np.allclose(known.to_22(mirrored), mirror(known.to_22(seen)))


@pytest.mark.parametrize(
    ("skeleton", "numbers"),
    [
        # as the formats publish them: hips, knees, ankles, shoulders, elbows, wrists; left before right
        ("smpl-24", (1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21)),
        ("smplx-127", (1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21)),
        ("coco-17", (11, 12, 13, 14, 15, 16, 5, 6, 7, 8, 9, 10)),
        ("openpose-25", (12, 9, 13, 10, 14, 11, 5, 2, 6, 3, 7, 4)),
        ("ntu-25", (12, 16, 13, 17, 14, 18, 4, 8, 5, 9, 6, 10)),
        ("h36m-17", (4, 1, 5, 2, 6, 3, 11, 14, 12, 15, 13, 16)),
        ("h36m-32", (6, 1, 7, 2, 8, 3, 17, 25, 18, 26, 19, 27)),
        ("mediapipe-33", (23, 24, 25, 26, 27, 28, 11, 12, 13, 14, 15, 16)),
        ("xsens-23", (19, 15, 20, 16, 21, 17, 12, 8, 13, 9, 14, 10)),
    ],
)
def test_limbs_stand_at_their_published_numbers(skeleton, numbers) -> None:
    known = JOINT_MAPS[skeleton]
    names = [known.expressions[limb].joints[0][0] for limb in LIMBS]
    assert [known.source_joints.index(name) for name in names] == list(numbers)


@pytest.mark.parametrize(
    ("skeleton", "target", "numbers"),
    [
        ("coco-17", Joint.HEAD, {3, 4}),
        ("openpose-25", Joint.HEAD, {17, 18}),
        ("openpose-25", Joint.LEFT_FOOT, {14, 19, 20}),
        ("openpose-25", Joint.RIGHT_FOOT, {11, 22, 23}),
        ("mediapipe-33", Joint.HEAD, {7, 8}),
        ("mediapipe-33", Joint.LEFT_FOOT, {27, 31}),
        ("mediapipe-33", Joint.RIGHT_FOOT, {28, 32}),
        ("ntu-25", Joint.NECK, {2}),
        ("ntu-25", Joint.HEAD, {2, 3}),
        ("ntu-25", Joint.LEFT_FOOT, {15}),
        ("ntu-25", Joint.RIGHT_FOOT, {19}),
        ("h36m-17", Joint.HEAD, {9, 10}),
        ("h36m-17", Joint.NECK, {8, 9}),
        ("h36m-32", Joint.HEAD, {14, 15}),
        ("h36m-32", Joint.LEFT_FOOT, {9}),
        ("h36m-32", Joint.RIGHT_FOOT, {4}),
    ],
)
def test_other_joints_are_made_of_the_published_numbers(skeleton, target, numbers) -> None:
    known = JOINT_MAPS[skeleton]
    assert {known.source_joints.index(name) for name, _ in known.expressions[target].joints} == numbers


@pytest.mark.parametrize(
    ("skeleton", "count"), [(name, int(name.rsplit("-", 1)[1])) for name in JOINT_MAPS if name[-1].isdigit()]
)
def test_the_number_in_the_name_is_that_of_the_joints(skeleton, count) -> None:
    assert len(JOINT_MAPS[skeleton].source_joints) == count


def test_the_suit_is_mapped_as_the_corpus_reader_maps_it() -> None:
    mapping = load_manifest("nymeria").body.joint_mapping
    ours = [JOINT_MAPS["xsens-23"].expressions[joint].joints[0][0] for joint in Joint]
    assert ours == list(mapping)
    assert set(mapping) <= set(XSENS_SEGMENTS)


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


def test_whole_millimetres_keep_their_fractions() -> None:
    whole = np.round(person(5)[:, list(LIMBS)] * 1000).astype(np.int64)
    joints = JointMap.of("limbs", LIMB_NAMES, IDENTITY).to_22(whole)
    assert np.allclose(joints / 1000, JointMap.of("limbs", LIMB_NAMES, IDENTITY).to_22(whole / 1000))


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


KNOWN = ("Hips", "Left Hand", "neck", "head", "j1")


@pytest.mark.parametrize(
    ("text", "joints", "axes"),
    [
        ("neck", (("neck", 1.0),), ()),
        ("neck + head", (("neck", 0.5), ("head", 0.5)), ()),
        ("0.25 neck + .75 head", (("neck", 0.25), ("head", 0.75)), ()),
        ("1.5 neck - 0.5 Hips", (("neck", 1.5), ("Hips", -0.5)), ()),
        ("neck + 0.1 @up - 0.2 @forward", (("neck", 1.0),), (("@up", 0.1), ("@forward", -0.2))),
        ("Left Hand", (("Left Hand", 1.0),), ()),
    ],
)
def test_what_can_be_said(text, joints, axes) -> None:
    read = parse_expression(text, KNOWN, where="map")
    assert (read.joints, read.axes) == (joints, axes)
