"""An import infers what the release leaves open and says how surely; where nothing tells, nothing is guessed."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from prbench.cli import main
from prbench.errors import InputFileError, RecordingsWouldBeLost, StorageError, TableError, UsageError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.protocol.manifests import load_manifest
from prbench.release.importing import import_release, terms_of
from prbench.release.layout import folder_of
from prbench.release.reading import ImportOptions
from prbench.sequences import DatasetInfo, SequenceTable
from tests.cli.reports import printed_document, refused, reported
from tests.parsing import all_commands
from tests.release.releases import ROWS, Style, imported, in_world, rows, table_of, value, write_release

KEY = "0000000003"
PAGE = (Path(__file__).parents[2] / "docs" / "release.md").read_text(encoding="utf-8")


@pytest.fixture
def release(tmp_path):
    return write_release(tmp_path / "release")


def motions(folder) -> list[np.ndarray]:
    chunks = list(table_of(folder).chunks())
    return [np.array(c.joints[a:b]) for c in chunks for a, b in zip(c.offsets[:-1], c.offsets[1:])]


@pytest.mark.parametrize("factor", [7, 100, 1000])
def test_sizes_of_nobody_in_metres_are_refused(factor, tmp_path) -> None:
    with pytest.raises(InputFileError, match=r"pelvis to head of 0\.35 to 0\.85 m"):
        imported(tmp_path, motion=lambda row: row.joints * factor)


def test_canonical_motions_are_not_touched_and_continued_backwards(tmp_path) -> None:
    assert value(imported(tmp_path), "motion_frame") == ("canonical", "certain")
    for motion, row in zip(motions(tmp_path), ROWS):
        np.testing.assert_array_equal(motion, row.joints)
    chunk = next(table_of(tmp_path).chunks())
    for transform in chunk.vectors("world_from_canonical"):
        np.testing.assert_array_equal(transform.reshape(4, 4), np.eye(4))
    joints = ROWS[0].joints
    np.testing.assert_allclose(chunk.poses("previous_joints")[0], 2 * joints[0] - joints[1], atol=1e-6)
    assert set(chunk.strings("previous_source")) == {"extrapolated"}


def test_world_motions_are_canonicalised_and_goal_and_gaze_with_them(tmp_path) -> None:
    report = imported(tmp_path, [in_world(row) for row in ROWS])
    assert value(report, "motion_frame") == ("world (canonicalised here)", "certain")
    assert value(report, "goal_frame") == ("as the motions", "likely")
    chunk = next(table_of(tmp_path).chunks())
    goals = chunk.vectors("goal_location")
    transforms = chunk.vectors("world_from_canonical")
    for motion, goal, transform, row in zip(motions(tmp_path), goals, transforms, ROWS):
        np.testing.assert_allclose(motion, row.joints, atol=1e-5)
        np.testing.assert_allclose(goal, row.goal_location, atol=1e-5)
        np.testing.assert_allclose(transform.reshape(4, 4), row.world_from_canonical, atol=1e-5)
    valid = ROWS[0].gaze_valid.nonzero()[0]
    np.testing.assert_allclose(chunk.frames("gaze_direction")[valid], ROWS[0].gaze_direction[valid], atol=1e-5)


def test_goals_that_fit_nowhere_are_imported_but_never_scored(tmp_path) -> None:
    report = imported(tmp_path, style=Style(goal=lambda goal: [axis + 20 for axis in goal]))
    assert value(report, "goal_frame") == ("unknown", "unknown")
    with pytest.raises(TableError, match=r"cannot be scored: .*goals are in an unknown frame"):
        run_method(RunRequest(method="ground-truth", data=(tmp_path / "table",), out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_sequences_of_unknown_recordings_are_not_taken_for_independent(tmp_path) -> None:
    imported(tmp_path)
    table = table_of(tmp_path)
    assert set(table.recordings()["recording_id"].to_pylist()) == {"unknown-train", "unknown-test"}
    report = run_method(RunRequest(method="ground-truth", data=(table.folder,), out=tmp_path / "run"))
    assert report.summaries[0].recordings == 1


@pytest.mark.parametrize("rate", [20, 25, 30])
def test_primes_two_seconds_after_the_start_tell_the_rate(rate, tmp_path) -> None:
    moved = [dataclasses.replace(row, prime_frame=min(2 * rate, row.n_frames - 1)) for row in ROWS]
    moved[0] = dataclasses.replace(moved[0], prime_frame=7)
    assert value(imported(tmp_path, moved), "fps") == (str(rate), "assumed")


def test_a_stated_rate_counts_two_are_refused_and_an_untold_one_has_to_be_given(tmp_path) -> None:
    assert value(imported(tmp_path / "one", fields={"fps": 24}), "fps") == ("24", "certain")
    with pytest.raises(InputFileError, match=r"the rates \[20\.0, 24\.0\]\. .*--fps"):
        imported(tmp_path / "two", fields=lambda row: {"fps": 20 if row is ROWS[0] else 24})
    moved = [dataclasses.replace(row, prime_frame=int(5 + 3 * i)) for i, row in enumerate(ROWS)]
    with pytest.raises(InputFileError, match=r"frame rate.*--fps"):
        imported(tmp_path / "without", moved)
    assert not (tmp_path / "without" / "table").exists()
    report = imported(tmp_path / "with", moved, options=ImportOptions(fps=20.0))
    assert value(report, "fps") == ("20", "certain")


def test_every_inference_stands_in_the_report_in_the_datasets_options_and_on_the_page(tmp_path) -> None:
    imported(tmp_path)
    options = DatasetInfo.read(tmp_path / "table").options
    text = (tmp_path / "table" / "import_report.json").read_text("utf-8")
    inferred = json.loads(text)["inferred"]
    explained = re.findall(r"^\| `(\w+)` \|", PAGE.split("## What an imported table")[0], re.MULTILINE)
    assert {each["name"] for each in inferred} == set(explained)
    for each in inferred:
        assert each["how_surely"] in ("certain", "likely", "assumed", "unknown")
        assert each["evidence"]
        assert options[f"release.{each['name']}"].startswith(each["value"])
    assert str(tmp_path) not in text
    assert str(tmp_path) not in (tmp_path / "table" / "dataset.json").read_text("utf-8")


def test_options_of_the_page_exist() -> None:
    commands = [all_commands()[name] for name in ("import-release", "export-release", "explain", "run")]
    known = {option for command in commands for parameter in command.params for option in parameter.opts}
    assert set(re.findall(r"(--[a-z][a-z-]+)", PAGE)) <= known


@pytest.mark.parametrize("dataset", ["adt", "gimo", "mogaze", "hot3d", "hd-epic"])
def test_a_released_dataset_names_the_study_and_the_source(dataset, tmp_path, capsys) -> None:
    manifest = load_manifest(dataset)
    write_release(tmp_path / "root" / folder_of(dataset), rows(6, dataset))
    import_release(tmp_path / "root", tmp_path / "out")
    info = DatasetInfo.read(tmp_path / "out" / dataset)
    assert manifest.licence in info.licence
    assert "Prime and Reach release" in info.licence
    assert "hatano_prime_and_reach" in info.citation
    assert manifest.citation.strip() in info.citation
    assert info.redistribution == ("none" if manifest.redistribution == "none" else "non-commercial")
    assert not info.synthetic
    assert main(["datasets", "--cite", str(tmp_path / "out" / dataset)]) == 0
    assert capsys.readouterr().out.count("hatano_prime_and_reach") == 1


def test_terms_of_an_export_can_be_stricter_than_the_manifests_but_never_looser() -> None:
    gimo, adt = load_manifest("gimo"), load_manifest("adt")
    assert terms_of("gimo", gimo, {"redistribution": "yes"})["redistribution"] == "none"
    assert terms_of("adt", adt, {"redistribution": "none"})["redistribution"] == "none"
    assert terms_of("adt", adt, {"redistribution": "as you like"})["redistribution"] == "none"
    assert "Prime and Reach" not in terms_of("adt", adt, {"redistribution": "yes"})["licence"]


def test_a_dataset_may_be_named_as_the_authors_do_but_not_as_another(tmp_path) -> None:
    write_release(tmp_path / "root" / "ADT", rows(6, "adt"))
    for number, root in enumerate((tmp_path / "root", tmp_path / "root" / "ADT")):
        result = import_release(root, tmp_path / f"table{number}", dataset="ADT")
        assert result.tables[0].dataset == "adt"
        with pytest.raises(InputFileError, match="a folder of mogaze"):
            import_release(root, tmp_path / "other", dataset="MoGaze")
    (tmp_path / "root" / "ADT").rename(tmp_path / "release")
    with pytest.raises(UsageError, match="unknown dataset 'kitchen'"):
        import_release(tmp_path / "release", tmp_path / "other", dataset="kitchen")


def test_one_broken_dataset_does_not_stop_the_others(tmp_path, capsys) -> None:
    root = tmp_path / "root"
    for name in ("synthetic-adt", "synthetic-mogaze"):
        write_release(root / name, rows(6, name))
    (root / "synthetic-mogaze" / "target_information.json").write_text("[]", encoding="utf-8")
    (root / "notes").mkdir()
    assert main(["import-release", str(root), "--out", str(tmp_path / "out")]) == 3
    assert "failed: synthetic-mogaze: " in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["synthetic-adt"]
    assert main(["import-release", str(root), "--out", str(tmp_path / "strict"), "--on-error", "fail"]) == 3
    assert "target_information.json" in capsys.readouterr().err


def test_what_stands_at_the_place_is_never_replaced_by_less(release, tmp_path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    with pytest.raises(StorageError):
        import_release(release, tmp_path / "mine", dataset="synthetic-adt")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]

    table = tmp_path / "table"
    import_release(release, table, dataset="synthetic-adt")
    before = {path.name: path.read_bytes() for path in table.iterdir()}
    (release / "motions" / f"{KEY}.npy").unlink()
    with pytest.raises(RecordingsWouldBeLost, match=f"the new one .* with {len(ROWS) - 1}"):
        import_release(release, table, dataset="synthetic-adt")
    words = ["import-release", str(release), "--dataset", "synthetic-adt", "--out", str(table)]
    assert main(words) == 8
    (release / "target_information.json").rename(tmp_path / "kept.json")
    (release / "target_information.json").write_text("{", encoding="utf-8")
    with pytest.raises(InputFileError, match="valid JSON"):
        import_release(release, table, dataset="synthetic-adt")
    assert {path.name: path.read_bytes() for path in table.iterdir()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept.json", "mine", "release", "table"]
    (tmp_path / "kept.json").rename(release / "target_information.json")
    assert main([*words, "--replace"]) == 3
    assert SequenceTable.open(table).scalars().num_rows == len(ROWS) - 1


def test_the_command_says_what_it_inferred_and_each_step_unless_it_is_quiet(release, tmp_path, capsys) -> None:
    arguments = ["import-release", str(release), "--dataset", "synthetic-adt", "--out", str(tmp_path / "table")]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    for part in ("how surely", "primed frame", "goal_frame", "field goal", "goal_location", "assumed"):
        assert part in printed.out
    assert "synthetic-adt: " in printed.err
    assert main([*arguments, "--quiet"]) == 0
    assert capsys.readouterr().err == ""
    assert main([*arguments, "--fps", "0"]) == 2
    assert main(["export-release", str(tmp_path / "table"), "--out", str(tmp_path / "again")]) == 0
    assert "6 sequences" in capsys.readouterr().out


def test_the_report_of_the_command_is_that_of_the_file(release, tmp_path, capsys) -> None:
    (release / "motions" / f"{KEY}.npy").unlink()
    table = tmp_path / "table"
    words = ["import-release", str(release), "--dataset", "synthetic-adt", "--out", str(table), "--json"]
    (report,) = reported(words, capsys, code=3).tables
    saved = json.loads((table / "import_report.json").read_text("utf-8"))
    for name in ("inferred", "problems"):
        assert [vars(each) for each in getattr(report, name)] == saved[name]
    for name in ("fields", "warnings", "fields_kept_in_extra"):
        assert getattr(report, name) == saved[name]
    assert report.problems[0].left_out
    document = printed_document(words, capsys, code=3)
    assert any(text.startswith("problem: 1 × ") for text in document.notes)
    (exported,) = reported(["export-release", str(table), "--out", str(tmp_path / "again")], capsys).datasets
    assert (exported.dataset, exported.sequences) == ("synthetic-adt", len(ROWS) - 1)
    assert exported.folder == tmp_path / "again" / "ADT"
    (tmp_path / "empty").mkdir()
    words = ["import-release", str(tmp_path / "empty"), "--out", str(tmp_path / "x")]
    refused(words, capsys, code=3, message="HD-EPIC")
    refused(["export-release", str(tmp_path), "--out", str(tmp_path / "x")], capsys, code=4, message="built dataset")
