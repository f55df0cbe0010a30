"""What damaged copies of HD-EPIC come to in a build."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from prbench.curation import BuildReport, build_dataset
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.synthetic.layouts import defects_of
from prbench.synthetic.people.perform import name_of_recording
from prbench.synthetic.write_tree import synthesize_tree
from tests.synthetic.defects.outcomes import assert_outcome

DEFECTS = {defect.name: defect for defect in defects_of("hd-epic")}
HARMLESS = ()
"""What reading does not mind."""
SEED = 1


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("hd-epic") / "root"
    synthesize_tree("hd-epic", root, recordings=2, seed=SEED, n_events=4, provocations={})
    return root


@pytest.fixture(scope="module")
def sound(tree, tmp_path_factory) -> BuildReport:
    return build_dataset("hd-epic", tree, tmp_path_factory.mktemp("sound") / "table")


def _damaged(tree: Path, name: str, tmp_path: Path, *more: str) -> BuildReport:
    copy = shutil.copytree(tree, tmp_path / "root")
    for each in (name, *more):
        DEFECTS[each].apply(copy, name_of_recording("hd-epic", SEED, 0))
    return build_dataset("hd-epic", copy, tmp_path / "table")


def _events(report: BuildReport) -> list[dict]:
    return SequenceTable(report.folder, DatasetInfo.read(report.folder)).events().to_pylist()


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_comes_to_what_it_should(tree, sound, name, tmp_path) -> None:
    assert_outcome(DEFECTS[name], _damaged(tree, name, tmp_path), sound, tmp_path, HARMLESS)


def test_without_bodies_the_primed_events_stay_with_times_and_wrists(tree, sound, tmp_path) -> None:
    report = _damaged(tree, "missing-bodies", tmp_path)
    first, whole = report.records[0], sound.records[0]
    primed = sum(whole.outcomes.get(name, 0) for name in ("sequence", "too_short", "minimum_movement"))
    assert first.outcomes["no_body"] == primed > 0
    events = _events(report)
    kept = [row for row in events if row["outcome"] == "no_body"]
    assert all(row["prime_time"] is not None and row["prime_time"] < row["event_time"] for row in kept)
    assert any(row["left_wrist"] is not None or row["right_wrist"] is not None for row in kept)


def test_a_time_file_that_ends_early_costs_the_places_of_what_comes_after(tree, sound, tmp_path) -> None:
    first = _damaged(tree, "truncated-time", tmp_path).records[0]
    assert sum(first.outcomes.values()) == sum(sound.records[0].outcomes.values()), "no event vanishes"
    assert first.outcomes["no_location"] > sound.records[0].outcomes.get("no_location", 0)
    assert "lie beyond the rows of the time file" in first.message


def test_without_tracked_hands_the_body_tells_the_same_hand(tree, sound, tmp_path) -> None:
    expected = {row["event_id"]: row["hand"] for row in _events(sound)}
    events = _events(_damaged(tree, "lost-hands", tmp_path))
    told = [row for row in events if row["recording_id"].endswith("0000") and row["hand"] is not None]
    assert {row["hand_source"] for row in told} == {"body"}
    assert all(row["hand"] == expected[row["event_id"]] for row in told)


def test_with_neither_hands_nor_bodies_no_hand_is_named(tree, tmp_path) -> None:
    events = _events(_damaged(tree, "lost-hands", tmp_path, "missing-bodies"))
    assert {row["hand"] for row in events if row["recording_id"].endswith("0000")} == {None}
