"""Find plain recordings and read their tables, checked, in their own units and axes (docs/own-recordings.md)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool, Float

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files.arrays import open_parquet
from prbench.files.bounded import read_toml, require, require_rows, structured
from prbench.readers import read_synthetic_tree
from prbench.readers.extents import SEVERAL_SENSORS, Extent
from prbench.readers.files import read_columns, read_header, read_lines
from prbench.readers.found import RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.readers.own import format as own
from prbench.recording import Recording

_PAGE = "docs/own-recordings.md lists tables and columns."
_LENGTH_TOLERANCE = 0.01
_GAZE = ("dx", "dy", "dz")
_EMPTY = "Leave the cells of a row empty where nothing was measured."


@dataclass(frozen=True)
class Table:
    """The known columns of one table, one value a row.

    Attributes:
        columns: Numbers (NaN: nothing measured) or texts, by the column's name.
    """

    path: Path
    columns: Mapping[str, np.ndarray]

    def vectors(self, names: Sequence[str]) -> Float[np.ndarray, "n k"]:
        """Return some columns of numbers side by side."""
        return np.column_stack([self.columns[name] for name in names])

    def measured(self, names: Sequence[str]) -> Bool[np.ndarray, " n"]:
        """Return the rows that hold all of some numbers."""
        return ~np.isnan(self.vectors(names)).any(axis=1)

    def refuse(
        self, bad: Bool[np.ndarray, " n"], column: str, expected: str, found: Callable[[int], object], remedy: str = ""
    ) -> None:
        """Refuse the table at its first bad row.

        Raises:
            InputFileError: naming the row; ``found`` gets its index.
        """
        place, first = numbering(self.path)
        about = {"place": place, "first": first, "column": column, "remedy": remedy}
        require_rows(self.path, bad, expected, lambda row: str(found(row)), **about)


@dataclass(frozen=True)
class Readings:
    """The content of one recording's files.

    Attributes:
        tables: The tables that are there, by name; without events.
        events: Texts by column of each event, by the row's place in its file.
    """

    about: own.About
    tables: Mapping[str, Table]
    events_file: Path
    events: Mapping[str, Mapping[str, str]]


def find_recordings(root: Path | str, dataset: str) -> tuple[RecordingFiles, ...]:
    """List the recordings below a folder, or the one that it is.

    A folder that holds tables without ``recording.toml``, beside others that have it, is one that lacks it.

    Args:
        root: Folder of the recordings.
        dataset: Name that the recordings carry.

    Raises:
        InputFileError: if there is no ``recording.toml``.
    """
    root = existing_folder(root, "a folder of plain recordings")
    is_one = is_present(root / own.ABOUT_FILE)
    folders = [root] if is_one else [path for path in sorted(root.iterdir()) if path.is_dir()]
    has_one = any(is_present(folder / own.ABOUT_FILE) for folder in folders)
    expected = f"{own.ABOUT_FILE} here, or in each folder below"
    require(root, (has_one, "", expected, names_in(root), f"Write one a recording: {_PAGE}"))
    tree = read_synthetic_tree(root)
    dataset, split = (dataset, {}) if tree is None else (f"{SYNTHETIC_PREFIX}{dataset}", tree.split)
    names = (own.ABOUT_FILE, *(f"{table}{suffix}" for table in own.TABLES for suffix in own.SUFFIXES))
    found = []
    for folder in folders:
        files = tuple(input_file(name, folder / name) for name in names if is_present(folder / name))
        if files:
            found.append(RecordingFiles(dataset, folder.name, folder, files, split=split.get(folder.name)))
    return tuple(found)


def read_about(found: RecordingFiles) -> own.About:
    """Read ``recording.toml``.

    Raises:
        InputFileError: if it is missing, or a key is missing, unknown or has another value.
    """
    path = found.require(own.ABOUT_FILE, own.ABOUT_FILE)
    about = structured(path, read_toml(path, "a recording's TOML file", _PAGE), own.About)
    head = about.head
    source = about.body.source
    fps = 1.0 if about.video is None else about.video.fps
    turned = f"'{head.forward}' and '{head.up}'"
    require(
        path,
        (about.participant.strip() != "", "participant", "the name of the person", "an empty one", ""),
        (head.forward[-1] != head.up[-1], "head", "two axes at a right angle", turned, ""),
        (0 < fps < np.inf, "video.fps", "a number above 0", f"{fps:g}", ""),
        (own.SOURCE.fullmatch(source), "body.source", "small letters, digits and hyphens", f"'{source}'", ""),
    )
    try:
        about.body.map  # noqa: B018 - raises for an unknown skeleton
    except UsageError as error:
        raise InputFileError(path, "body.skeleton", expected="a known skeleton", found=str(error)) from error
    return about


def read_readings(found: RecordingFiles) -> Readings:
    """Read one recording.

    Raises:
        InputFileError: for a missing column, a row that cannot be, or two files of one table.
    """
    about = read_about(found)
    paths: dict[str, Path] = {}
    for path in (file.path for file in found.files if file.role != own.ABOUT_FILE):
        earlier = paths.setdefault(path.stem, path)
        remedy = "Remove the one that is out of date."
        require(path, (earlier == path, "", "one file a table", f"{earlier.name} beside it", remedy))
    events = _read_events(paths["events"], about) if "events" in paths else {}
    tables = {name: _read_table(path, name, about) for name, path in paths.items() if name != "events"}
    return Readings(about, tables, paths.get("events", found.folder), events)


def numbering(path: Path) -> tuple[str, int]:
    """Return what a row of a table is called in messages, and the number of the first one."""
    return ("line", 2) if path.suffix == ".csv" else ("row", 1)


def _known_columns(path: Path, name: str, about: own.About) -> tuple[str, ...]:
    """Return the known columns of a table; refuse one that lacks some, or contradicts what is stated."""
    columns = own.columns_of(name, about)
    header = read_header(path) if path.suffix == ".csv" else _opened(path).schema_arrow.names
    begun = [group for group in columns.optional if any(column in header for column in group)]
    wanted = (*columns.required, *(column for group in begun for column in group))
    joints = f", a joint of the skeleton '{about.body.skeleton}'" if name == "body" else ""
    found = f"the columns {', '.join(header)}"
    for column in wanted:
        remedy = f"{did_you_mean(column, header)} {_PAGE}".strip()
        require(path, (column in header, "header", f"a column '{column}'{joints}", found, remedy))
    # Four names say which number is which; an order that says otherwise is a mistake in one of the two.
    order = [column for column in header if column in own.QUATERNION]
    stated = [f"q{letter}" for letter in about.axes.quaternion]
    expected = f"{', '.join(stated)}, as axes.quaternion in {own.ABOUT_FILE} says"
    remedy = "Name the columns after what they hold, or correct the key."
    require(path, (len(order) < 4 or order == stated, "header", expected, ", ".join(order), remedy))
    return wanted


def _opened(path: Path) -> pq.ParquetFile:
    try:
        return open_parquet(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputFileError(path, "", expected="a Parquet file", found=str(error)) from error


def _cells(path: Path, columns: Sequence[str], texts: Collection[str] = own.TEXTS) -> dict[str, np.ndarray]:
    """Read some columns: numbers, NaN where there is none, and texts."""
    if path.suffix == ".csv":
        table = read_columns(path, {column: str if column in texts else float for column in columns})
        return {column: table[column].to_numpy() for column in columns}
    read = {}
    with _opened(path) as file:
        for column in columns:
            values = file.read([column])[column]
            try:
                values = values.cast(pa.string() if column in texts else pa.float64(), safe=False)
            except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
                expected = "texts" if column in texts else f"numbers in the units of {own.ABOUT_FILE}"
                raise InputFileError(path, f"column '{column}'", expected=expected, found=str(error)) from error
            read[column] = (values.fill_null("") if column in texts else values).to_numpy()
    return read


def _read_events(path: Path, about: own.About) -> dict[str, dict[str, str]]:
    """Read the rows of the events as texts, so that an odd one loses itself alone."""
    columns = _known_columns(path, "events", about)
    timed = "time" in columns or ("frame" in columns and about.video is not None)
    expected = f"a column 'time', or 'frame' and [video] in {own.ABOUT_FILE}"
    require(path, (timed, "header", expected, f"the columns {', '.join(columns)}", _PAGE))
    if path.suffix == ".csv":
        header, lines = read_lines(path, columns, _PAGE)
        rows = {f"line {line}": dict(zip(header, cells, strict=False)) for line, cells in lines}
        return {key: {column: row.get(column, "") for column in columns} for key, row in rows.items()}
    cells = zip(*_cells(path, columns, columns).values(), strict=True)
    return {f"row {row}": dict(zip(columns, texts, strict=True)) for row, texts in enumerate(cells, start=1)}


def _read_table(path: Path, name: str, about: own.About) -> Table:
    """Read one table; refuse it for whatever one table alone can tell."""
    table = Table(path, _cells(path, _known_columns(path, name, about)))
    cells = table.columns
    # What belongs together is there whole or not at all; joints may be missing one by one.
    columns = own.columns_of(name, about)
    for group in (columns.required, *columns.optional):
        numbers = [column for column in group if column in cells and column not in {"time", *own.TEXTS}]
        values = table.vectors(numbers) if numbers else np.zeros((0, 0))
        empty = np.isnan(values)
        odd = np.isinf(values).any(axis=1) | (empty.any(axis=1) & ~empty.all(axis=1) & (name != "body"))
        table.refuse(odd, "", f"finite numbers in {', '.join(numbers[:7])}", values.__getitem__, _EMPTY)
    for names in (own.QUATERNION, _GAZE):
        if set(names) <= set(cells):
            length = np.linalg.norm(table.vectors(names), axis=1)
            remedy = "Divide a direction by its length; a point that is looked at is no direction." * (names == _GAZE)
            wrong = np.abs(length - 1) > _LENGTH_TOLERANCE
            table.refuse(wrong, "", f"a length of 1 of {', '.join(names)}", length.round(4).__getitem__, remedy)
    for column, allowed in own.WORDS.items():
        if column in cells:
            bad = np.array([text.lower() not in allowed for text in cells[column]], dtype=bool)
            table.refuse(bad, column, f"one of {', '.join(allowed)}", cells[column].__getitem__)
    if "object_id" in cells:
        bad = np.array([text.strip() == "" or "/" in text for text in cells["object_id"]], dtype=bool)
        table.refuse(bad, "object_id", "a name without '/'", cells["object_id"].__getitem__)
    if "time" in cells:
        # Each object and each hand has a clock of its own, whatever the order of the rows.
        times = cells["time"]
        table.refuse(~np.isfinite(times), "time", "a time", times.__getitem__)
        ids = cells.get("object_id", cells.get("side", np.zeros(len(times)))).astype(str)
        order = np.argsort(ids, kind="stable")
        follows = np.append(False, ids[order][1:] == ids[order][:-1])
        before = np.empty(len(times))
        before[order] = np.where(follows, np.append(-np.inf, times[order][:-1]), -np.inf)
        remedy = "Sort the rows by time, and remove repeated ones."
        found = lambda row: f"{times[row]:.6f} after {before[row]:.6f}"  # noqa: E731 - one message
        table.refuse(times <= before, "time", "times that increase", found, remedy)
    return table


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """Return the streams of one recording that last as long as it does; objects and hands may be out of sight."""
    seconds = own.TIME_UNITS[read_about(found).units.time]
    ends = []
    for file in found.files:
        if file.path.stem in ("head", "gaze", "body"):
            times = _cells(file.path, ["time"])["time"] * seconds
            span = (float(times[0]), float(times[-1])) if len(times) else (None, None)
            about = {"may_start_late": True, "slack": SEVERAL_SENSORS}
            ends.append(Extent(file.path.stem, file.path.name, *span, **about))
    return tuple(ends)
