"""Options of readers from the texts of a command line."""

from __future__ import annotations

import pytest

from prbench.datasets import readable_datasets
from prbench.errors import UsageError
from prbench.readers import described_options, reader_for


@pytest.mark.parametrize("dataset", readable_datasets())
def test_defaults_describe_themselves_without_places_of_this_machine(dataset) -> None:
    described = described_options(reader_for(dataset).options)
    assert set(described) == set(reader_for(dataset).options.names())
    assert not any("/" in value for value in described.values())


def test_texts_become_values_of_their_kind() -> None:
    options = reader_for("gimo", {"meshes": "true", "body": "bvh"}).options
    assert described_options(options)["meshes"] == "true"
    assert described_options(options)["body"] == "bvh"


def test_a_misspelt_name_is_answered_with_the_nearest_one() -> None:
    with pytest.raises(UsageError, match="Did you mean 'include_excluded'"):
        reader_for("mogaze", {"include_exluded": "true"})


def test_a_wrong_value_is_answered_with_the_allowed_ones() -> None:
    with pytest.raises(UsageError, match="body is one of: auto, smplx, bvh"):
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
