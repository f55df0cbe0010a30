"""Where a generated motion comes to stand."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.geometry.skeleton import Joint, bone_lengths, facing_yaw, z_up
from prbench.representation import canonicalise
from prbench.representation.converters import (
    in_frame_of,
    on_body_of,
    on_floor,
    padded,
    placed_on,
    to_canonical,
)
from tests.fakes import STANDING
from tests.representation.converters.bodies import person
from tests.representation.motions import turned


def test_a_canonical_motion_comes_back_from_any_world() -> None:
    elsewhere = z_up(turned(person(), 2.2) + np.array([3.0, 0.4, -7.0])) * 1000
    back = to_canonical(elsewhere, 20.0, up="z", unit="mm")
    assert back.dtype == np.float32
    assert np.allclose(back, person(), atol=2e-5)


def test_60_fps_become_20_by_time() -> None:
    times = np.arange(121) / 60
    fast = np.stack([np.interp(times, np.arange(240) / 20, column) for column in person().reshape(240, -1).T], axis=1)
    back = to_canonical(fast.reshape(-1, 22, 3), 60.0, n_frames=41)
    assert np.allclose(back, canonicalise(person()[:41]), atol=1e-4)


def test_the_wrong_up_axis_is_named() -> None:
    with pytest.raises(InputFileError, match="axis that points up"):
        to_canonical(z_up(person()), 20.0)


@pytest.mark.parametrize("yaw", [0.0, 1.0, np.pi, -2.5])
def test_a_moved_and_turned_copy_is_put_back_exactly(yaw) -> None:
    moved = (turned(person(), yaw) + np.array([5.0, -0.3, 2.0])).astype(np.float32)
    assert np.allclose(placed_on(moved, person()[0]), person(), atol=3e-6)


def test_placing_moves_the_motion_as_one() -> None:
    other = canonicalise(person(100, 700))
    placed = placed_on(other, person()[0])
    assert np.allclose(bone_lengths(placed), bone_lengths(other), atol=1e-6)
    assert facing_yaw(placed[0]) == pytest.approx(facing_yaw(person()[0]), abs=1e-6)
    assert np.allclose(placed[0, Joint.PELVIS], person()[0, Joint.PELVIS], atol=1e-6)


def test_height_by_pelvis_or_by_floor() -> None:
    taller = (person() * np.float32(1.1)).astype(np.float32)
    by_pelvis = placed_on(taller, person()[0])
    by_floor = placed_on(taller, person()[0], height="floor")
    assert by_pelvis[0, 0, 1] == pytest.approx(person()[0, 0, 1], abs=1e-6)
    assert by_pelvis[..., 1].min() < -0.05  # the longer legs reach below the floor
    assert by_floor[..., 1].min() == pytest.approx(0, abs=1e-6)


def test_a_pose_without_heading_is_named() -> None:
    folded = STANDING.astype(np.float32).copy()
    folded[:, 0] = folded[:, 2] = 0.0
    with pytest.raises(InputFileError, match="initial_joints, frame 0: expected a pose with a heading"):
        placed_on(person(), folded)


def test_on_the_body_of_the_initial_pose_bones_are_the_person_s_and_feet_keep_their_steps() -> None:
    smaller = (person() * np.float32(0.8)).astype(np.float32)
    grown = on_body_of(smaller, person()[0])
    assert np.allclose(bone_lengths(grown), bone_lengths(person()[0]), atol=1e-5)
    assert np.allclose(placed_on(grown, person()[0]), person(), atol=1e-4)


def test_bones_of_another_body_keep_their_directions() -> None:
    rng = np.random.default_rng(0)
    stretched = STANDING * rng.uniform(0.9, 1.1, size=(1, 3))
    ours = on_body_of(person(), stretched.astype(np.float32))
    assert np.allclose(bone_lengths(ours), bone_lengths(stretched), atol=1e-5)
    bone = ours[:, Joint.LEFT_WRIST] - ours[:, Joint.LEFT_ELBOW]
    same = person()[:, Joint.LEFT_WRIST] - person()[:, Joint.LEFT_ELBOW]
    cosine = (bone * same).sum(-1) / np.linalg.norm(bone, axis=-1) / np.linalg.norm(same, axis=-1)
    assert np.allclose(cosine, 1, atol=1e-5)


def test_on_floor() -> None:
    assert on_floor(person() + np.float32(0.7))[..., 1].min() == pytest.approx(0, abs=1e-6)


def test_in_the_frame_of_the_given_frames() -> None:
    world = turned(person(), 1.3) + np.array([1.0, 0.2, -2.0])
    assert np.allclose(in_frame_of(world[10:], world), person()[10:], atol=1e-5)


def test_padding_repeats_the_last_frame() -> None:
    batch = padded([person(3), person(5)])
    assert batch.shape == (2, 5, 22, 3)
    assert np.array_equal(batch[0, 3], person(3)[2])
    assert np.array_equal(batch[1], person(5))
