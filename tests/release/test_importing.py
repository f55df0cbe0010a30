"""Damaged and incomplete releases: everything is named, nothing is dropped in silence, nothing is half-written."""

from __future__ import annotations

import json
import pickle
import re

import numpy as np
import pytest

from prbench.cli import main
from prbench.errors import InputFileError, RecordingsWouldBeLost, StorageError, UsageError
from prbench.release.importing import import_release
from prbench.release.reading import ImportOptions
from prbench.sequences import DatasetInfo, SequenceTable
from tests.cli.reports import printed_document, refused, reported
from tests.release.releases import rows, write_release
from tests.release.tables import looking_table

ROWS = rows(6)
KEY = "0000000003"


@pytest.fixture
def release(tmp_path):
    return write_release(tmp_path / "release", ROWS)


def targets(release) -> dict:
    return json.loads((release / "target_information.json").read_text("utf-8"))


def rewrite(release, change) -> None:
    entries = targets(release)
    change(entries[KEY])
    (release / "target_information.json").write_text(json.dumps(entries), encoding="utf-8")


def changed_array(kind, change):
    def spoil(release):
        path = release / kind / f"{KEY}.npy"
        np.save(path, change(np.load(path)), allow_pickle=True)

    return spoil


def cut(release):
    path = release / "motions" / f"{KEY}.npy"
    path.write_bytes(path.read_bytes()[:-100])


def with_nan(motion):
    motion[4, 7, 1] = np.nan
    return motion


LEFT_OUT = {
    "no motion": (lambda release: (release / "motions" / f"{KEY}.npy").unlink(), "no file in motions"),
    "truncated": (cut, r"motion: expected \d+ bytes for shape"),
    "empty file": (
        lambda release: (release / "motions" / f"{KEY}.npy").write_bytes(b""),
        "an array as np.save writes it",
    ),
    "a page of HTML": (
        lambda r: (r / "motions" / f"{KEY}.npy").write_text("<html>" * 99),
        "an array as np.save writes it",
    ),
    "objects": (changed_array("motions", lambda _: np.array([{"a": 1}], dtype=object)), "found Python objects"),
    "integers": (changed_array("motions", lambda m: m.astype(np.int32)), "float32 or float64"),
    "24 joints": (changed_array("motions", lambda m: np.zeros((9, 24, 3), np.float32)), r"shape \(N, 22, 3\)"),
    "flat": (changed_array("motions", lambda m: m.reshape(len(m), 66)), r"shape \(N, 22, 3\)"),
    "one frame": (changed_array("motions", lambda m: m[:1]), "2 frames or more"),
    "NaN": (changed_array("motions", with_nan), "found NaN"),
    "no heading": (changed_array("motions", lambda m: np.zeros_like(m)), "has no heading"),
    "no goal": (lambda r: rewrite(r, lambda entry: entry.pop("goal_location")), "three finite numbers, found nothing"),
    "NaN goal": (
        lambda r: rewrite(r, lambda e: e.update(goal_location=[float("nan"), 0, 0])),
        "three finite numbers",
    ),
    "no such subset": (lambda r: rewrite(r, lambda e: e.update(subset="holdout")), "train or test, found 'holdout'"),
    "prime after the end": (lambda r: rewrite(r, lambda e: e.update(primed_frame=5000)), "primed frame"),
    "prime before the start": (lambda r: rewrite(r, lambda e: e.update(primed_frame=-1)), "primed frame"),
    "half a frame": (lambda r: rewrite(r, lambda e: e.update(primed_frame=40.5)), "primed frame"),
    "a deep goal": (
        lambda r: rewrite(r, lambda e: e.update(goal_location=json.loads("[" * 90 + "1" + "]" * 90))),
        "three finite numbers",
    ),
    "no prime": (lambda r: rewrite(r, lambda e: e.update(primed_frame=None)), "expected a number"),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_a_sequence_that_cannot_be_used_is_left_out_and_named(name, release, tmp_path) -> None:
    spoil, message = LEFT_OUT[name]
    spoil(release)
    result = import_release(release, tmp_path / "table", dataset="synthetic-adt")
    assert not result.complete
    table = SequenceTable.open(tmp_path / "table")
    assert table.scalars().num_rows == len(ROWS) - 1
    assert [each.recording_id for each in table.info.quarantine] == [f"sequence {KEY}"]

    assert re.search(message, table.info.quarantine[0].message)
    assert table.info.counts.recordings_failed == 1
    failed = [row for row in table.recordings().to_pylist() if row["status"] == "failed"]
    assert [row["recording_id"] for row in failed] == [f"sequence {KEY}"]
    options = ImportOptions(on_error="fail")
    with pytest.raises(InputFileError, match=KEY):
        import_release(release, tmp_path / "strict", dataset="synthetic-adt", options=options)
    assert not (tmp_path / "strict").exists()


KEPT = {
    "no gaze": (lambda r: (r / "gazes" / f"{KEY}.npy").unlink(), "no file in gazes", 0),
    "short gaze": (changed_array("gazes", lambda g: g[:-5]), "found .*: no gaze", 0),
    "gaze of a frame less": (changed_array("gazes", lambda g: g[:-1]), "found .*: no gaze", 0),
    "zero gaze": (changed_array("gazes", lambda g: g * 0), "no frame has a unit vector", 0),
    "flat gaze": (changed_array("gazes", lambda g: g[:, :2]), r"shape \(N, 3\)", 0),
}


@pytest.mark.parametrize("name", KEPT)
def test_a_sequence_with_bad_gaze_is_kept_without_it(name, release, tmp_path) -> None:
    spoil, message, valid = KEPT[name]
    before = import_release(release, tmp_path / "before", dataset="synthetic-adt").tables[0]
    assert before.problems == []
    spoil(release)
    report = import_release(release, tmp_path / "table", dataset="synthetic-adt").tables[0]
    assert report.left_out == 0
    assert [each.sequence for each in report.problems] == [KEY]

    assert re.search(message, report.problems[0].problem)
    chunk = next(SequenceTable.open(tmp_path / "table").chunks())
    row = chunk.take([3])
    expected = ROWS[3].gaze_valid.copy()
    if valid == 0:
        expected[:] = False
    np.testing.assert_array_equal(row.frames("gaze_valid"), expected)


def test_gaze_lengths_near_one_are_made_one_and_others_invalid(tmp_path) -> None:
    def gaze(row):
        directions = row.gaze_direction.copy()
        directions[0] *= 1.1
        directions[1] *= 1.5
        directions[2] = np.nan
        directions[3] = 0
        return directions

    release = write_release(tmp_path / "release", ROWS, gaze=gaze)
    import_release(release, tmp_path / "table", dataset="synthetic-adt")
    chunk = next(SequenceTable.open(tmp_path / "table").chunks()).take([0])
    assert chunk.frames("gaze_valid")[:5].tolist() == [True, False, False, False, True]
    np.testing.assert_allclose(np.linalg.norm(chunk.frames("gaze_direction"), axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(chunk.frames("gaze_direction")[0], ROWS[0].gaze_direction[0], atol=1e-6)


def test_files_without_entries_are_named(release, tmp_path) -> None:
    np.save(release / "motions" / "0000000099.npy", ROWS[0].joints)
    (release / "motions" / "readme.txt").write_text("hello")
    result = import_release(release, tmp_path / "table", dataset="synthetic-adt")
    assert not result.complete
    report = result.tables[0]
    assert [(each.sequence, each.problem) for each in report.problems] == [
        ("0000000099", "a motion without an entry in target_information.json")
    ]


def test_keys_without_numbers_are_named(tmp_path) -> None:
    from tests.release.releases import Style

    names = ["first", "1", "2", "3", "4", "5"]
    release = write_release(tmp_path / "release", ROWS, Style(key=lambda index: names[index]))
    report = import_release(release, tmp_path / "table", dataset="synthetic-adt").tables[0]
    assert [(each.sequence, each.problem) for each in report.problems] == [
        ("first", "an entry without a motion: its key holds no number"),
        ("0000000000", "a motion without an entry in target_information.json"),
    ]


@pytest.mark.parametrize("link", ["file", "folder", "dataset", "targets"])
def test_no_path_is_followed_out_of_the_release(link, release, tmp_path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    root = tmp_path / "root"
    root.mkdir()
    inner = root / "synthetic-adt"
    if link == "dataset":
        release.rename(outside / "synthetic-adt")
        inner.symlink_to(outside / "synthetic-adt")
    else:
        release.rename(inner)
        names = {"file": f"motions/{KEY}.npy", "folder": "motions", "targets": "target_information.json"}
        moved = inner / names[link]
        moved.rename(outside / moved.name)
        moved.symlink_to(outside / moved.name)
    with pytest.raises(InputFileError, match="a link that leads out of it"):
        import_release(root, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_key_is_never_a_path(release, tmp_path) -> None:
    entries = targets(release)
    entries["../../etc/0000000003"] = entries.pop(KEY)
    (release / "target_information.json").write_text(json.dumps(entries), encoding="utf-8")
    report = import_release(release, tmp_path / "table", dataset="synthetic-adt").tables[0]
    assert report.left_out == 0


def test_nothing_is_unpickled(release, tmp_path) -> None:
    marker = tmp_path / "executed"

    class Bomb:
        def __reduce__(self):
            return (marker.write_text, ("boom",))

    (release / "motions" / f"{KEY}.npy").write_bytes(pickle.dumps(Bomb()))
    np.save(release / "gazes" / f"{KEY}.npy", np.array([Bomb()], dtype=object), allow_pickle=True)
    import_release(release, tmp_path / "table", dataset="synthetic-adt")
    assert not marker.exists()


def test_a_header_that_claims_more_than_the_file_holds_takes_no_memory(release, tmp_path) -> None:
    path = release / "motions" / f"{KEY}.npy"
    np.save(path, np.zeros((2, 22, 3), np.float32))
    honest = path.read_bytes()
    for number, lie in enumerate(
        (b"(200000000000, 22, 3), }", b"(200000000000, 22, 3)   ", b"(-2, -22, 3), }         ")
    ):
        path.write_bytes(honest.replace(b"(2, 22, 3), }           ", lie))
        assert path.read_bytes() != honest
        result = import_release(release, tmp_path / f"table{number}", dataset="synthetic-adt")
        assert result.tables[0].left_out == 1


def test_something_that_is_no_table_is_never_replaced(release, tmp_path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    with pytest.raises(StorageError):
        import_release(release, tmp_path / "mine", dataset="synthetic-adt")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]


def test_a_failed_import_leaves_the_earlier_table(release, tmp_path) -> None:
    import_release(release, tmp_path / "table", dataset="synthetic-adt")
    before = DatasetInfo.read(tmp_path / "table")
    (release / "target_information.json").write_text("{", encoding="utf-8")
    with pytest.raises(InputFileError, match="valid JSON"):
        import_release(release, tmp_path / "table", dataset="synthetic-adt")
    assert DatasetInfo.read(tmp_path / "table") == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["release", "table"]


def test_one_broken_dataset_does_not_stop_the_others(tmp_path, capsys) -> None:
    root = tmp_path / "root"
    for name in ("synthetic-adt", "synthetic-mogaze"):
        write_release(root / name, rows(6, name))
    (root / "synthetic-mogaze" / "target_information.json").write_text("[]", encoding="utf-8")
    (root / "notes").mkdir()
    assert main(["import-release", str(root), "--out", str(tmp_path / "out")]) == 3
    assert "failed: synthetic-mogaze: " in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["synthetic-adt"]
    code = main(["import-release", str(root), "--out", str(tmp_path / "strict"), "--on-error", "fail"])
    assert code == 3
    assert "target_information.json" in capsys.readouterr().err


def test_the_command_says_what_it_inferred(release, tmp_path, capsys) -> None:
    arguments = ["import-release", str(release), "--dataset", "synthetic-adt", "--out", str(tmp_path / "table")]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    for part in ("how surely", "primed frame", "goal frame", "field goal", "goal_location", "assumed"):
        assert part in text
    assert main([*arguments, "--fps", "0"]) == 2
    assert main(["import-release", str(tmp_path), "--out", str(tmp_path / "x")]) == 3
    assert "HD-EPIC" in capsys.readouterr().err
    assert main(["export-release", str(tmp_path / "table"), "--out", str(tmp_path / "again")]) == 0
    assert "6 sequences" in capsys.readouterr().out


def test_the_report_of_the_command_is_that_of_the_file(release, tmp_path, capsys) -> None:
    (release / "motions" / f"{KEY}.npy").unlink()
    table = tmp_path / "table"
    words = ["import-release", str(release), "--dataset", "synthetic-adt", "--out", str(table), "--json"]
    (imported,) = reported(words, capsys, code=3).tables
    saved = json.loads((table / "import_report.json").read_text("utf-8"))
    assert [vars(each) for each in imported.inferred] == saved["inferred"]
    assert imported.fields == saved["fields"]
    assert [vars(each) for each in imported.counts] == saved["counts"]
    assert [vars(each) for each in imported.problems] == saved["problems"]
    assert imported.problems[0].left_out
    assert (imported.warnings, imported.fields_kept_in_extra) == (saved["warnings"], saved["fields_kept_in_extra"])
    document = printed_document(words, capsys, code=3)
    assert any(text.startswith("problem: 1 × ") for text in document.notes)
    (exported,) = reported(["export-release", str(table), "--out", str(tmp_path / "again")], capsys).datasets
    assert (exported.dataset, exported.sequences) == ("synthetic-adt", len(ROWS) - 1)
    assert exported.folder == tmp_path / "again" / "synthetic-adt"
    refused(["import-release", str(tmp_path), "--out", str(tmp_path / "x")], capsys, code=3, message="HD-EPIC")
    refused(["export-release", str(tmp_path), "--out", str(tmp_path / "x")], capsys, code=4, message="built dataset")


def test_the_steps_of_an_import_are_told_unless_it_is_quiet(release, tmp_path, capsys) -> None:
    words = ["import-release", str(release), "--dataset", "synthetic-adt", "--out", str(tmp_path / "table")]
    assert main(words) == 0
    assert "synthetic-adt: " in capsys.readouterr().err
    assert main([*words, "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_damaged_further_arrays_are_told(tmp_path) -> None:
    from prbench.release.exporting import export_release

    table = looking_table(tmp_path / "table", 6)
    export_release([table.folder], tmp_path / "release")
    path = tmp_path / "release" / "synthetic-adt" / "further" / "0000000002.npz"
    path.write_bytes(path.read_bytes()[:200])
    result = import_release(tmp_path / "release", tmp_path / "back", dataset="synthetic-adt")
    assert [each.problem for each in result.tables[0].problems] == ["further: damaged or of another motion, not used"]
    assert SequenceTable.open(tmp_path / "back").scalars().num_rows == 6


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


def test_a_field_of_another_kind_in_one_entry_does_no_harm(release, tmp_path) -> None:
    entries = targets(release)
    for key, entry in entries.items():
        entry |= {"units": "m", "fps": 20, "action": "pick", "video": "v", "hand": "left"}
        if key == KEY:
            entry |= {"units": ["m"], "fps": {}, "action": [1], "video": {"a": 1}, "hand": 7, "text_prompt": 5}
    (release / "target_information.json").write_text(json.dumps(entries), encoding="utf-8")
    report = import_release(release, tmp_path / "table", dataset="synthetic-adt").tables[0]
    assert report.left_out == 0
    row = SequenceTable.open(tmp_path / "table").scalars().to_pylist()[3]
    assert (row["action"], row["hand"], row["text"], row["recording_id"]) == ("unknown", None, "", "unknown-test")


def test_an_import_that_lacks_a_sequence_does_not_replace_the_table_of_the_whole_release(release, tmp_path) -> None:
    table = tmp_path / "table"
    import_release(release, table, dataset="synthetic-adt")
    before = {path.name: path.read_bytes() for path in table.iterdir()}
    (release / "motions" / f"{KEY}.npy").unlink()
    with pytest.raises(RecordingsWouldBeLost, match=f"the new one .* with {len(ROWS) - 1}"):
        import_release(release, table, dataset="synthetic-adt")
    assert {path.name: path.read_bytes() for path in table.iterdir()} == before
    words = ["import-release", str(release), "--dataset", "synthetic-adt", "--out", str(table)]
    assert main([*words]) == 8
    assert main([*words, "--replace"]) == 3
    assert SequenceTable.open(table).scalars().num_rows == len(ROWS) - 1
