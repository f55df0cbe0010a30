"""What damaged copies of Aria Digital Twin come to in a build."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from prbench.curation import BuildReport, build_dataset
from prbench.synthetic.layouts import defects_of
from prbench.synthetic.people.perform import name_of_recording
from prbench.synthetic.write_tree import synthesize_tree
from tests.synthetic.defects.outcomes import assert_outcome

DEFECTS = {defect.name: defect for defect in defects_of("adt")}
HARMLESS = ("mps-gaze",)
"""What reading does not mind."""
SEED = 1


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("adt") / "root"
    synthesize_tree("adt", root, recordings=2, seed=SEED, n_events=2, provocations={})
    return root


@pytest.fixture(scope="module")
def sound(tree, tmp_path_factory) -> BuildReport:
    return build_dataset("adt", tree, tmp_path_factory.mktemp("sound") / "table")


def _damaged(tree: Path, name: str, tmp_path: Path) -> BuildReport:
    """Only what is damaged is copied; the rest is linked."""
    recording = name_of_recording("adt", SEED, 0)
    copy = tmp_path / "root"
    copy.mkdir()
    for entry in tree.iterdir():
        if entry.name == recording:
            shutil.copytree(entry, copy / entry.name)
        else:
            (copy / entry.name).symlink_to(entry)
    DEFECTS[name].apply(copy, recording)
    return build_dataset("adt", copy, tmp_path / "table")


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_comes_to_what_it_should(tree, sound, name, tmp_path) -> None:
    assert_outcome(DEFECTS[name], _damaged(tree, name, tmp_path), sound, tmp_path, HARMLESS)


def test_an_untracked_stretch_never_makes_an_event_vanish_in_silence(tree, sound, tmp_path) -> None:
    first = _damaged(tree, "untracked-objects", tmp_path).records[0]
    before, after = sound.records[0].outcomes, first.outcomes
    lost = sum(before.values()) - sum(after.values())
    assert lost <= 0 or after.get("tracking_lost", 0) > 0 or first.message


def test_without_the_suit_there_are_no_hands_and_so_no_events(tree, tmp_path) -> None:
    first = _damaged(tree, "no-skeleton", tmp_path).records[0]
    assert not sum(first.outcomes.values())
