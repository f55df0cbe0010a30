"""What the ends of files tell without reading them: damage, first and last times, streams that stop too early.

A text file that was cut between two lines reads as whole, and what happened after the cut is missing without a word.
Only the other streams of the recording can tell: they go on. A reader with a method ``extents`` says which streams its
recordings have (:class:`prbench.readers.KnowsEnds`).
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import h5py
import msgspec
import numpy as np

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, open_regular, read_end, require_size
from prbench.limits import LARGEST_ARCHIVE, LARGEST_UNPACKED, LARGEST_UNPACKED_FOR_ITS_END, LONGEST_LINE
from prbench.readers.files import header_names, opened, source_of
from prbench.readers.found import InputFile

# Seconds by which two streams that one tracking system writes frame by frame may end apart: half of what a person needs
# to reach for something, and more than the frames that are lost at the end of public samples (0.1 s).
ONE_SYSTEM = 0.5
# Seconds by which sensors that start and stop by themselves, or the results of different programs, may begin or end
# apart. In the public sample of the Machine Perception Services poses begin 1.4 s after gaze and end 1.1 s before it;
# the first video frame of HD-EPIC may be more than 1 s late. No sequence begins in the two seconds before a look
# anyway.
SEVERAL_SENSORS = 2.0
_REMEDY = "it may be cut off: compare its size with the original, or copy or download it again"


@dataclass(frozen=True)
class Extent:
    """First and last time of one stream.

    Attributes:
        stream: Name of the stream in messages.
        file: Name of the file.
        first: Time of its first sample, seconds on a clock that all streams of the recording share; None if unknown.
        last: Time of its last sample; None if it holds none.
        tells_span: True where the recording lasts at least as long. Not so where a dataset's sensors run on without
            ground truth.
        may_start_late: True where a late start is normal.
        slack: Seconds by which it may begin after the recording or end before it.
    """

    stream: str
    file: str
    first: float | None
    last: float | None
    tells_span: bool = True
    may_start_late: bool = False
    slack: float = ONE_SYSTEM


# Bytes that are read of each end. The static objects of an ADT recording take 60 kB before the first one that moves; a
# frame of a skeleton, printed with one number a line, 130 kB.
_END = 1 << 18
_NAMED_TIME = re.compile(rb'"(?:tracking_)?timestamp_ns"\s*:\s*(\d{1,19})(?=[\s,}])')


def shortfalls(extents: Sequence[Extent]) -> tuple[str, ...]:
    """Say of each stream that stops before the recording does, or begins after it, by how much.

    The recording is as long as the longest of those streams that tell its span.

    Args:
        extents: Every stream of one recording of which the ends are known.

    Returns:
        One message a stream and end; none where all is well, or fewer than two streams can be compared.
    """
    starts = [extent.first for extent in extents if extent.tells_span and extent.first is not None]
    ends = [extent.last for extent in extents if extent.tells_span and extent.last is not None]
    if not starts or not ends:
        return ()
    start = min(starts)
    end = max(ends)
    told = []
    for extent in extents:
        named = f"{extent.stream} ({extent.file})"
        if extent.last is None:
            told.append(f"{named} holds no sample with a time: events may be missing; {_REMEDY}")
            continue
        if extent.last < end - extent.slack:
            said = f"{named} ends {end - extent.last:.1f} s before the recording does, {extent.last - start:.1f} s"
            told.append(f"{said} after its start: later events may be missing; {_REMEDY}")
        if extent.first is not None and extent.first > start + extent.slack and not extent.may_start_late:
            said = f"{named} begins {extent.first - start:.1f} s after the recording does: earlier events may be"
            told.append(f"{said} missing; {_REMEDY}")
    return tuple(told)


def can_be_looked_at(file: InputFile) -> bool:
    """Return True where the ends of a file can be seen without much work."""
    return not file.member or file.size <= LARGEST_UNPACKED_FOR_ITS_END


def csv_extent(stream: str, file: InputFile, column: str, seconds: float) -> Extent:
    """Return the extent of a CSV file.

    Args:
        stream: What it holds.
        file: The file.
        column: Name of its time column; negative times are none.
        seconds: Length of the column's unit.
    """
    head, tail = _both_ends(file)
    header, _, rows = head.partition(b"\n")
    try:
        place = header_names(header).index(column)
    except (UnicodeDecodeError, ValueError):  # no text, or no such column
        return _extent(stream, file, (), (), seconds)
    complete = rows.splitlines()[:-1] if len(head) == _END else rows.splitlines()
    return _extent(stream, file, _cells(complete, place), _cells(tail.splitlines()[1:], place), seconds)


def _extent(stream: str, file: InputFile, head: Iterable[float], tail: Iterable[float], seconds: float) -> Extent:
    """Return the extent from the earliest time near the beginning of a file to the latest near its end."""
    ends = (min(head, default=None), max(tail, default=None))
    first, last = (None if time is None else time * seconds for time in ends)
    return Extent(stream, file.member.rpartition("/")[2] or file.path.name, first, last)


def _both_ends(file: InputFile) -> tuple[bytes, bytes]:
    """Return the first and the last bytes; of a small file or a member of an archive all of it where that is less."""
    if not file.member:
        with open_regular(file.path) as plain:
            return plain.read(_END), read_end(file.path, _END)
    with opened(source_of(file)) as member:
        content = member.read(LARGEST_UNPACKED_FOR_ITS_END)
    return content[:_END], content[-_END:]


def _cells(lines: Iterable[bytes], place: int) -> Iterable[float]:
    """Return the numbers of one column that can be times."""
    for line in lines:
        values = line.split(b",", place + 1)
        try:
            time = float(values[place])
        except (IndexError, ValueError):
            continue
        if np.isfinite(time) and time >= 0:
            yield time


def json_extent(stream: str, file: InputFile) -> Extent:
    """Return the extent of a JSON or JSON lines file whose frames have a ``timestamp_ns``."""
    head, tail = _both_ends(file)
    first, last = (map(float, _NAMED_TIME.findall(part)) for part in (head, tail))
    return _extent(stream, file, first, last, 1e-9)


_TAIL = 65536  # bytes; longer than any line of the formats that are read


def damage(file: InputFile) -> str:
    """Say in a few words what is wrong with an input file; empty if nothing seems to be.

    Archives, CSV, JSON, JSON lines, HDF5 and pickles are looked at, at their ends alone.
    """
    path = file.path
    try:
        with foreign_input(path):
            if require_size(path, largest=LARGEST_ARCHIVE if file.member else LARGEST_UNPACKED) == 0:
                return "empty"
            if file.member or zipfile.is_zipfile(path) or path.suffix in (".zip", ".npz"):
                # The table of contents stands at the end of a zip file, so a cut one has none.
                try:
                    with zipfile.ZipFile(path) as archive:
                        names = archive.namelist()
                except zipfile.BadZipFile:
                    return "cut off: an archive without table of contents"
                return f"holds no '{file.member}'" if file.member and file.member not in names else ""
            end = read_end(path, _TAIL)
            last = end.splitlines(keepends=True)[-1]
            suffix = path.suffix.lower()
            if suffix == ".csv" and not last.endswith((b"\n", b"\r")):
                with open_regular(path) as lines:
                    columns = lines.readline(LONGEST_LINE).count(b",") + 1
                found = last.count(b",") + 1
                return "" if found == columns else f"cut off: its last line has {found} of {columns} values"
            if suffix == ".json" and not end.rstrip().endswith((b"}", b"]")):
                return "cut off: it does not end with a closing bracket"
            if suffix == ".pkl" and not end.endswith(b"."):
                return "cut off: it does not end with a stop mark"
            if suffix == ".jsonl":
                try:
                    msgspec.json.decode(last)
                except (msgspec.DecodeError, UnicodeDecodeError):
                    return "cut off: its last line is no JSON"
            if suffix in (".hdf5", ".h5"):
                try:
                    h5py.File(path, "r").close()
                except OSError as error:
                    return "cut off" if "truncated" in str(error) else "no HDF5 file"
            return ""
    except InputFileError as error:
        return f"cannot be read ({error.found})"
