"""``prbench build-dataset``: what its options ask of the reader, what it reports, and what damaged copies cost."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from prbench.cli import main
from prbench.cli.builds import note_recordings
from prbench.errors import UsageError
from prbench.sequences import Recording, SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from tests.cli.reports import printed_document, refused, reported
from tests.curation.sources import folder_bytes
from tests.shared import made_once


@pytest.fixture(scope="module")
def copy() -> Path:
    """A copy of a dataset with two recordings, of which one lacks a file."""

    def make(root: Path) -> None:
        synthesize_tree("adt", root / "ADT", recordings=2, seed=4, n_events=2)
        sorted(root.glob("ADT/*/scene_objects.csv"))[0].unlink()

    return made_once("incomplete-adt", make) / "ADT"


@pytest.fixture
def place(tmp_path) -> Path:
    """A folder with a copy of a dataset below ``copies/ADT``, and its table below ``tables/synthetic-adt``."""

    def make(place: Path) -> None:
        synthesize_tree("adt", place / "copies" / "ADT", recordings=1, seed=4, n_events=2)
        assert main(["build-dataset", "all", "--root", str(place / "copies"), "--out", str(place / "tables")]) == 0

    return Path(shutil.copytree(made_once("built-adt", make), tmp_path / "place"))


def record(name: str, status: str, outcomes: dict[str, int], message: str = "", **more) -> Recording:
    return Recording(name, "somebody", "train", name, 60.0, outcomes, status, message, **more)


def test_recordings_that_gave_no_sequence_or_are_cut_short_are_named_with_the_cause(capsys):
    size = "size of the glasses unknown, DVT-L assumed: gaze origins may be off by 2.4 mm"
    lacks = ("no valid gaze, so no event can be primed",)
    note_recordings(
        [
            record("blind", "read", {"not_primed": 2, "too_short": 3}, size, lacks=lacks),
            record("idle", "read", {}, size, lacks=("no hand of the wearer took up or put down an object",)),
            record("quiet", "read", {"minimum_movement": 1}, size),
            record("fine", "read", {"sequence": 1, "not_primed": 4}, "gaze on half of the frames"),
            record("broken", "failed", {}, "no file"),
            record("cut", "read", {"sequence": 1}, "objects (o.csv) ends; dim", shortfalls=("objects (o.csv) ends",)),
        ],
        reused=0,
    )
    assert capsys.readouterr().err.splitlines() == [
        "failed: broken: no file",
        "remark: fine: gaze on half of the frames",
        "remark: cut: dim",
        f"remark: blind: {size}; and 2 more, see the column `message`",
        "cut short: cut: objects (o.csv) ends",
        "no sequence: blind: of 5 events 3 too_short, 2 not_primed; no valid gaze, so no event can be primed",
        "no sequence: idle: no candidate event; no hand of the wearer took up or put down an object",
        "no sequence: quiet: of 1 events 1 minimum_movement",
    ]


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        ([], {}),
        (["--in-hand", "surface"], {"meshes": "true"}),
        (["--option", "poses=egoallo", "--option", "smplh_model=m"], {"poses": "egoallo", "smplh_model": "m"}),
    ],
)
def test_what_needs_meshes_or_bodies_asks_the_reader_for_them(words, asked, monkeypatch) -> None:
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
    words = ["build-dataset", "all", "--root", str(copy.parent)]
    (plan,) = reported([*words, "--dry-run"], capsys).planned
    assert plan.root == copy
    (tmp_path / "tables" / "synthetic-adt").mkdir(parents=True)
    (tmp_path / "tables" / "synthetic-adt" / "mine.txt").write_text("a file that prbench did not write")
    report = reported([*words, "--out", str(tmp_path / "tables")], capsys, code=3)
    assert report.built == {}
    assert [each.dataset for each in report.not_built] == ["synthetic-adt"]
    assert "synthetic-adt" in report.not_built[0].message
    assert main([*words, "--out", str(tmp_path / "others")]) == 3
    assert "from files to sequences" in capsys.readouterr().out


def test_mistakes_are_errors_in_the_document(tmp_path, capsys) -> None:
    refused(["build-dataset", "adt", "--root", str(tmp_path)], capsys, code=2, message="--out DIR is needed")
    words = ["build-dataset", "adt", "--root", str(tmp_path), "--limit", "1", "--out", str(tmp_path / "t")]
    refused(words, capsys, code=2, message="No such option '--limit'")


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
