"""The layout of the authors' release: files, names of fields, arrays, our own block, and what the authors state.

Arrays are read without trust: headers are held against the file's size, and nothing is unpickled. The ``prbench`` block
of an entry holds the columns of a sequence for which the layout has no field; other tools pass over it. Together with
the layout's own fields and the arrays of ``further/`` it holds every column of the sequence table, so that a table
comes back unchanged.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pyarrow as pa

from prbench.errors import InputFileError
from prbench.files.arrays import Archive, read_header
from prbench.files.bounded import foreign_input, read_text, read_whole
from prbench.limits import HARMLESS_SIZE, LARGEST_JSON
from prbench.protocol.manifests import read_toml
from prbench.readers.found import names_in
from prbench.sequences.schema import is_bulky
from prbench.sequences.sequence import SEQUENCES

SYNTHETIC_PREFIX = "synthetic-"


class KnownDataset(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One dataset of the study: its folder, and its sequences of each split."""

    folder: str
    train: int
    test: int


class KnownRelease(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``benchmarks/prime_and_reach/release.toml``, which explains every number."""

    frame_rates: tuple[float, ...]
    frame_rate_tolerance: float
    agreeing_primes: float
    lowest_pelvis_to_head: float
    highest_pelvis_to_head: float
    goal_to_wrist: float
    canonical_position: float
    canonical_yaw_deg: float
    unit_gaze_tolerance: float
    gaze_tolerance: float
    required_fields: tuple[str, ...]
    fields: dict[str, tuple[str, ...]]
    datasets: dict[str, KnownDataset]


@cache
def load_known() -> KnownRelease:
    """Read the constants, once."""
    return read_toml("prbench_benchmarks.prime_and_reach", "release.toml", KnownRelease)


def dataset_of(folder: str) -> str | None:
    """Return the dataset that a folder name means (``HD-EPIC``, ``hd_epic`` …, ``synthetic-adt``), or None."""
    # The prefix is cut off before hyphens go, so that a synthetic copy keeps its own name.
    name = folder.lower()
    prefix = SYNTHETIC_PREFIX if name.startswith(SYNTHETIC_PREFIX) else ""
    wanted = letters(name.removeprefix(prefix))
    for dataset in load_known().datasets:
        if letters(dataset) == wanted:
            return prefix + dataset
    return None


def folder_of(dataset: str) -> str:
    """Return the folder name of a dataset; a dataset that is not the study's keeps its own name."""
    known = load_known().datasets.get(dataset)
    return dataset if known is None else known.folder


def letters(name: str) -> str:
    """Return a name in lower case, letters and digits only: ``HD-EPIC`` and ``hd_epic`` become equal."""
    return re.sub(r"[^a-z0-9]", "", str(name).lower())


TARGETS = "target_information.json"
MOTIONS = "motions"
GAZES = "gazes"
# Folder that only this toolkit writes: arrays that the layout has no place for.
FURTHER = "further"
# Record that our exporter writes beside the targets: the table and its terms.
EXPORT_RECORD = "prbench_export.json"

_ENDS = re.compile(r"^\D+|\D+$")


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


def list_files(folder: Path) -> dict[str, dict[int, Path]]:
    """List the arrays of one dataset's folder by kind (``motions`` …) and by the number in their names.

    Raises:
        InputFileError: if two files have one number, or a file leads out of the folder.
    """
    # A link to a file outside could make us print or copy what the user never meant to share.
    for name in (TARGETS, EXPORT_RECORD):
        _require_inside(folder, folder / name)
    found: dict[str, dict[int, Path]] = {MOTIONS: {}, GAZES: {}, FURTHER: {}}
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
                continue
            other = found[name].setdefault(index, path)
            if other is not path:
                names = f"{other.name} and {entry.name}"
                raise InputFileError(folder / name, f"sequence {index}", expected="one file", found=names)
    return found


@foreign_input()
def read_targets(path: Path) -> dict[str, dict[str, Any]]:
    """Read ``target_information.json``: the fields of every sequence by its key.

    Raises:
        InputFileError: if it is missing, no JSON, no object by sequence, or two keys mean one sequence.
    """

    def without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) != len(pairs):
            names = [name for name, _ in pairs]
            repeated = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"the key '{repeated}' twice in one object")
        return found

    try:
        content = json.loads(read_text(path, largest=LARGEST_JSON), object_pairs_hook=without_repeats)
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


# Columns for whose arrays the authors' layout has no place, and their shapes; -1 is the number of frames.
FURTHER_ARRAYS = {
    "previous_joints": (22, 3),
    "next_joints": (22, 3),
    "gaze_origin": (-1, 3),
    "gaze_direction": (-1, 3),
    "gaze_valid": (-1,),
    "head_position": (-1, 3),
    "head_rotation": (-1, 4),
}
_HEAD = ("head_position", "head_rotation")  # both or none
_REMEDY = "Copy or download the file again."


@foreign_input()
def read_array(path: Path, per_frame: tuple[int, ...]) -> tuple[np.ndarray, bytes]:
    """Read the array (N, *per_frame) of a ``.npy`` file in single or double precision.

    Returns:
        The array as it stands in the file, and the bytes of the file.

    Raises:
        InputFileError: if this is no ``.npy`` file, holds objects, is truncated, or has another shape or other
            numbers.
    """
    content = read_whole(path, largest=HARMLESS_SIZE)
    header = read_header(io.BytesIO(content), path, "", remedy=_REMEDY)
    wanted = ", ".join(("N", *map(str, per_frame)))
    for expected, found, right in (
        (f"{header.offset + header.nbytes} bytes for shape {header.shape}", str(len(content)),
         len(content) == header.offset + header.nbytes),
        # Either byte order is accepted, so the comparison must not see it.
        ("float32 or float64", str(header.dtype), header.dtype.newbyteorder("=") in (np.float32, np.float64)),
        (f"shape ({wanted})", str(header.shape), len(header.shape) > 0 and header.shape[1:] == per_frame),
    ):  # fmt: skip
        if not right:
            raise InputFileError(path, "", expected=expected, found=found, remedy=_REMEDY)
    return header.shaped(np.frombuffer(content, header.dtype, math.prod(header.shape), header.offset)), content


@foreign_input()
def read_further(path: Path, n_frames: int) -> tuple[dict[str, np.ndarray], bytes]:
    """Read the arrays of a ``.npz`` that an export wrote, without trusting it.

    Returns:
        The arrays by name, and the bytes of the file.

    Raises:
        InputFileError: if it is damaged, compressed, holds objects, or belongs to a motion of another length.
    """
    content = read_whole(path, largest=HARMLESS_SIZE)
    archive = Archive(path, content)
    # Our exporter never compresses; a compressed member may unpack to any size.
    if not all(map(archive.stored_as_is, archive.members)):
        raise InputFileError(path, "", expected="arrays without compression", found="compressed ones")
    arrays = archive.load(tuple(FURTHER_ARRAYS))
    shapes = {name: tuple(n_frames if size < 0 else size for size in shape) for name, shape in FURTHER_ARRAYS.items()}
    whole = set(FURTHER_ARRAYS) - set(arrays) in (set(), set(_HEAD))
    fits = all(
        values.shape == shapes[name] and values.dtype.kind in "fb" and np.isfinite(values).all()
        for name, values in arrays.items()
    )
    if not (whole and fits):
        raise InputFileError(
            path, "", expected="the arrays of this sequence", found="others", remedy="Export it again."
        )
    return arrays, content


_IN_THE_LAYOUT = ("dataset", "split", "fps", "prime_frame", "goal_location")
BLOCK_COLUMNS = [each for each in SEQUENCES if not is_bulky(each.type) and each.name not in _IN_THE_LAYOUT]
_JSON = {pa.string(): str, pa.float64(): float, pa.int32(): int}


_TYPES: dict[str, Any] = {}
for _column in BLOCK_COLUMNS:
    if pa.types.is_fixed_size_list(_column.type):
        _size = msgspec.Meta(min_length=_column.type.list_size, max_length=_column.type.list_size)
        _TYPES[_column.name] = Annotated[list[float], _size]
    elif _column.nullable or _column.name == "prime_time_uncertainty":  # JSON has no NaN, so None stands for it
        _TYPES[_column.name] = _JSON[_column.type] | None
    else:
        _TYPES[_column.name] = _JSON[_column.type]
_Block = msgspec.defstruct(
    "_Block",
    [
        *_TYPES.items(),
        ("extra", dict[str, str]),
        ("event_id", str),
        ("motion_frame", Literal["canonical", "world"]),
        ("goal_frame", Literal["known", "unknown"], "known"),
    ],
)


def convert_block(value: Any, *, fps: float, primed_frame: float, n_frames: int) -> dict[str, Any] | None:
    """Return the columns of a block, and the three names beside them; None for one that does not fit its sequence.

    Args:
        value: What stands in the entry; a user's file like any other, which may have been edited.
        fps: Frame rate of the import.
        primed_frame: Frame of the prime, from the entry.
        n_frames: Frames of the motion.
    """
    try:
        block = msgspec.structs.asdict(msgspec.convert(value, _Block))
    except msgspec.ValidationError:
        return None
    numbers = [number for each in block.values() for number in (each if isinstance(each, list) else [each])]
    if not all(math.isfinite(number) for number in numbers if isinstance(number, float)):
        return None
    # A block that no longer fits belongs to an entry that somebody changed; its fields then count, not the block.
    same_prime = abs(block["preroll"] * fps - primed_frame) <= 0.5 + 1e-6
    span = block["event_time"] - block["start_time"]
    same_length = block["n_frames"] == n_frames and abs(span * fps - n_frames + 1) < 1e-3
    if not (same_prime and same_length):
        return None
    if block["prime_time_uncertainty"] is None:
        block["prime_time_uncertainty"] = math.nan
    for name in ("goal_box_world_min", "goal_box_world_max"):
        block[name] = np.array(block[name])
    block["world_from_canonical"] = np.array(block["world_from_canonical"]).reshape(4, 4)
    return block
