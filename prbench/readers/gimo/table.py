"""The tables of GIMO: ``dataset.csv`` with the segments, and the user's annotation of pick events.

Sources: docs/specification/gimo.md#segment-table and ``docs/gimo-events.md``, which defines the second one: the dataset
says neither when something is picked up nor where; *Prime and Reach* annotated that by hand.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from prbench.files.bounded import require
from prbench.readers.files import read_entries, read_lines
from prbench.readers.gimo import format as gimo
from prbench.recording import Side, UnreadableEntry

_LAST_FRAME = 10**7  # Frame number that no recording reaches: four days at 30 frames a second.
_MOST_DIGITS = 9  # of a frame number
_YES = ("yes", "y", "true", "1", "x")
_NO = ("no", "n", "false", "0", "")
SegmentKey = tuple[str, str, int, int]  # Scene, sequence, first and last frame.


@dataclass(frozen=True)
class Row:
    """A segment, and what its line in the file brought up.

    Attributes:
        repeated: Further lines that say exactly the same; they are left out.
    """

    line: int
    segment: gimo.Segment
    repeated: tuple[int, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return remarks for the report of a build."""
        if not self.repeated:
            return ()
        lines = ", ".join(str(line) for line in self.repeated)
        return (f"line {self.line} of {gimo.TABLE_FILE} is repeated in line {lines}; the repetition is left out",)


@dataclass(frozen=True)
class EventRow:
    """One line of the table of events.

    Attributes:
        event_frame: None on a line that says no to a proposal without a frame.
        confirmed: True where a person confirmed the line; lines that nobody confirmed are no events.
        unreadable: What is wrong with a line that cannot be read; it is no event.
    """

    line: int
    segment: SegmentKey
    event_frame: int | None
    action: str
    hand: Side | None
    confirmed: bool
    unreadable: UnreadableEntry | None = None


def read_segments(path: Path) -> tuple[tuple[Row, ...], list[UnreadableEntry]]:
    """Read all segments in the order of the file, each once.

    The byte-order mark, further columns and unnamed ones are welcome; the eighth column, where it is unnamed, holds
    hints. A hint that is no frame of its segment is no hint.

    Returns:
        The segments, and the lines that are none: a value is no frame number, the segment ends before it starts,
        ``training`` is not 0, 1 or 2, or an earlier line gives the segment another split or transformation.

    Raises:
        InputFileError: for a missing column, or a table without any segment.
    """
    header, lines = read_lines(path, gimo.TABLE_COLUMNS, "This is another file, or another version of the table.")
    has_hints = len(header) <= gimo.HINT_INDEX or header[gimo.HINT_INDEX] in ("", f"Unnamed: {gimo.HINT_INDEX}")

    def read_segment(cells: list[str]) -> gimo.Segment:
        # Of two columns of one name the first counts, so the cells are looked up from the last to the first.
        values = dict(reversed(list(itertools.zip_longest(header, cells[: len(header)], fillvalue=""))))
        numbers = {name: _whole(values[name]) for name in ("start_frame", "end_frame", "training")}
        start, end, training = numbers.values()
        expected = "training 1 (train), 0 (test) or 2 (train, but unused by the official loader)"
        texts = ("scene", "sequence_path", "transformation")
        require(
            path,
            *((numbers[name] >= 0, "", f"a whole number '{name}'", f"'{values[name]}'", "") for name in numbers),
            *((values[name] != "", "", f"a '{name}'", "nothing", "") for name in texts),
            (start <= end, "", "a start_frame that is not behind the end_frame", f"{start} to {end}", ""),
            (training in gimo.PUBLISHED_SPLITS, "", expected, training, ""),
        )
        hint = _whole(cells[gimo.HINT_INDEX]) if has_hints and len(cells) > gimo.HINT_INDEX else -1
        hinted = hint if start <= hint <= end else None
        activity = values.get(gimo.ACTIVITY_COLUMN, "")
        scene, sequence, transformation = (values[name] for name in texts)
        return gimo.Segment(scene, sequence, start, end, transformation, training, activity, hinted)

    segments, unreadable = read_entries(path, {f"line {line}": cells for line, cells in lines}, read_segment)
    rows: dict[SegmentKey, Row] = {}
    for key, segment in segments.items():
        line = int(key.removeprefix("line "))
        first = rows.setdefault(segment.key, Row(line, segment))
        said = (segment.training, segment.transformation)
        if said != (first.segment.training, first.segment.transformation):
            expected = f"the same split and transformation as line {first.line}, which is the same segment"
            unreadable.append(UnreadableEntry(path.name, key, expected, f"training {said[0]}, {said[1]}"))
        elif first.line != line:
            rows[segment.key] = Row(first.line, first.segment, (*first.repeated, line))
    require(path, (len(rows) > 0, "", "segments, one a line", unreadable[0] if unreadable else "a header alone", ""))
    return tuple(rows.values()), unreadable


def _whole(text: str) -> int:
    """Return the frame number in a cell; -1 where there is none."""
    try:
        value = float(text)
    except ValueError:
        return -1
    return int(value) if 0 <= value <= _LAST_FRAME and value.is_integer() else -1


def overlapping(rows: Sequence[Row], row: Row) -> tuple[gimo.Segment, ...]:
    """Return the other segments of the same sequence that share frames with one."""
    mine = row.segment
    others = [each.segment for each in rows if each.segment.key != mine.key and each.segment.key[:2] == mine.key[:2]]
    return tuple(each for each in others if each.start_frame <= mine.end_frame and each.end_frame >= mine.start_frame)


def read_events(path: Path) -> tuple[EventRow, ...]:
    """Read all lines of an events table.

    A line cannot be read with a value that is no frame number, an action other than pick and put, a hand other than
    left, right and nothing, a frame outside of its segment, or a ``confirmed`` that is neither yes nor no.

    Raises:
        InputFileError: for a missing column.
    """
    remedy = f"The columns are {', '.join(gimo.EVENT_COLUMNS)};"
    remedy += " `prbench build-dataset gimo --propose-events FILE` writes such a file."
    header, lines = read_lines(path, (name for name in gimo.EVENT_COLUMNS if name != "hand"), remedy)
    return tuple(_event_row(path, line, dict(zip(header, cells, strict=False))) for line, cells in lines)


def _event_row(path: Path, line: int, cells: dict[str, str]) -> EventRow:
    frames = ("start_frame", "end_frame", "event_frame")
    texts = {name: cells.get(name, "") for name in (*frames, "action", "hand", "scene", "sequence_path")}
    start, end, frame = (int(texts[name]) if _is_frame(texts[name]) else -1 for name in frames)
    action = texts["action"].lower()
    hand = texts["hand"].lower()
    # Without the column every line of a file counts.
    said = cells.get(gimo.CONFIRMED_COLUMN, _YES[0]).lower()
    confirmed = said in _YES
    no_frame = texts["event_frame"] == "" and not confirmed
    checks: tuple[tuple[bool, str, str, str], ...] = (
        *((_is_frame(texts[name]), name, "a frame number", f"'{texts[name]}'") for name in frames[:2]),
        (said in (*_YES, *_NO), gimo.CONFIRMED_COLUMN, "yes, no, or nothing (not looked at yet)", f"'{said}'"),
        (no_frame or _is_frame(texts["event_frame"]), "event_frame", "a frame number", f"'{texts['event_frame']}'"),
        (no_frame or start <= frame <= end, "event_frame", f"a frame from {start} to {end}", str(frame)),
        (action in ("pick", "put") or not confirmed, "action", "pick or put", f"'{action}'"),
        (hand in ("left", "right", ""), "hand", "left, right, or nothing", f"'{hand}'"),
    )
    segment = (texts["scene"], texts["sequence_path"], start, end)
    for holds, name, good, found in checks:
        if not holds:
            entry = UnreadableEntry(path.name, f"line {line}, column '{name}'", good, found)
            return EventRow(line, segment, None, "", None, confirmed=False, unreadable=entry)
    return EventRow(line, segment, None if no_frame else frame, action, cast(Side, hand) if hand else None, confirmed)


def _is_frame(text: str) -> bool:
    return text.isdecimal() and len(text) <= _MOST_DIGITS


def events_of(
    row: Row, table: Sequence[EventRow], *, hints: bool
) -> tuple[tuple[gimo.EventFrame, ...], tuple[str, ...], str | None]:
    """Return the picks of one segment: those of the table where it names the segment, else the hint of ``dataset.csv``.

    Returns:
        The picks, remarks, and the reason why there are none (None where there are some).
    """
    segment = row.segment
    mine = [event for event in table if event.segment == segment.key]
    if not mine:
        if hints and segment.hint is not None:
            return (gimo.EventFrame(segment.hint, None, "hint"),), (), None
        return (), (), "no event is annotated for it"
    puts = [event for event in mine if event.confirmed and event.action == "put"]
    remarks = tuple(f"line {event.line} of the events names a put, GIMO has none: left out" for event in puts)
    frames: dict[int, Side | None] = {}
    for event in mine:
        if event.confirmed and event.action == "pick" and event.event_frame is not None:
            frames[event.event_frame] = event.hand
    if not frames:
        if odd := [str(event.unreadable) for event in mine if event.unreadable]:
            return (), remarks, f"its event cannot be read: {'; '.join(odd)}"
        waiting = sum(not event.confirmed for event in mine)
        reason = f"none of its {waiting} proposed events is confirmed" if waiting else "only puts are annotated for it"
        return (), remarks, reason
    return tuple(gimo.EventFrame(frame, hand) for frame, hand in sorted(frames.items())), remarks, None


def require_one_split(path: Path, rows: Sequence[Row], table: Sequence[EventRow]) -> None:
    """Refuse an event that stands in both splits: overlapping segments of one sequence, one test and one not.

    Raises:
        InputFileError: naming both lines.
    """
    segments = {row.segment.key: row.segment for row in rows}
    seen: dict[tuple[str, str, int], tuple[int, bool]] = {}
    for event in table:
        where = f"line {event.line}"
        segment = segments.get(event.segment)
        if segment is None or not event.confirmed or event.event_frame is None:
            continue
        is_test = segment.training == gimo.TEST
        line, was_test = seen.setdefault((segment.scene, segment.sequence, event.event_frame), (event.line, is_test))
        found = f"frame {event.event_frame} of {segment.sequence} in a training and in a test segment"
        found += f" (the other is line {line})"
        require(path, (was_test == is_test, where, "an event in one split only", found, "Remove one of the two lines."))


def lines_of_no_segment(path: Path, rows: Sequence[Row], table: Sequence[EventRow]) -> list[UnreadableEntry]:
    """Return the lines of a table of events that name no segment of ``dataset.csv``: they would say nothing."""
    known = {row.segment.key for row in rows}
    expected = f"scene, sequence_path, start_frame and end_frame of a row of {gimo.TABLE_FILE}"
    return [
        event.unreadable
        or UnreadableEntry(path.name, f"line {event.line}", expected, ", ".join(map(str, event.segment)))
        for event in table
        if event.segment not in known
    ]


def hints_in_both_splits(rows: Sequence[Row]) -> frozenset[SegmentKey]:
    """Return the segments whose hint is also a frame of a segment of the other split that has the same hint."""
    splits: dict[tuple[str, str, int], dict[bool, list[SegmentKey]]] = {}
    for row in rows:
        segment = row.segment
        if segment.hint is not None:
            place = splits.setdefault((segment.scene, segment.sequence, segment.hint), {})
            place.setdefault(segment.training == gimo.TEST, []).append(segment.key)
    return frozenset(key for place in splits.values() if len(place) == 2 for keys in place.values() for key in keys)
