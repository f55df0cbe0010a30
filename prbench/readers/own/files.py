"""Find plain recordings and read their tables, checked, in their own units and axes (docs/own-recordings.md)."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from jaxtyping import Float

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError, did_you_mean
from prbench.files.arrays import open_parquet
from prbench.files.bounded import read_toml, require, require_rows, structured
from prbench.readers import read_synthetic_tree
from prbench.readers.files import read_columns, read_header, read_lines
from prbench.readers.found import RecordingFiles, existing_folder, input_file, is_present, names_in
from prbench.readers.own import format as own
from prbench.readers.three_point import find_body

_PAGE = "docs/own-recordings.md lists tables and columns."
_LENGTH_TOLERANCE = 0.01
_EMPTY = "Leave all of them empty where nothing was measured."
_SORT = "Sort the rows by time, and remove repeated ones."
_DIRECTION = "Divide a direction by its length; a point that is looked at is no direction."


@dataclass(frozen=True)
class Table:
    """The known columns of one table, one value a row.

    Attributes:
        columns: Numbers or texts, by the column's name; NaN in joints and boxes that are not known.
    """

    path: Path
    columns: Mapping[str, np.ndarray]

    def vectors(self, names: Sequence[str]) -> Float[np.ndarray, "n k"]:
        """Return some columns of numbers side by side."""
        return np.column_stack([self.columns[name] for name in names])


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
        if files := tuple(input_file(name, folder / name) for name in names if is_present(folder / name)):
            files += find_body(root, folder.name)
            found.append(RecordingFiles(dataset, folder.name, folder, files, split=split.get(folder.name)))
    return tuple(found)


def read_about(found: RecordingFiles) -> own.About:
    """Read ``recording.toml``.

    Raises:
        InputFileError: if it is missing, or a key is missing, unknown or has another value.
    """
    path = found.require(own.ABOUT_FILE, own.ABOUT_FILE)
    return structured(path, read_toml(path, "a recording's TOML file", _PAGE), own.About, remedy=_PAGE)


def read_readings(found: RecordingFiles, about: own.About | None = None) -> Readings:
    """Read one recording.

    Args:
        found: Its files; a role is the name that a file has in a recording.
        about: Units and axes, where no ``recording.toml`` tells them.

    Raises:
        InputFileError: for a missing column, a row that cannot be, or two files of one table.
    """
    about = about or read_about(found)
    paths: dict[str, Path] = {}
    for role, path in ((file.role, file.path) for file in found.files if Path(file.role).stem in own.TABLES):
        earlier = paths.setdefault(Path(role).stem, path)
        remedy = "Remove the one that is out of date."
        require(path, (earlier == path, "", "one file a table", f"{earlier.name} beside it", remedy))
    events = _read_events(paths["events"], about) if "events" in paths else {}
    tables = {name: _read_table(path, name, about) for name, path in paths.items() if name != "events"}
    return Readings(about, tables, paths.get("events", found.folder), events)


def _known_columns(path: Path, name: str, about: own.About) -> tuple[str, ...]:
    """Return the known columns of a table; refuse one that lacks some, or contradicts what is stated."""
    required, *optional = own.columns_of(name, about)
    header = read_names(path)
    begun = [group for group in optional if any(column in header for column in group)]
    wanted = (*required, *(column for group in begun for column in group))
    skeleton = f" (skeleton '{about.body.skeleton}')" if name == "body" else ""
    found = f"the columns {', '.join(header)}"
    for column in wanted:
        remedy = f"{did_you_mean(column, header)} {_PAGE}".strip()
        require(path, (column in header, "header", f"a column '{column}'{skeleton}", found, remedy))
    # Four names say which number is which; an order that says otherwise is a mistake in one of the two.
    order = [column for column in header if column in own.QUATERNION]
    stated = [f"q{letter}" for letter in about.axes.quaternion]
    expected = f"{', '.join(stated)}, as axes.quaternion in {own.ABOUT_FILE} says"
    remedy = "Name the columns after what they hold, or correct the key."
    require(path, (len(order) < 4 or order == stated, "header", expected, ", ".join(order), remedy))
    return wanted


def read_names(path: Path) -> list[str]:
    """Return the names of a table's columns."""
    return read_header(path) if path.suffix == ".csv" else list(_read_parquet(path, {}))


def _read_parquet(path: Path, kinds: Mapping[str, type]) -> dict[str, np.ndarray]:
    """Read columns of a Parquet file as numbers or texts; without kinds the names of all columns alone."""
    where = ""
    try:
        with open_parquet(path) as file:
            read = dict.fromkeys([] if kinds else file.schema_arrow.names, np.zeros(0))
            for column, kind in kinds.items():
                where = f"column '{column}'"
                cells = file.read([column])[column].cast(pa.float64() if kind is float else pa.string(), safe=False)
                read[column] = (cells if kind is float else cells.fill_null("")).to_numpy()
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError) as error:
        expected = f"a Parquet file of texts, and of numbers in the units of {own.ABOUT_FILE}"
        raise InputFileError(path, where, expected=expected, found=str(error)) from error
    return read


def read_cells(path: Path, columns: Sequence[str], texts: Collection[str] = own.TEXTS) -> dict[str, np.ndarray]:
    """Read some columns: numbers, NaN where there is none, and texts."""
    kinds: dict[str, type] = {column: str if column in texts else float for column in columns}
    if path.suffix != ".csv":
        return _read_parquet(path, kinds)
    table = read_columns(path, kinds)
    return {column: table[column].to_numpy() for column in columns}


def _read_events(path: Path, about: own.About) -> dict[str, dict[str, str]]:
    """Read the rows of the events as texts, so that an odd one loses itself alone."""
    columns = _known_columns(path, "events", about)
    timed = "time" in columns or ("frame" in columns and about.video is not None)
    expected = f"a column 'time', or 'frame' and [video] in {own.ABOUT_FILE}"
    require(path, (timed, "header", expected, f"the columns {', '.join(columns)}", _PAGE))
    if path.suffix == ".csv":
        header, lines = read_lines(path, columns, _PAGE)
        return {f"line {line}": dict(zip(header, cells, strict=False)) for line, cells in lines}
    cells = zip(*read_cells(path, columns, columns).values(), strict=True)
    return {f"row {row}": dict(zip(columns, texts, strict=True)) for row, texts in enumerate(cells, start=1)}


def _read_table(path: Path, name: str, about: own.About) -> Table:
    """Read the rows of one table in which something was measured; refuse it for whatever one table alone can tell."""
    cells = read_cells(path, _known_columns(path, name, about))
    place, first = ("line", 2) if path.suffix == ".csv" else ("row", 1)
    refuse = partial(require_rows, path, place=place, first=first)
    numbers = [column for column in cells if column not in {"time", *own.TEXTS}]
    values = np.column_stack([np.zeros((len(next(iter(cells.values()))), 0)), *(cells[column] for column in numbers)])
    empty = np.isnan(values)
    # A row is there whole or not at all; joints may be missing one by one.
    odd = np.isinf(values).any(axis=1) | (empty.any(axis=1) & ~empty.all(axis=1) & (name != "body"))
    refuse(odd, f"finite numbers in {', '.join(numbers[:7])}", lambda row: str(values[row, :7]), remedy=_EMPTY)
    for names, remedy in ((own.QUATERNION, ""), (own.GAZE, _DIRECTION)):
        if set(names) <= set(cells):
            length = np.linalg.norm(np.stack([cells[column] for column in names]), axis=0)
            wrong = np.abs(length - 1) > _LENGTH_TOLERANCE
            expected = f"a length of 1 of {', '.join(names)}"
            refuse(wrong, expected, length.round(4).astype(str).__getitem__, remedy=remedy)
    for column, allowed in own.WORDS.items():
        texts = np.array(cells.get(column, []), dtype=object)
        bad = np.array([not re.fullmatch(allowed, text, re.IGNORECASE) for text in texts], dtype=bool)
        refuse(bad, f"a text of the form {allowed}", texts.__getitem__, column=column)
    if "time" in cells:
        # Each object and each hand has a clock of its own, whatever the order of the rows.
        times = cells["time"]
        clock = cells.get("object_id", cells.get("side", np.zeros(len(times))))
        before = pd.Series(times).groupby(clock).shift(fill_value=-np.inf).to_numpy()
        found = lambda row: f"{times[row]} after {before[row]}"  # noqa: E731 - two columns
        refuse(~(times > before), "times that increase", found, column="time", remedy=_SORT)
    measured = ~empty.all(axis=1) | (len(numbers) == 0) | (name == "objects")
    return Table(path, {column: values[measured] for column, values in cells.items()})
