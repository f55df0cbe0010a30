"""What damaged copies of MoGaze come to in a build."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from prbench.curation import BuildReport, build_dataset
from prbench.sequences import SequenceTable
from prbench.synthetic.layouts import defects_of
from prbench.synthetic.write_tree import synthesize_tree

DEFECTS = {defect.name: defect for defect in defects_of("mogaze")}
HARMLESS = ("bad-segments", "raised-floor")
"""Defects that reading repairs: every event is found, and as often primed."""


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("mogaze") / "mogaze"
    synthesize_tree("mogaze", root, recordings=2, seed=4, n_events=4)  # long enough that 20 frames are below 1 %
    return root


@pytest.fixture(scope="module")
def sound(tree, tmp_path_factory) -> BuildReport:
    return build_dataset("mogaze", tree, tmp_path_factory.mktemp("sound") / "table")


def _damaged(tree: Path, name: str, tmp_path: Path) -> BuildReport:
    copy = shutil.copytree(tree, tmp_path / "mogaze")
    first = min(path.name for path in tree.glob("*_human_data.hdf5")).removesuffix("_human_data.hdf5")
    DEFECTS[name].apply(copy, first)
    return build_dataset("mogaze", copy, tmp_path / "table")


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_comes_to_what_it_should(tree, sound, name, tmp_path) -> None:
    report, defect = _damaged(tree, name, tmp_path), DEFECTS[name]
    first, second = report.records
    assert first.status == defect.outcome
    assert defect.says in first.message
    assert str(tmp_path) not in first.message, "no folder of this machine in the table"
    if name != "no-scene":  # it is shared by all recordings
        assert second == sound.records[1], "the other recording is as it was"
    if name in HARMLESS:
        assert first.outcomes == sound.records[0].outcomes


def test_a_raised_floor_changes_no_sequence(tree, sound, tmp_path) -> None:
    raised = SequenceTable.open(_damaged(tree, "raised-floor", tmp_path).folder)
    whole = SequenceTable.open(sound.folder)
    assert raised.info.identity_digest == whole.info.identity_digest
    for key in ("location", "box_min", "box_max"):
        one, other = (table.events()[key].combine_chunks().flatten().to_numpy() for table in (raised, whole))
        assert one == pytest.approx(other, abs=0.03), "the floor is taken from the lowest toes"


def test_a_body_without_frames_around_an_event_leaves_the_others(tree, tmp_path) -> None:
    first, _ = _damaged(tree, "lost-body", tmp_path).records
    assert sum(first.outcomes.values()) == 4
