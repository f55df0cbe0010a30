"""Distances between hands and objects, and what an unseen hand means."""

from __future__ import annotations

import dataclasses
import sys

import msgspec
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from prbench.curation.in_hand import close_to, contact_distance, find_holdings, held_segments, rests
from prbench.curation.options import CurationOptions
from prbench.errors import MissingExtraError, UsageError
from prbench.protocol.manifests import load_manifest
from prbench.recording import HandStream, ObjectTrack
from tests.curation.scenes import RULE, scene

assert RULE is not None
SURFACE = msgspec.structs.replace(RULE, contact="hand_vertex", target="surface", distance=0.05)
ORIGIN = msgspec.structs.replace(SURFACE, target="origin")
UPRIGHT = np.array([[1.0, 0.0, 0.0, 0.0]])
with_meshes = pytest.mark.usefixtures("open3d_or_slow_loop")


def _hand(points: np.ndarray) -> HandStream:
    """Vertices that rest for a second."""
    return HandStream("left", "hand_vertex", np.array([0.0, 1.0]), np.stack([points] * 2), np.ones(2, dtype=bool))


def _object(mesh: trimesh.Trimesh) -> ObjectTrack:
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return ObjectTrack(
        object_id="1",
        name="thing",
        category="thing",
        times=np.array([0.0, 1.0]),
        position=np.zeros((2, 3)),
        rotation=np.repeat(UPRIGHT, 2, axis=0),
        valid=np.ones(2, dtype=bool),
        box_min=vertices.min(axis=0),
        box_max=vertices.max(axis=0),
        movable=True,
        surface=(vertices, faces),
    )


def _distance(points: np.ndarray, track: ObjectTrack, rule, position=None, rotation=UPRIGHT) -> float:
    place = np.zeros((1, 3)) if position is None else position
    return float(contact_distance(_hand(points), track, rule, np.array([0.5]), place, rotation)[0])


@with_meshes
def test_the_surface_of_a_ball_is_nearer_than_its_origin_and_further_than_its_box() -> None:
    ball = _object(trimesh.creation.icosphere(subdivisions=4, radius=0.06))
    corner = np.array([[0.06, 0.06, 0.06]])
    outside = 0.06 * (np.sqrt(3) - 1)
    assert _distance(corner, ball, SURFACE) == pytest.approx(outside, abs=2e-4)
    assert _distance(corner, ball, ORIGIN) == pytest.approx(0.06 * np.sqrt(3))
    assert _distance(corner, ball, msgspec.structs.replace(SURFACE, target="oriented_box")) == 0.0


@with_meshes
def test_surface_distances_agree_with_an_exact_method() -> None:
    """trimesh's closest points on triangles, for an object that was turned and moved."""
    rng = np.random.default_rng(2)
    mesh = trimesh.creation.torus(major_radius=0.05, minor_radius=0.015)
    turned = trimesh.transformations.random_rotation_matrix(rng.random(3))
    quaternion = trimesh.transformations.quaternion_from_matrix(turned)[None]
    place = np.array([[0.3, -0.2, 1.0]])
    track = _object(mesh)
    for _ in range(6):
        local = rng.normal(0.0, 0.03, (50, 3))
        world = local @ turned[:3, :3].T + place
        corners = np.repeat(np.asarray(mesh.triangles)[None], 50, axis=0).reshape(-1, 3, 3)
        exact = trimesh.triangles.closest_point(corners, np.repeat(local, len(mesh.faces), axis=0))
        expected = np.linalg.norm(exact.reshape(50, -1, 3) - local[:, None], axis=2).min()
        assert _distance(world, track, SURFACE, place, quaternion) == pytest.approx(expected, abs=1e-6)


@with_meshes
def test_beyond_the_rule_s_distance_a_lower_bound_is_enough() -> None:
    ball = _object(trimesh.creation.icosphere(subdivisions=3, radius=0.06))
    far = np.array([[0.0, 0.20, 0.0]])
    assert _distance(far, ball, SURFACE) == pytest.approx(0.14, abs=1e-3)


def test_an_object_without_surface_stands_in_with_its_box() -> None:
    point = dataclasses.replace(
        _object(trimesh.creation.icosphere(radius=0.06)),
        surface=None,
        box_min=np.zeros(3),
        box_max=np.zeros(3),
    )
    assert _distance(np.array([[0.0, 0.0, 0.04]]), point, SURFACE) == pytest.approx(0.04)


def test_many_frames_are_worked_off_in_parts_with_the_same_result() -> None:
    rng = np.random.default_rng(3)
    times = np.linspace(0.0, 10.0, 601)
    points = rng.normal(0.0, 0.1, (601, 788, 3))
    hand = HandStream("left", "hand_vertex", times, points, np.ones(601, dtype=bool))
    ball = _object(trimesh.creation.icosphere(radius=0.06))
    place = rng.normal(0.0, 0.05, (601, 3))
    together = contact_distance(hand, ball, ORIGIN, times, place, np.repeat(UPRIGHT, 601, axis=0))
    assert together == pytest.approx(np.linalg.norm(points - place[:, None], axis=2).min(axis=1))


def test_a_rule_about_surfaces_needs_them() -> None:
    recording = scene()
    with pytest.raises(UsageError, match="--option meshes=true"):
        find_holdings(recording, SURFACE)
    find_holdings(recording, ORIGIN)


def test_hot3d_lists_the_rule_of_the_paper_and_its_alternatives() -> None:
    manifest = load_manifest("hot3d")
    rule = manifest.in_hand_rule(None)
    assert (rule.contact, rule.target, rule.distance) == ("hand_vertex", "origin", 0.05)
    targets = {name: entry.target for name, entry in manifest.in_hand_alternatives.items()}
    assert targets == {"surface": "surface", "box": "oriented_box", "wrist": "oriented_box"}


@pytest.mark.parametrize(
    ("before", "after", "seconds", "resting", "close"),
    [
        pytest.param(0.01, 0.02, 1.5, True, True, id="unseen for a moment between two touches"),
        pytest.param(0.01, 0.02, 2.5, True, False, id="unseen too long"),
        pytest.param(0.01, 0.10, 1.5, True, False, id="it had left"),
        pytest.param(0.10, 0.01, 1.5, True, False, id="it came back"),
        pytest.param(0.01, 0.02, 5.0, False, True, id="the object never rested"),
        pytest.param(0.01, 0.10, 5.0, False, True, id="carried on out of sight"),
        pytest.param(0.10, 0.01, 5.0, False, True, id="carried into sight"),
        pytest.param(0.10, 0.10, 5.0, False, False, id="somebody else carried it"),
    ],
)
def test_a_hand_that_is_unseen_holds_what_it_held_until_that_rests(before, after, seconds, resting, close) -> None:
    times = np.arange(0.0, 10.0, 0.1)
    distance = np.where(times < 4.0, before, after)
    unseen = (times >= 4.0) & (times < 4.0 + seconds - 0.15)
    distance[unseen] = np.inf
    found = close_to(distance, times, np.full(len(times), resting), 0.05)
    assert found[unseen].tolist() == [close] * int(unseen.sum())


def test_unseen_at_the_start_or_the_end_is_close_as_far_as_the_object_moves() -> None:
    times = np.arange(0.0, 1.0, 0.1)
    distance = np.full(10, np.inf)
    distance[4:6] = 0.01
    resting = np.isin(np.arange(10), [0, 1, 2, 7, 8, 9])
    assert np.flatnonzero(close_to(distance, times, resting, 0.05)).tolist() == [3, 4, 5, 6]


@pytest.mark.parametrize(("seconds", "sway", "resting"), [(2.0, 0.001, True), (0.8, 0.001, False), (2.0, 0.02, False)])
def test_what_keeps_its_place_for_a_second_rests(seconds, sway, resting) -> None:
    times = np.arange(0.0, 6.0, 0.1)
    still = (times > 2) & (times < 2.05 + seconds)
    centre = np.column_stack([np.linspace(0.0, sway, len(times)) * len(times) / still.sum(), 0 * times, 0 * times])
    assert rests(times, centre, still, 0.005).tolist() == (still & resting).tolist()


TIMES = np.arange(30) / 10


def mask(text: str) -> np.ndarray:
    """``#`` is True."""
    return np.array([letter == "#" for letter in text.ljust(30, ".")])


def segments(held: str, staying: str = "") -> list[list[int]]:
    found = held_segments(mask(held), mask(staying), TIMES, minimum_duration=0.2, join_gap=0.35)
    return found.tolist()


@pytest.mark.parametrize(
    ("held", "staying", "expected"),
    [
        pytest.param("", "", [], id="nothing"),
        pytest.param("#", "", [], id="a sample"),
        pytest.param("..###", "", [[2, 5]], id="exactly the minimum"),
        pytest.param("..##.", "", [], id="shorter than the minimum"),
        pytest.param("####..####", "", [[0, 10]], id="0.3 s from last to first are bridged"),
        pytest.param("####...####", "", [[0, 4], [7, 11]], id="0.4 s are not"),
        pytest.param("####.........####", "....#########....", [[0, 17]], id="bridged while the hand stays"),
        pytest.param("####.........####", "....####.####....", [[0, 4], [13, 17]], id="the hand leaves"),
        pytest.param("####..####......####", "", [[0, 10], [16, 20]], id="three pieces, two together"),
        pytest.param("##....####", "##########", [[6, 10]], id="a short slide lengthens nothing"),
        pytest.param("##..####", "", [[0, 8]], id="a pause at the beginning"),
    ],
)
def test_segments_by_hand(held: str, staying: str, expected: list[list[int]]) -> None:
    assert segments(held, staying) == expected


@pytest.mark.parametrize(("staying", "expected"), [(".##", [[2, 4]]), ("..##", [])])
def test_a_tracking_gap_beside_a_piece_is_part_of_it_where_the_hand_stays(staying, expected) -> None:
    times = TIMES + 0.3 * (TIMES > 0.15)
    found = held_segments(mask("..##"), mask(staying), times, minimum_duration=0.2, join_gap=0.35)
    assert found.tolist() == expected


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.lists(st.booleans(), min_size=60, max_size=60))
def test_time_reversal_changes_nothing(held: list[bool], staying: list[bool]) -> None:
    n = len(held)
    times = np.arange(n) / 10
    one = held_segments(np.array(held), np.array(staying[:n]), times, minimum_duration=0.2, join_gap=0.35)
    other = held_segments(np.array(held[::-1]), np.array(staying[:n][::-1]), times, minimum_duration=0.2, join_gap=0.35)
    assert one.tolist() == (n - other[::-1, ::-1]).tolist()


def test_without_open3d_that_is_told_before_anything_is_read(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError, match=r"'surface' needs .*pip install 'prbench\[open3d\]'"):
        CurationOptions(in_hand="surface").require_fits(load_manifest("hot3d"))
    CurationOptions().require_fits(load_manifest("mogaze"))  # nothing is asked about meshes
