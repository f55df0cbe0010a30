"""Axes, units, rates and bodies of other worlds, and where a generated motion comes to stand."""

from __future__ import annotations

import re

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.geometry.skeleton import PARENTS, Joint, bone_lengths, facing_yaw, z_up
from prbench.representation import canonicalise
from prbench.representation.converters import (
    at_rate,
    at_times,
    check_limbs,
    check_sides,
    frames_needed,
    front_of_legs,
    in_frame_of,
    on_body_of,
    on_floor,
    padded,
    placed_on,
    to_canonical,
    to_y_up,
)
from tests.fakes import STANDING
from tests.representation.converters.bodies import person
from tests.representation.motions import golden, turned


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


UP = {"x": (1, 0, 0), "-x": (-1, 0, 0), "y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1)}


@pytest.mark.parametrize("up", UP)
def test_the_axis_that_points_up_becomes_y_by_a_rotation(up) -> None:
    turned = to_y_up(np.array([UP[up], (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float), up=up)
    assert turned[0].tolist() == [0, 1, 0]
    assert np.linalg.det(turned[1:]) == pytest.approx(1)


def test_z_up_is_the_inverse_of_the_library_s_own_turn() -> None:
    assert np.allclose(to_y_up(z_up(person(5)), up="z"), person(5), atol=0)


def test_camera_coordinates_have_y_down_and_z_forward() -> None:
    assert to_y_up(np.array([[0.2, -1.5, 3.0]]), up="-y").tolist() == [[0.2, 1.5, -3.0]]


@pytest.mark.parametrize("up", UP)
def test_a_left_handed_world_is_mirrored_and_keeps_its_up_axis(up) -> None:
    turned = to_y_up(np.array([UP[up], (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float), up=up, left_handed=True)
    assert turned[0].tolist() == [0, 1, 0]
    assert np.linalg.det(turned[1:]) == pytest.approx(-1)


@pytest.mark.parametrize(("unit", "metres"), [("cm", 0.01), ("mm", 0.001), (0.5, 0.5)])
def test_units_become_metres(unit, metres) -> None:
    assert to_y_up(np.ones((1, 3)), unit=unit) == pytest.approx(metres)


def test_millimetres_in_whole_numbers_are_not_cut_to_metres() -> None:
    assert to_y_up(np.array([[1, 1450, 3]]), unit="mm").tolist() == [[0.001, 1.45, 0.003]]


def line(times: np.ndarray) -> np.ndarray:
    """A point that moves at 1, 2 and 3 m/s."""
    return times[:, None] * np.array([1.0, 2.0, 3.0])


@pytest.mark.parametrize("fps", [12.5, 20.0, 29.97, 30.0, 60.0, 100.0, 120.0])
def test_any_rate_comes_to_the_same_motion_at_20_fps(fps) -> None:
    wanted = 101
    n = frames_needed(wanted, fps)
    got = at_rate(line(np.arange(n) / fps), fps, n_frames=wanted)
    assert np.allclose(got, line(np.arange(wanted) / 20), atol=1e-9)
    with pytest.raises(InputFileError, match=r"5\.000 s of motion"):  # one frame fewer does not cover it
        at_rate(line(np.arange(n - 1) / fps), fps, n_frames=wanted)


def test_as_many_frames_as_the_motion_covers() -> None:
    assert len(at_rate(np.zeros((31, 2)), 30.0)) == 21
    assert len(at_rate(np.zeros((30, 2)), 30.0)) == 20
    assert len(at_rate(np.zeros((1, 2)), 30.0)) == 1


def test_uneven_times_are_taken_as_they_are() -> None:
    times = 7.0 + np.array([0.0, 0.04, 0.11, 0.2, 0.31])
    assert np.allclose(at_times(times, line(times)), line(7.0 + np.arange(7) / 20))


def standing() -> np.ndarray:
    """The person at a place of work, whose feet, knees, hips and shoulders face one way."""
    return person(start=600)


def test_a_person_in_order_points_to_the_front_and_is_let_through() -> None:
    # Feet and shoulders of who walks do not turn into the way at the same time.
    for joints, least in ((standing(), 0.95), (person(), 0.8)):
        for feet in (True, False):
            front = front_of_legs(joints, feet=feet)
            assert front is not None
            assert front > least
        check_sides(joints)
        check_limbs(joints)


def test_a_left_handed_world_is_named_and_left_handed_repairs_it() -> None:
    unity = person() * np.array([1, 1, -1], dtype=np.float32)
    assert np.allclose(to_canonical(unity, 20.0, left_handed=True), person(), atol=1e-5)


def test_the_front_does_not_depend_on_the_heading() -> None:
    for yaw in (0.5, 2.0, -2.9):
        assert front_of_legs(turned(person(), yaw)) == pytest.approx(front_of_legs(person()), abs=1e-6)


def test_straight_legs_without_feet_say_nothing() -> None:
    straight = STANDING.copy()
    for knee, hip, ankle in ((4, 1, 7), (5, 2, 8)):
        straight[knee] = (straight[hip] + straight[ankle]) / 2
    assert front_of_legs(straight[None], feet=False) is None
    check_sides(straight[None], feet=False)


def test_normalised_bodies_are_told_the_factor() -> None:
    normalised = person() / np.float32(10.0)
    with pytest.raises(InputFileError, match=r"unit=[\d.]+ \(metres a unit\) makes them adults") as refusal:
        check_limbs(normalised)
    told = re.search(r"unit=([\d.]+)", str(refusal.value))
    assert told is not None
    adult = normalised * float(told[1])
    check_limbs(adult)
    # People differ in size; thighs, shins and arms of the median adult are 33 cm long.
    ends = [Joint[f"{side}_{end}"] for side in ("LEFT", "RIGHT") for end in ("KNEE", "ANKLE", "ELBOW", "WRIST")]
    lengths = [np.linalg.norm(adult[:, end] - adult[:, PARENTS[end]], axis=-1).mean() for end in ends]
    assert np.median(lengths) == pytest.approx(0.33, rel=0.01)


def test_a_child_is_a_person(samples) -> None:
    check_limbs(golden(samples, "child")["joints_in"])
