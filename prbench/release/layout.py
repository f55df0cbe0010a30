"""The layout of the authors' release: folders, numbered arrays, and the entries of ``target_information.json``.

Arrays are read without trust: headers are held against the file's size, and nothing is unpickled.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from prbench.errors import InputFileError
from prbench.files.arrays import first_repeated, load_array
from prbench.files.bounded import foreign_input, require
from prbench.files.storage import inside, read_json
from prbench.limits import HARMLESS_SIZE
from prbench.protocol.manifests import read_toml
from prbench.readers.found import names_in

SYNTHETIC_PREFIX = "synthetic-"
TARGETS = "target_information.json"
MOTIONS = "motions"
GAZES = "gazes"
# Record that our exporter writes beside the targets: the table and its terms.
EXPORT_RECORD = "prbench_export.json"
# The field that tells the number of an entry in a list; entries of the layout's object have their key instead.
SEQUENCE = "sequence"
SUBSET = "subset"
# What the values of the subset mean.
SUBSETS = {
    **dict.fromkeys(("train", "training"), "train"),
    **dict.fromkeys(("test", "testing"), "test"),
    **dict.fromkeys(("val", "valid", "validation"), "validation"),
}
_ENDS = re.compile(r"^\D+|\D+$")
_FOLDERS_DEEP = 2  # an unpacked archive often has a folder around the release


class KnownRelease(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``benchmarks/prime_and_reach/release.toml``, which explains every number."""

    frame_rates: tuple[float, ...]
    frame_rate_tolerance: float
    agreeing_primes: float
    later_primes: float
    lowest_pelvis_to_head: float
    highest_pelvis_to_head: float
    lowest_upright: float
    goal_to_wrist: float
    goal_to_gaze: float
    canonical_position: float
    canonical_yaw_deg: float
    unit_gaze_tolerance: float
    gaze_tolerance: float
    required_fields: tuple[str, ...]
    fields: dict[str, tuple[str, ...]]
    folders: dict[str, str]


@cache
def load_known() -> KnownRelease:
    """Read the constants, once."""
    return read_toml("prbench_benchmarks.prime_and_reach", "release.toml", KnownRelease)


def letters(name: str) -> str:
    """Return a name in lower case, letters and digits only: ``HD-EPIC`` and ``hd_epic`` become equal."""
    return re.sub(r"[^a-z0-9]", "", str(name).lower())


def dataset_of(folder: str) -> str | None:
    """Return the dataset that a folder name means (``HD-EPIC``, ``hd_epic`` …, ``synthetic-adt``), or None."""
    # The prefix is cut off before hyphens go, so that a synthetic copy keeps its own name.
    name = folder.lower()
    prefix = SYNTHETIC_PREFIX if name.startswith(SYNTHETIC_PREFIX) else ""
    wanted = letters(name.removeprefix(prefix))
    return {letters(dataset): prefix + dataset for dataset in load_known().folders}.get(wanted)


def folder_of(dataset: str) -> str:
    """Return the folder name of a dataset; a dataset that is not the study's keeps its own name."""
    return load_known().folders.get(dataset.removeprefix(SYNTHETIC_PREFIX), dataset)


def read_export_record(folder: Path) -> dict[str, Any] | None:
    """Read what our exporter wrote beside the targets; None in a folder that it did not write."""
    if not (folder / EXPORT_RECORD).is_file():
        return None
    record = read_json(folder / EXPORT_RECORD)
    return record if isinstance(record, dict) else None


@foreign_input()
def find_datasets(root: Path, dataset: str | None = None) -> list[tuple[str, Path]]:
    """Find the dataset folders of a release, sorted by name: in the root, else in the folders below it.

    Args:
        root: The release, a folder around it, or the folder of one dataset.
        dataset: Name of the only dataset; a ``root`` of unknown name is taken for this dataset's folder.

    Raises:
        InputFileError: if there is none, or a folder's name leads out of the root.
    """
    require(root, (root.is_dir(), "", "the folder of a release", "no folder", ""))
    if _holds_dataset(root):
        name = _name_of(root.resolve()) or dataset or ""
        wanted = f"a folder of {dataset}" if dataset else "a folder that is named after its dataset"
        remedy = "" if dataset else "Say which it is: --dataset NAME"
        require(root, (name and _is_wanted(name, dataset), "", wanted, root.resolve().name, remedy))
        return [(name, root)]
    level = [root]
    found: list[tuple[str, Path]] = []
    for depth in range(1 + _FOLDERS_DEEP):
        inner = sorted(folder for around in level for folder in around.iterdir() if folder.is_dir())
        # A folder `adt` somewhere below may be anything, such as a built table.
        named = [(_name_of(folder), folder) for folder in inner if depth == 0 or _holds_dataset(folder)]
        found = [(name, folder) for name, folder in named if name is not None and _is_wanted(name, dataset)]
        if found:
            break
        level = [folder for folder in inner if not folder.is_symlink()]
    wanted = f"a folder of {dataset}" if dataset else f"folders {', '.join(load_known().folders.values())}"
    require(root, (found, "", wanted, names_in(root), ""))
    repeated = first_repeated(name for name, _ in found)
    require(root, (repeated is None, str(repeated), "one folder", "two", "Name one of them as ROOT."))
    for _, folder in found:
        inside(root, str(folder.relative_to(root)))
    return found


def _name_of(folder: Path) -> str | None:
    """Return the dataset of a folder; an export of synthetic people says so, whatever its folder is called."""
    name = dataset_of(folder.name)
    stated = (read_export_record(folder) or {}).get("dataset")
    return stated if name is not None and stated == f"{SYNTHETIC_PREFIX}{name}" else name


def _holds_dataset(folder: Path) -> bool:
    return (folder / TARGETS).exists() or (folder / MOTIONS).is_dir()


def _is_wanted(name: str, dataset: str | None) -> bool:
    return dataset in (None, name, name.removeprefix(SYNTHETIC_PREFIX))


def list_files(folder: Path) -> dict[str, dict[int, Path]]:
    """List the arrays of one dataset's folder by kind (``motions`` …) and by the number in their names.

    Raises:
        InputFileError: if two files have one number, or a file leads out of the folder.
    """
    # A link to a file outside could make us print or copy what the user never meant to share.
    for name in (TARGETS, EXPORT_RECORD):
        inside(folder, name)
    found: dict[str, dict[int, Path]] = {MOTIONS: {}, GAZES: {}}
    for name in [name for name in found if (folder / name).is_dir()]:
        inside(folder, name)
        with os.scandir(folder / name) as listed:
            entries = sorted(listed, key=lambda entry: entry.name)
        for entry in entries:
            path = Path(entry.path)
            index = index_of(path.stem)
            # Only links can lead out of the release, so no other path has to be resolved.
            if entry.is_symlink():
                inside(folder, f"{name}/{entry.name}")
            if path.suffix != ".npy" or index is None or not entry.is_file():
                continue
            other = found[name].setdefault(index, path)
            names = f"{other.name} and {entry.name}"
            require(folder / name, (other is path, f"sequence {index}", "one file", names, ""))
    return found


@foreign_input()
def read_targets(path: Path, field_map: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Read ``target_information.json``: the fields of every sequence by its key.

    The layout's form is one object with an object of fields a sequence. A list of such objects, one inside another
    object (``{"sequences": …}``), one a subset (``{"train": …, "test": …}``) and lists of the keys of each subset
    beside the entries say the same, and are read as well. Fields of fields are named ``target.position``.

    Args:
        path: The file.
        field_map: The user's names of fields; ``sequence`` is needed here.

    Raises:
        InputFileError: if it is missing, no JSON, holds no entries of sequences, or two keys mean one sequence.
    """

    def without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            repeated = first_repeated(name for name, _ in pairs)
            raise InputFileError(path, "", expected="every key once in an object", found=f"'{repeated}' twice")
        return found

    content = read_json(path, as_object=without_repeats)
    entries: dict[str, dict[str, Any]] = {}
    key_of: dict[int, str] = {}
    # Keys that are listed stand for entries without fields, and may be spelt otherwise than those with fields.
    for key, subset, fields in sorted(_entries(path, content, field_map), key=lambda entry: not entry[2]):
        index = index_of(key)
        same = key if index is None else key_of.setdefault(index, key)
        entry = entries.setdefault(same, {})
        added = dict(_flat(fields))
        # `seq_12` and `12` name one motion file.
        once = not fields or (same == key and not entry.keys() & added.keys())
        entry |= added
        stated = entry.setdefault(SUBSET, subset) if subset else subset
        require(
            path,
            (once, f"sequence {index}", "one key", f"'{same}' and '{key}'", ""),
            (stated == subset, f"sequence {key}", "one subset", f"'{stated}' and '{subset}'", ""),
        )
    require(path, (entries, "", "one sequence or more", "none", ""))
    return entries


def _entries(
    path: Path, content: Any, field_map: Mapping[str, str], subset: str = ""
) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield key, subset (empty where its place tells none) and fields of every entry; no fields where it is listed."""
    if isinstance(content, list):
        aliases = load_known().fields[SEQUENCE]
        for place, fields in enumerate(content):
            if isinstance(fields, dict):
                named = [each for name, each in fields.items() if letters(name) in aliases]
                key = fields.get(field_map.get(SEQUENCE, ""), named[0] if named else place)
                yield str(key), subset, fields
            elif subset and isinstance(fields, str | int):
                yield str(fields), subset, {}
            else:
                raise _no_entry(path, f"a {type(fields).__name__} in a list")
        return
    if not isinstance(content, dict):
        raise _no_entry(path, f"a {type(content).__name__}")
    for key, value in content.items():
        inner = value if isinstance(value, dict) and index_of(key) is None else {}
        if letters(key) in SUBSETS and isinstance(value, dict | list):
            yield from _entries(path, value, field_map, SUBSETS[letters(key)])
        elif isinstance(value, list) or (inner and _holds_entries(inner)):
            yield from _entries(path, value, field_map, subset)
        elif inner and all(index_of(name) is not None for name in inner):
            for name, each in inner.items():  # one value a sequence, by field
                yield name, subset, {key: each}
        elif isinstance(value, dict):
            yield key, subset, value
        else:
            raise _no_entry(path, f"a {type(value).__name__} under the key '{key}'")


def _holds_entries(content: dict[str, Any]) -> bool:
    """Return True for an object of subsets, or of objects that hold more than a point."""
    if all(letters(name) in SUBSETS for name in content):
        return True
    return all(isinstance(each, dict) and not is_point(each) for each in content.values())


def _no_entry(path: Path, found: str) -> InputFileError:
    by_sequence = "an object with one key a sequence, and an object of its fields under each"
    return InputFileError(path, "", expected=by_sequence, found=found)


def _flat(fields: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the fields of an entry; those of a field that holds fields get its name before theirs."""
    for name, value in fields.items():
        if isinstance(value, dict) and value and not is_point(value):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def is_point(value: Any) -> bool:
    """Return True for three values, in a list or by the names of the axes."""
    return len(value) == 3 and (isinstance(value, list) or sorted(map(str.lower, value)) == ["x", "y", "z"])


def index_of(key: str) -> int | None:
    """Return the number of a sequence key or file name (``motions/0000000012.npy``, ``seq_12``, ``12``), or None."""
    digits = _ENDS.sub("", re.split(r"[/\\]", key.strip())[-1].removesuffix(".npy"))
    # isdigit alone also accepts superscripts and other scripts; 18 digits still fit into 64 bits.
    return int(digits) if digits.isascii() and digits.isdigit() and len(digits) <= 18 else None


@foreign_input()
def read_array(path: Path, per_frame: tuple[int, ...]) -> np.ndarray:
    """Read the array (N, *per_frame) of a ``.npy`` file in single or double precision, as it stands there.

    Raises:
        InputFileError: if this is no ``.npy`` file, holds objects, is truncated, or has another shape or other
            numbers.
    """
    remedy = "Copy or download the file again."
    array = load_array(path, largest=HARMLESS_SIZE, remedy=remedy)
    wanted = ", ".join(("N", *map(str, per_frame)))
    require(
        path,
        # Either byte order is accepted, so the comparison must not see it.
        (array.dtype.newbyteorder("=") in (np.float32, np.float64), "", "float32 or float64", array.dtype, remedy),
        (array.ndim and array.shape[1:] == per_frame, "", f"shape ({wanted})", array.shape, remedy),
    )
    return array
