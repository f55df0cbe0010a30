"""What damaged copies of HOT3D come to in a build."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from prbench.curation import BuildReport, build_dataset
from prbench.synthetic.layouts import defects_of
from prbench.synthetic.write_tree import synthesize_tree

DEFECTS = {defect.name: defect for defect in defects_of("hot3d")}


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("hot3d") / "hot3d"
    synthesize_tree("hot3d", root, recordings=1, seed=4, n_events=2)
    return root


@pytest.fixture(scope="module")
def sound(tree, tmp_path_factory) -> BuildReport:
    return build_dataset("hot3d", tree, tmp_path_factory.mktemp("sound") / "table")


def _damaged(tree: Path, name: str, tmp_path: Path) -> BuildReport:
    copy = shutil.copytree(tree, tmp_path / "hot3d")
    first = min(path.parent.name for path in tree.glob("*/metadata.json"))
    DEFECTS[name].apply(copy, first)
    return build_dataset("hot3d", copy, tmp_path / "table")


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defect_comes_to_what_it_should(tree, name, tmp_path) -> None:
    (record,), defect = _damaged(tree, name, tmp_path).records, DEFECTS[name]
    assert record.status == defect.outcome, record.message
    assert defect.says in record.message
    assert str(tmp_path) not in record.message, "no folder of this machine in the table"


def test_a_bad_recording_leaves_the_others_alone(tmp_path) -> None:
    synthesize_tree("hot3d", tmp_path / "tree", recordings=2, seed=4, n_events=2)
    sound = build_dataset("hot3d", tmp_path / "tree", tmp_path / "sound").records
    first, second = _damaged(tmp_path / "tree", "withheld", tmp_path).records
    assert (first.status, second) == ("skipped", sound[1])


@pytest.mark.parametrize("name", ["missing-profile", "lost-hands"])
def test_without_hand_vertices_no_event_is_invented(tree, name, tmp_path) -> None:
    (first,) = _damaged(tree, name, tmp_path).records
    assert first.outcomes == {}


def test_without_bodies_events_stay_with_their_reason(tree, sound, tmp_path) -> None:
    (first,) = _damaged(tree, "missing-bodies", tmp_path).records
    assert sum(first.outcomes.values()) == sum(sound.records[0].outcomes.values())
    assert "sequence" not in first.outcomes
    assert first.outcomes["no_body"] > 0


@pytest.mark.parametrize("name", ["missing-models", "slam-gap", "lost-object", "failed-start"])
def test_what_can_be_bridged_costs_no_event(tree, sound, name, tmp_path) -> None:
    (first,) = _damaged(tree, name, tmp_path).records
    assert sum(first.outcomes.values()) == sum(sound.records[0].outcomes.values())
