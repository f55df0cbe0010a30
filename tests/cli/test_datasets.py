"""``prbench datasets`` and ``prbench inspect`` as a program reads them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from prbench.cli import main
from prbench.datasets import readable_datasets
from prbench.synthetic.write_tree import synthesize_tree
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def copies(tmp_path_factory) -> Path:
    """A folder with a copy of ADT, of which one recording out of two lacks a required file."""
    root = tmp_path_factory.mktemp("copies")
    synthesize_tree("adt", root / "ADT", recordings=2, seed=4, n_events=1)
    sorted(root.glob("ADT/*/scene_objects.csv"))[0].unlink()
    return root


def test_every_dataset_is_reported_with_its_terms(capsys) -> None:
    report = reported(["datasets"], capsys)
    assert set(readable_datasets()) <= {each.name for each in report.datasets}
    for each in report.datasets:
        assert each.licence
        assert each.redistribution in ("yes", "non-commercial", "none")
        assert each.found == ""
    assert report.unusable_readers == []


def test_what_is_found_below_a_folder_is_reported_with_what_it_lacks(copies, capsys) -> None:
    (adt,) = reported(["datasets", "adt", "--root", str(copies)], capsys).datasets
    assert adt.found == f"2 recordings in {copies / 'ADT'}"
    assert any("scene_objects.csv is missing in 1 of 2 recordings" in line for line in adt.missing)
    assert adt.rates_hz
    assert adt.citation.startswith("@")


def test_the_printed_list_and_page_hold_what_the_report_holds(copies, capsys) -> None:
    assert main(["datasets", "--root", str(copies)]) == 0
    printed = capsys.readouterr().out
    assert str(copies / "ADT") in printed
    assert "adt: scene_objects.csv is missing" in printed
    assert main(["datasets", "adt"]) == 0
    assert "licence:         " in capsys.readouterr().out


def test_a_mistake_in_a_name_is_an_error_in_the_document(capsys) -> None:
    refused(["datasets", "atd"], capsys, code=2, message="Did you mean 'adt'?")


def test_citations_are_reported_as_they_are_printed(tmp_path, capsys) -> None:
    table = fake_dataset(tmp_path / "table", 4).folder
    report = reported(["datasets", "--cite", str(table)], capsys)
    assert main(["datasets", "--cite", str(table)]) == 0
    assert capsys.readouterr().out == f"{report.bibtex}\n"
    refused(["datasets", "--cite", str(tmp_path / "gone")], capsys, code=4, message="expected a built dataset")


def test_an_inspection_reports_every_recording_also_the_complete_ones(copies, tmp_path, capsys) -> None:
    report = reported(["inspect", str(copies)], capsys, code=3)
    (adt,) = report.datasets
    assert (adt.name, adt.root) == ("synthetic-adt", copies / "ADT")
    assert [each.state for each in adt.recordings] == ["incomplete", "complete"]
    assert "scene_objects.csv" in " ".join(adt.recordings[0].remarks)
    assert all(each.size > 0 for each in adt.recordings)
    assert main(["inspect", str(copies), "--out", str(tmp_path / "i.json")]) == 3
    printed = capsys.readouterr().out
    assert f"report: {tmp_path / 'i.json'}" in printed
    document = json.loads((tmp_path / "i.json").read_text())
    assert (document["command"], document["exit_code"]) == ("inspect", 3)
    assert document["report"]["datasets"][0]["recordings"][1]["state"] == "complete"
    refused(["inspect", str(tmp_path / "gone")], capsys, code=3, message="gone")
