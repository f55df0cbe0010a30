"""Which sequences lie below a folder, however the download groups were unpacked.

Source: docs/specification/nymeria.md#folder-tree.
"""

from __future__ import annotations

import os
from pathlib import Path

from prbench.corpora.nymeria import format as nymeria
from prbench.errors import InputFileError
from prbench.readers import SYNTHETIC_PREFIX, InputFile, RecordingFiles, synthetic_tree_around
from prbench.readers.found import input_file
from prbench.readers.synthetic_tree import require_marked

SUIT, SMPL, METADATA, TRAJECTORY, OFFSET = "suit", "smpl", "metadata", "trajectory", "time_offset"
"""Roles of the files; narrations have the role of their kind."""

_ROLES = {
    nymeria.SUIT_FILE: SUIT,
    nymeria.SMPL_FILE: SMPL,
    nymeria.METADATA_FILE: METADATA,
    nymeria.TRAJECTORY_FILE: TRAJECTORY,
    nymeria.OFFSET_FILE: OFFSET,
    **{name: kind for kind, name in nymeria.NARRATION_FILES.items()},
}
_INNER_FOLDERS = ("body", "narration", "mps", "slam", nymeria.HEAD_FOLDER)


def find_sequences(root: Path) -> tuple[RecordingFiles, ...]:
    """All sequences of which a suit, a fit or a text was found.

    A file belongs to the sequence whose name stands in its path, so that trees of one group each (all bodies, all
    narrations) and sequences nested a level deeper are found alike.

    Raises:
        InputFileError: if there is none.
    """
    root = root.expanduser().resolve()
    found: dict[str, dict[str, Path]] = {}
    shared: Path | None = None
    for path in _interesting_files(root):
        role = _ROLES[path.name]
        if role == OFFSET and path.parent == root:
            shared = path
            continue
        if role == TRAJECTORY and nymeria.HEAD_FOLDER not in path.parts:
            continue
        found.setdefault(_sequence_of(path, root), {}).setdefault(role, path)
    wanted = {SUIT, SMPL, *nymeria.NARRATION_FILES}
    sequences = {name: files for name, files in found.items() if wanted & files.keys()}
    if not sequences:
        raise InputFileError(
            root,
            "",
            expected=f"sequence folders with body/{nymeria.SUIT_FILE}",
            found="none",
            remedy="Give the folder that holds <date>_<session>_<name>_<act>_<uid> folders.",
        )
    recordings = tuple(_files(root, name, sequences[name], shared) for name in sorted(sequences))
    require_marked(root, {recording.recording_id: recording.dataset for recording in recordings})
    return recordings


def _interesting_files(root: Path) -> list[Path]:
    """By name, in a fixed order; links to folders are followed, each folder is entered once."""
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
    return paths


def _sequence_of(path: Path, root: Path) -> str:
    """The folder on the way that is named like a sequence, else the one that holds the group's folder."""
    folders = [root.name, *path.relative_to(root).parts[:-1]]
    for name in reversed(folders):
        if nymeria.SEQUENCE_NAME.fullmatch(name):
            return name
    outer = [name for name in folders if name not in _INNER_FOLDERS]
    return outer[-1] if outer else root.name


def _files(root: Path, name: str, files: dict[str, Path], shared: Path | None) -> RecordingFiles:
    if shared is not None:
        files = {OFFSET: shared, **files}
    inputs: list[InputFile] = [input_file(role, files[role]) for role in sorted(files)]
    suit = files.get(SUIT)
    folder = root / name if suit is None else suit.parent.parent
    tree = next(filter(None, (synthetic_tree_around(file.path.parent, root) for file in inputs)), None)
    dataset, splits = ("nymeria", {}) if tree is None else (f"{SYNTHETIC_PREFIX}nymeria", tree.split)
    return RecordingFiles(dataset, name, folder, tuple(inputs), split=splits.get(name))
