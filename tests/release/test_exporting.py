"""A table that goes out through the layout and comes back is scored as before, and the terms of its data are kept."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from prbench.cli import main
from prbench.errors import RedistributionError, TableError, UsageError
from prbench.geometry.skeleton import transform_points
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.synthetic_table import build_synthetic_table
from prbench.release.exporting import export_release
from prbench.release.importing import import_release
from prbench.release.layout import folder_of, load_known
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.sequences.dataset_info import NOTICE_FILE, may_pass_on
from prbench.synthetic.people import PRESETS as ALL_PRESETS
from prbench.viewing.explain import explain_event
from tests.release.tables import looking_table
from tests.shared import made_once

PRESETS = sorted(set(ALL_PRESETS) & set(load_known().folders))


@pytest.fixture(scope="module", params=PRESETS)
def curated(request) -> SequenceTable:
    """A table that curation built from synthetic recordings."""
    name = request.param
    folder = made_once(
        f"release-{name}", lambda out: build_synthetic_table(name, 1, 3, out / "table", n_events=6) and None
    )
    return SequenceTable.open(folder / "table")


def to_the_world(release: Path, table: SequenceTable) -> None:
    """Turn an export in canonical frames into one in the recordings' worlds."""
    path = release / "target_information.json"
    entries = json.loads(path.read_text("utf-8"))
    poses = [each.reshape(4, 4) for chunk in table.chunks() for each in chunk.vectors("world_from_canonical")]
    for (key, entry), world_from_canonical in zip(entries.items(), poses, strict=True):
        turn = world_from_canonical.copy()
        turn[:3, 3] = 0
        for kind, matrix in (("motions", world_from_canonical), ("gazes", turn)):
            file = release / kind / f"{key}.npy"
            np.save(file, transform_points(matrix, np.load(file).astype(np.float64)).astype(np.float32))
        entry["goal_location"] = transform_points(world_from_canonical, np.array(entry["goal_location"])).tolist()
    path.write_text(json.dumps(entries), encoding="utf-8")


@pytest.mark.parametrize("frame", ["canonical", "world"])
def test_with_nothing_but_what_the_page_promises_everything_is_inferred_right(curated, frame, tmp_path) -> None:
    export_release([curated.folder], tmp_path / "release", as_published=True)
    if frame == "world":
        to_the_world(tmp_path / "release" / folder_of(curated.info.dataset), curated)
    report = import_release(tmp_path / "release", tmp_path / "back").tables[0]
    assert report.left_out == 0
    found = {each.name: each.value for each in report.inferred}
    assert (found["fps"], found["first_frame"], found["units"]) == ("20", "0", "metres")
    assert (found["goal_frame"], found["gaze_frame"]) == ("as the motions", "as the motions")
    assert found["motion_frame"].startswith(frame)
    back = SequenceTable.open(tmp_path / "back" / curated.info.dataset)
    columns = ["joints", "goal_location", "gaze_valid", "action", "split", "prime_frame"]
    before, after = (next(each.chunks(columns=columns, rows=10_000)) for each in (curated, back))
    np.testing.assert_allclose(after.joints, before.joints, atol=1e-5)
    np.testing.assert_allclose(after.vectors("goal_location"), before.vectors("goal_location"), atol=1e-5)
    np.testing.assert_array_equal(after.frames("gaze_valid"), before.frames("gaze_valid"))
    assert after.strings("action") == before.strings("action")
    splits = [name.replace("validation", "train") for name in before.strings("split")]
    assert after.strings("split") == splits


def test_what_is_written_is_the_authors_layout(tmp_path) -> None:
    table = looking_table(tmp_path / "table", 6)
    export_release([table.folder], tmp_path / "release")
    folder = tmp_path / "release" / "ADT"
    targets = json.loads((folder / "target_information.json").read_text("utf-8"))
    assert list(targets) == [f"{index:010d}" for index in range(6)]
    rows = [row for chunk in table.chunks() for row in chunk.batch.to_pylist()]
    for row, (key, entry) in zip(rows, targets.items(), strict=True):
        motion, gaze = np.load(folder / "motions" / f"{key}.npy"), np.load(folder / "gazes" / f"{key}.npy")
        n = row["n_frames"]
        assert (motion.shape, motion.dtype, gaze.shape) == ((n, 22, 3), np.float32, (n, 3))
        valid = np.array(row["gaze_valid"])
        np.testing.assert_allclose(np.linalg.norm(gaze[valid], axis=1), 1, atol=1e-6)
        assert np.isnan(gaze[~valid]).all()
        found = {name: entry[name] for name in ("goal_location", "subset", "primed_frame", "event_frame")}
        assert found == {
            "goal_location": row["goal_location"], "subset": row["split"], "primed_frame": row["prime_frame"],
            "event_frame": n - 1,
        }  # fmt: skip
        assert (entry["fps"], entry["units"], entry["up"]) == (20.0, "m", "y")


def test_an_export_replaces_only_exports(tmp_path) -> None:
    table = looking_table(tmp_path / "table", 6)
    export_release([table.folder], tmp_path / "release")
    files = {path: path.read_bytes() for path in (tmp_path / "release").rglob("*") if path.is_file()}
    export_release([table.folder], tmp_path / "release")
    assert {path: path.read_bytes() for path in (tmp_path / "release").rglob("*") if path.is_file()} == files
    mine = tmp_path / "mine" / "ADT"
    mine.mkdir(parents=True)
    (mine / "thesis.txt").write_text("years of work")
    with pytest.raises(Exception, match="ADT"):
        export_release([table.folder], tmp_path / "mine")
    assert (mine / "thesis.txt").read_text() == "years of work"


def test_two_tables_of_one_dataset_and_what_is_no_table_are_refused(tmp_path) -> None:
    one, other = looking_table(tmp_path / "one", 4), looking_table(tmp_path / "other", 6)
    with pytest.raises(UsageError, match="two tables are of ADT"):
        export_release([one.folder, other.folder], tmp_path / "release")
    with pytest.raises(TableError):
        export_release([tmp_path], tmp_path / "release")


def test_an_imported_table_can_be_explained_and_run(tmp_path) -> None:
    export_release([looking_table(tmp_path / "table").folder], tmp_path / "release")
    import_release(tmp_path / "release", tmp_path / "back", dataset="synthetic-adt")
    back = SequenceTable.open(tmp_path / "back")
    text = explain_event(back.folder, back.events()["event_id"][0].as_py()).text()
    assert "outcome: sequence" in text
    assert "the release's own events" in text
    report = run_method(RunRequest(method="ground-truth", data=(back.folder,), out=tmp_path / "run"))
    means = {metric.metric: metric.mean for metric in report.summaries[0].metrics}
    assert (means["reach_success"], means["mpjpe"]) == (1.0, 0.0)


@pytest.mark.parametrize("kind", ["none", "non-commercial", "yes"])
def test_export_obeys_the_terms(kind, tmp_path, capsys) -> None:
    free = looking_table(tmp_path / "free", 4, dataset="synthetic-mogaze")
    table = looking_table(tmp_path / "table", 4)
    msgspec.structs.replace(DatasetInfo.read(table.folder), redistribution=kind).write(table.folder)
    arguments = ["export-release", str(free.folder), str(table.folder), "--out", str(tmp_path / "release")]
    if kind == "none":
        with pytest.raises(RedistributionError, match="--permission synthetic-adt"):
            export_release([free.folder, table.folder], tmp_path / "release")
        assert not (tmp_path / "release").exists(), "nothing is written, not even what would be allowed"
        assert main([*arguments, "--permission", "synthetic-mogaze"]) == 10
        arguments += ["--permission", "synthetic-adt"]
    assert main(arguments) == 0
    folder = tmp_path / "release" / "ADT"
    assert (folder / NOTICE_FILE).is_file() == (kind != "yes")
    record = json.loads((folder / "prbench_export.json").read_text("utf-8"))
    assert (record["permission_stated"], record["redistribution"]) == (kind == "none", kind)
    assert ("notice: " in capsys.readouterr().out) == (kind != "yes")


def test_a_table_that_may_not_be_passed_on_stays_so_after_a_round_trip(tmp_path) -> None:
    table = looking_table(tmp_path / "table", 6, dataset="gimo")
    info = DatasetInfo.read(table.folder)
    msgspec.structs.replace(info, redistribution="none", synthetic=False).write(table.folder)
    export_release([table.folder], tmp_path / "release", permitted=["gimo"])
    assert (tmp_path / "release" / "GIMO" / "motions").is_dir()
    import_release(tmp_path / "release", tmp_path / "back")
    assert not may_pass_on(DatasetInfo.read(tmp_path / "back" / "gimo"))
