"""Looks through meshes: marked, or not counted."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

from prbench.curation import CurationOptions, curate_recording
from prbench.curation.priming import MARGIN, Surroundings
from prbench.errors import MissingExtraError, UsageError
from prbench.protocol.manifests import load_manifest
from prbench.recording import Occluder, Recording
from tests.curation.scenes import EYE, LOOK_A, LOOK_B, MANIFEST, PLACE_A, PLACE_B, PROTOCOL, clock, gaze, scene, track

TWO_TRIANGLES = np.array([(0, 1, 2), (0, 2, 3)])
MARK, REQUIRE = CurationOptions(occlusion="mark"), CurationOptions(occlusion="require")

pytestmark = pytest.mark.usefixtures("open3d_or_slow_loop")


def pane(x: tuple[float, float], y: tuple[float, float], z: float) -> np.ndarray:
    """Corners of an upright rectangle that faces the person."""
    return np.array([(x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z)])


def wall(*panes: np.ndarray, name: str = "wall", object_id: str | None = None) -> Occluder:
    """Some rectangles in one mesh."""
    faces = np.concatenate([TWO_TRIANGLES + 4 * number for number in range(len(panes))])
    return Occluder(name, np.concatenate(panes), faces, object_id)


WHOLE = wall(pane((-3.0, 3.0), (0.0, 3.0), 0.7))
"""Between the eye and both places of the cup."""
BEFORE_A = wall(pane((0.0, 3.0), (0.0, 3.0), 0.7), name="half")
WINDOW_X, WINDOW_Y = EYE[:2] + (PLACE_A - EYE)[:2] * (0.7 - EYE[2]) / (PLACE_A - EYE)[2]
WITH_WINDOW = wall(
    pane((-3.0, WINDOW_X - 0.1), (0.0, 3.0), 0.7),
    pane((WINDOW_X + 0.1, 3.0), (0.0, 3.0), 0.7),
    pane((WINDOW_X - 0.1, WINDOW_X + 0.1), (0.0, WINDOW_Y - 0.1), 0.7),
    pane((WINDOW_X - 0.1, WINDOW_X + 0.1), (WINDOW_Y + 0.1, 3.0), 0.7),
)
"""A wall with a window through which the first place of the cup is seen, and only that."""


def _outcomes(recording: Recording, options: CurationOptions) -> dict[str, tuple[str, str, str]]:
    """Outcome, stage and mark of each action."""
    curated = curate_recording(recording, MANIFEST, PROTOCOL, options)
    marks = {row.action: row.extra.get("primed_through", "") for row in curated.sequences}
    return {row.action: (row.outcome, row.stage, marks.get(row.action, "")) for row in curated.events}


def test_nothing_is_asked_by_default() -> None:
    blocked = _outcomes(scene(occluders=(WHOLE,)), CurationOptions())
    assert blocked == _outcomes(scene(), CurationOptions())
    assert {outcome for outcome, _, _ in blocked.values()} == {"sequence"}


def test_an_event_primed_through_a_wall_is_marked_and_stays() -> None:
    assert _outcomes(scene(occluders=(BEFORE_A,)), MARK) == {
        "pick": ("sequence", "filters", "half"),
        "put": ("sequence", "filters", ""),
    }
    curated = curate_recording(scene(occluders=(BEFORE_A,)), MANIFEST, PROTOCOL, MARK)
    assert "1 of 2 primed events are primed through a mesh" in curated.record.message
    unasked = curate_recording(scene(), MANIFEST, PROTOCOL)
    assert [row.prime_time for row in curated.events] == [row.prime_time for row in unasked.events]


def test_only_unobstructed_looks_prime_where_that_is_required() -> None:
    assert _outcomes(scene(occluders=(BEFORE_A,)), REQUIRE) == {
        "pick": ("not_primed", "occlusion", ""),
        "put": ("sequence", "filters", ""),
    }
    (pick, _) = curate_recording(scene(occluders=(BEFORE_A,)), MANIFEST, PROTOCOL, REQUIRE).events
    assert pick.value == 15.0, "half a second of looks at 30 Hz"


def test_through_a_window_beside_the_wall_one_sees() -> None:
    assert _outcomes(scene(occluders=(WITH_WINDOW,)), MARK) == {
        "pick": ("sequence", "filters", ""),
        "put": ("sequence", "filters", "wall"),
    }


def test_a_later_look_from_another_place_primes() -> None:
    times = clock(30)
    stream = gaze(times, [(LOOK_A, LOOK_A + 0.5, PLACE_A), (LOOK_B, LOOK_B + 0.5, PLACE_B)])
    origin, direction = stream.origin.copy(), stream.direction.copy()
    beyond = (times >= 12.5) & (times < 13.0)
    origin[beyond] = (0.5, 1.2, 0.9)  # past the wall
    direction[beyond] = (PLACE_A - origin[beyond]) / np.linalg.norm(PLACE_A - origin[beyond], axis=1, keepdims=True)
    recording = scene(gaze=dataclasses.replace(stream, origin=origin, direction=direction), occluders=(BEFORE_A,))
    primes = {
        options.occlusion: curate_recording(recording, MANIFEST, PROTOCOL, options).events[0].prime_time
        for options in (MARK, REQUIRE)
    }
    assert primes == {"mark": pytest.approx(LOOK_A), "require": pytest.approx(12.5)}


def test_the_object_s_own_mesh_hides_nothing() -> None:
    shell = wall(pane((-0.1, 0.1), (-0.1, 0.1), -0.08), name="cup", object_id="1")  # 8 cm before its centre
    assert _outcomes(scene(occluders=(shell,)), REQUIRE) == _outcomes(scene(), REQUIRE)
    another = dataclasses.replace(shell, object_id=None, vertices=shell.vertices + PLACE_A, name="screen")
    assert _outcomes(scene(occluders=(another,)), REQUIRE)["pick"][:2] == ("not_primed", "occlusion")


def test_a_mesh_moves_with_its_object() -> None:
    times, between = clock(30), EYE + 0.5 * (PLACE_A - EYE)
    aside = between + np.array([1.0, 0.0, 0.0])
    screen = wall(pane((-0.2, 0.2), (-0.2, 0.2), 0.0), name="screen", object_id="7")
    for gone_at, mark in ((LOOK_A - 1.0, ""), (LOOK_A + 2.0, "screen")):
        place = np.where((times < gone_at)[:, None], between, aside)
        recording = scene(occluders=(screen,))
        moved = dataclasses.replace(
            recording, objects=(*recording.objects, track(times, place, name="screen", object_id="7"))
        )
        assert _outcomes(moved, MARK)["pick"] == ("sequence", "filters", mark)


def test_a_turned_object_turns_its_mesh() -> None:
    times = np.array([0.0])
    board = wall(pane((-1.0, 1.0), (-0.01, 0.01), 0.0), name="board", object_id="7")
    upright = np.array([[1.0, 0.0, 0.0, 0.0]])
    on_end = np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])  # 90 degrees about z
    for rotation, hidden in ((upright, False), (on_end, True)):
        body = dataclasses.replace(track(times, np.array([[0.0, 0.0, 1.0]]), object_id="7"), rotation=rotation)
        around = Surroundings(scene(objects=(body,), occluders=(board,)))
        above = np.array([[0.0, 0.5, 0.0]]), np.array([[0.0, 0.0, 1.0]])
        assert around.obstacles(times, *above, np.array([2.0]), but="1") == (("board",) if hidden else ("",))


def test_the_nearest_of_several_meshes_is_named_and_what_lies_behind_the_place_is_none() -> None:
    panes = [wall(pane((-1, 1), (-1, 1), z), name=str(z)) for z in (3.0, 1.0, 2.0)]
    around = Surroundings(scene(occluders=tuple(panes)))
    ahead = np.zeros((4, 3)), np.tile((0.0, 0.0, 1.0), (4, 1))
    reach = np.array([0.5, 1.5, 1.0 + 0.9 * MARGIN, 1.0 + 1.1 * MARGIN])
    assert around.obstacles(np.zeros(4), *ahead, reach, but="") == ("", "1.0", "", "1.0")
    backwards = np.zeros((1, 3)), np.array([[0.0, 0.0, -1.0]])
    assert around.obstacles(np.zeros(1), *backwards, np.array([9.0]), but="") == ("",)


def test_without_meshes_that_is_said() -> None:
    curated = curate_recording(scene(), MANIFEST, PROTOCOL, MARK)
    assert "no meshes, so no look was tested for occlusion" in curated.record.message
    assert [row.outcome for row in curated.events] == ["sequence", "sequence"]


def test_without_open3d_that_is_told_before_anything_is_read(monkeypatch) -> None:
    monkeypatch.undo()  # of the fixture, which lets the slow loop answer
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError, match=r"--occlusion mark needs .*pip install 'prbench\[open3d\]'"):
        MARK.require_fits(load_manifest("mogaze"))
    with pytest.raises(MissingExtraError, match=r"'surface' needs .*pip install 'prbench\[open3d\]'"):
        CurationOptions(in_hand="surface").require_fits(load_manifest("hot3d"))
    CurationOptions().require_fits(load_manifest("mogaze"))  # nothing is asked about meshes


def test_occlusion_and_published_priming_exclude_each_other() -> None:
    with pytest.raises(UsageError, match="choose one"):
        CurationOptions(occlusion="mark", priming="published")


def test_the_choice_stands_in_the_description_of_a_dataset() -> None:
    described = REQUIRE.described(load_manifest("mogaze"), PROTOCOL)
    assert described["occlusion"] == "require"
    assert CurationOptions().described(load_manifest("mogaze"), PROTOCOL)["occlusion"] == "off"
