"""The commands on copies that are damaged or gone: what they say, what they leave alone, and how they end."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from prbench.cli.main import main
from prbench.sequences import SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from tests.curation.sources import folder_bytes


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with a copy of a dataset below ``copies/ADT``, and its table below ``tables/synthetic-adt``."""
    place = tmp_path_factory.mktemp("place")
    synthesize_tree("adt", place / "copies" / "ADT", recordings=1, seed=4, n_events=2)
    words = ["build-dataset", "all", "--root", str(place / "copies"), "--out", str(place / "tables")]
    assert main(words) == 0
    return place


@pytest.fixture
def place(built, tmp_path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "place"))


def build(place: Path, name: str, *more: str) -> int:
    root = place / "copies" if name == "all" else place / "copies/ADT"
    out = place / "tables" if name == "all" else place / "tables" / name
    return main(["build-dataset", name.removeprefix("synthetic-"), "--root", str(root), "--out", str(out), *more])


@pytest.mark.parametrize("name", ["all", "synthetic-adt"])
def test_a_copy_that_is_gone_costs_no_table(place, capsys, name) -> None:
    for path in place.glob("copies/ADT/*/scene_objects.csv"):
        path.unlink()
    before = folder_bytes(place / "tables")
    assert build(place, name) != 0
    told = " ".join("".join(capsys.readouterr()).split())
    for part in ("not replaced", "1 recordings with", "the new one 0 with 0", "scene_objects.csv", "--replace"):
        assert part in told, part
    assert {name: content for name, content in folder_bytes(place / "tables").items() if ".work" not in name} == before
    build(place, name, "--replace")
    assert SequenceTable.open(place / "tables" / "synthetic-adt").info.counts.recordings_read == 0


def test_a_file_cut_between_two_lines_is_told_by_every_command(place, capsys) -> None:
    (path,) = place.glob("copies/ADT/*/scene_objects.csv")
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[: int(len(lines) * 0.6)]))
    for thorough in ([], ["--thorough"]):
        assert main(["inspect", str(place / "copies"), *thorough]) == 3
        told = " ".join(capsys.readouterr().out.split())
        assert "1 recording (1 cut short)" in told
        assert "objects (scene_objects.csv) ends" in told
    assert main(["build-dataset", "adt", "--root", str(place / "copies/ADT"), "--out", str(place / "cut")]) == 3
    printed = capsys.readouterr()
    assert "1 of those that were read are cut short" in " ".join(printed.out.split())
    assert "cut short: " in printed.err
    (row,) = SequenceTable.open(place / "cut").recordings().to_pylist()
    assert "objects (scene_objects.csv) ends" in row["message"]
    assert main(["inspect", str(place / "cut")]) == 0
    assert "1 of 1 recordings are cut short" in capsys.readouterr().out
    assert build(place, "all") == 3, "nor does it replace the table of the whole copy"
    assert "scene_objects" not in (place / "tables/synthetic-adt/dataset.json").read_text()
