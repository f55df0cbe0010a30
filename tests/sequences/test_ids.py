"""Names that would lead out of a folder, and ids that stand twice, are refused and nothing is made."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.curation.job import native_sources
from prbench.curation.options import NO_OPTIONS
from prbench.errors import InputFileError, RunError, TableError
from prbench.files.storage import is_path_part
from prbench.harness.run_folder.scores import SCORES, read_scores, write_scores
from prbench.sequences import SequenceTable
from tests.fakes import fake_dataset


@pytest.mark.parametrize("name", ["../../evil", "y" * 100_000])
def test_a_dataset_whose_name_leads_elsewhere_leaves_nothing_behind(tmp_path: Path, capsys, name: str) -> None:
    tables = [fake_dataset(tmp_path / "deep" / "down" / part, 4).folder for part in "ab"]
    info = json.loads((tables[1] / "dataset.json").read_text())
    (tables[1] / "dataset.json").write_text(json.dumps(info | {"dataset": name}))
    before = {path.relative_to(tmp_path) for path in tmp_path.rglob("*")}
    run = ["run", "--method", "static", "--condition", "none", "--out", str(tmp_path / "deep" / "down" / "run")]
    assert main([*run, "--data", *map(str, tables)]) == TableError.exit_code
    said = capsys.readouterr().err
    assert "dataset: expected a name that a folder can have" in said
    assert len(said) < 1000
    assert {path.relative_to(tmp_path) for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize("name", ["adt", "synthetic-hot3d", "My Data 2", "hd_epic.v2"])
def test_ordinary_names_are_fine(name: str) -> None:
    assert is_path_part(name)


@pytest.mark.parametrize("name", ["/tmp/evil", "..", "", "-rf", ".hidden", "a\\b", "a:b", "x\x1b", "y" * 200])
def test_other_names_are_not(name: str) -> None:
    assert not is_path_part(name)


@pytest.mark.parametrize("name", ["sequences", "events", "recordings"])
def test_a_table_with_an_id_twice_is_refused_and_the_id_named(tmp_path: Path, name: str, monkeypatch) -> None:
    monkeypatch.setattr(SequenceTable, "require_unchanged", lambda _: None)  # a table that was forged with its digests
    folder = fake_dataset(tmp_path / "d", 6).folder
    path = folder / f"{name}.parquet"
    rows = pq.read_table(path)
    if len(rows) == 0:
        pytest.skip("the table of this kind is empty here")
    pq.write_table(pa.concat_tables([rows, rows.slice(0, 1)]), path)
    first = rows.column(0)[0].as_py()
    with pytest.raises(TableError, match=f"{name}: expected rows with different ids, found '{first}' twice"):
        getattr(SequenceTable.open(folder), name)()


def test_scores_with_a_value_twice_are_refused(tmp_path: Path) -> None:
    row = {"sequence_id": "a/b", "dataset": "adt", "sample": 0, "metric": "mpjpe", "value": 0.5, "flag": None}
    write_scores(tmp_path / "scores.parquet", [pa.Table.from_pylist([row, row], SCORES)])
    with pytest.raises(RunError, match=r"expected one value for each .*, found more: adt, a/b, sample 0, mpjpe"):
        read_scores(tmp_path / "scores.parquet")


def test_one_recording_in_two_folders_is_refused_and_both_are_named(tmp_path: Path, monkeypatch) -> None:
    class Twice:
        dataset = "adt"

        def find(self, root: Path):
            from prbench.readers import RecordingFiles

            return tuple(RecordingFiles("adt", "kitchen", root / part, ()) for part in ("one", "two"))

    monkeypatch.setattr("prbench.curation.job.reader_for", lambda *_: Twice())
    with pytest.raises(InputFileError, match=r"'kitchen' in .*one and .*two"):
        native_sources("adt", tmp_path, NO_OPTIONS)


def test_a_message_that_quotes_a_header_of_100_000_characters_is_cut(tmp_path: Path, capsys) -> None:
    folder = fake_dataset(tmp_path / "d", 2).folder
    rows = pq.read_table(folder / "sequences.parquet")
    pq.write_table(rows.rename_columns(["x" * 100_000, *rows.column_names[1:]]), folder / "sequences.parquet")
    assert main(["inspect", str(folder)]) == TableError.exit_code
    assert len(capsys.readouterr().err) < 5_000
