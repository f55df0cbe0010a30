"""Gaze of Nymeria in the suit's world, on rotations whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import XSENS_SEGMENTS, y_up
from prbench.protocol.manifests import load_manifest
from prbench.readers.aria_mps import format as mps
from prbench_adapters.corpora.nymeria.clock import ClockOffset
from prbench_adapters.corpora.nymeria.recording import gaze_in_suit_world, head_from_device
from prbench_adapters.corpora.nymeria.suit import clean_suit
from tests.adapters.corpora.suits import walking_suit

OFFSET = ClockOffset("file", -3.0)
MOUNTED = Rotation.from_euler("xyz", [20.0, -70.0, 110.0], degrees=True)  # head from glasses
OTHER_WORLD = Rotation.from_euler("z", 40.0, degrees=True)  # the glasses' world has another heading


@pytest.fixture(scope="module")
def clean():
    suit = walking_suit(240 * 20)
    seconds = np.arange(len(suit.time_us)) / 240.0
    about = np.stack([0.4 * np.sin(2 * seconds), 0.6 * np.sin(1.3 * seconds + 1), 0.9 * np.sin(0.9 * seconds)], axis=1)
    rotation = suit.rotation.copy()
    rotation[:, XSENS_SEGMENTS.index("Head")] = Rotation.from_rotvec(about).as_quat(scalar_first=True)
    return clean_suit(replace(suit, rotation=rotation), load_manifest("nymeria"), path="xdata.npz")


def _glasses(clean):
    """Times on the glasses' clock and their rotations, device to their world."""
    piece = clean.pieces[0]
    frames = np.arange(0, piece.stop - piece.first, 2)
    times = piece.start + frames / 240.0 - OFFSET.seconds
    head = Rotation.from_quat(clean.head_rotation[piece.first + frames], scalar_first=True)
    return times, (OTHER_WORLD * head * MOUNTED).as_quat(scalar_first=True)


def test_how_the_glasses_sit_is_found_from_turns_alone(clean):
    found, message = head_from_device(clean, OFFSET, *_glasses(clean))
    assert found is not None, message
    assert (found.inv() * MOUNTED).magnitude() < np.deg2rad(0.1)


def test_glasses_that_turn_otherwise_give_no_gaze(clean):
    times, rotation = _glasses(clean)
    found, message = head_from_device(clean, OFFSET, times, rotation[::-1])
    assert found is None
    assert "turn differently" in message


def test_a_clock_that_was_guessed_gives_no_gaze(clean):
    found, message = head_from_device(clean, ClockOffset("start_alignment", -3.0), *_glasses(clean))
    assert found is None
    assert "clocks" in message


def test_a_fixed_point_in_the_distance_is_seen_in_one_direction_of_the_suits_world(clean):
    piece = clean.pieces[0]
    times = piece.start + np.arange(0.0, 18.0, 0.1)
    frames = piece.first + np.floor((times - piece.start) * 240 + 1e-6).astype(int)
    head = Rotation.from_quat(clean.head_rotation[frames], scalar_first=True)
    # Straight ahead of the pupils in the first frame, Z up.
    ahead = mps.device_from_cpf("DVT-S")[:3, :3] @ [0.0, 0.0, 1.0]
    target = (head[0] * MOUNTED).apply(ahead)
    in_cpf = (head * MOUNTED).inv().apply(target) @ mps.device_from_cpf("DVT-S")[:3, :3]
    yaw, pitch = mps.gaze_angles(in_cpf)
    nothing = np.zeros(len(times))
    angles = mps.GazeAngles(
        (times * 1e6).astype(np.int64), yaw, pitch, nothing, np.zeros((len(times), 2)), np.zeros((len(times), 2))
    )
    directions, valid = gaze_in_suit_world(clean, MOUNTED, times, angles)
    assert 10 < valid.sum() < len(times)  # where the head turns away by more than 60 degrees nothing is measured
    assert np.allclose(directions[valid], y_up(target), atol=1e-6)
    assert np.allclose(directions[~valid], [0.0, 0.0, 1.0])


def test_gaze_outside_the_suits_time_is_not_measured(clean):
    piece = clean.pieces[0]
    times = np.array([piece.start - 1.0, piece.end + 1.0])
    none = np.zeros(2)
    angles = mps.GazeAngles(np.zeros(2, dtype=np.int64), none, none, none, np.zeros((2, 2)), np.zeros((2, 2)))
    _, valid = gaze_in_suit_world(clean, MOUNTED, times, angles)
    assert not valid.any()
