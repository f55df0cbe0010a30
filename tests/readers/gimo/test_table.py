"""``dataset.csv`` and the table of events: what they may look like, and what is refused with its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.errors import InputFileError
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.table import (
    Row,
    events_of,
    hints_in_both_splits,
    lines_of_no_segment,
    overlapping,
    read_events,
    read_segments,
    require_one_split,
)

HEADER = "sequence_path,start_frame,end_frame,scene,transformation,training"
FULL = f"{HEADER},action,,,"
EVENTS = "scene,sequence_path,start_frame,end_frame,event_frame,action,hand"


def table(folder: Path, *lines: str, header: str = HEADER) -> Path:
    path = folder / "dataset.csv"
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8-sig")
    return path


def events(folder: Path, *lines: str, header: str = EVENTS) -> Path:
    path = folder / "prbench_events.csv"
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return path


def rows_of(path: Path) -> tuple[Row, ...]:
    rows, unreadable = read_segments(path)
    assert not unreadable
    return rows


def test_mark_unnamed_columns_and_hints_are_understood(tmp_path) -> None:
    path = table(
        tmp_path,
        "S,10,50,room,t.json,2,take book,33,,",
        "S,60,90,room,t.json,0,sit,95,,",
        "S,100,120,room,t.json,1,walk,,x,",
        header=FULL,
    )
    first, second, third = (row.segment for row in rows_of(path))
    assert first == gimo.Segment("room", "S", 10, 50, "t.json", 2, "take book", 33)
    assert (second.hint, third.hint) == (None, None), "a frame outside of the segment is no hint"
    assert first.name == "room_S_10-50"


def test_shorter_tables_named_columns_and_foreign_letters(tmp_path) -> None:
    (row,) = rows_of(table(tmp_path, "2022:01/x,1,2,living room,t.json,1"))
    assert (row.segment.activity, row.segment.hint, row.remarks) == ("", None, ())
    assert row.segment.name == "living-room_2022-01-x_1-2", "no character that files forbid"
    (row,) = rows_of(table(tmp_path, "S,10,50,room,t.json,1,a,33", header=f"{HEADER},action,person"))
    assert row.segment.hint is None, "a named eighth column is no hint"


def test_a_repeated_row_is_dropped_and_reported(tmp_path) -> None:
    line = "2022-01-21-200703,209,613,room,t.json,1"
    first, _ = rows_of(table(tmp_path, line, "S,1,2,room,t.json,1", line))
    assert first.remarks == ("line 2 of dataset.csv is repeated in line 4; the repetition is left out",)


def test_overlapping_segments_know_each_other(tmp_path) -> None:
    rows = rows_of(
        table(tmp_path, "S,1,10,a,t.json,1", "S,10,20,a,t.json,1", "S,21,30,a,t.json,1", "T,1,10,a,t.json,1")
    )
    assert [segment.start_frame for segment in overlapping(rows, rows[0])] == [10]
    assert overlapping(rows, rows[2]) == ()


def test_events_decide_where_they_name_a_segment_and_hints_elsewhere(tmp_path) -> None:
    named, hinted, neither = rows_of(
        table(tmp_path, "S,1,90,a,t.json,1,x,50", "T,1,90,a,t.json,1,x,60", "U,1,90,a,t.json,1", header=FULL)
    )
    rows = read_events(events(tmp_path, "a,S,1,90,42,pick,left", "a,S,1,90,30,PICK,"))
    found = events_of(named, rows, hints=True)
    assert found == ((gimo.EventFrame(30), gimo.EventFrame(42, "left")), (), None)
    assert events_of(hinted, rows, hints=True)[0] == (gimo.EventFrame(60, None, "hint"),)
    assert events_of(hinted, rows, hints=False)[2] == "no event is annotated for it"
    assert events_of(neither, rows, hints=True)[0] == ()


def test_only_confirmed_rows_count_and_a_no_silences_the_hint(tmp_path) -> None:
    (row,) = rows_of(table(tmp_path, "S,1,90,a,t.json,1,x,50", header=FULL))
    header = f"{EVENTS},confirmed,confidence"
    for word, n in (("yes", 1), ("X", 1), ("no", 0), ("", 0)):
        rows = read_events(events(tmp_path, f"a,S,1,90,42,pick,left,{word},0.9", header=header))
        assert len(events_of(row, rows, hints=True)[0]) == n, word
    assert events_of(row, rows, hints=True)[2] == "none of its 1 proposed events is confirmed"


def test_puts_are_left_out_with_a_word(tmp_path) -> None:
    (row,) = rows_of(table(tmp_path, "S,1,90,a,t.json,1"))
    found = events_of(row, read_events(events(tmp_path, "a,S,1,90,42,put,left")), hints=True)
    remarks = ("line 2 of the events names a put, GIMO has none: left out",)
    assert found == ((), remarks, "only puts are annotated for it")


def test_an_event_in_both_splits_is_refused_with_both_lines(tmp_path) -> None:
    rows = rows_of(table(tmp_path, "S,1,50,a,t.json,1", "S,40,90,a,t.json,0", "T,40,90,a,t.json,0"))
    path = events(tmp_path, "a,S,1,50,45,pick,", "a,T,40,90,45,pick,", "a,S,40,90,45,pick,")
    with pytest.raises(InputFileError, match=r"line 4: expected an event in one split only, .*the other is line 2"):
        require_one_split(path, rows, read_events(path))
    apart = events(tmp_path, "a,S,1,50,45,pick,", "a,S,40,90,46,pick,")
    require_one_split(apart, rows, read_events(apart))


def test_hints_that_collide_are_found(tmp_path) -> None:
    rows = rows_of(
        table(tmp_path, "S,1,50,a,t.json,1,x,45", "S,40,90,a,t.json,0,x,45", "S,41,91,a,t.json,0,x,60", header=FULL)
    )
    assert hints_in_both_splits(rows) == {rows[0].segment.key, rows[1].segment.key}


@pytest.mark.parametrize(
    ("line", "expected", "found"),
    [
        ("S,50,10,room,t.json,1", "a start_frame that is not behind the end_frame", "50 to 10"),
        ("S,10,50,room,t.json,3", "training 1 (train), 0 (test) or 2", "3"),
        ("S,10,50,room,t.json,", "a whole number 'training'", "''"),
        *(
            (f"S,{frame},50,room,t.json,1", "a whole number 'start_frame'", f"'{frame}'")
            for frame in ("nan", "inf", "1e300", "2.5", "ten", "", "-3", "True")
        ),
        ("S,10,50,,t.json,1", "a 'scene'", "nothing"),
        ("T,1,9,room,t.json,0", "the same split and transformation as line 2", "training 0, t.json"),
    ],
)
def test_an_odd_segment_is_named_and_the_others_are_read(tmp_path, line, expected, found) -> None:
    rows, (entry,) = read_segments(table(tmp_path, "T,1,9,room,t.json,1", line, "U,1,9,room,t.json,1"))
    assert [row.segment.sequence for row in rows] == ["T", "U"]
    assert (entry.file, entry.key) == ("dataset.csv", "line 3")
    assert entry.expected.startswith(expected)
    assert entry.found == found


def test_a_table_of_odd_segments_alone_is_refused_with_the_first(tmp_path) -> None:
    with pytest.raises(InputFileError, match=r"expected segments, one a line, found dataset.csv, line 2: .*'ten'"):
        read_segments(table(tmp_path, "S,ten,50,room,t.json,1"))


@pytest.mark.parametrize(
    ("cells", "column", "expected", "found"),
    [
        ("a,S,1,90,95,pick,left,yes", "event_frame", "a frame from 1 to 90", "95"),
        ("a,S,1,90,,pick,left,yes", "event_frame", "a frame number", "''"),
        ("a,S,x,90,4,pick,left,yes", "start_frame", "a frame number", "'x'"),
        ("a,S,1,90,4,grab,left,yes", "action", "pick or put", "'grab'"),
        ("a,S,1,90,4,pick,both,yes", "hand", "left, right, or nothing", "'both'"),
        ("a,S,1,90,4,pick,left,maybe", "confirmed", "yes, no, or nothing (not looked at yet)", "'maybe'"),
    ],
)
def test_an_odd_event_is_named_and_no_hint_takes_its_place(tmp_path, cells, column, expected, found) -> None:
    path = events(tmp_path, "a,T,1,90,4,pick,left,yes", cells, header=f"{EVENTS},confirmed")
    good, odd = read_events(path)
    assert (good.unreadable, good.event_frame) == (None, 4)
    assert odd.unreadable is not None
    assert odd.unreadable.key == f"line 3, column '{column}'"
    assert (odd.unreadable.expected, odd.unreadable.found) == (expected, found)
    (row,) = rows_of(table(tmp_path, "S,1,90,a,t.json,1,x,50", header=FULL))
    if column != "start_frame":
        assert "cannot be read: prbench_events.csv, line 3" in str(events_of(row, (odd,), hints=True)[2])
    named = lines_of_no_segment(path, [row], (odd,))
    assert named == ([odd.unreadable] if column == "start_frame" else [])
