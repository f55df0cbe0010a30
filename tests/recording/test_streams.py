"""What no recording can hold is refused where streams are made, whichever reader makes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import InputFileError, RecordingUnusable
from prbench.files.arrays import first_repeated, require_column, require_near
from tests.curation.scenes import scene


def _changed(stream, field: str, row: int, value: float):
    values = np.array(getattr(stream, field))
    values[row, ...] = value
    return replace(stream, **{field: values})


CASES = {
    "gaze origin": (lambda r: _changed(r.gaze, "origin", 3, 9e29), "gaze origin, row 3: .* 10,000 m .*9e\\+29 m"),
    "gaze direction": (lambda r: _changed(r.gaze, "direction", 2, 4.0), "gaze direction, row 2: .*found length 6.9"),
    "gaze clock": (lambda r: _changed(r.gaze, "times", -1, 9e29), r"gaze, row \d+: expected a time within 1e\+10 s"),
    "a week": (lambda r: _changed(r.gaze, "times", -1, 9e5), "gaze: expected at most 604,800 s from first to last"),
    "glasses": (lambda r: _changed(r.head, "position", 0, -9e29), "glasses, row 0: .*found -9e\\+29 m"),
    "turn of glasses": (lambda r: _changed(r.head, "rotation", 1, 9e29), "rotation of glasses, row 1"),
    "body": (lambda r: _changed(r.body, "joints", 5, 1e12), "body, row 5: .*found 1e\\+12 m"),
    "hand": (lambda r: _changed(r.hands[0], "points", 4, 10_001.0), "hand, row 4: .*found 10001 m"),
    "object": (lambda r: _changed(r.objects[0], "position", 0, 9e29), r"object .* \(.*\), row 0: .*9e\+29 m"),
    "box": (lambda r: replace(r.objects[0], box_max=np.full(3, 9e29)), "box of object .*, row 1: .*100 m"),
    "span": (lambda r: replace(r, span=(0.0, 9e29)), "ground truth, row 1: expected a time"),
    "ids": (lambda r: replace(r, objects=(*r.objects, r.objects[0])), "objects: .* different ids, found '1' twice"),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_number_that_cannot_be_is_named_with_stream_row_and_value(name) -> None:
    change, says = CASES[name]
    with pytest.raises(RecordingUnusable, match=says):
        change(scene())


def test_rows_that_are_not_valid_may_hold_anything() -> None:
    gaze = scene().gaze
    origin = gaze.origin.copy()
    origin[0] = 9e29
    valid = gaze.valid.copy()
    valid[0] = False
    assert replace(gaze, origin=origin, valid=valid).origin[0, 0] == 9e29


def test_nothing_is_wrong_with_nothing() -> None:
    require_near("none", np.zeros((0, 3)), farthest=1.0)


def test_a_column_of_a_file_names_line_and_column() -> None:
    with pytest.raises(
        InputFileError, match=r"a\.csv, line 4, column 'yaw': expected a number within 3.2 rad, found 9e\+29"
    ):
        require_column("a.csv", "yaw", np.array([0.0, np.nan, 9e29]), largest=3.2, unit="rad")


def test_the_first_repeated_id_is_found() -> None:
    assert first_repeated(["a", "b", "b", "a"]) == "b"
    assert first_repeated(["a", "b"]) is None
