"""``prbench build-dataset``: what its options ask of the reader, and what it reports."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from prbench.cli import main
from prbench.errors import UsageError
from prbench.synthetic.write_tree import synthesize_tree
from tests.cli.reports import printed_document, refused, reported


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """A copy of a dataset with two recordings, of which one lacks a file."""
    root = tmp_path_factory.mktemp("copies") / "ADT"
    synthesize_tree("adt", root, recordings=2, seed=4, n_events=2)
    sorted(root.glob("*/scene_objects.csv"))[0].unlink()
    return root


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        ([], {}),
        (["--in-hand", "surface"], {"meshes": "true"}),
        (["--option", "poses=egoallo", "--option", "smplh_model=m"], {"poses": "egoallo", "smplh_model": "m"}),
    ],
)
def test_what_needs_meshes_or_bodies_asks_the_reader_for_them(words, asked, tmp_path, monkeypatch) -> None:
    given = []

    def build(dataset, root, out, *, options, **_):
        given.append((dataset, root, out, dict(options.reader)))
        raise UsageError("far enough")

    monkeypatch.setattr("prbench.curation.build_dataset", build)
    assert main(["build-dataset", "hot3d", "--root", "r", "--out", "o", *words]) == 2
    assert given == [("hot3d", Path("r"), Path("o"), asked)]


def test_a_build_reports_its_funnel_and_every_recording(copy, tmp_path, capsys) -> None:
    words = ["build-dataset", "adt", "--root", str(copy), "--out", str(tmp_path / "table")]
    report = reported(words, capsys, code=3)
    assert report.built == {str(tmp_path / "table"): json.loads((tmp_path / "table" / "dataset.json").read_text())}
    assert report.planned == report.not_built == []
    document = printed_document([*words, "--quiet"], capsys, code=3)
    assert any(text.startswith("failed: ") and "scene_objects.csv" in text for text in document.notes)


def test_a_plan_reports_what_would_be_read_and_writes_nothing(copy, tmp_path, capsys) -> None:
    words = ["build-dataset", "adt", "--root", str(copy), "--dry-run"]
    (one,) = reported([*words, "--workers", "2"], capsys).planned
    assert (one.dataset, one.root, len(one.recordings)) == ("adt", copy, 2)
    assert one.input_bytes > 0
    (first,) = reported([*words, "--max-recordings", "1"], capsys).planned
    assert first.recordings == one.recordings[:1]
    (chosen,) = reported([*words, "--recordings", "*seq001*"], capsys).planned
    assert chosen.recordings == one.recordings[1:]
    assert list(tmp_path.iterdir()) == []


def test_building_all_reports_what_gave_no_table(copy, tmp_path, capsys) -> None:
    shutil.copytree(copy, tmp_path / "copies" / "ADT")
    words = ["build-dataset", "all", "--root", str(tmp_path / "copies")]
    (plan,) = reported([*words, "--dry-run"], capsys).planned
    assert plan.root == tmp_path / "copies" / "ADT"
    (tmp_path / "tables" / "synthetic-adt").mkdir(parents=True)
    (tmp_path / "tables" / "synthetic-adt" / "mine.txt").write_text("a file that prbench did not write")
    report = reported([*words, "--out", str(tmp_path / "tables")], capsys, code=3)
    assert report.built == {}
    assert [each.dataset for each in report.not_built] == ["synthetic-adt"]
    assert "synthetic-adt" in report.not_built[0].message
    assert main([*words, "--out", str(tmp_path / "others")]) == 3
    printed = capsys.readouterr().out
    assert "from files to sequences" in printed


def test_mistakes_are_errors_in_the_document(tmp_path, capsys) -> None:
    refused(["build-dataset", "adt", "--root", str(tmp_path)], capsys, code=2, message="--out DIR is needed")
    words = ["build-dataset", "adt", "--root", str(tmp_path), "--limit", "1", "--out", str(tmp_path / "t")]
    refused(words, capsys, code=2, message="No such option '--limit'")
