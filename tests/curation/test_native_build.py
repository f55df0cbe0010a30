"""Builds from native files: what is chosen, what is skipped, what the dry run says."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from prbench.curation import BuildOptions, build_dataset, plan_build
from prbench.errors import InputFileError, StorageError, UsageError
from prbench.files.storage import read_json
from prbench.sequences import SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from tests.curation.sources import folder_bytes
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("native") / "tree"
    synthesize_tree("adt", root, recordings=2, seed=8, size="tiny", n_events=4)
    return root


def test_a_synthetic_tree_is_named_and_split_as_its_mark_says(tree: Path, tmp_path: Path) -> None:
    build_dataset("adt", tree, tmp_path / "table")
    table = SequenceTable.open(tmp_path / "table")
    assert (table.info.dataset, table.info.synthetic) == ("synthetic-adt", True)
    splits = dict(zip(*(table.recordings()[name].to_pylist() for name in ("recording_id", "split")), strict=True))
    mark = read_json(tree / "synthetic.json")
    assert isinstance(mark, dict)
    assert splits == mark["split"]


def test_where_the_files_lie_leaves_no_trace(tree: Path, tmp_path: Path) -> None:
    shutil.copytree(tree, tmp_path / "elsewhere" / "copy")
    build_dataset("adt", tree, tmp_path / "one")
    build_dataset("adt", tmp_path / "elsewhere" / "copy", tmp_path / "two")
    assert folder_bytes(tmp_path / "one") == folder_bytes(tmp_path / "two")
    assert str(tmp_path).encode() not in b"".join(folder_bytes(tmp_path / "one").values())


def test_the_dry_run_counts_and_writes_nothing(tree: Path, tmp_path: Path) -> None:
    before = sorted(tree.rglob("*"))
    plan = plan_build("adt", tree)
    assert len(plan.recordings) == 2
    assert plan.input_bytes > 1e6
    assert plan.estimated_seconds > 0
    assert sorted(tree.rglob("*")) == before
    assert len(plan_build("adt", tree, BuildOptions(recordings="*seq001*")).recordings) == 1
    assert list(tmp_path.iterdir()) == []


def test_known_bad_and_damaged_recordings_are_named_and_the_others_built(tree: Path, tmp_path: Path) -> None:
    copy = tmp_path / "tree"
    shutil.copytree(tree, copy)
    good, other = sorted(path for path in copy.iterdir() if path.name.startswith("Apartment"))
    other.rename(copy / "Apartment_release_clean_seq139_M1292")
    shutil.copytree(good, copy / "Apartment_release_cut_M1292")
    objects = copy / "Apartment_release_cut_M1292" / "scene_objects.csv"
    objects.write_bytes(objects.read_bytes()[:-7])
    report = build_dataset("adt", copy, tmp_path / "table")
    problems = {item.recording_id: item for item in report.info.quarantine}
    assert problems["Apartment_release_clean_seq139_M1292"].status == "skipped"
    assert "IMU" in problems["Apartment_release_clean_seq139_M1292"].message
    assert problems["Apartment_release_cut_M1292"].status == "failed"
    assert problems["Apartment_release_cut_M1292"].message.startswith("Apartment_release_cut_M1292/scene_objects.csv")
    assert report.info.counts.recordings_read == 1
    assert plan_build("adt", copy).skipped == ("Apartment_release_clean_seq139_M1292",)


def test_a_wrong_root_and_an_unknown_dataset_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="no such folder"):
        build_dataset("adt", tmp_path / "nowhere", tmp_path / "table")
    with pytest.raises(UsageError, match="adt"):
        build_dataset("adtt", tmp_path, tmp_path / "table")


def test_invented_recordings_without_their_mark_are_refused(tmp_path) -> None:
    tree = synthesize_tree("adt", tmp_path / "tree", recordings=1, seed=3, n_events=2)
    (tree.root / "synthetic.json").unlink()
    with pytest.raises(InputFileError, match=r"synthetic\.json"):
        build_dataset("adt", tree.root, tmp_path / "table")
    assert not (tmp_path / "table").exists()


def test_a_table_of_another_dataset_is_not_replaced(tmp_path) -> None:
    tree = synthesize_tree("adt", tmp_path / "tree", recordings=1, seed=3, n_events=2)
    fake_dataset(tmp_path / "table", n=3, dataset="synthetic-mogaze")
    before = (tmp_path / "table" / "dataset.json").read_bytes()
    with pytest.raises(StorageError, match="synthetic-mogaze"):
        build_dataset("adt", tree.root, tmp_path / "table")
    assert (tmp_path / "table" / "dataset.json").read_bytes() == before
