"""The suit's file: cleaned without bridging anything, and mapped to the 22 joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.geometry.skeleton import XSENS_SEGMENTS, Joint, y_up
from prbench.protocol.manifests import load_manifest
from prbench_adapters.corpora.nymeria.format import Suit
from prbench_adapters.corpora.nymeria.suit import clean_suit, measured_head_tilt, read_suit
from tests.adapters.corpora.suits import walking_suit, write_arrays
from tests.fakes import STANDING

MANIFEST = load_manifest("nymeria")


def clean(suit: Suit):
    return clean_suit(suit, load_manifest("nymeria"), path="xdata.npz")


def test_the_published_index_list_is_the_mapping_by_name():
    default = [XSENS_SEGMENTS.index(name) for name in MANIFEST.body.joint_mapping]
    assert default == [1, 19, 15, 2, 20, 16, 3, 21, 17, 4, 22, 18, 5, 11, 7, 6, 12, 8, 13, 9, 14, 10]


@pytest.mark.parametrize("shaped", [False, True])
def test_both_shapes_are_read(tmp_path, shaped):
    suit = walking_suit(600)
    changed = {"segment_tXYZ": suit.position, "segment_qWXYZ": suit.rotation} if shaped else {}
    read = read_suit(write_arrays(tmp_path / "xdata.npz", suit, **changed))
    np.testing.assert_allclose(read.position, suit.position, atol=1e-6)
    np.testing.assert_array_equal(read.time_us, suit.time_us)


def test_a_jump_splits_the_motion_even_where_the_end_point_is_right():
    suit = walking_suit(1800)
    times = suit.time_us.copy()
    times[600:1200] -= 61_400
    pieces = clean(replace(suit, time_us=times)).pieces
    assert [(piece.first, piece.stop) for piece in pieces] == [(0, 600), (600, 1200), (1200, 1800)]
    assert pieces[1].start == pytest.approx(times[600] / 1e6)


@pytest.mark.parametrize(("off_us", "n_pieces"), [(990, 1), (1010, 2)])
def test_a_step_of_one_millisecond_is_the_border(off_us, n_pieces):
    suit = walking_suit(1200)
    times = suit.time_us.copy()
    times[600:] += off_us + 1  # the nominal step is 4166.67 us
    assert len(clean(replace(suit, time_us=times)).pieces) == n_pieces


def test_pieces_shorter_than_two_seconds_are_left_out():
    suit = walking_suit(1200)
    times = suit.time_us.copy()
    times[480:] += 10_000_000  # 479 steps: 1.996 s
    assert [piece.first for piece in clean(replace(suit, time_us=times)).pieces] == [480]


def test_frames_without_position_are_never_bridged():
    suit = walking_suit(1400)
    position = suit.position.copy()
    position[600:603, 5] = np.nan
    cleaned = clean(replace(suit, position=position))
    assert [(piece.first, piece.stop) for piece in cleaned.pieces] == [(0, 600), (603, 1400)]
    assert "3 frames without position" in cleaned.messages[0]


def test_a_recording_without_a_usable_piece_is_refused():
    suit = walking_suit(600)
    position = suit.position.copy()
    position[::100] = np.nan
    with pytest.raises(InputFileError, match=r"at least 2 s of steady 240 Hz.*6 frames"):
        clean(replace(suit, position=position))


def test_missing_rotations_repeat_the_one_before_and_begin_as_identity():
    suit = walking_suit(600)
    rotation = suit.rotation.copy()
    rotation[:, 6] = [0.6, 0.8, 0.0, 0.0]
    rotation[:2, 6] = 0.0
    rotation[300:302, 6] = 0.04
    filled = clean(replace(suit, rotation=rotation)).head_rotation
    np.testing.assert_allclose(filled[:2], [[1, 0, 0, 0]] * 2)
    np.testing.assert_allclose(filled[300:302], [[0.6, 0.8, 0, 0]] * 2)


def test_a_body_on_its_head_is_refused():
    suit = walking_suit(600)
    with pytest.raises(InputFileError, match="Z up"):
        clean(replace(suit, position=suit.position * [1.0, 1.0, -1.0]))


def test_the_suit_world_becomes_y_up():
    np.testing.assert_allclose(y_up(np.array([1.0, 2.0, 3.0])), [1.0, 3.0, -2.0])


def test_joints_keep_their_shape_and_walk_where_they_face():
    joints = clean(walking_suit(1200)).pieces[0].joints
    body = joints[0] - joints[0, Joint.PELVIS]
    expected = STANDING - STANDING[Joint.PELVIS]
    np.testing.assert_allclose(np.linalg.norm(body, axis=1), np.linalg.norm(expected, axis=1), atol=1e-9)
    np.testing.assert_allclose(body[:, 1], expected[:, 1], atol=1e-9)
    way = joints[-1, 0] - joints[0, 0]
    left = joints[0, Joint.LEFT_HIP] - joints[0, Joint.RIGHT_HIP]
    assert np.cross(left, [0.0, 1.0, 0.0]) @ way > 0.0


def test_a_body_that_walks_backwards_has_its_sides_swapped():
    with pytest.raises(InputFileError, match="Left and right"):
        clean(walking_suit(1200, speed=-0.8))


def test_a_body_that_hardly_moves_is_judged_by_its_pelvis_segment():
    assert not clean(walking_suit(1200, speed=0.0)).messages
    turned = walking_suit(1200, speed=0.0)
    rotation = turned.rotation.copy()
    rotation[:, 0] = [0.0, 0.0, 0.0, 1.0]  # x axis backwards
    with pytest.raises(InputFileError, match="pelvis segment"):
        clean(replace(turned, rotation=rotation))
    walking = replace(walking_suit(1200), rotation=rotation)
    assert clean(walking).messages == ("the pelvis segment's x axis points backwards",)


def test_the_head_tilt_is_measured_on_the_calibration_pose():
    suit = walking_suit(600)
    bone = STANDING[Joint.HEAD] - STANDING[Joint.NECK]
    assert measured_head_tilt(suit) == pytest.approx(np.rad2deg(np.arctan2(bone[2], bone[1])), abs=1e-3)
    assert measured_head_tilt(replace(suit, tpose=None)) is None
    assert clean(replace(suit, tpose=None)).head_tilt_deg == MANIFEST.body.head_tilt_deg
