"""Find the sequences of Nymeria, however the download groups were unpacked, and read their narrations.

Source: docs/specification/nymeria.md#narrations.
"""

from __future__ import annotations

import os
from pathlib import Path

from prbench.files.bounded import require
from prbench.readers import SYNTHETIC_PREFIX, RecordingFiles, require_marked, synthetic_tree_around
from prbench.readers.files import read_lines, require_column_names
from prbench.readers.found import input_file
from prbench_adapters.corpora.nymeria import format as nymeria
from prbench_adapters.corpora.nymeria.format import Narration

SUIT = "suit"
TRAJECTORY = "trajectory"
OFFSET = "time_offset"  # Roles of the files; narrations have the role of their kind.

_ROLES = {nymeria.SUIT_FILE: SUIT, nymeria.TRAJECTORY_FILE: TRAJECTORY, nymeria.OFFSET_FILE: OFFSET}
_ROLES |= {name: kind for kind, name in nymeria.NARRATION_FILES.items()}
_INNER_FOLDERS = ("body", "narration", "mps", "slam", nymeria.HEAD_FOLDER)


def find_sequences(root: Path) -> tuple[RecordingFiles, ...]:
    """Find all sequences with a suit or a text.

    A file belongs to the sequence whose name stands in its path, so that trees of one group each (all bodies, all
    narrations) and sequences nested a level deeper are found alike.

    Raises:
        InputFileError: if there is none.
    """
    root = root.expanduser().resolve()
    found: dict[str, dict[str, Path]] = {}
    shared: Path | None = None
    # Files of known names in a fixed order; links to folders are followed, and each folder is entered once.
    paths: list[Path] = []
    entered: set[str] = set()
    for folder, inner, names in os.walk(root, followlinks=True):
        real = os.path.realpath(folder)
        if real in entered:
            inner.clear()
            continue
        entered.add(real)
        videos = Path(folder).name.startswith("recording_")
        inner[:] = sorted(name for name in inner if not name.startswith(".") and not (videos and name == "data"))
        # A folder or a dead link that bears a file's name is listed too: reading it says what stands there.
        paths += [Path(folder) / name for name in sorted({*names, *inner} & _ROLES.keys())]
    for path in paths:
        role = _ROLES[path.name]
        if role == OFFSET and path.parent == root:
            shared = path
            continue
        if role == TRAJECTORY and nymeria.HEAD_FOLDER not in path.parts:
            continue
        # The folder on the way that is named like a sequence, else the one that holds the group's folder.
        folders = [root.name, *path.relative_to(root).parts[:-1]]
        named = [name for name in folders if nymeria.SEQUENCE_NAME.fullmatch(name)]
        outer = [root.name, *(name for name in folders if name not in _INNER_FOLDERS)]
        found.setdefault((named or outer)[-1], {}).setdefault(role, path)
    wanted = {SUIT, *nymeria.NARRATION_FILES}
    sequences = {name: files for name, files in found.items() if wanted & files.keys()}
    remedy = "Give the folder that holds <date>_<session>_<name>_<act>_<uid> folders."
    require(root, (sequences, "", f"sequence folders with body/{nymeria.SUIT_FILE}", "none", remedy))
    recordings = []
    for name, files in sorted(sequences.items()):
        files = files if shared is None else {OFFSET: shared, **files}
        inputs = tuple(input_file(role, files[role]) for role in sorted(files))
        folder = files[SUIT].parent.parent if SUIT in files else root / name
        tree = next(filter(None, (synthetic_tree_around(file.path.parent, root) for file in inputs)), None)
        dataset, splits = ("nymeria", {}) if tree is None else (f"{SYNTHETIC_PREFIX}nymeria", tree.split)
        recordings.append(RecordingFiles(dataset, name, folder, inputs, split=splits.get(name)))
    require_marked(root, {recording.recording_id: recording.dataset for recording in recordings})
    return tuple(recordings)


_LONGEST_DURATION = 1000.0  # where every duration is longer, the unit is no second


def read_narrations(path: Path, kind: str) -> tuple[Narration, ...]:
    """Read one narration file, rows in file order.

    Empty answers are kept as empty texts, so that they can be counted; an empty file has no rows.

    Args:
        path: CSV, with or without byte order mark.
        kind: Key of :data:`prbench_adapters.corpora.nymeria.format.NARRATION_FILES`.

    Raises:
        InputFileError: if a time column or every answer column is missing, a time is no number, a line is cut, or the
            times are milliseconds.
    """
    header, rows = read_lines(path, (), "")
    if not header:
        return ()
    lower = [name.lower() for name in header]
    require_column_names(path, lower, (nymeria.START_COLUMN, nymeria.END_COLUMN))
    # Answers are known by the name that follows "Describe my".
    answers = [
        (column, header[column][len(nymeria.ANSWER_PREFIX) :].strip())
        for column, name in enumerate(lower)
        if name.startswith(nymeria.ANSWER_PREFIX)
    ]
    found = f"the columns {', '.join(header)}"
    remedy = "This is another file, or another version of the format."
    require(path, (answers, "header", "a column whose name begins with 'Describe my'", found, remedy))
    narrations = []
    for number, row in rows:
        remedy = "The file may be truncated; download it again."
        require(path, (len(row) >= len(header), f"row {number}", f"{len(header)} cells", len(row), remedy))
        cells = dict(zip(lower, row, strict=False))
        start, end = (_seconds(path, number, cells[name]) for name in (nymeria.START_COLUMN, nymeria.END_COLUMN))
        texts = tuple((name, row[column].strip()) for column, name in answers)
        narrations.append(Narration(kind, start, end, texts, cells.get(nymeria.ANNOTATOR_COLUMN, "").strip()))
    shortest = min((row.end - row.start for row in narrations), default=0.0)
    found = f"{shortest:,.0f} or more from start to end in every row"
    remedy = "These look like milliseconds; divide both columns by 1,000."
    require(path, (shortest <= _LONGEST_DURATION, "start_time, end_time", "seconds", found, remedy))
    return tuple(narrations)


def _seconds(path: Path, number: int, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    finite = abs(value) < float("inf")
    require(path, (finite, f"row {number}", "a time in seconds", f"'{cell}'", "Download the file again."))
    return value
