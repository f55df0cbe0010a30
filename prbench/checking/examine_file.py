"""Reads a file of motions, finds what was expected of them, and diagnoses them: ``prbench doctor``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.checking.doctor.body import BODY_PARAMETERS
from prbench.checking.doctor.examinations import diagnose
from prbench.checking.doctor.motion_set import NOTHING_KNOWN, Diagnosis, Expected
from prbench.errors import InputFileError, UsageError
from prbench.files.arrays import Archive, map_array, read_header, read_parquet
from prbench.files.bounded import foreign_input, open_regular, require
from prbench.files.storage import turn_into_paths
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.offline import read_conditions_file
from prbench.representation import N_FEATURES
from prbench.sequences import SequenceTable
from prbench.shown import quoted

_LIMIT = 200  # motions that are looked at, so that a large run takes seconds
_DEFAULT_FPS = 20.0  # the protocol's rate, for files that nothing else is known of
_LARGEST = 8 * 1024**3  # bytes of one array
_IDS = ("sequence_id", "opaque_id")
_FORMS = "an .npy or .npz file, Parquet, a folder of .npy or Parquet files, or a run folder"
_POSE_SIZE = N_JOINTS * 3


@dataclass(frozen=True)
class DoctorRequest:
    """A file to examine, and what to compare it with."""

    path: Path
    data: tuple[Path, ...] = ()
    conditions: Path | None = None
    seed: int = 0
    fps: float | None = None

    def __post_init__(self) -> None:
        turn_into_paths(self, "path", "data", "conditions")


@dataclass(frozen=True)
class DoctorReport:
    """The result of examining a file.

    Attributes:
        path: The file, or the folder.
        total: Motions in the file.
        examined: Number of motions that were looked at.
        compared: Number of motions that were compared with what was asked for.
        shapes: Different shapes of the arrays, in the order of the file; at most five.
        fps: Frame rate by which the motions were read, in frames per second.
        diagnoses: Findings; empty if there are none. Where one is certain, the exit code is 1.
    """

    path: Path
    total: int
    examined: int
    compared: int
    shapes: tuple[str, ...]
    fps: float
    diagnoses: tuple[Diagnosis, ...]

    @property
    def certain(self) -> bool:
        """True if a diagnosis is certain."""
        return any(diagnosis.certain for diagnosis in self.diagnoses)


def examine_file(request: DoctorRequest) -> DoctorReport:
    """Read motions and diagnose them.

    Raises:
        InputFileError: if nothing can be read.
        TableError: if a table cannot be read.
        UsageError: if expectations were given that belong to none of the motions.
    """
    named = read_motions(request.path)
    # Evenly spread: the first motions of a file are often those of one recording.
    places = np.linspace(0, len(named) - 1, min(len(named), _LIMIT)).round().astype(int)
    names = [named[place][0] for place in places]
    motions = [named[place][1] for place in places]
    known: dict[str, Expected] = {}
    for folder in request.data:
        known |= _from_table(names, folder, seed=request.seed)
    if request.conditions is not None:
        known |= _from_conditions(names, request.conditions)
    expected = [known.get(name, NOTHING_KNOWN) for name in names]
    compared = sum(each is not NOTHING_KNOWN for each in expected)
    if not compared and (request.data or request.conditions):
        shown = ", ".join(f"'{quoted(name)}'" for name in names[:2])
        places_given = ", ".join(map(str, (*request.data, *filter(None, [request.conditions]))))
        said = f"none of the {len(names)} motions is of {places_given}: they are named {shown} …"
        remedy = "Give them a column sequence_id or opaque_id (with the right --seed)"
        raise UsageError(f"{said} {remedy}, or leave --data and --conditions out.")
    rates = {each.fps for each in expected if each.fps is not None}
    fps = request.fps or (rates.pop() if len(rates) == 1 else _DEFAULT_FPS)
    shapes = tuple(dict.fromkeys(str(motion.shape) for motion in motions))[:5]
    found = diagnose(motions, expected, fps=fps)
    return DoctorReport(request.path, len(named), len(names), compared, shapes, fps, found)


def _from_table(names: Sequence[str], folder: Path, *, seed: int) -> dict[str, Expected]:
    """Return what a table says of the motions with these sequence ids or opaque ids."""
    table = SequenceTable.open(folder).with_sequences()
    ids = table.scalars(columns=["sequence_id"])["sequence_id"].to_pylist()
    wanted = set(names)
    known_as = {name: name for name in ids if name in wanted}
    if not known_as:
        opaque = opaque_ids(ids, run_salt(seed, table.identity))
        known_as = {name: hidden for name, hidden in zip(ids, opaque, strict=True) if hidden in wanted}
    found = {}
    for chunk in table.chunks(columns=("fps", "joints", "previous_joints"), ids=frozenset(known_as)):
        previous = chunk.poses("previous_joints")
        for row, name in enumerate(chunk.sequence_ids):
            first = np.array(chunk.joints[chunk.offsets[row]], dtype=np.float64)
            before = np.array(previous[row], dtype=np.float64)
            fps = float(chunk.numbers("fps")[row])
            found[known_as[name]] = Expected(first, before, int(chunk.n_frames[row]), fps)
    return found


def _from_conditions(names: Sequence[str], path: Path) -> dict[str, Expected]:
    """Return what a conditions file asks for: by opaque id, by number, or in order where there are no names."""
    conditions = read_conditions_file(path)
    expected = Expected.of_each(conditions)
    found = dict(zip(conditions.opaque_id, expected, strict=True))
    # The names that `motions/%010d.npy` files have.
    found |= {f"{row:010d}": each for row, each in enumerate(expected)}
    if not found.keys() & set(names) and len(names) == len(expected):
        return dict(zip(names, expected, strict=True))
    return found


# Name of a motion (sequence id, opaque id, number or file name), and its array of any shape
_Named = tuple[str, np.ndarray]


@foreign_input()
def read_motions(path: Path) -> list[_Named]:
    """Read the motions of a file or folder with their names, without asking that they be right.

    Raises:
        InputFileError: if nothing there can be read as numbers.
    """
    require(path, (path.exists(), "", _FORMS, "no such file", ""))
    files = [path]
    if path.is_dir():
        runs = [folder for folder in (path, *sorted(path.iterdir())) if (folder / "predictions").is_dir()]
        plain = path / "motions" if (path / "motions").is_dir() else path
        folders = [folder / "predictions" for folder in runs] or [plain]
        inside = [file for folder in folders for file in sorted(folder.iterdir())]
        files = [file for file in inside if file.suffix in (".npy", ".parquet") and file.name[0] != "."]
    motions: list[_Named] = []
    for file in files:
        suffix = file.suffix.lower()
        if suffix == ".npy":
            with open_regular(file) as stream:
                header = read_header(stream, file, "")
            motions += _unbatched(file.stem, _numbers(map_array(file, header), file, ""))
        elif suffix == ".npz":
            motions += _npz(Archive(file))
        elif suffix in (".parquet", ".pq"):
            motions += _parquet(file)
        else:
            remedy = "Save the joints with np.save: pickles (.pkl, .pt, .pth) are never opened, they can run programs."
            raise InputFileError(file, "", expected=_FORMS, found=f"a file named *{suffix}", remedy=remedy)
    require(path, (len(motions) > 0, "", "motions", "none", ""))
    return motions


def _numbers(values: np.ndarray, path: Path, where: str) -> np.ndarray:
    require(path, (values.dtype.kind in "fiu", where, "numbers", values.dtype, ""))
    return values


def _unbatched(name: str, values: np.ndarray) -> Iterator[_Named]:
    """Split an array with a batch axis into one motion for each row, without the zeros or NaN behind its last frame."""
    flat_frames = values.ndim == 3 and 3 not in values.shape
    flat_frames = flat_frames and bool({*values.shape[1:]} & {_POSE_SIZE, N_FEATURES, *BODY_PARAMETERS})
    if not (values.ndim >= 4 or flat_frames) or 1 in values.shape[:2]:
        yield name, values
        return
    for row, motion in enumerate(values):
        written = np.flatnonzero(np.any(np.nan_to_num(motion) != 0, axis=tuple(range(1, motion.ndim))))
        yield f"{name}[{row}]", (motion[: written[-1] + 1] if written.size else motion)


def _npz(archive: Archive) -> Iterator[_Named]:
    """Read an array ``joints`` beside ids and lengths, padded or one motion after another; else one array a motion."""
    headers = {name: archive.header(name) for name in archive.members}
    if "joints" not in headers:
        names = [name for name, header in headers.items() if header.dtype.kind in "fiu" and len(header.shape) >= 2]
        if "noise_seed" in headers or not names:
            found = ", ".join(f"{name} {header.shape}" for name, header in headers.items()) or "nothing"
            remedy = "Give the file of motions here, and one of conditions with --conditions."
            raise InputFileError(archive.path, "", expected="arrays of motions", found=found, remedy=remedy)
        # The arrays with 22 joints, else the poses of a body's parameters, else all.
        of_22 = [name for name in names if len(headers[name].shape) > 2 and headers[name].shape[-2:] == (N_JOINTS, 3)]
        for name in of_22 or [name for name in names if name == "poses"] or names:
            yield from _unbatched(name, archive.read(name, largest=_LARGEST))
        return
    joints = _numbers(archive.read("joints", largest=_LARGEST), archive.path, "'joints'")
    require(archive.path, (joints.ndim > 0, "'joints'", "frames of joints", "one number", ""))
    id_name = next((name for name in _IDS if name in headers), None)
    ids = None if id_name is None else [str(name) for name in np.atleast_1d(archive.read(id_name, largest=_LARGEST))]
    if "n_frames" not in headers:
        yield from zip(ids, joints, strict=True) if ids and len(ids) == len(joints) else _unbatched("joints", joints)
        return
    lengths = np.atleast_1d(archive.read("n_frames", largest=_LARGEST))
    found = f"{lengths.dtype} of shape {lengths.shape}"
    is_list = lengths.ndim == 1 and lengths.dtype.kind in "iu"
    require(archive.path, (is_list, "'n_frames'", "a whole number for each motion", found, ""))
    lengths = lengths.astype(np.int64).clip(0)
    if len(joints) == len(lengths):
        rows = [motion[:length] for motion, length in zip(joints, lengths, strict=True)]
    else:
        rows = np.split(joints, np.cumsum(lengths)[:-1]) if len(joints) == lengths.sum() else [joints]
    names = ids if ids and len(ids) == len(rows) else [f"joints[{row}]" for row in range(len(rows))]
    yield from zip(names, rows, strict=True)


def _parquet(path: Path) -> Iterator[_Named]:
    try:
        table = read_parquet(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputFileError(path, "", expected="a readable Parquet file", found=str(error).splitlines()[0]) from error
    found = ", ".join(table.column_names)
    require(path, ("joints" in table.column_names, "", "a column 'joints'", found, "Rename the column."))
    id_name = next((name for name in _IDS if name in table.column_names), None)
    names = table[id_name].to_pylist() if id_name else [f"row {row}" for row in range(table.num_rows)]
    for row, name in enumerate(names):
        # The frames of one row, however deeply their numbers are nested.
        where = f"row {row}, column 'joints'"
        cell = table["joints"][row]
        found = str(cell.type) if cell.is_valid else "null"
        require(path, (cell.is_valid and pa.types.is_nested(cell.type), where, "a list of frames", found, ""))
        values = cell.values
        count = len(values)
        while pa.types.is_nested(values.type):
            is_list = not (pa.types.is_struct(values.type) or pa.types.is_map(values.type))
            require(path, (is_list, where, "lists of numbers", values.type, ""))
            values = values.flatten()
        numbers = _numbers(values.to_numpy(zero_copy_only=False), path, where)
        if numbers.size == count and count % _POSE_SIZE == 0:
            count //= _POSE_SIZE  # one flat list
        found = f"{numbers.size} numbers in {count} frames"
        require(path, (count > 0 and numbers.size % count == 0, where, "frames of one size", found, ""))
        frames = numbers.reshape(count, -1)
        yield str(name), frames.reshape(count, N_JOINTS, 3) if frames.shape[1] == _POSE_SIZE else frames
