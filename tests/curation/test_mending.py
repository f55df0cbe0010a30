"""``--shift`` and ``--scale`` give back what a wrong clock or unit took, from the native files to the table."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.curation import build_dataset
from prbench.curation.differences import compare_builds
from prbench.curation.mending import mended, stream_numbers
from prbench.errors import UsageError
from prbench.synthetic.write_tree import synthesize_tree
from tests.curation.test_stream_checks import clean
from tests.shared import made_once


def adt(folder: Path) -> None:
    synthesize_tree("adt", folder / "ADT", recordings=1, seed=88, n_events=6)
    build_dataset("adt", folder / "ADT", folder / "table")


def faulty(folder: Path, name: str, columns: tuple[str, ...], changed) -> Path:
    """A copy of the recordings in which some columns of a CSV file are other numbers."""
    root = shutil.copytree(made_once("adt-with-clocks", adt) / "ADT", folder / "ADT")
    (path,) = root.glob(f"*/{name}")
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row.update({column: changed(row[column]) for column in columns})
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    return root


FAULTS = {
    "objects 0.7 s late": (
        "scene_objects.csv",
        ("timestamp[ns]",),
        lambda text: text if text == "-1" else str(int(text) + 700_000_000),
        ("objects: 0.", "--shift objects=-0."),
        "--shift=objects=-0.7",
    ),
    "gaze 5 s late": (
        "eyegaze.csv",
        ("tracking_timestamp_us",),
        lambda text: str(int(text) + 5_000_000),
        ("gaze: 5.0", "--shift gaze=-5.0"),
        "--shift=gaze=-5",
    ),
    "objects in millimetres": (
        "scene_objects.csv",
        ("t_wo_x[m]", "t_wo_y[m]", "t_wo_z[m]"),
        lambda text: repr(float(text) * 1000),
        ("objects: ", "--scale objects=0.001"),
        "--scale=objects=0.001",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_build_names_the_fault_and_its_option_gives_the_events_of_the_clean_files(tmp_path, capfd, fault):
    name, columns, changed, said, option = FAULTS[fault]
    root = faulty(tmp_path, name, columns, changed)
    assert main(["build-dataset", "adt", "--root", str(root), "--out", str(tmp_path / "wrong")]) == 3
    told = capfd.readouterr().err
    assert all(text in told for text in said)
    assert "may be cut off" not in told
    assert main(["build-dataset", "adt", "--root", str(root), "--out", str(tmp_path / "mended"), option]) == 0
    whole = made_once("adt-with-clocks", adt) / "table"
    difference = compare_builds(whole, tmp_path / "mended")
    assert difference.unchanged_events == pq.read_metadata(whole / "events.parquet").num_rows
    # Within 10 micrometres and 1 microsecond; only what the readers remark on differs.
    assert [(change.kind, change.decided_by) for change in difference.changes] in ([], [("values", "message")])
    options = json.loads((tmp_path / "mended" / "dataset.json").read_text())["options"]
    assert len([key for key in options if key.startswith(("shift.", "scale."))]) == 1


def test_inspect_calls_the_recording_inconsistent_and_complete_once_mended(tmp_path, capfd):
    name, columns, changed, said, option = FAULTS["gaze 5 s late"]
    root = faulty(tmp_path, name, columns, changed)
    assert main(["inspect", str(root), "--thorough", "--json"]) == 3
    (recording,) = json.loads(capfd.readouterr().out)["report"]["datasets"][0]["recordings"]
    assert recording["state"] == "inconsistent"
    assert recording["remarks"][0].startswith(said[0])
    assert main(["inspect", str(root), "--thorough", option]) == 0
    # Whoever names a stream vouches for it: the finding is told, and stops nothing.
    assert main(["inspect", str(root), "--thorough", "--shift=gaze=0"]) == 0
    assert main(["build-dataset", "adt", "--root", str(root), "--out", str(tmp_path / "table"), "--shift=gaze=0"]) == 0
    assert "gaze: 5.0" in capfd.readouterr().err
    assert main(["inspect", str(root), option]) == 2
    assert "--thorough" in capfd.readouterr().err


def test_a_small_lag_is_told_kept_and_stops_nothing(tmp_path, capfd):
    root = faulty(tmp_path, "eyegaze.csv", ("tracking_timestamp_us",), lambda text: str(int(text) + 350_000))
    assert main(["build-dataset", "adt", "--root", str(root), "--out", str(tmp_path / "table")]) == 0
    assert "streams: " in capfd.readouterr().err
    assert main(["inspect", str(root), "--thorough", "--all"]) == 0
    assert "--shift gaze=-0.3" in capfd.readouterr().out


@pytest.mark.parametrize("preset", ["adt", "hd-epic", "mogaze", "gimo"])
def test_what_is_moved_there_and_back_is_the_same(preset):
    recording = clean(preset)
    seconds = {"gaze": 2.5, "hands": -1.5, "objects": 0.75, "body": 3.0}
    there = mended(recording, stream_numbers(seconds, "shift"), ())
    back = mended(there, stream_numbers({name: -each for name, each in seconds.items()}, "shift"), ())
    np.testing.assert_allclose(back.gaze.times, recording.gaze.times, atol=1e-9)
    valid = back.gaze.valid & recording.gaze.valid
    assert valid.sum() > 0.9 * recording.gaze.valid.sum()
    np.testing.assert_allclose(back.gaze.direction[valid], recording.gaze.direction[valid], atol=1e-6)
    for one, other in zip(back.hands, recording.hands, strict=True):
        seen = one.valid & other.valid
        np.testing.assert_allclose(one.points[seen], other.points[seen], atol=1e-6)
    assert [event.event_time for event in back.annotated_events] == pytest.approx(
        [event.event_time for event in recording.annotated_events]
    )


def test_a_glob_before_the_stream_means_some_recordings_and_goes_before_what_is_meant_for_all():
    recording = clean("adt")
    name = recording.recording_id
    numbers = stream_numbers({f"{name[:9]}*:gaze": 2, "gaze": 1, "other:body": 3}, "shift")
    moved = mended(recording, numbers, ())
    np.testing.assert_allclose(moved.gaze.times, recording.gaze.times + 2)
    np.testing.assert_array_equal(moved.body.times, recording.body.times)
    assert mended(recording, stream_numbers({"other:body": 3}, "shift"), ()) is recording


def test_nothing_to_mend_is_the_recording_itself():
    recording = clean("adt")
    assert mended(recording, (), ()) is recording


@pytest.mark.parametrize(
    ("option", "given", "says"),
    [
        ("shift", {"gase": "1"}, "Did you mean 'gaze'?"),
        ("shift", {"gaze": "soon"}, "expected seconds"),
        ("shift", {"gaze": "nan"}, "expected seconds"),
        ("scale", {"objects": "0"}, "a factor above 0"),
        ("scale", {"gaze": "0.001"}, "expected one of"),
    ],
)
def test_a_wrong_stream_or_number_is_refused(option, given, says):
    with pytest.raises(UsageError, match=says.replace("?", r"\?")):
        stream_numbers(given, option)


def test_one_shift_is_not_meant_for_every_dataset(tmp_path, capfd):
    made = made_once("adt-with-clocks", adt)
    out = str(tmp_path / "tables")
    assert main(["build-dataset", "all", "--root", str(made / "ADT"), "--out", out, "--shift=gaze=1"]) == 2
    assert "belong to one dataset" in capfd.readouterr().err
