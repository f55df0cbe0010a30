"""``prbench inspect``: what is there, what is missing, what is cut off; without reading, and with."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from prbench.checking.catalogue import catalogue
from prbench.checking.inspection import inspect_folder
from prbench.curation.job import native_sources
from prbench.curation.options import NO_OPTIONS
from prbench.errors import InputFileError
from prbench.synthetic.write_tree import synthesize_tree


@pytest.fixture
def tree(tmp_path, adt_tree) -> Path:
    return Path(shutil.copytree(adt_tree, tmp_path / "ADT"))


def first_of(tree: Path) -> Path:
    return sorted(folder for folder in tree.iterdir() if (folder / "metadata.json").is_file())[0]


def states(root: Path, **options) -> list[tuple[str, tuple[str, ...]]]:
    return [(r.state, r.remarks) for dataset in inspect_folder(root, **options).datasets for r in dataset.recordings]


def test_a_whole_copy_is_complete_from_above_and_from_inside(tree) -> None:
    for root in (tree, tree.parent):
        inspection = inspect_folder(root)
        assert inspection.all_complete
        assert [(d.name, d.root, len(d.recordings)) for d in inspection.datasets] == [("synthetic-adt", tree, 2)]


@pytest.mark.parametrize("name", ["3d_bounding_box.csv", "scene_objects.csv", "instances.json", "eyegaze.csv"])
def test_a_missing_file_is_named_and_reading_would_fail_too(tree, name) -> None:
    (first_of(tree) / name).unlink()
    (state, remarks), (other, _) = states(tree)
    assert (state, other) == ("incomplete", "complete")
    assert name in remarks[0]
    (entry,) = catalogue(tree, "adt")
    assert any(name in line and "1 of 2 recordings" in line for line in entry.missing)


def test_invented_recordings_without_their_mark_are_incomplete(tree) -> None:
    (tree / "synthetic.json").unlink()
    assert states(tree) == [("incomplete", ("missing: synthetic.json",))] * 2


@pytest.mark.parametrize("name", ["scene_objects.csv", "instances.json", "Skeleton_*.json", "aria_trajectory.csv"])
def test_a_cut_file_is_damaged_and_an_empty_one_too(tree, name) -> None:
    (path,) = first_of(tree).glob(name)
    content = path.read_bytes()
    line = content.rindex(b"\n", 0, len(content) // 2) if b"\n" in content else len(content) // 2
    path.write_bytes(content[: line + 9])
    assert states(tree)[0][0] == "damaged"
    assert "cut off" in states(tree)[0][1][0]
    path.write_bytes(b"")
    assert states(tree)[0][1] == (f"{path.name}: empty",)


def test_only_a_thorough_look_finds_what_is_wrong_inside(tree) -> None:
    path = first_of(tree) / "aria_trajectory.csv"
    lines = path.read_text().splitlines()
    lines[5], lines[6] = lines[6], lines[5]
    path.write_text("\n".join(lines) + "\n")
    assert [state for state, _ in states(tree)] == ["complete", "complete"]
    (state, remarks), (other, _) = states(tree, thorough=True)
    assert (state, other) == ("unreadable", "complete")
    assert "aria_trajectory.csv, line" in remarks[0]


def test_a_known_bad_recording_is_said_to_be_left_out_and_harms_nothing(tree) -> None:
    first_of(tree).rename(tree / "Apartment_release_clean_seq139_M1292")
    inspection = inspect_folder(tree)
    found = {recording.recording_id: recording for recording in inspection.datasets[0].recordings}
    assert found["Apartment_release_clean_seq139_M1292"].state == "left out"
    assert inspection.all_complete


def test_a_folder_of_something_else_is_refused_with_what_it_holds(tmp_path) -> None:
    (tmp_path / "thesis").mkdir()
    with pytest.raises(InputFileError, match="thesis"):
        inspect_folder(tmp_path)
    with pytest.raises(InputFileError, match="expected a folder, found nothing"):
        inspect_folder(tmp_path / "nowhere")


def test_a_thorough_look_sees_rows_of_a_trajectory_that_reading_passes_over(tmp_path) -> None:
    root = synthesize_tree("hot3d", tmp_path / "HOT3D", recordings=1, seed=4, n_events=2).root
    (path,) = root.glob("*/mps/slam/closed_loop_trajectory.csv")
    lines = path.read_text().splitlines(keepends=True)
    broken = len(lines) // 2
    lines[broken] = lines[broken].replace(",", ",nan,", 1).rsplit(",", 1)[0] + "\n"
    path.write_text("".join(lines))
    assert states(root)[0][0] == "complete"
    state, remarks = states(root, thorough=True)[0]
    assert state == "unreadable"
    assert "closed_loop_trajectory.csv" in remarks[0]


def inspect_calls_usable(root: Path) -> bool:
    try:
        found = inspect_folder(root)
    except InputFileError:  # nothing is recognised any more
        return False
    return all(row.state in ("complete", "cut short") for each in found.datasets for row in each.recordings)


def build_reads(preset: str, root: Path) -> bool:
    try:
        (source,) = native_sources(preset, root, NO_OPTIONS)
        return source.skip_reason is None and source.read() is not None
    except InputFileError:
        return False


SLOW = [pytest.param(preset, marks=pytest.mark.slow) for preset in ("gimo", "hot3d")]


@pytest.mark.parametrize("preset", ["adt", "mogaze", "hd-epic", *SLOW])
def test_without_any_one_file_inspect_and_the_build_say_the_same(preset: str, tmp_path: Path) -> None:
    synthesize_tree(preset, tmp_path, recordings=1, seed=3, n_events=1)
    kinds: dict[str, Path] = {}
    for path in sorted(tmp_path.rglob("*.*")):
        kinds.setdefault(re.sub(r"\d+", "#", path.name), path)
    told = []
    for path in kinds.values():
        if "truth" in path.parts or not path.is_file():
            continue
        content = path.read_bytes()
        path.unlink()
        told.append(inspect_calls_usable(tmp_path))
        assert told[-1] == build_reads(preset, tmp_path), path
        path.write_bytes(content)
    assert set(told) == {True, False}
