"""Joints are found by the names that other programs give them."""

from __future__ import annotations

import pytest

from prbench.geometry.skeleton import Joint, match_names, normalised
from tests.readers.gimo_sample import skeleton


@pytest.mark.parametrize("name", ["LeftUpLeg", "left_up_leg", "Actor:L_UpLeg", "mixamorig:LeftUpLeg", "Left Up-Leg"])
def test_spellings_of_one_name_are_one(name) -> None:
    assert normalised(name) == "leftupleg"


def test_shoulder_means_collar_or_shoulder_by_the_names_beside_it() -> None:
    sides = [
        f"{side}{part}"
        for part in ("Hip", "Knee", "Ankle", "Toe", "Collar", "Shoulder", "Elbow", "Wrist")
        for side in ("Left", "Right")
    ]
    joints = ["Hips", "Chest", "Spine", "Spine1", "Neck", "Head", *sides]
    columns, _, _ = match_names(joints)
    names = [joints[column] for column in columns]
    assert -1 not in columns
    assert names[Joint.LEFT_SHOULDER] == "LeftShoulder"
    assert names[Joint.LEFT_COLLAR] == "LeftCollar"
    assert [names[Joint.SPINE1], names[Joint.SPINE2], names[Joint.SPINE3]] == ["Spine", "Spine1", "Chest"]
    suit = [joint.name for joint in skeleton().joints]
    of_suit, _, _ = match_names(suit)
    assert suit[of_suit[Joint.LEFT_COLLAR]] == "LeftShoulder"
    assert suit[of_suit[Joint.LEFT_SHOULDER]] == "LeftArm"


def test_names_that_nobody_knows_are_told() -> None:
    columns, unmatched, _ = match_names(["Hips", "Schwanz"])
    assert unmatched == ("Schwanz",)
    assert columns.count(-1) == 21
