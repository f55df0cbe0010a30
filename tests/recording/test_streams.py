"""What no recording can hold is refused where streams are made, whichever reader makes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import InputFileError, RecordingUnusable
from prbench.files.arrays import first_repeated, require_column, require_near
from prbench.geometry.skeleton import N_JOINTS, WRISTS
from prbench.recording import BodyStream, HandStream, plausible_body_frames, reaching_hand, wrists_at
from tests.curation.scenes import scene
from tests.readers.conftest import STANDING


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


RATE = 120.0


def _walk(n: int) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(n) / RATE
    return times, STANDING + times[:, None, None] * np.array([1.5, 0.0, 0.0])


def _bad(times: np.ndarray, joints: np.ndarray) -> list[int]:
    return np.flatnonzero(~plausible_body_frames(times, joints)).tolist()


def test_a_walk_is_believed() -> None:
    assert _bad(*_walk(240)) == []


@pytest.mark.parametrize("jumped", [[50], [50, 51, 52], [0, 1], [238, 239]], ids=str)
def test_a_whole_body_that_jumps_away_for_some_frames_is_not(jumped) -> None:
    times, joints = _walk(240)
    joints[jumped] += (0.0, 0.0, 0.4)
    assert _bad(times, joints) == jumped


def test_a_body_that_jumps_and_stays_is_believed_on_both_sides() -> None:
    times, joints = _walk(240)
    joints[100:] += (0.0, 0.0, 0.4)
    assert _bad(times, joints) == []


def test_zeros_and_other_bones_are_not_believed() -> None:
    times, joints = _walk(240)
    joints[30] = 0.0
    joints[60:90, 20] += (0.3, 0.0, 0.0)
    joints[120, 3, 1] = np.nan
    assert _bad(times, joints) == [30, *range(60, 90), 120]


def test_a_speed_just_below_ten_metres_a_second_is_a_movement() -> None:
    times, joints = _walk(240)
    fast, slow = joints.copy(), joints.copy()
    fast[50] += (0.0, 0.0, 10.2 / RATE)
    slow[50] += (0.0, 0.0, 9.5 / RATE)
    assert _bad(times, fast) == [50]
    assert _bad(times, slow) == []


def test_two_frames_are_too_few_to_tell_a_jump() -> None:
    times, joints = _walk(2)
    joints[1] += 1.0
    assert _bad(times, joints) == []


PLACE = np.zeros(3)


def at(side, distance: float, source="tracked"):
    return side, (np.array([distance, 0.0, 0.0]), source)


@pytest.mark.parametrize(
    ("wrists", "hand"),
    [
        ((), None),  # nothing is known
        ((at("left", 0.19),), "left"),
        ((at("left", 0.21),), None),  # the hand that nobody saw may be nearer
        ((at("left", 0.39), at("right", 0.60)), "left"),
        ((at("left", 0.41), at("right", 0.60)), None),  # neither is there
        ((at("left", 0.125), at("right", 0.10)), "right"),
        ((at("left", 0.115), at("right", 0.10)), None),  # closer to each other than places are exact
    ],
)
def test_the_nearest_wrist_counts_where_it_is_near_and_clearly_nearer(wrists, hand) -> None:
    assert reaching_hand(dict(wrists), PLACE)[0] == hand


def test_the_source_is_that_of_the_nearest_wrist() -> None:
    wrists = dict((at("left", 0.5), at("right", 0.1, "body")))
    assert reaching_hand(wrists, PLACE) == ("right", "body")


def _tracked(side, x: float, unseen: tuple[float, float] = (0.0, 0.0)) -> HandStream:
    times = np.arange(0, 10, 0.1)
    valid = (times < unseen[0]) | (times > unseen[1])
    return HandStream(side, "wrist", times, np.tile([x, 0.0, 0.0], (len(times), 1, 1)), valid)


def _body(left: float, right: float) -> BodyStream:
    times = np.arange(0, 10, 1 / 30)
    joints = np.zeros((len(times), N_JOINTS, 3))
    joints[:, WRISTS, 0] = [left, right]
    return BodyStream(times, joints, np.ones(len(times), dtype=bool))


def test_a_wrist_is_the_tracked_one_and_the_bodys_only_where_tracking_lost_it() -> None:
    hands = (_tracked("right", 2.0), _tracked("left", 1.0, unseen=(4.9, 5.2)))
    wrists = wrists_at(hands, _body(1.1, 2.1), 5.05)
    found = [(side, source, position[0]) for side, (position, source) in wrists.items()]
    assert found == [("left", "body", pytest.approx(1.1)), ("right", "tracked", pytest.approx(2.0))]


def test_a_wrist_that_neither_source_knows_is_left_out() -> None:
    hands = (_tracked("left", 1.0, unseen=(4.9, 5.2)), _tracked("right", 2.0))
    assert list(wrists_at(hands, None, 5.05)) == ["right"]
    assert wrists_at((), _body(1.0, 2.0), 11.0) == {}, "after the end of the body"


def test_other_contact_points_are_no_wrists() -> None:
    fingers = HandStream("left", "middle_finger_base", np.arange(3.0), np.zeros((3, 1, 3)), np.ones(3, dtype=bool))
    assert wrists_at((fingers,), None, 1.0) == {}
