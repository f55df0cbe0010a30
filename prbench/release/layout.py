"""The files of a release: a folder for each dataset, with one JSON file and arrays numbered by sequence."""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, read_text
from prbench.limits import LARGEST_JSON
from prbench.readers.found import names_in
from prbench.release.known import dataset_of

TARGETS = "target_information.json"
MOTIONS = "motions"
GAZES = "gazes"
FURTHER = "further"
"""Folder that only this toolkit writes: arrays that the layout has no place for."""
EXPORT_RECORD = "prbench_export.json"
"""Record that our exporter writes beside the targets: the table and its terms."""

_ENDS = re.compile(r"^\D+|\D+$")


@dataclass(frozen=True)
class DatasetFiles:
    """The files of one dataset's folder."""

    folder: Path
    motions: dict[int, Path]
    gazes: dict[int, Path]
    further: dict[int, Path]
    unused_names: tuple[str, ...]
    """Names in the folders of arrays that are no array of a sequence."""


@foreign_input()
def find_datasets(root: Path, dataset: str | None = None) -> list[tuple[str, Path]]:
    """Find the dataset folders of a release, sorted by name.

    Args:
        root: The release, or the folder of one dataset.
        dataset: Name of the only dataset; a ``root`` of unknown name is taken for this dataset's folder.

    Raises:
        InputFileError: if there is none, or a folder's name leads out of the root.
    """
    if not root.is_dir():
        raise InputFileError(root, "", expected="the folder of a release", found="no folder")
    if (root / TARGETS).exists() or (root / MOTIONS).is_dir():
        own_name = dataset_of(root.resolve().name)
        name = dataset or own_name
        if name is None or own_name not in (None, name):
            raise InputFileError(
                root,
                "",
                expected=f"a folder of {dataset}" if dataset else "a folder that is named after its dataset",
                found=root.resolve().name,
                remedy="" if dataset else "Say which it is: --dataset NAME",
            )
        return [(name, root)]
    found = []
    for folder in sorted(root.iterdir()):
        name = dataset_of(folder.name)
        if folder.is_dir() and name is not None and dataset in (None, name):
            _require_inside(root, folder)
            found.append((name, folder))
    if not found:
        wanted = f"a folder of {dataset}" if dataset else "folders HD-EPIC, MoGaze, HOT3D, ADT or GIMO"
        raise InputFileError(root, "", expected=wanted, found=names_in(root))
    return found


def list_files(folder: Path) -> DatasetFiles:
    """List the arrays of one dataset's folder by the number in their names.

    Raises:
        InputFileError: if two files have one number, or a file leads out of the folder.
    """
    # A link to a file outside could make us print or copy what the user never meant to share.
    for name in (TARGETS, EXPORT_RECORD):
        _require_inside(folder, folder / name)
    found: dict[str, dict[int, Path]] = {MOTIONS: {}, GAZES: {}, FURTHER: {}}
    unused_names = []
    for name in [name for name in found if (folder / name).is_dir()]:
        _require_inside(folder, folder / name)
        with os.scandir(folder / name) as listed:
            entries = sorted(listed, key=lambda entry: entry.name)
        for entry in entries:
            path = Path(entry.path)
            index = index_of(path.stem)
            # Only links can lead out of the release, so no other path has to be resolved.
            if entry.is_symlink():
                _require_inside(folder, path)
            if path.suffix != (".npz" if name == FURTHER else ".npy") or index is None or not entry.is_file():
                unused_names.append(f"{name}/{entry.name}")
                continue
            other = found[name].setdefault(index, path)
            if other is not path:
                names = f"{other.name} and {entry.name}"
                raise InputFileError(folder / name, f"sequence {index}", expected="one file", found=names)
    return DatasetFiles(folder, found[MOTIONS], found[GAZES], found[FURTHER], tuple(unused_names))


@foreign_input()
def read_targets(path: Path) -> dict[str, dict[str, Any]]:
    """Read ``target_information.json``: the fields of every sequence by its key.

    Raises:
        InputFileError: if it is missing, no JSON, no object by sequence, or two keys mean one sequence.
    """
    try:
        content = json.loads(read_text(path, largest=LARGEST_JSON), object_pairs_hook=_without_repeats)
    except FileNotFoundError as error:
        raise InputFileError(path, "", expected="a JSON file", found="no file") from error
    except RecursionError as error:
        raise InputFileError(path, "", expected="entries of sequences", found="thousands of nested lists") from error
    except (ValueError, OSError) as error:  # JSONDecodeError and UnicodeDecodeError are ValueErrors
        remedy = "The file may be truncated; copy or download it again."
        raise InputFileError(path, "", expected="valid JSON", found=str(error), remedy=remedy) from error
    by_sequence = "an object with one key a sequence, and an object of its fields under each"
    if not isinstance(content, dict):
        raise InputFileError(path, "", expected=by_sequence, found=f"a {type(content).__name__}")
    if not content:
        raise InputFileError(path, "", expected="one sequence or more", found="none")
    first: dict[int, str] = {}
    for key, fields in content.items():
        if not isinstance(fields, dict):
            found = f"a {type(fields).__name__} under the key '{key}'"
            raise InputFileError(path, "", expected=by_sequence, found=found)
        index = index_of(key)
        # `seq_12` and `12` name one motion file.
        if index is not None and first.setdefault(index, key) != key:
            raise InputFileError(path, f"sequence {index}", expected="one key", found=f"'{first[index]}' and '{key}'")
    return content


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        names = [name for name, _ in pairs]
        repeated = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key '{repeated}' twice in one object")
    return found


def index_of(key: str) -> int | None:
    """Return the number of a sequence key or file name (``motions/0000000012.npy``, ``seq_12``, ``12``), or None."""
    name = re.split(r"[/\\]", key.strip())[-1].removesuffix(".npy")
    digits = _ENDS.sub("", name)
    # isdigit alone also accepts superscripts and other scripts; 18 digits still fit into 64 bits.
    return int(digits) if digits.isascii() and digits.isdigit() and len(digits) <= 18 else None


def _require_inside(root: Path, path: Path) -> None:
    if not path.resolve().is_relative_to(root.resolve()):
        raise InputFileError(
            path,
            "",
            expected="a path inside the release",
            found="a link that leads out of it",
            remedy="Copy what it points to into the release.",
        )
