"""Counts and inferences stand in the report."""

from __future__ import annotations

import json

from prbench.release.layout import load_known
from prbench.release.report import count_splits
from prbench.sequences import DatasetInfo
from tests.release.imports import imported


def test_counts_stand_beside_the_studys() -> None:
    known = load_known().datasets["gimo"]
    counts = count_splits(["train"] * 108 + ["test"] * 21, known)
    assert [(row.split, row.found, row.study) for row in counts] == [("train", 108, 108), ("test", 21, 22)]


def test_every_inference_stands_in_the_report_and_in_the_datasets_options(tmp_path) -> None:
    imported(tmp_path)
    options = DatasetInfo.read(tmp_path / "table").options
    written = json.loads((tmp_path / "table" / "import_report.json").read_text("utf-8"))
    names = {each["name"] for each in written["inferred"]}
    assert {
        "fps", "units", "motion_frame", "goal_frame",
    } <= names  # fmt: skip
    for each in written["inferred"]:
        assert each["how_surely"] in ("certain", "likely", "assumed", "unknown")
        assert each["evidence"]
        assert options[f"release.{each['name']}"].startswith(each["value"])
    assert str(tmp_path) not in (tmp_path / "table" / "import_report.json").read_text("utf-8")
    assert str(tmp_path) not in (tmp_path / "table" / "dataset.json").read_text("utf-8")
