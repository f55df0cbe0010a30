"""``build-dataset all``: one table a dataset, whatever the other datasets do."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from prbench.curation.build import build_all, found_datasets, plan_build
from prbench.curation.options import BuildOptions, CurationOptions
from prbench.errors import InputFileError, UsageError
from prbench.sequences import SequenceTable


@pytest.fixture
def root(tmp_path, adt_tree) -> Path:
    shutil.copytree(adt_tree, tmp_path / "copies" / "ADT")
    return tmp_path / "copies"


def test_what_is_found_is_built_under_its_name_and_equals_a_build_by_itself(root, tmp_path, adt_tree) -> None:
    from prbench.curation import build_dataset

    steps = []
    (report,), broken = build_all(root, tmp_path / "out", progress=lambda done, total, last: steps.append(done))
    assert (report.info.counts.recordings_failed, broken) == (0, [])
    assert steps == [1, 2]
    alone = build_dataset("adt", adt_tree, tmp_path / "alone")
    assert SequenceTable.open(tmp_path / "out" / "synthetic-adt").info == alone.info


def test_the_dry_run_names_folders_and_recordings(root) -> None:
    (found,), _ = found_datasets(root, BuildOptions())
    plan = plan_build(found.dataset, found.root)
    assert (found.name, plan.root, len(plan.recordings)) == ("synthetic-adt", root / "ADT", 2)


def test_a_recording_that_fails_is_reported_and_the_dataset_is_not_complete(root, tmp_path) -> None:
    victim = sorted(folder for folder in (root / "ADT").iterdir() if (folder / "metadata.json").is_file())[0]
    (victim / "scene_objects.csv").unlink()
    (report,), _ = build_all(root, tmp_path / "out")
    assert report.info.counts.recordings_failed == 1
    with pytest.raises(InputFileError, match=r"scene_objects\.csv"):
        build_all(root, tmp_path / "out2", options=BuildOptions(on_error="fail"))


def test_two_copies_of_one_dataset_are_refused_by_their_places(root, tmp_path, adt_tree) -> None:
    shutil.copytree(adt_tree, root / "ADT-backup")
    with pytest.raises(UsageError, match=r"ADT and .*ADT-backup"):
        build_all(root, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "options", [BuildOptions(reader=(("colour", "red"),)), BuildOptions(CurationOptions(in_hand="wrist"))]
)
def test_options_that_fit_no_dataset_are_refused_before_anything_is_built(root, tmp_path, options) -> None:
    with pytest.raises(UsageError):
        build_all(root, tmp_path / "out", options=options)
    assert not (tmp_path / "out").exists()
