"""HD-EPIC before its videos are downloaded: picks and puts listed and counted from the annotations alone."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

import prbench
from prbench.cli.main import main
from prbench.readers import reader_for
from tests.cli.reports import refused, reported
from tests.readers.hd_epic_copies import FIRST, annotation, write_copy
from tests.shared import made_once

OFFICIAL = Path(os.environ.get("PRBENCH_SAMPLES", "/nowhere")) / "hd-epic-official"


@pytest.fixture
def repository(tmp_path) -> Path:
    """Return the annotation repository of two invented videos, without the videos."""
    whole = made_once("hd-epic-two-videos", write_copy)
    shutil.copytree(whole / "hd-epic-annotations", tmp_path / "root" / "hd-epic-annotations")
    shutil.copy(whole / "synthetic.json", tmp_path / "root")
    return tmp_path / "root"


def test_events_alone_are_those_of_the_whole_copy_on_the_videos_clock(repository, tmp_path) -> None:
    options = {"events_only": "true"}
    whole = reader_for("hd-epic").read(reader_for("hd-epic").find(made_once("hd-epic-two-videos", write_copy))[0])
    alone = reader_for("hd-epic", options).read(reader_for("hd-epic", options).find(repository)[0])
    assert [event.native_key for event in alone.annotated_events] == [e.native_key for e in whole.annotated_events]
    shown = json.loads(annotation(repository, "assoc_info.json").read_text())[FIRST]
    seconds = {track["time_segment"][0] for entry in shown.values() for track in entry["tracks"]}
    picks = {round(event.event_time, 3) for event in alone.annotated_events if event.action == "pick"}
    assert picks == seconds
    for one, other in zip(alone.annotated_events, whole.annotated_events, strict=True):
        assert (one.location is None) == (other.location is None)


def test_the_build_lists_every_pick_and_put_and_no_sequence(repository, tmp_path, capsys) -> None:
    out = tmp_path / "table"
    words = ["build-dataset", "hd-epic", "--root", str(repository), "--events-only", "--out", str(out)]
    (info,) = reported(words, capsys).built.values()
    assert info["counts"]["sequences"] == 0
    events = prbench.open_table(out).events.to_pandas()
    assert set(events["outcome"]) == {"annotation_only"}
    assert info["counts"]["events"] == len(events) > 0
    assert main(words) == 0
    said = capsys.readouterr()
    assert "annotated picks and puts" in said.out
    assert "no sequence" not in said.err


def test_associations_alone_are_enough(repository, capsys) -> None:
    for path in repository.rglob("*_info.json"):
        if path.name != "assoc_info.json":
            path.unlink()
    folder = annotation(repository, "assoc_info.json").parent
    shutil.copy(repository / "synthetic.json", folder)
    (dataset,) = reported(["inspect", str(folder)], capsys).datasets
    assert dataset.annotations.totals["picks"] == dataset.annotations.totals["puts"] > 0
    assert {recording.state for recording in dataset.recordings} == {"left out"}
    assert "--events-only" in dataset.recordings[0].remarks[0]
    assert any("mask_info.json is not there" in line for line in dataset.annotations.remarks)


def test_validate_counts_what_is_published_about_priming(repository, capsys) -> None:
    counts = reported(["validate", "hd-epic", "--root", str(repository)], capsys).annotations
    published = json.loads(next(repository.rglob("priming_info.json")).read_text())
    sides = [side for objects in published.values() for entry in objects.values() for side in entry.values()]
    assert sum(sum(each.values()) for each in counts.priming.values()) == len(sides)
    primed = sum(side["prime_stats"]["frame_primed"] >= 0 for side in sides)
    assert sum(each.get("primed", 0) for each in counts.priming.values()) == primed == counts.totals["primed"]
    assert counts.published == {}, "nothing published stands beside invented videos"
    refused(["validate", "hd-epic"], capsys, code=2, message="--root DIR")


def test_other_datasets_have_no_events_without_their_streams(tmp_path, capsys) -> None:
    words = ["build-dataset", "adt", "--root", str(tmp_path), "--events-only", "--out", str(tmp_path / "table")]
    refused(words, capsys, code=2, message="adt: its events are found in its streams")


@pytest.mark.skipif(not OFFICIAL.is_dir(), reason="PRBENCH_SAMPLES holds no official annotations of HD-EPIC")
def test_the_official_file_has_the_published_counts(capsys) -> None:
    (dataset,) = reported(["inspect", str(OFFICIAL)], capsys).datasets
    counts = dataset.annotations
    assert counts.totals == counts.published["repository of 2025-05-30"]
    assert counts.published["paper"]["primed"] == 18_264
    assert counts.by_participant["P03"]["picks"] == 3068
    assert counts.unreadable == []
