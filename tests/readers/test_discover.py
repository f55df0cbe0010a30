"""Every reader finds its own recordings and nobody else's."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from prbench.checking.inspection import missing_files
from prbench.datasets import readable_datasets
from prbench.errors import InputFileError
from prbench.protocol.manifests import load_manifest
from prbench.readers import SYNTHETIC_FILE, reader_for
from prbench.readers.discover import discover
from prbench.synthetic.write_tree import synthesize_tree
from tests.readers.own.plain import recording_of, write_plain


@pytest.fixture(scope="module")
def copies(tmp_path_factory) -> Path:
    """A synthetic tree of every dataset side by side; not to be changed."""
    root = tmp_path_factory.mktemp("copies")
    for dataset in set(readable_datasets()) - {"own"}:
        synthesize_tree(dataset, root / dataset, recordings=1, seed=3, n_events=2)
    write_plain(root / "own", recording_of("hd-epic"))
    mark = json.loads((root / "adt" / SYNTHETIC_FILE).read_text())
    (root / "own" / SYNTHETIC_FILE).write_text(json.dumps({**mark, "preset": "own", "split": {"one": "test"}}))
    return root


def test_each_tree_is_recognised_by_its_own_reader_alone(copies) -> None:
    found = discover(copies)
    assert found.broken == ()
    assert [(each.name, each.root) for each in found.found] == [
        (f"synthetic-{dataset}", copies / dataset) for dataset in sorted(readable_datasets())
    ]
    assert discover(copies / "hot3d").found[0].recordings == reader_for("hot3d").find(copies / "hot3d")


@pytest.mark.parametrize("dataset", readable_datasets())
def test_the_mark_is_seen_from_the_folder_above_too(copies, dataset) -> None:
    try:
        found = reader_for(dataset).find(copies)
    except InputFileError:
        return  # most readers do not look into sub-folders
    assert {recording.dataset for recording in found} == {f"synthetic-{dataset}"}


def test_without_their_marks_the_readers_still_agree(copies, tmp_path) -> None:
    import shutil

    root = Path(shutil.copytree(copies, tmp_path / "copies"))
    for mark in root.glob("*/synthetic.json"):
        mark.unlink()
    assert [(each.name, each.recordings[0].folder.is_relative_to(root)) for each in discover(root).found] == [
        (dataset, True) for dataset in sorted(readable_datasets())
    ]


@pytest.mark.parametrize("dataset", readable_datasets())
def test_a_whole_copy_has_every_required_file(copies, dataset) -> None:
    manifest = load_manifest(dataset)
    assert manifest.required_roles, "a manifest says which files a recording cannot do without"
    for recording in reader_for(dataset).find(copies / dataset):
        assert missing_files(recording, manifest.required_roles) == ()


def test_two_datasets_in_one_and_the_same_folder_are_both_found(copies, tmp_path) -> None:
    import shutil

    root = tmp_path / "mixed"
    for dataset in ("mogaze", "gimo"):
        shutil.copytree(copies / dataset, root, dirs_exist_ok=True)
    (root / "synthetic.json").unlink()
    assert [each.dataset for each in discover(root).found] == ["gimo", "mogaze"]
