"""A table that goes out through the layout and comes back is the same table."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pytest

from prbench.errors import TableError, UsageError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.release.exporting import export_release
from prbench.release.importing import import_release
from prbench.release.reading import ImportOptions
from prbench.sequences import SequenceTable
from prbench.sequences.schema import SEQUENCES
from prbench.viewing.explain import explain_event
from tests.release.tables import looking_table

DATASETS = ["synthetic-adt", "synthetic-mogaze", "synthetic-hot3d", "synthetic-hd-epic", "synthetic-gimo"]


def whole(table: SequenceTable) -> pa.Table:
    return pa.Table.from_batches([chunk.batch for chunk in table.chunks()]).combine_chunks()


def leaves(column: pa.ChunkedArray) -> np.ndarray:
    array = column.combine_chunks()
    while pa.types.is_nested(array.type):
        array = array.flatten()
    return array.to_numpy(zero_copy_only=False)


def test_tables_of_all_datasets_come_back_without_change(tmp_path) -> None:
    tables = [looking_table(tmp_path / name, 12, dataset=name) for name in DATASETS]
    export_release([table.folder for table in tables], tmp_path / "release")
    result = import_release(tmp_path / "release", tmp_path / "back")
    assert result.complete
    assert sorted(report.dataset for report in result.tables) == sorted(DATASETS)
    for table in tables:
        back = SequenceTable.open(tmp_path / "back" / table.info.dataset)
        assert back.identity == table.identity
        assert back.content == table.content
        for name in SEQUENCES.names:
            assert whole(back)[name].equals(whole(table)[name]), f"{name} is the same to the last bit"
        assert back.events()["event_id"].equals(table.events()["event_id"])


def test_what_is_written_is_the_authors_layout(tmp_path) -> None:
    table = looking_table(tmp_path / "table", 6)
    export_release([table.folder], tmp_path / "release")
    folder = tmp_path / "release" / "synthetic-adt"
    targets = json.loads((folder / "target_information.json").read_text("utf-8"))
    assert list(targets) == [f"{index:010d}" for index in range(6)]
    rows = whole(table)
    for index, (key, entry) in enumerate(targets.items()):
        motion, gaze = np.load(folder / "motions" / f"{key}.npy"), np.load(folder / "gazes" / f"{key}.npy")
        n = rows["n_frames"][index].as_py()
        assert motion.shape == (n, 22, 3)
        assert motion.dtype == np.float32
        valid = np.array(rows["gaze_valid"][index].as_py())
        assert gaze.shape == (n, 3)
        np.testing.assert_allclose(np.linalg.norm(gaze[valid], axis=1), 1, atol=1e-6)
        assert np.isnan(gaze[~valid]).all()
        assert entry["goal_location"] == rows["goal_location"][index].as_py()
        assert entry["subset"] == rows["split"][index].as_py()
        assert entry["primed_frame"] == rows["prime_frame"][index].as_py()
        assert entry["event_frame"] == n - 1
        assert (entry["fps"], entry["units"], entry["up"]) == (20.0, "m", "y")


def test_exporting_twice_gives_the_same_bytes_and_replaces_only_exports(tmp_path) -> None:
    table = looking_table(tmp_path / "table", 6)
    export_release([table.folder], tmp_path / "release")
    files = {path: path.read_bytes() for path in (tmp_path / "release").rglob("*") if path.is_file()}
    export_release([table.folder], tmp_path / "release")
    assert {path: path.read_bytes() for path in (tmp_path / "release").rglob("*") if path.is_file()} == files
    mine = tmp_path / "mine" / "synthetic-adt"
    mine.mkdir(parents=True)
    (mine / "thesis.txt").write_text("years of work")
    with pytest.raises(Exception, match="synthetic-adt"):
        export_release([table.folder], tmp_path / "mine")
    assert (mine / "thesis.txt").read_text() == "years of work"


def test_two_tables_of_one_dataset_do_not_fit_one_release(tmp_path) -> None:
    one, other = looking_table(tmp_path / "one", 4), looking_table(tmp_path / "other", 6)
    with pytest.raises(UsageError, match="two tables are of synthetic-adt"):
        export_release([one.folder, other.folder], tmp_path / "release")


def test_an_imported_table_can_be_explained_and_run(tmp_path) -> None:
    table = looking_table(tmp_path / "table")
    export_release([table.folder], tmp_path / "release")
    import_release(tmp_path / "release", tmp_path / "back", dataset="synthetic-adt")
    back = SequenceTable.open(tmp_path / "back")
    event = back.events()["event_id"][0].as_py()
    text = explain_event(back.folder, event).text()
    assert "outcome: sequence" in text
    assert "the release's own events" in text
    report = run_method(RunRequest(method="ground-truth", data=(back.folder,), out=tmp_path / "run"))
    means = {metric.metric: metric.mean for metric in report.summaries[0].metrics}
    assert means["reach_success"] == 1.0
    assert means["mpjpe"] == 0.0


def test_an_edited_motion_no_longer_gets_what_belonged_to_the_old_one(tmp_path) -> None:
    table = looking_table(tmp_path / "table", 6)
    export_release([table.folder], tmp_path / "release")
    folder = tmp_path / "release" / "synthetic-adt"
    for kind in ("motions", "gazes"):
        path = folder / kind / "0000000002.npy"
        np.save(path, np.load(path)[:-1])
    result = import_release(tmp_path / "release", tmp_path / "back", dataset="synthetic-adt")
    back = SequenceTable.open(tmp_path / "back")
    ids = back.scalars()["sequence_id"].to_pylist()
    assert "synthetic-adt/0000000002/release" in ids
    assert len(ids) == 6
    assert back.content != table.content
    assert not result.tables[0].left_out


def test_at_another_rate_what_belonged_to_the_old_one_is_not_used(tmp_path) -> None:
    table = looking_table(tmp_path / "table", 4)
    export_release([table.folder], tmp_path / "release")
    options = ImportOptions(fps=30.0)
    import_release(tmp_path / "release", tmp_path / "back", dataset="synthetic-adt", options=options)
    back = SequenceTable.open(tmp_path / "back").scalars()
    assert set(back["fps"].to_pylist()) == {30.0}
    assert set(back["prime_kind"].to_pylist()) == {"unknown"}


def test_a_table_that_is_no_table_is_told(tmp_path) -> None:
    with pytest.raises(TableError):
        export_release([tmp_path], tmp_path / "release")
