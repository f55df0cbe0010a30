"""What damaged copies of every native layout come to in a build."""

from __future__ import annotations

import functools
import importlib
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from prbench.curation import BuildReport, build_dataset
from prbench.sequences import SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from tests.readers import gimo_sample

TREES = {
    "adt": {"recordings": 2, "seed": 1, "n_events": 2, "provocations": {}},
    "hd-epic": {"recordings": 2, "seed": 1, "n_events": 4, "provocations": {}},
    "hot3d": {"recordings": 1, "seed": 4, "n_events": 2},
    "mogaze": {"recordings": 2, "seed": 4, "n_events": 4},  # long enough that 20 frames are below 1 %
}
GIMO = ("2022-01-01-000000", "2022-01-02-000000")  # two segments of 45 frames
DEFECTS = {
    (layout, each.name): each
    for layout in (*TREES, "gimo")
    for each in importlib.import_module(f"tests.readers.{layout.replace('-', '_')}.defects").DEFECTS
}
HARMLESS = {("adt", "mps-gaze"), ("mogaze", "bad-segments"), ("mogaze", "raised-floor")}  # reading repairs them
SHARED = {("mogaze", "no-scene")}  # what is damaged belongs to all recordings

Whole = Callable[[str], tuple[Path, BuildReport, str]]


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Whole:
    """From a layout to a sound tree, what a build makes of it, and the recording that damages are done to."""

    @functools.cache
    def made(layout: str) -> tuple[Path, BuildReport, str]:
        root = tmp_path_factory.mktemp(layout) / layout
        if layout == "gimo":
            scenes = zip(("one", "two"), GIMO, strict=True)
            gimo_sample.write_root(root, *(gimo_sample.readings(scene=s, sequence=name) for s, name in scenes))
        else:
            synthesize_tree(layout, root, **TREES[layout])
        sound = build_dataset(layout, root, root.parent / "table")
        return root, sound, GIMO[0] if layout == "gimo" else sound.records[0].recording_id.rpartition("/")[2]

    return made


def damaged(whole: Whole, folder: Path, layout: str, *names: str) -> BuildReport:
    root, _, first = whole(layout)
    copy = shutil.copytree(root, folder / layout)
    for name in names:
        DEFECTS[layout, name].apply(copy, first)
    return build_dataset(layout, copy, folder / "table")


def count(record) -> int:
    return sum(record.outcomes.values())


def events(report: BuildReport) -> list[dict]:
    return SequenceTable.open(report.folder).events().to_pylist()


@pytest.mark.parametrize(("layout", "name"), DEFECTS)
def test_a_defect_comes_to_what_it_should(whole, layout, name, tmp_path) -> None:
    report, defect, sound = damaged(whole, tmp_path, layout, name), DEFECTS[layout, name], whole(layout)[1]
    first, *others = report.records
    assert first.status == defect.outcome, first.message
    assert defect.says in first.message
    assert str(tmp_path) not in first.message, "no folder of this machine in the table"
    if (layout, name) not in SHARED:
        assert others == list(sound.records[1:]), "the other recording is as it was"
    if (layout, name) in HARMLESS:
        assert {**first.outcomes, "unreadable_entry": 0} == {**sound.records[0].outcomes, "unreadable_entry": 0}
    if (layout, name) == ("adt", "mps-gaze"):
        assert first == sound.records[0]
        assert report.info.content_digest == sound.info.content_digest


def test_a_sound_segment_of_gimo_shows_none_of_this(whole) -> None:
    first = whole("gimo")[1].records[0]
    assert first.status == "read"
    assert [name for (layout, name), each in DEFECTS.items() if layout == "gimo" and each.says in first.message] == []


def test_an_untracked_stretch_never_makes_an_event_vanish_in_silence(whole, tmp_path) -> None:
    first, before = damaged(whole, tmp_path, "adt", "untracked-objects").records[0], whole("adt")[1].records[0]
    assert count(before) <= count(first) or first.outcomes.get("tracking_lost", 0) > 0 or first.message


@pytest.mark.parametrize(
    ("layout", "name"), [("adt", "no-skeleton"), ("hot3d", "missing-profile"), ("hot3d", "lost-hands")]
)
def test_without_hands_no_event_is_invented(whole, layout, name, tmp_path) -> None:
    assert count(damaged(whole, tmp_path, layout, name).records[0]) == 0


@pytest.mark.parametrize("name", ["missing-models", "slam-gap", "lost-object", "failed-start", "missing-bodies"])
def test_what_can_be_bridged_costs_no_event_of_hot3d(whole, name, tmp_path) -> None:
    first, before = damaged(whole, tmp_path, "hot3d", name).records[0], whole("hot3d")[1].records[0]
    assert count(first) == count(before)
    if name == "missing-bodies":
        assert "sequence" not in first.outcomes
        assert first.outcomes["no_body"] > 0


def test_without_bodies_the_primed_events_stay_with_times_and_wrists(whole, tmp_path) -> None:
    report, before = damaged(whole, tmp_path, "hd-epic", "missing-bodies"), whole("hd-epic")[1].records[0]
    primed = sum(before.outcomes.get(name, 0) for name in ("sequence", "too_short", "minimum_movement"))
    assert report.records[0].outcomes["no_body"] == primed > 0
    kept = [row for row in events(report) if row["outcome"] == "no_body"]
    assert all(row["prime_time"] is not None and row["prime_time"] < row["event_time"] for row in kept)
    assert any(row["left_wrist"] is not None or row["right_wrist"] is not None for row in kept)


def test_a_time_file_that_ends_early_costs_the_places_of_what_comes_after(whole, tmp_path) -> None:
    first, before = damaged(whole, tmp_path, "hd-epic", "truncated-time").records[0], whole("hd-epic")[1].records[0]
    assert count(first) == count(before), "no event vanishes"
    assert first.outcomes["no_location"] > before.outcomes.get("no_location", 0)
    assert "lie beyond the rows of the time file" in first.message


@pytest.mark.parametrize("bodies", [True, False])
def test_without_tracked_hands_the_body_tells_the_same_hand_and_without_either_none_is_named(
    whole, bodies, tmp_path
) -> None:
    _, sound, first = whole("hd-epic")
    expected = {row["event_id"]: row["hand"] for row in events(sound)}
    report = damaged(whole, tmp_path, "hd-epic", "lost-hands", *([] if bodies else ["missing-bodies"]))
    rows = [row for row in events(report) if row["recording_id"] == first]
    told = [row for row in rows if row["hand"] is not None]
    assert {row["hand_source"] for row in told} == ({"body"} if bodies else set())
    assert all(row["hand"] == expected[row["event_id"]] for row in told)


def test_a_raised_floor_changes_no_sequence(whole, tmp_path) -> None:
    raised = SequenceTable.open(damaged(whole, tmp_path, "mogaze", "raised-floor").folder)
    sound = SequenceTable.open(whole("mogaze")[1].folder)
    assert raised.info.identity_digest == sound.info.identity_digest
    for key in ("location", "box_min", "box_max"):
        one, other = (table.events()[key].combine_chunks().flatten().to_numpy() for table in (raised, sound))
        assert one == pytest.approx(other, abs=0.03), "the floor is taken from the lowest toes"


def test_a_body_without_frames_around_an_event_leaves_the_others(whole, tmp_path) -> None:
    assert count(damaged(whole, tmp_path, "mogaze", "lost-body").records[0]) == 4
