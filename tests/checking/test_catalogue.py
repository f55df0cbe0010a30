from __future__ import annotations

import msgspec
import pytest

from prbench.checking.catalogue import catalogue, citation_text
from prbench.checking.inspection import inspect_folder
from prbench.errors import InputFileError, TableError, UsageError
from prbench.protocol.manifests import dataset_names, load_manifest
from prbench.sequences import SequenceTable
from prbench_adapters.corpora.build import build_corpus
from prbench_adapters.corpora.synthetic import synthesize_corpus_tree
from tests.fakes import fake_dataset


def test_every_dataset_is_listed_with_its_terms() -> None:
    entries = catalogue()
    assert tuple(entry.name for entry in entries) == dataset_names()
    assert all(entry.redistribution in ("none", "non-commercial", "yes") for entry in entries)


def test_what_is_below_a_root_is_counted_and_told_with_its_place(tmp_path, adt_tree) -> None:
    (entry,) = catalogue(adt_tree, "adt")
    assert entry.found == f"2 recordings in {adt_tree}"
    (entry,) = catalogue(adt_tree.parent, "adt")
    assert entry.found == f"2 recordings in {adt_tree}"


def test_a_root_without_any_dataset_is_refused_with_what_it_holds(tmp_path) -> None:
    (tmp_path / "holiday").mkdir()
    with pytest.raises(InputFileError, match="holiday"):
        catalogue(tmp_path)


def test_a_misspelt_name_is_answered_with_the_nearest_one() -> None:
    with pytest.raises(UsageError, match="Did you mean 'adt'"):
        catalogue(name="atd")


def test_a_citation_holds_terms_dataset_study_and_toolkit_each_once(tmp_path) -> None:
    manifest = load_manifest("adt")
    folders = []
    for name in ("one", "two"):
        table = fake_dataset(tmp_path / name, n=3)
        info = msgspec.structs.replace(
            table.info, licence=manifest.licence, redistribution="non-commercial", citation=manifest.citation
        )
        info.write(table.folder)
        folders.append(SequenceTable.open(table.folder).folder)
    text = citation_text(folders)
    assert text.count("@inproceedings{pan2023aria") == 1
    assert text.count("@misc{hatano_prime_and_reach") == 1
    assert text.count("@software{prbench") == 1
    assert "VERSION" not in text
    assert text.count("% synthetic-adt") == 2
    assert "non-commercial purposes only" in text
    assert text.count("{") == text.count("}")


def test_a_folder_that_is_no_table_is_refused(tmp_path) -> None:
    with pytest.raises(TableError, match=r"dataset\.json"):
        citation_text([tmp_path])


def test_corpora_are_found_and_cited_like_datasets(tmp_path) -> None:
    synthesize_corpus_tree("nymeria", tmp_path / "copies" / "Nymeria", recordings=1, seed=3)
    (entry,) = catalogue(tmp_path / "copies", "nymeria")
    assert entry.found.startswith("1 recordings in ")
    build_corpus("nymeria", tmp_path / "copies" / "Nymeria", tmp_path / "corpus")
    text = citation_text([tmp_path / "corpus"])
    assert "% synthetic-nymeria" in text
    assert "@software{prbench" in text
    (inspected,) = inspect_folder(tmp_path / "copies").datasets
    assert (inspected.name, inspected.recordings[0].state) == ("synthetic-nymeria", "complete")
