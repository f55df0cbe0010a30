"""Counts and inferences stand in the report."""

from __future__ import annotations

import json

from prbench.release.known import load_known
from prbench.release.report import count_rows, count_warnings
from tests.release.imports import imported


def test_counts_stand_beside_the_studys() -> None:
    known = load_known().datasets["gimo"]
    counts = count_rows(["train"] * 108 + ["test"] * 21, known)
    assert [(row.split, row.found, row.expected) for row in counts] == [("train", 108, 108), ("test", 21, 22)]
    assert count_warnings(counts) == ("test: 21 sequences, the study has 22.",)


def test_every_inference_stands_in_the_report_and_in_the_datasets_options(tmp_path) -> None:
    report = imported(tmp_path)
    written = json.loads((tmp_path / "table" / "import_report.json").read_text("utf-8"))
    names = {each["name"] for each in written["inferred"]}
    assert {
        "fps", "units", "motion_frame", "goal_frame", "skeleton", "primed_frame", "frame_0", "gaze_on_goal",
    } <= names  # fmt: skip
    for each in written["inferred"]:
        assert each["how_surely"] in ("certain", "likely", "assumed", "unknown")
        assert each["evidence"]
        assert report.info.options[f"release.{each['name']}"].startswith(each["value"])
    assert str(tmp_path) not in (tmp_path / "table" / "import_report.json").read_text("utf-8")
    assert str(tmp_path) not in (tmp_path / "table" / "dataset.json").read_text("utf-8")
