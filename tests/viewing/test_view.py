"""Which table, which sequences and which motions a view shows, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from prbench.contract import Condition
from prbench.errors import RedistributionError, RunError, StorageError, TableError, UsageError
from prbench.harness.first_run import default_folder, default_table_folders
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import Predictions, RunFolder, read_scores
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.viewing.replay.scene import RECORDED, score_row
from prbench.viewing.view import ViewRequest, scenes_of, view
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A made-up table, the same under other terms, another one of that name, and runs on the first."""
    place = tmp_path_factory.mktemp("views")
    fake_dataset(place / "table", 24)
    fake_dataset(place / "other", 16)
    fake_dataset(place / "mogaze", 8, dataset="synthetic-mogaze")
    data = (place / "table",)
    for method, name, limit in (
        ("scripted", "scripted", None),
        ("ground-truth", "truth", None),
        ("scripted", "few", 3),
    ):
        request = RunRequest(method=method, data=data, condition=Condition.GOAL_LOCATION, limit=limit, out=place / name)
        run_method(request)
    (place / "interrupted").mkdir()
    (place / "interrupted" / "run.json").write_bytes((place / "scripted" / "run.json").read_bytes())
    return place


def _changed(place: Path, tmp_path: Path, **changes: object) -> Path:
    """The table with other words in dataset.json; no digest depends on them."""
    folder = tmp_path / "table"
    folder.mkdir()
    for path in (place / "table").iterdir():
        if path.is_file():
            (folder / path.name).write_bytes(path.read_bytes())
    msgspec.structs.replace(DatasetInfo.read(folder), **changes).write(folder)
    return folder


def _request(place: Path, *runs: str, **options) -> ViewRequest:
    given = {"out": place / "view.png", "data": (place / "table",)} | options
    return ViewRequest(runs=tuple(place / run for run in runs), **given)


def test_recorded_and_generated_motion_of_the_same_sequence_stand_side_by_side(place):
    scenes = scenes_of(_request(place, "scripted", limit=2))
    assert len(scenes) == 2
    table = SequenceTable.open(place / "table")
    predictions = Predictions.open(place / "scripted" / "synthetic-adt/predictions")
    for scene in scenes:
        chunk = next(table.chunks(ids=frozenset({scene.sequence_id})))
        recorded, generated = scene.motions
        assert recorded.label == RECORDED
        assert generated.label == "scripted, goal-loc"
        np.testing.assert_array_equal(recorded.joints, chunk.joints.astype(np.float64))
        np.testing.assert_array_equal(generated.joints, predictions.motions([scene.sequence_id], 0).values)
        assert scene.goal is not None
        np.testing.assert_allclose(scene.goal.box_corners.mean(axis=0), chunk.vectors("goal_location")[0], atol=1e-5)
        assert scene.prime_time == pytest.approx(2.0)


def test_the_scores_shown_are_those_of_the_run(place):
    scenes = scenes_of(_request(place, "scripted", limit=3))
    rows = read_scores(place / "scripted" / "synthetic-adt/scores.parquet").to_pylist()
    for scene in scenes:
        for metric in ("prime_success", "reach_success", "goal_mpjpe", "location_error", "mpjpe"):
            (value,) = [r["value"] for r in rows if (r["sequence_id"], r["metric"]) == (scene.sequence_id, metric)]
            assert scene.motions[1].scores[metric] == value


def test_the_recorded_motion_is_scored_as_the_ground_truth_run_scores_it(place):
    scenes = scenes_of(_request(place, "scripted", limit=4))
    rows = read_scores(place / "truth" / "synthetic-adt/scores.parquet").to_pylist()
    values = {(row["sequence_id"], row["metric"]): row["value"] for row in rows}
    for scene in scenes:
        for metric in ("prime_success", "reach_success", "prime_success_gaze"):
            assert scene.motions[0].scores[metric] == values[scene.sequence_id, metric]


def test_several_runs_show_what_they_have_in_common_or_the_sequence_that_a_part_of_an_id_names(place):
    (scene,) = scenes_of(_request(place, "scripted", sequences=("/obj5/",)))
    assert "/obj5/" in scene.sequence_id
    scenes = scenes_of(_request(place, "scripted", "few"))
    assert {scene.sequence_id for scene in scenes} == set(
        Predictions.open(place / "few" / "synthetic-adt/predictions").ids
    )
    assert [motion.label for motion in scenes[0].motions[1:]] == [
        "scripted, goal-loc (scripted)",
        "scripted, goal-loc (few)",
    ]


def test_an_embedded_table_is_found_by_its_digest(place, tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path))
    with pytest.raises(TableError, match=r"content digest [0-9a-f]{12}….*--data DIR"):
        scenes_of(_request(place, "scripted", data=()))
    for number, folder in enumerate(default_table_folders(), start=1):
        fake_dataset(folder, 2 * number)
    fake_dataset(default_folder().parent / "of-a-much-earlier-version" / "adt", 16)
    fake_dataset(default_folder().parent / "of-an-earlier-version" / "adt", 24)
    assert scenes_of(_request(place, "scripted", data=(), limit=1))


def test_a_sequence_that_the_run_left_out_is_told_with_the_reason(place):
    ids = SequenceTable.open(place / "table").scalars(split="train")["sequence_id"].to_pylist()
    with pytest.raises(UsageError, match="the run was of split 'test'"):
        scenes_of(_request(place, "scripted", sequences=(ids[0],)))
    held = set(Predictions.open(place / "few" / "synthetic-adt/predictions").ids)
    test = SequenceTable.open(place / "table").scalars(split="test")["sequence_id"].to_pylist()
    missing = next(name for name in test if name not in held)
    with pytest.raises(UsageError, match="with --limit 3"):
        scenes_of(_request(place, "few", sequences=(missing,)))


def test_an_interrupted_run_is_shown_without_scores(place, tmp_path):
    run = tmp_path / "unscored"
    (run / "synthetic-adt/predictions").mkdir(parents=True)
    (run / "run.json").write_bytes((place / "scripted" / "run.json").read_bytes())
    part = place / "scripted" / "synthetic-adt/predictions" / "part-00000.parquet"
    (run / "synthetic-adt/predictions" / part.name).write_bytes(part.read_bytes())
    (scene,) = scenes_of(ViewRequest(out=Path("a.png"), runs=(run,), data=(place / "table",), limit=1))
    assert score_row(scene, scene.motions[1])[:2] == ("–", "–")


def test_recorded_motion_gaze_and_goal_of_none_are_left_out(place, tmp_path):
    data = (_changed(place, tmp_path, redistribution="none"),)
    with pytest.raises(RedistributionError, match="--permission synthetic-adt"):
        scenes_of(_request(place, data=data))
    control = _on_table(place / "scripted", tmp_path / "control", data[0])
    with pytest.raises(RedistributionError, match="scripted"):  # moved from the recorded first pose
        scenes_of(ViewRequest(out=Path("a.png"), runs=(control,), data=data))
    method = _on_table(place / "scripted", tmp_path / "run", data[0], name="made-up", kind="adapter")
    (scene,) = scenes_of(ViewRequest(out=Path("a.png"), runs=(method,), data=data, limit=1))
    assert [motion.label for motion in scene.motions] == ["made-up, goal-loc"]
    assert scene.goal is None
    assert all(motion.gaze is None for motion in scene.motions)
    assert "left out here" in scene.notice
    permitted = ViewRequest(out=Path("a.png"), runs=(method,), data=data, limit=1, permitted=("synthetic-adt",))
    (scene,) = scenes_of(permitted)
    assert scene.shows_recorded
    assert scene.goal is not None
    assert "by permission" in scene.notice


def _on_table(run: Path, folder: Path, table: Path, **method: str) -> Path:
    """The same run as if it had been made on a table with other terms, perhaps by another method."""
    record = RunFolder.open(run).record
    terms = DatasetInfo.read(table).redistribution
    tables = tuple(msgspec.structs.replace(each, redistribution=terms) for each in record.tables)
    (folder / "synthetic-adt/predictions").mkdir(parents=True)
    msgspec.structs.replace(record, method=msgspec.structs.replace(record.method, **method), tables=tables).write(
        folder
    )
    for path in (run / "synthetic-adt/predictions").iterdir():
        (folder / "synthetic-adt/predictions" / path.name).write_bytes(path.read_bytes())
    return folder


def test_the_notice_of_non_commercial_data_goes_into_the_view(place, tmp_path):
    data = (_changed(place, tmp_path, redistribution="non-commercial"),)
    run = _on_table(place / "scripted", tmp_path / "run", data[0])
    report = view(ViewRequest(out=tmp_path / "view.html", runs=(run,), data=data, limit=1))
    assert report.notices == ("Made up: for non-commercial purposes only, under the dataset's own licence.",)
    assert "for non-commercial purposes only" in report.out.read_text(encoding="utf-8")


def test_goals_in_an_unknown_frame_are_not_drawn_and_nothing_is_measured_against_them(place, tmp_path):
    data = (_changed(place, tmp_path, options={"goal_frame": "unknown"}),)
    report = view(ViewRequest(out=tmp_path / "a.png", data=data, limit=1))
    (scene,) = report.scenes
    assert scene.goal is None
    assert not scene.motions[0].scores


@pytest.mark.parametrize("name", ["view.gif", "view", "view.png.txt"])
def test_another_suffix_is_refused_before_anything_is_read(name, tmp_path):
    with pytest.raises(UsageError, match=r"\.html, \.png, \.svg, \.pdf or \.mp4"):
        view(ViewRequest(out=tmp_path / name, runs=(tmp_path / "no run",)))


def test_a_folder_as_file_is_refused(tmp_path):
    (tmp_path / "a.png").mkdir()
    with pytest.raises(StorageError, match="is a folder"):
        view(ViewRequest(out=tmp_path / "a.png", data=(tmp_path,)))


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({}, "nothing to view"),
        ({"data": (Path("t"),), "sequences": ("a",), "limit": 2}, "leave --limit out"),
        ({"runs": tuple(Path(str(number)) for number in range(7))}, "at most 6 runs"),
        ({"runs": (Path("a"), Path("a"))}, "more than once"),
    ],
)
def test_requests_that_do_not_fit_together(asked, told):
    with pytest.raises(UsageError, match=told):
        ViewRequest(out=Path("a.png"), **asked)


@pytest.mark.parametrize(
    ("run", "options", "told"),
    [
        ("scripted", {"data": "mogaze"}, "is of synthetic-adt; --data names synthetic-mogaze"),
        ("scripted", {"sample": 3}, "a sample from 0 to 0, found 3"),
        ("table", {}, "expected a run folder"),
        ("interrupted", {}, "expected the predictions of a run, found none"),
    ],
)
def test_what_a_run_cannot_show_is_told(place, run, options, told):
    if "data" in options:
        options = {"data": (place / options["data"],)}
    with pytest.raises(RunError, match=told):
        scenes_of(_request(place, run, **options))


def test_another_table_is_refused_with_both_digests(place):
    digests = [SequenceTable.open(place / name).info.content_digest[:12] for name in ("table", "other")]
    with pytest.raises(RunError, match=f"{digests[0]}….*{digests[1]}…"):
        scenes_of(_request(place, "scripted", data=(place / "other",)))


@pytest.mark.parametrize(("runs", "options", "count"), [((), {"limit": 5}, 5), (("truth",), {"limit": 1}, 1)])
def test_recorded_motion_stands_alone_without_runs_and_with_that_of_itself(place, runs, options, count):
    scenes = scenes_of(_request(place, *runs, **options))
    assert len(scenes) == count
    assert {tuple(motion.label for motion in scene.motions) for scene in scenes} == {(RECORDED,)}
