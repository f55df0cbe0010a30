"""The tables of GIMO: ``dataset.csv`` with the segments, and the user's annotation of pick events.

Sources: docs/specification/gimo.md#segment-table and ``docs/gimo-events.md``, which defines the second one: the dataset
says neither when something is picked up nor where; *Prime and Reach* annotated that by hand.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from prbench.errors import InputFileError
from prbench.files.bounded import require_size
from prbench.readers.files import missing_file
from prbench.readers.gimo import format as gimo
from prbench.recording.streams import Side

_LAST_FRAME = 10**7
"""Frame number that no recording reaches: four days at 30 frames a second."""


@dataclass(frozen=True)
class Row:
    """A segment, and what its line in the file brought up."""

    line: int
    segment: gimo.Segment
    repeated: tuple[int, ...] = ()
    """Further lines that say exactly the same; they are left out."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return remarks for the report of a build."""
        if not self.repeated:
            return ()
        lines = ", ".join(str(line) for line in self.repeated)
        return (f"line {self.line} of {gimo.TABLE_FILE} is repeated in line {lines}; the repetition is left out",)


def read_segments(path: Path) -> tuple[Row, ...]:
    """All segments in the order of the file, each once.

    The byte-order mark, further columns and unnamed ones are welcome; the eighth column, where it is unnamed, holds
    hints. A hint that is no frame of its segment is no hint.

    Raises:
        InputFileError: naming the line: for a missing column, a value that is no frame number, a segment that ends
            before it starts, another value of ``training`` than 0, 1 or 2, or one segment listed twice with
            different splits or transformations.
    """
    lines = list(read_lines(path))
    if not lines:
        raise InputFileError(path, "", expected="a header and segments", found="nothing")
    header = lines[0][1]
    missing = [name for name in gimo.TABLE_COLUMNS if name not in header]
    if missing:
        raise InputFileError(
            path,
            "header",
            expected=f"a column '{missing[0]}'",
            found=f"the columns {', '.join(cell or '(unnamed)' for cell in header)}",
            remedy="This is another file, or another version of the table.",
        )
    header, lines = header, lines[1:]
    rows: dict[tuple[str, str, int, int], Row] = {}
    for line, cells in lines:
        segment = _segment(path, line, header, cells)
        first = rows.get(segment.key)
        if first is None:
            rows[segment.key] = Row(line, segment)
        elif (first.segment.training, first.segment.transformation) == (segment.training, segment.transformation):
            rows[segment.key] = Row(first.line, first.segment, (*first.repeated, line))
        else:
            raise InputFileError(
                path,
                f"line {line}",
                expected=f"the same split and transformation as line {first.line}, which is the same segment",
                found=f"training {segment.training}, {segment.transformation}",
                remedy="Remove one of the two lines.",
            )
    if not rows:
        raise InputFileError(path, "", expected="segments, one a line", found="a header alone")
    return tuple(rows.values())


def overlapping(rows: tuple[Row, ...], row: Row) -> tuple[gimo.Segment, ...]:
    """Other segments of the same sequence that share frames with one."""
    mine = row.segment
    return tuple(
        other.segment
        for other in rows
        if other.segment.key != mine.key
        and (other.segment.scene, other.segment.sequence) == (mine.scene, mine.sequence)
        and other.segment.start_frame <= mine.end_frame
        and other.segment.end_frame >= mine.start_frame
    )


def read_lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Lines of a CSV file that hold anything, with their numbers.

    Raises:
        InputFileError: if the file is missing or no text.
    """
    try:
        require_size(path)
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            for cells in reader:
                if any(cell.strip() for cell in cells):
                    yield reader.line_num, [cell.strip() for cell in cells]
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputFileError(path, "", expected="text with comma-separated values", found=str(error)) from error


def _segment(path: Path, line: int, header: list[str], cells: list[str]) -> gimo.Segment:
    # Of two columns of one name the first counts, so the cells are looked up from the last to the first.
    values = dict(reversed(list(itertools.zip_longest(header, cells[: len(header)], fillvalue=""))))
    start, end, training = (
        _number(path, line, name, values[name]) for name in ("start_frame", "end_frame", "training")
    )
    for name in ("scene", "sequence_path", "transformation"):
        if not values[name]:
            raise InputFileError(path, f"line {line}", expected=f"a '{name}'", found="nothing")
    if start > end:
        raise InputFileError(
            path,
            f"line {line}",
            expected="a start_frame that is not behind the end_frame",
            found=f"{start} to {end}",
            remedy="Correct the line, or remove it.",
        )
    if training not in gimo.PUBLISHED_SPLITS:
        raise InputFileError(
            path,
            f"line {line}",
            expected="training 1 (train), 0 (test) or 2 (train, but unused by the official loader)",
            found=str(training),
            remedy="Correct the line, or remove it.",
        )
    return gimo.Segment(
        scene=values["scene"],
        sequence=values["sequence_path"],
        start_frame=start,
        end_frame=end,
        transformation=values["transformation"],
        training=training,
        activity=values.get(gimo.ACTIVITY_COLUMN, ""),
        hint=_hint(header, cells, start, end),
    )


def _number(path: Path, line: int, name: str, text: str) -> int:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not (0 <= value <= _LAST_FRAME and value.is_integer()):
        raise InputFileError(path, f"line {line}", expected=f"a whole number '{name}'", found=f"'{text}'")
    return int(value)


def _hint(header: list[str], cells: list[str], start: int, end: int) -> int | None:
    """The frame in the unnamed eighth column, if it is one of the segment."""
    named = len(header) > gimo.HINT_INDEX and header[gimo.HINT_INDEX] not in ("", f"Unnamed: {gimo.HINT_INDEX}")
    if named or len(cells) <= gimo.HINT_INDEX:
        return None
    try:
        frame = float(cells[gimo.HINT_INDEX])
    except ValueError:
        return None
    return int(frame) if frame.is_integer() and start <= frame <= end else None


def published_lengths(root: Path) -> dict[str, tuple[int, ...]]:
    """Frames of every row of ``dataset.csv`` by published split; a row that stands there twice counts twice."""
    lengths: dict[str, list[int]] = {}
    for row in read_segments(root / gimo.TABLE_FILE):
        of_split = lengths.setdefault(gimo.PUBLISHED_SPLITS[row.segment.training], [])
        of_split += [len(row.segment.frames)] * (1 + len(row.repeated))
    return {split: tuple(frames) for split, frames in sorted(lengths.items())}


_SegmentKey = tuple[str, str, int, int]

_REQUIRED = tuple(name for name in gimo.EVENT_COLUMNS if name != "hand")
_ACTIONS = ("pick", "put")
_HANDS = ("left", "right", "")
_MOST_DIGITS = 9  # of a frame number
_YES = ("yes", "y", "true", "1", "x")
_NO = ("no", "n", "false", "0", "")


@dataclass(frozen=True)
class EventRow:
    """One line of the table."""

    line: int
    segment: _SegmentKey
    event_frame: int | None
    """None on a line that says no to a proposal without a frame."""
    action: str
    hand: Side | None
    confirmed: bool
    """True where a person confirmed the line; lines that nobody confirmed are no events."""


@dataclass(frozen=True)
class _SegmentEvents:
    """The known picks of one segment."""

    events: tuple[gimo.EventFrame, ...]
    remarks: tuple[str, ...] = ()
    reason: str | None = None
    """Reason why there are none."""


def read_events(path: Path) -> tuple[EventRow, ...]:
    """All lines of an events table.

    Raises:
        InputFileError: naming line and column: for a missing column, a value that is no frame number, an action other
            than pick and put, a hand other than left, right and nothing, a frame outside of its segment, or a
            ``confirmed`` that is neither yes nor no.
    """
    lines = list(read_lines(path))
    header = lines[0][1] if lines else []
    missing = [name for name in _REQUIRED if name not in header]
    if missing:
        raise InputFileError(
            path,
            "header",
            expected=f"a column '{missing[0]}'",
            found=f"the columns {', '.join(header) or '(none)'}",
            remedy=f"The columns are {', '.join(gimo.EVENT_COLUMNS)};"
            " `prbench build-dataset gimo --propose-events FILE` writes such a file.",
        )
    return tuple(_row(path, line, dict(zip(header, cells, strict=False))) for line, cells in lines[1:])


def events_of(row: Row, table: Sequence[EventRow], *, hints: bool) -> _SegmentEvents:
    """The picks of one segment: those of the table where it names the segment, else the hint of ``dataset.csv``."""
    segment = row.segment
    mine = [event for event in table if event.segment == segment.key]
    if not mine:
        if hints and segment.hint is not None:
            return _SegmentEvents((gimo.EventFrame(segment.hint, None, "hint"),))
        return _SegmentEvents((), (), "no event is annotated for it")
    puts = [event for event in mine if event.confirmed and event.action == "put"]
    picks = [event for event in mine if event.confirmed and event.action == "pick" and event.event_frame is not None]
    remarks = tuple(f"line {event.line} of the events names a put, GIMO has none: left out" for event in puts)
    if not picks:
        waiting = sum(not event.confirmed for event in mine)
        reason = f"none of its {waiting} proposed events is confirmed" if waiting else "only puts are annotated for it"
        return _SegmentEvents((), remarks, reason)
    frames: dict[int, Side | None] = {cast(int, event.event_frame): event.hand for event in picks}
    return _SegmentEvents(tuple(gimo.EventFrame(frame, hand) for frame, hand in sorted(frames.items())), remarks)


def require_one_split(path: Path, rows: Sequence[Row], table: Sequence[EventRow]) -> None:
    """Refuse an event that stands in both splits: overlapping segments of one sequence, one test and one not.

    Raises:
        InputFileError: naming both lines.
    """
    segments = {row.segment.key: row.segment for row in rows}
    seen: dict[tuple[str, str, int], tuple[int, bool]] = {}
    for event in table:
        segment = segments.get(event.segment)
        if segment is None or not event.confirmed or event.event_frame is None:
            continue
        is_test = segment.training == gimo.TEST
        line, was_test = seen.setdefault((segment.scene, segment.sequence, event.event_frame), (event.line, is_test))
        if was_test != is_test:
            raise InputFileError(
                path,
                f"line {event.line}",
                expected="an event in one split only",
                found=f"frame {event.event_frame} of {segment.sequence} in a training and in a test segment"
                f" (the other is line {line})",
                remedy="Remove one of the two lines.",
            )


def hints_in_both_splits(rows: Sequence[Row]) -> frozenset[_SegmentKey]:
    """Segments whose hint is also a frame of a segment of the other split that has the same hint."""
    splits: dict[tuple[str, str, int], dict[bool, list[_SegmentKey]]] = {}
    for row in rows:
        segment = row.segment
        if segment.hint is not None:
            place = splits.setdefault((segment.scene, segment.sequence, segment.hint), {})
            place.setdefault(segment.training == gimo.TEST, []).append(segment.key)
    return frozenset(key for place in splits.values() if len(place) == 2 for keys in place.values() for key in keys)


def require_known_segments(path: Path, rows: Sequence[Row], table: Sequence[EventRow]) -> None:
    """Refuse lines about segments that ``dataset.csv`` does not list: with a slip in a name they would say nothing.

    Raises:
        InputFileError: naming the first such line.
    """
    known = {row.segment.key for row in rows}
    lost = next((event for event in table if event.segment not in known), None)
    if lost is not None:
        scene, sequence, start, end = lost.segment
        raise InputFileError(
            path,
            f"line {lost.line}",
            expected=f"scene, sequence_path, start_frame and end_frame of a row of {gimo.TABLE_FILE}",
            found=f"{scene}, {sequence}, {start}, {end}",
            remedy="Copy the four cells from there.",
        )


def _row(path: Path, line: int, cells: Mapping[str, str]) -> EventRow:
    start, end = (_frame(path, line, name, cells.get(name, "")) for name in ("start_frame", "end_frame"))
    confirmed = _confirmed(path, line, cells)
    text = cells.get("event_frame", "")
    frame = None if not text and not confirmed else _frame(path, line, "event_frame", text)
    if frame is not None and not start <= frame <= end:
        raise _wrong(path, line, "event_frame", f"a frame from {start} to {end}", str(frame))
    action = cells.get("action", "").lower()
    hand = cells.get("hand", "").lower()
    if action not in _ACTIONS and confirmed:
        raise _wrong(path, line, "action", "pick or put", f"'{action}'")
    if hand not in _HANDS:
        raise _wrong(path, line, "hand", "left, right, or nothing", f"'{hand}'")
    return EventRow(
        line=line,
        segment=(cells.get("scene", ""), cells.get("sequence_path", ""), start, end),
        event_frame=frame,
        action=action,
        hand=cast(Side, hand) if hand else None,
        confirmed=confirmed,
    )


def _confirmed(path: Path, line: int, cells: Mapping[str, str]) -> bool:
    """Return True for every line of a file without the column, and else for lines that say yes."""
    if gimo.CONFIRMED_COLUMN not in cells:
        return True
    text = cells[gimo.CONFIRMED_COLUMN].lower()
    if text not in (*_YES, *_NO):
        raise _wrong(path, line, gimo.CONFIRMED_COLUMN, "yes, no, or nothing (not looked at yet)", f"'{text}'")
    return text in _YES


def _frame(path: Path, line: int, name: str, text: str) -> int:
    if not text.isdecimal() or len(text) > _MOST_DIGITS:
        raise _wrong(path, line, name, "a frame number", f"'{text}'")
    return int(text)


def _wrong(path: Path, line: int, column: str, expected: str, found: str) -> InputFileError:
    return InputFileError(
        path, f"line {line}, column '{column}'", expected=expected, found=found, remedy="Correct the line."
    )
