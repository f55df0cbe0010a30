"""The tables of the study: printed numbers, estimates, and rows that are scored."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from msgspec.structs import replace

from prbench.cli.main import main
from prbench.errors import RunError, UsageError
from prbench.harness.intervals import compare
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.tables import Block, as_json, as_markdown
from prbench_benchmarks.motion_prediction.charts import draw_prediction
from prbench_benchmarks.motion_prediction.predictors import ConstantVelocity
from prbench_benchmarks.motion_prediction.scoring import Scores
from prbench_benchmarks.motion_prediction.study_tables import (
    PUBLISHED_METRICS,
    TABLES,
    PredictionTables,
    estimates,
    load_tables,
    paired,
    prediction_tables,
    published_scores,
    scores_of_runs,
)
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.benchmarks.motion_prediction.windows import walking, write


@pytest.mark.parametrize(("name", "cells"), [("table_1", 56), ("table_2", 24), ("table_3", 20), ("apd", 4)])
def test_a_table_has_all_its_cells_once(name, cells):
    numbers = published_scores(name)
    assert len(numbers) == cells
    keys = Counter((each["dataset"], each["method"], each["variant"], each["metric"]) for each in numbers)
    assert max(keys.values()) == 1
    assert all(float(each["value"]) > 0 for each in numbers)


@pytest.mark.parametrize("table", TABLES)
def test_every_printed_number_belongs_to_a_row(table):
    rows = {(row.method, row.variant) for row in load_tables().rows if table in row.tables}
    numbers = published_scores(f"table_{table}")
    assert {(each["method"], each["variant"]) for each in numbers} <= rows
    assert {each["metric"] for each in numbers} == set(PUBLISHED_METRICS)


def test_the_gain_over_humanmac_is_the_one_that_the_text_claims():
    ade = {
        each["method"]: float(each["value"])
        for each in published_scores("table_1")
        if (each["dataset"], each["metric"]) == ("mogaze", "ade") and each["variant"] in ("full", "without gaze")
    }
    full = next(
        float(each["value"])
        for each in published_scores("table_1")
        if (each["dataset"], each["metric"], each["variant"]) == ("mogaze", "ade", "full")
    )
    assert 1 - full / ade["humanmac"] == pytest.approx(0.128, abs=0.001)


def test_names_of_rows_are_unique():
    names = [row.name for row in load_tables().rows]
    assert len(set(names)) == len(names)


def scores(shift: float = 0.0, recordings: int = 8) -> Scores:
    rng = np.random.default_rng(0)
    found = Scores()
    for number in range(recordings):
        values = 20 + rng.normal(size=5) + 3 * rng.normal()
        names = [f"{number}/{place}" for place in range(5)]
        ade = values + shift + 0.01 * rng.normal()
        found.add({"window_id": names, "recording_id": [str(number)] * 5, "ade": ade, "wrist_to_goal": [np.nan] * 5})
    return found


def test_intervals_are_over_recordings():
    estimate = estimates(scores())["ade"]
    assert (estimate.n_recordings, estimate.n_sequences) == (8, 40)
    assert estimate.low is not None
    assert estimate.high is not None
    of_windows = 1.96 * np.std(scores().columns["ade"]) / np.sqrt(40)
    assert estimate.high - estimate.low > 2 * 2 * of_windows
    assert "wrist_to_goal" not in estimates(scores())


def test_no_interval_of_a_distance_reaches_below_zero():
    few = Scores()
    for number in range(8):
        values = [0.0, 0.0, 6.0 if number == 0 else 0.0]
        few.add({"window_id": [f"{number}/{k}" for k in range(3)], "recording_id": [str(number)] * 3, "mmade": values})
    assert estimates(few)["mmade"].low == 0.0


def test_differences_are_paired():
    pair = paired(scores(-0.1), scores(), "ade")
    assert pair is not None
    found = compare({"ade": pair})["ade"]
    assert found.difference.mean == pytest.approx(-0.1)
    assert found.difference.high is None  # the differences are equal: they show no spread
    assert paired(scores(-0.1), scores(), "wrist_to_goal") is None


def test_scores_of_other_windows_are_refused():
    with pytest.raises(UsageError, match="same windows"):
        paired(scores(), scores(recordings=7), "ade")


@pytest.fixture(scope="module")
def windows(tmp_path_factory):
    runs = [walking(f"r{n}", 110, number=n, split="train" if n > 1 else "test") for n in range(4)]
    return write(tmp_path_factory.mktemp("windows") / "w", *runs)


@pytest.fixture(scope="module")
def tables(windows):
    return prediction_tables(windows, samples=3)


def measured(table) -> dict:
    """ADE of the measured rows by label."""
    rows = {row.text["method"]: row.cells for row in table.blocks[0].rows}
    return {name: {cell.metric: cell.value for cell in cells}.get("ade") for name, cells in rows.items()}


def test_rows_without_learning_stand_beside_the_printed_numbers(tables):
    found = measured(tables[0])
    assert found["ground truth"] == pytest.approx(0.0, abs=1e-4)
    assert found["zero velocity"] > found["nearest past"]
    printed = {row.text["method"]: row.text for row in tables[0].blocks[1].rows}
    assert tables[0].blocks[1].title == "printed for mogaze"
    assert printed["GazeMoDiff"]["ade"] == "0.638"
    assert "zero velocity" not in printed
    text = as_markdown(tables)
    assert "| HumanMAC |" in text
    assert "are not to be compared" in text


def test_rows_that_cannot_be_run_say_why(tables):
    assert measured(tables[2])["GazeMoDiff, no cross-attention"] is None
    assert any("weights 'no-cross-attention'" in note for note in tables[2].notes)


def test_methods_are_ordered_and_references_are_not(tables):
    order = next(note for note in tables[0].notes if note.startswith("By ADE: "))
    for method in ("nearest past, head", "zero velocity", "CVAE", "BeLFusion", "HumanMAC", "GazeMoDiff, no gaze"):
        assert method in order
    assert "DLow" not in order  # it answers with fifty futures only
    assert "ground truth" not in order
    assert " (-" not in order


def test_a_method_with_one_future_is_said_to_have_one_guess(windows, monkeypatch):
    module = "prbench_benchmarks.motion_prediction.study_tables"
    rows = [row for row in load_tables().rows if row.method in ("gazemotion", "nearest-past", "zero-velocity")]
    known = PredictionTables(titles=load_tables().titles, rows=tuple(rows))
    monkeypatch.setattr(f"{module}.load_tables", lambda: known)
    monkeypatch.setattr(f"{module}.load_adapter", lambda *_, **__: ConstantVelocity())
    notes = prediction_tables(windows, samples=3, limit=2)[1].notes
    assert [note for note in notes if "one guess" in note] == [
        "GazeMotion: it has one future: its errors are those of one guess, not the best of 3."
    ]


def test_the_value_of_gaze_is_paired_between_all_conditions(tables):
    value = tables[-1]
    told = {row.text["told"] for row in value.blocks[0].rows if row.text["method"] == "nearest-past"}
    assert told == {"pose → pose+head", "pose → pose+gaze", "pose+head → pose+gaze"}
    metrics = {row.text["metric"] for row in value.blocks[0].rows}
    assert metrics == {"ade", "fde", "ade_mean"}  # windows that slide have no goal


@pytest.mark.slow
def test_the_command_writes_the_same_tables_again(windows, tmp_path):
    paths = [tmp_path / "tables.md", tmp_path / "tables.csv", tmp_path / "chart.png"]
    assert main(["study", "prediction", str(windows), "--limit", "2", "--out", *map(str, paths)]) == 0
    again = prediction_tables(windows, limit=2)
    assert paths[0].read_text() == as_markdown(again)
    assert "2 windows of" in as_json(again)
    assert paths[2].read_bytes().startswith(b"\x89PNG")


def test_the_figure_shows_errors_over_the_horizon_and_what_gaze_is_worth_before_the_event(tables, tmp_path):
    value = tables[-1]
    (row,) = [
        row
        for row in value.blocks[0].rows
        if (row.text["method"], row.text["metric"], row.text["told"]) == ("nearest-past", "ade", "pose → pose+gaze")
    ]
    at_event = [replace(row.cells[0], variant=f"ade, windows: event-{lead}") for lead in ("2", "0.5")]
    anchored = replace(value, blocks=(Block(rows=(replace(row, cells=tuple(at_event)),)),))
    draw_prediction([*tables[:3], anchored], tmp_path / "both.svg")
    drawn = (tmp_path / "both.svg").read_text()
    for words in ("seconds after the last observed frame", "seconds before the event", "GazeMoDiff", "pose+gaze"):
        assert words in drawn
    draw_prediction(tables, tmp_path / "sliding.svg")  # windows that slide have no time to an event
    assert "seconds before the event" not in (tmp_path / "sliding.svg").read_text()


def test_one_condition_has_no_value(windows, monkeypatch):
    from prbench_benchmarks.motion_prediction import study_tables

    rows = [row for row in study_tables.load_tables().rows if row.method in ("zero-velocity", "ground-truth")]
    known = study_tables.PredictionTables(titles=study_tables.load_tables().titles, rows=tuple(rows))
    monkeypatch.setattr(study_tables, "load_tables", lambda: known)
    assert len(prediction_tables(windows, samples=1)) == 3


def test_finished_runs_stand_for_their_rows(windows, tmp_path):
    out = tmp_path / "runs" / "constant"
    asked = {"benchmark": "motion-prediction", "condition": "pose", "samples": 1, "limit": 2}
    run_method(RunRequest(method="constant-velocity", data=(windows,), out=out, **asked))  # type: ignore[arg-type]
    scores = scores_of_runs([tmp_path / "runs"], WindowsTable.open(windows))
    tables = prediction_tables(windows, [out], samples=2)
    assert " 2 windows of" in tables[0].part
    assert measured(tables[0])["constant velocity"] == scores["constant-velocity-pose"].means()["ade"]
    # The run's windows are those of the other rows, too: paired differences would refuse others.
    order = next(note for note in tables[0].notes if note.startswith("By ADE: "))
    assert "constant velocity" in order
    assert "zero velocity" in order


def test_no_runs_and_runs_with_a_limit_are_refused(windows, tmp_path):
    with pytest.raises(RunError, match="found none"):
        scores_of_runs([tmp_path], WindowsTable.open(windows))
    with pytest.raises(UsageError, match="leave it out"):
        prediction_tables(windows, [tmp_path], limit=2)
