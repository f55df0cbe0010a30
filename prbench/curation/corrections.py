"""Corrections of events by a person: read from a file that belongs in version control, applied during curation.

Source: docs/review.md#the-corrections-file. Event ids are those of the uncorrected events, whatever a correction
changes, so that a file can be applied again.
"""

from __future__ import annotations

import csv
import dataclasses
import difflib
import io
import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from prbench.curation.events import Decision, PickPutEvent, Place
from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, read_whole, require
from prbench.files.storage import bytes_digest
from prbench.limits import FARTHEST_POSITION, HARMLESS_SIZE
from prbench.shown import quoted

COLUMNS = ("event_id", "change", "value", "reason", "author")
DROPPED = "dropped_by_person"
# What the value of each change is, for messages; empty where the change has none.
CHANGES = {
    "drop": "",
    "move": "seconds by which the event is moved, from -10 to 10 and not 0, such as -0.40",
    "hand": "left or right",
    "goal": "x y z in metres, world frame of the recording, such as 0.52 0.91 -1.30",
    "rename": "the object's new name",
    "accept": "",
    "note": "",
}
# Changes that no other may stand beside, except for notes.
_ALONE = ("drop", "accept")
_LARGEST_MOVE = 10.0  # seconds; what lies farther away is another event
# The doubt of curation that each change settles: who says when, by which hand or where has looked.
_SETTLES = {"move": "tracking_lost", "hand": "other_wearer", "goal": "no_location"}
# Spreadsheets take such cells for formulas; whoever writes the file puts an apostrophe before them.
_GUARDED = re.compile(r"''*\s*[=+\-@\uff1d\uff0b\uff0d\uff20]")


class Correction(NamedTuple):
    """One row of the file: what is changed in which event, to what, why, by whom, and where the row stands."""

    event_id: str
    change: str
    value: str
    reason: str
    author: str
    where: str


class UnknownEventError(InputFileError):
    """A correction names an event that the build does not find; it ends the build, whatever else it may skip."""


@dataclasses.dataclass(frozen=True)
class Corrections:
    """The content of a corrections file.

    Attributes:
        file: Name of the file, without its folder.
        digest: SHA-256 of its bytes.
        rows: Its rows in order.
    """

    file: str
    digest: str
    rows: tuple[Correction, ...]

    def by_recording(self, dataset: str, recording_ids: Collection[str], *, partial: bool) -> dict[str, Corrections]:
        """Return the rows of each recording of a build that has some.

        Args:
            dataset: Name of the dataset.
            recording_ids: All recordings that will be in the table.
            partial: True where the user has chosen among the recordings: rows of others then wait for them.

        Raises:
            UnknownEventError: for an event of another dataset, or of a recording that a whole build does not have.
        """
        found: dict[str, list[Correction]] = {}
        for row in self.rows:
            parts = row.event_id.split("/")
            starts = ("/".join(parts[1:end]) for end in range(len(parts) - 1, 1, -1))
            recording = next((start for start in starts if start in recording_ids), None)
            if recording is not None and parts[0] == dataset:
                found.setdefault(recording, []).append(row)
            elif parts[0] != dataset or not partial:
                near = difflib.get_close_matches("/".join(parts[1:-3]), recording_ids, n=1, cutoff=0.0)
                remedy = f"The nearest recording is {', '.join(near)}. Where a copy lacks recordings, name those that"
                remedy = f"{remedy} it has with --recordings: rows of others then wait."
                raise self._unknown(row, f"an event of a recording of this build ({dataset}/RECORDING/…)", remedy)
        return {name: dataclasses.replace(self, rows=tuple(rows)) for name, rows in found.items()}

    def described(self, dataset: str, read: Iterable[str]) -> dict[str, str]:
        """Return what ``dataset.json`` says of the file, among the options of the build.

        Args:
            dataset: Name of the dataset.
            read: Recordings that were read; rows of others were not applied.
        """
        applied = self.by_recording(dataset, frozenset(read), partial=True).values()
        waiting = sorted(set(self.rows).difference(*(each.rows for each in applied)))
        said = {"corrections": str(len(self.rows)), "corrections_digest": self.digest}
        if waiting:
            said["corrections_waiting"] = f"{len(waiting)} (first: {waiting[0].event_id})"
        return said

    def settle(self, events: Iterable[PickPutEvent]) -> list[PickPutEvent]:
        """Return the events of one recording with the rows about them applied; ids and order stay.

        Raises:
            UnknownEventError: for a row about an event that is none of them, with the nearest one.
        """
        known = {event.event_id: event for event in events}
        mine: dict[str, list[Correction]] = {}
        for row in self.rows:
            if row.event_id not in known:
                near = _nearest(row.event_id, known)
                remedy = f"The nearest is '{quoted(near)}'." if near else "Its recording has no events."
                raise self._unknown(row, "an event that this build finds", remedy)
            mine.setdefault(row.event_id, []).append(row)
        return [_corrected(event, mine.get(name, ())) for name, event in known.items()]

    def _unknown(self, row: Correction, expected: str, remedy: str) -> UnknownEventError:
        where = f"{row.where}, event_id"
        return UnknownEventError(self.file, where, expected=expected, found=f"'{row.event_id}'", remedy=remedy)


def _nearest(wanted: str, known: Collection[str]) -> str | None:
    """Return the id of the event of the same object and action that is nearest in time, else the one most alike."""
    stem, _, time = wanted.rpartition("/")
    same = [name for name in known if name.rpartition("/")[0] == stem]
    if same and time.lstrip("-").isdecimal():
        return min(same, key=lambda name: abs(int(name.rpartition("/")[2]) - int(time)))
    return next(iter(difflib.get_close_matches(wanted, known, n=1, cutoff=0.0)), None)


def _corrected(event: PickPutEvent, rows: Collection[Correction]) -> PickPutEvent:
    """Apply the rows of one event, which do not contradict one another."""
    said = []
    for row in rows:
        said.append(f"{row.change}{' ' if row.value else ''}{row.value}: {row.reason} ({row.author})")
        if event.rejected is not None and event.rejected.outcome == _SETTLES.get(row.change):
            event = dataclasses.replace(event, rejected=None)
        if row.change == "drop":
            event = dataclasses.replace(event, rejected=Decision(DROPPED, "correction"))
        elif row.change == "move":
            event = dataclasses.replace(event, event_time=event.event_time + float(row.value), primed_anew=True)
        elif row.change == "hand":
            event = dataclasses.replace(event, hand=row.value, hand_source="person")
        elif row.change == "rename":
            event = dataclasses.replace(event, object_name=row.value)
        elif row.change == "goal":
            # The box keeps its size and moves with its middle; where none was known, the goal is a point.
            goal = np.array(row.value.split(), dtype=np.float64)
            place = event.place or Place(goal, goal, goal)
            moved = goal - place.location
            place = Place(goal, place.box_min + moved, place.box_max + moved)
            event = dataclasses.replace(event, place=place, primed_anew=True)
    if not said:
        return event
    return dataclasses.replace(event, corrected="; ".join(said), settled=any(row.change != "note" for row in rows))


@foreign_input()
def read_corrections(path: Path) -> Corrections:
    """Read a file of corrections, CSV or TOML (docs/review.md#the-corrections-file).

    Raises:
        InputFileError: naming file and row: for another kind of file or encoding, a column too many or missing, a value
            that its change does not have, a missing reason or author, and rows that contradict one another.
    """
    content = read_whole(path, largest=HARMLESS_SIZE)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        found = f"byte 0x{content[error.start]:02x}"
        remedy = "Save it as 'CSV UTF-8'."
        raise InputFileError(path, f"line {line}", expected="text in UTF-8", found=found, remedy=remedy) from error
    kinds = {".csv": _csv_rows, ".toml": _toml_rows}
    suffix = path.suffix.lower()
    require(path, (suffix in kinds, "", "a file that ends in .csv or .toml", f"'{path.suffix}'", ""))
    rows: list[Correction] = []
    before: dict[str, list[Correction]] = {}
    for where, cells in kinds[suffix](path, text):
        row = Correction(**{name: cells.get(name, "") for name in COLUMNS}, where=where)
        row = row._replace(change=row.change.lower())
        _require_sound(path, row, before.setdefault(row.event_id, []))
        before[row.event_id].append(row)
        rows.append(row)
    return Corrections(path.name, bytes_digest(content), tuple(rows))


def _require_sound(path: Path, row: Correction, others: Iterable[Correction]) -> None:
    """Refuse a row that says nothing, something impossible, or something else than an earlier row of its event."""
    is_event = row.event_id.count("/") >= 4  # dataset, recording, object, action and time
    require(
        path,
        (is_event, f"{row.where}, event_id", "an event_id of events.parquet", f"'{row.event_id}'", ""),
        (row.change in CHANGES, f"{row.where}, change", ", ".join(CHANGES), f"'{row.change}'", ""),
        (row.reason != "", f"{row.where}, reason", "a reason", "nothing", "Say why, for whoever reads the table."),
        (row.author != "", f"{row.where}, author", "who says so", "nothing", "Write a name."),
    )
    try:
        sizes = [abs(float(text)) for text in row.value.split()]
    except ValueError:
        sizes = []
    sound = {
        "move": len(sizes) == 1 and 0 < sizes[0] <= _LARGEST_MOVE,
        "hand": row.value in ("left", "right"),
        "goal": len(sizes) == 3 and all(size <= FARTHEST_POSITION for size in sizes),
        "rename": row.value != "",
    }
    expected = CHANGES[row.change] or f"no value for '{row.change}'"
    require(path, (sound.get(row.change, row.value == ""), f"{row.where}, value", expected, f"'{row.value}'", ""))
    for other in others:
        alone = row.change in _ALONE or other.change in _ALONE
        clash = row.change == other.change or (alone and "note" not in (row.change, other.change))
        expected = f"nothing that repeats or contradicts the '{other.change}' of {other.where} for the same event"
        require(path, (not clash, row.where, expected, f"'{row.change}'", "Keep one of the two rows."))


def _csv_rows(path: Path, text: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield place and cells of each row; blank lines are passed over."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    header: list[str] = []
    all_columns = f"the columns {', '.join(COLUMNS)}"
    end = 0
    try:
        for cells in reader:
            where = f"line {end + 1}"
            end = reader.line_num
            cells = [cell.strip() for cell in cells]
            cells = [cell[1:] if _GUARDED.match(cell) else cell for cell in cells]
            while cells and not cells[-1] and len(cells) > len(header or COLUMNS):
                cells.pop()  # spreadsheets write the empty columns beside a table, too
            if not any(cells):
                continue
            if not header:
                header = cells
                remedy = "Save it with commas between the columns." if re.search(r"[;\t]", cells[0]) else ""
                found = quoted(", ".join(header))
                require(path, (sorted(header) == sorted(COLUMNS), where, all_columns, found, remedy))
                continue
            remedy = "Text with commas stands between double quotes."
            require(path, (len(cells) == len(header), where, f"{len(header)} cells", str(len(cells)), remedy))
            yield where, dict(zip(header, cells, strict=True))
    except csv.Error as error:
        expected = "values with commas between"
        raise InputFileError(path, f"line {end + 1}", expected=expected, found=str(error)) from error
    require(path, (header != [], "line 1", all_columns, "an empty file", ""))


class _Table(msgspec.Struct, forbid_unknown_fields=True):
    event_id: str
    change: str
    value: str | float | list[float] = ""
    reason: str = ""
    author: str = ""


class _Document(msgspec.Struct, forbid_unknown_fields=True):
    correction: list[_Table] = []


def _toml_rows(path: Path, text: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield place and values of each table ``[[correction]]``, as the texts of a CSV file."""
    try:
        tables = msgspec.toml.decode(text, type=_Document).correction
    except (msgspec.ValidationError, msgspec.DecodeError) as error:
        raise InputFileError(path, "", expected="tables [[correction]]", found=str(error)) from error
    for number, table in enumerate(tables, start=1):
        values = table.value if isinstance(table.value, list) else [table.value]
        cells = msgspec.structs.asdict(table) | {"value": " ".join(map(str, values))}
        yield f"correction {number}", {name: text.strip() for name, text in cells.items()}
