"""Options of readers from the texts of a command line."""

from __future__ import annotations

import json

import pytest

from prbench.datasets import readable_datasets
from prbench.errors import InputFileError, UsageError
from prbench.readers import InputFile, Reader, RecordingFiles, described_options, read_synthetic_tree, reader_for


@pytest.mark.parametrize("dataset", readable_datasets())
def test_every_registered_reader_is_one(dataset) -> None:
    reader = reader_for(dataset)
    assert isinstance(reader, Reader)
    assert reader.dataset == dataset


@pytest.mark.parametrize("dataset", readable_datasets())
def test_a_wrong_root_is_told_what_was_looked_for_and_found(tmp_path, dataset) -> None:
    with pytest.raises(InputFileError, match="no such folder"):
        reader_for(dataset).find(tmp_path / "nowhere")
    (tmp_path / "root" / "holiday.jpg").mkdir(parents=True)
    with pytest.raises(InputFileError, match=r"expected .*found .*holiday\.jpg"):
        reader_for(dataset).find(tmp_path / "root")


def test_synthetic_data_has_the_reader_of_its_layout() -> None:
    assert reader_for("synthetic-adt") is reader_for("adt")


MARK = {
    "generator": "prbench 0",
    "version": 1,
    "seed": 3,
    "preset": "adt",
    "world": "default",
    "split": {"still_life": "test"},
}


def test_a_synthetic_tree_is_recognised_from_its_root_and_from_one_recording(folder) -> None:
    assert read_synthetic_tree(folder) is None
    assert reader_for("adt").find(folder)[0].dataset == "adt"
    (folder.parent / "synthetic.json").write_text(json.dumps(MARK))
    for root in (folder.parent, folder):
        tree = read_synthetic_tree(root)
        assert tree is not None
        assert tree.split == {"still_life": "test"}
        (found,) = reader_for("adt").find(root)
        assert found.dataset == "synthetic-adt"
        assert reader_for("adt").read(found).dataset == "synthetic-adt"


def test_a_damaged_mark_is_refused_and_not_taken_for_real_data(folder) -> None:
    (folder.parent / "synthetic.json").write_text(json.dumps({**MARK, "split": {"still_life": "training"}}))
    with pytest.raises(InputFileError, match=r"synthetic\.json"):
        reader_for("adt").find(folder.parent)


def test_a_missing_file_is_named_beside_the_first_others_only(tmp_path):
    files = tuple(InputFile(f"part {index}", tmp_path / f"{index:03}.npz", 1) for index in range(100))
    with pytest.raises(InputFileError, match=r"no such file beside 000\.npz, .*, 007\.npz and 92 more\. Download"):
        RecordingFiles("adt", "somewhere", tmp_path, files).require("trajectory", "trajectory.csv")


@pytest.mark.parametrize("dataset", readable_datasets())
def test_defaults_describe_themselves_without_places_of_this_machine(dataset) -> None:
    described = described_options(reader_for(dataset).options)
    assert set(described) == set(reader_for(dataset).options.names())
    assert not any("/" in value for value in described.values())


def test_texts_become_values_of_their_kind() -> None:
    options = reader_for("gimo", {"hints": "false", "body": "bvh"}).options
    assert described_options(options)["hints"] == "false"
    assert described_options(options)["body"] == "bvh"


def test_a_misspelt_name_is_answered_with_the_nearest_one() -> None:
    with pytest.raises(UsageError, match="Did you mean 'include_excluded'"):
        reader_for("mogaze", {"include_exluded": "true"})


def test_a_wrong_value_is_answered_with_the_allowed_ones() -> None:
    with pytest.raises(UsageError, match=r"\$\.body`. It is one of: auto, smplx, bvh"):
        reader_for("gimo", {"body": "sphere"})


def test_a_file_is_described_by_its_content_and_not_by_its_place(tmp_path) -> None:
    described = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "model.npz").write_bytes(b"weights")
        options = reader_for("hot3d", {"smplh_model": str(tmp_path / folder / "model.npz")}).options
        described.append(described_options(options)["smplh_model"])
    assert described[0] == described[1]
    assert len(described[0]) == 64
