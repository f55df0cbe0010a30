"""Stories of single events."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest

from prbench.curation import build_from_sources
from prbench.curation.differences import compare_builds
from prbench.errors import UsageError
from prbench.recording import UnreadableEntry
from prbench.viewing.explain import EventStory, draw_event_story, explain_event
from tests.curation.scenes import LOOK_A, PLACE_A, clock, gaze, scene, stranger
from tests.curation.sources import SceneSource, trembling
from tests.fakes import fake_dataset


class UnseenPut(SceneSource):
    """The put is never looked at."""

    def read(self):
        import dataclasses

        looks = [(LOOK_A, LOOK_A + 0.5, PLACE_A)]
        return trembling(dataclasses.replace(super().read(), gaze=gaze(clock(30), looks)))


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("explain") / "adt"
    build_from_sources([SceneSource("room_a"), UnseenPut("room_b")], folder)
    return folder


def stages(story: EventStory) -> dict[str, str]:
    return {stage.name: stage.verdict for stage in story.stages}


def test_a_sequences_story_names_every_number_that_decided(table: Path) -> None:
    story = explain_event(table, "room_a/cup/pick")
    assert set(stages(story).values()) == {"passed"}
    text = story.text()
    for part in (
        "outcome: sequence",
        "left hand",
        "first look at 11.000 s (hit)",
        "box 8 × 10 × 8 cm",
        "at least 0.20 m",
    ):
        assert part in text


def test_a_dropped_events_story_ends_where_it_was_dropped(table: Path) -> None:
    story = explain_event(table, "room_b/cup/put")
    assert stages(story) == {
        "in hand": "passed", "location": "passed", "priming": "stopped here", "clipping": "not reached",
        "body": "not reached", "filters": "not reached",
    }  # fmt: skip
    assert story.motion is None
    assert "gaze came no nearer to the box than" in story.text()
    assert "(near miss: at most 5.0 cm)" in story.text()


def test_an_entry_that_could_not_be_read_tells_what_was_found(tmp_path: Path) -> None:
    odd = UnreadableEntry("mask_info.json", "m1", "a mask", "`null` instead of `object`")
    build_from_sources([SceneSource("room", unreadable=(odd,))], tmp_path / "table")
    story = explain_event(tmp_path / "table", "mask_info.json")
    assert story.title == "entry m1 of mask_info.json"
    assert "cannot be read: mask_info.json, m1: expected a mask, found `null`" in story.text()
    assert compare_builds(tmp_path / "table", tmp_path / "table").equal, "an entry has no time, and is the same entry"


def test_event_ids_sequence_ids_and_unique_parts_all_lead_to_the_event(table: Path) -> None:
    story = explain_event(table, "room_a/cup/pick")
    assert story.event.sequence_id is not None
    for name in (story.event.event_id, story.event.sequence_id, story.event.event_id.removeprefix("adt/")):
        assert explain_event(table, name).event.event_id == story.event.event_id


def test_a_part_that_fits_several_lists_them_and_an_unknown_id_its_neighbours(table: Path) -> None:
    with pytest.raises(UsageError, match=r"fits 2 events(.|\n)*room_a/1/pick(.|\n)*room_b/1/pick"):
        explain_event(table, "cup/pick")
    with pytest.raises(UsageError, match=r"no event 'room_a/cap/pick'(.|\n)*room_a/cup/pick"):
        explain_event(table, "room_a/cap/pick")


def test_the_motion_of_the_story_is_canonical_and_its_box_surrounds_the_goal(table: Path) -> None:
    scene = explain_event(table, "room_a/cup/pick").motion
    assert scene is not None
    assert scene.goal is not None
    np.testing.assert_allclose(scene.goal.box_corners.mean(axis=0), scene.goal.location, atol=1e-6)
    assert scene.motions[0].joints.shape == (len(scene.times), 22, 3)


@pytest.mark.parametrize("event", ["room_a/cup/pick", "room_b/cup/put"])
def test_a_story_can_be_drawn(table: Path, tmp_path: Path, event: str) -> None:
    draw_event_story(explain_event(table, event), tmp_path / "story.png")
    assert (tmp_path / "story.png").read_bytes().startswith(b"\x89PNG")


def test_a_dataset_without_sequences_can_be_explained(tmp_path: Path) -> None:
    class Unseen(SceneSource):
        def read(self):
            times = clock(120)
            passer_by = stranger(times, np.tile([9.0, 1.0, 9.0], (len(times), 1)))
            return trembling(scene(gaze=gaze(clock(30), []), other_people=(passer_by,)))

    build_from_sources([Unseen("kitchen_1")], tmp_path / "adt")
    assert explain_event(tmp_path / "adt", "cup/pick").event.outcome == "not_primed"


def test_where_the_licence_keeps_goals_the_story_does_not_tell_them(tmp_path) -> None:
    table = fake_dataset(tmp_path / "t", n=3)
    event = table.events()["event_id"][0].as_py()
    assert " m, box " in explain_event(table.folder, event).text()
    msgspec.structs.replace(table.info, redistribution="none").write(table.folder)
    assert " m, box " not in explain_event(table.folder, event).text()
    assert " m, box " in explain_event(table.folder, event, permitted=["synthetic-adt"]).text()


def test_names_can_neither_steer_the_terminal_nor_add_lines_nor_end_a_drawing(table: Path, tmp_path: Path) -> None:
    story = explain_event(table, "room_a/cup/pick")
    name = "cup\x1b[2J\n  + filters  passed $\\frac$"
    event = dataclasses.replace(story.event, object_name=name)
    named = dataclasses.replace(story, event=event)
    assert "\x1b" not in named.text()
    assert "cup\\x1b[2J\\n  + filters" in named.text()
    draw_event_story(named, tmp_path / "story.png")
