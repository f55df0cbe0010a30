"""Reads a file of motions, finds what was expected of them, and diagnoses them: ``prbench doctor``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.checking.doctor.body import (
    examine_body,
    examine_finite,
    examine_quality,
    examine_scale,
    examine_shape,
    examine_unit,
)
from prbench.checking.doctor.frame_rate import examine_clock, examine_frame_rate, examine_length, examine_recorded_clock
from prbench.checking.doctor.joint_order import examine_joint_order, examine_left_right
from prbench.checking.doctor.motion_set import NOTHING_KNOWN, Diagnosis, Examination, Expected, Finding, MotionSet
from prbench.checking.doctor.place import (
    examine_facing,
    examine_first_frame,
    examine_floor,
    examine_position,
    examine_root,
    examine_up_axis,
)
from prbench.errors import InputFileError, UsageError
from prbench.files.arrays import Archive, ArrayHeader, map_array, read_header, read_parquet
from prbench.files.bounded import foreign_input, open_regular
from prbench.files.storage import turn_into_paths
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.offline import ConditionsFile, read_conditions_file
from prbench.sequences import SequenceTable

_LARGEST = 8 * 1024**3  # bytes of one array
_IDS = ("sequence_id", "opaque_id")
_FORMS = "an .npy or .npz file, Parquet, a folder of .npy or Parquet files, or a run folder"
_POSE_SIZE = N_JOINTS * 3


@dataclass(frozen=True)
class NamedMotion:
    """A motion and its name."""

    name: str
    """Sequence id, opaque id, number or the file's name."""
    sample: int
    values: np.ndarray
    """The array, of any shape."""


@dataclass(frozen=True)
class _MotionsRead:
    """The motions of a file, or some of them."""

    motions: tuple[NamedMotion, ...]
    total: int
    """All motions there are; ``motions`` holds fewer if a limit was given."""


@foreign_input()
def read_motions(path: Path, *, limit: int | None = None) -> _MotionsRead:
    """Read motions without asking that they be right.

    Args:
        path: A file or a folder of the forms above.
        limit: At most so many, spread evenly.

    Raises:
        InputFileError: if nothing there can be read as numbers.
    """
    if not path.exists():
        raise InputFileError(path, "", expected=_FORMS, found="no such file")
    motions = list(_from_folder(path) if path.is_dir() else _from_file(path))
    if not motions:
        raise InputFileError(path, "", expected="motions", found="none")
    # Evenly spread: the first motions of a file are often those of one recording.
    count = min(len(motions), limit or len(motions))
    chosen = [motions[place] for place in np.linspace(0, len(motions) - 1, count).round().astype(int)]
    return _MotionsRead(tuple(chosen), len(motions))


def _from_folder(path: Path) -> Iterator[NamedMotion]:
    runs = [folder for folder in (path, *sorted(path.iterdir())) if (folder / "predictions").is_dir()]
    places = [folder / "predictions" for folder in runs] or [path / "motions" if (path / "motions").is_dir() else path]
    for place in places:
        for file in sorted(place.iterdir()):
            if file.suffix in (".npy", ".parquet") and file.name[0] != ".":
                yield from _from_file(file)


def _from_file(path: Path) -> Iterator[NamedMotion]:
    suffix = path.suffix.lower()
    if suffix == ".npy":
        with open_regular(path) as stream:
            header = read_header(stream, path, "")
        yield from _unbatched(path.stem, _numbers(map_array(path, header), path, ""))
    elif suffix == ".npz":
        yield from _npz(path)
    elif suffix in (".parquet", ".pq"):
        yield from _parquet(path)
    else:
        remedy = "Save the joints with np.save: pickles (.pkl, .pt, .pth) are never opened, they can run programs."
        raise InputFileError(path, "", expected=_FORMS, found=f"a file named *{suffix}", remedy=remedy)


def _numbers(values: np.ndarray, path: Path, where: str) -> np.ndarray:
    if values.dtype.kind not in "fiu":
        raise InputFileError(path, where, expected="numbers", found=str(values.dtype))
    return values


def _unbatched(name: str, values: np.ndarray) -> Iterator[NamedMotion]:
    """Split an array with a batch axis into one motion for each row, without the zeros or NaN behind its last frame."""
    if values.ndim < 4 or values.shape[0] == 1 or values.shape[1] == 1:
        yield NamedMotion(name, 0, values)
        return
    for row, motion in enumerate(values):
        flat = np.nan_to_num(motion.reshape(len(motion), -1))
        written = np.flatnonzero(np.any(flat != 0, axis=1))
        yield NamedMotion(f"{name}[{row}]", 0, (motion[: written[-1] + 1] if written.size else motion))


def _npz(path: Path) -> Iterator[NamedMotion]:
    archive = Archive(path)
    headers = archive.headers()
    names = [name for name, header in headers.items() if header.dtype.kind in "fiu" and len(header.shape) >= 2]
    if "joints" in headers:
        yield from _npz_columns(archive)
        return
    if "noise_seed" in headers:
        raise InputFileError(
            path,
            "",
            expected="an array 'joints' with motions",
            found="the conditions that motions are to be made from",
            remedy="Give the file of motions here, and this one with --conditions.",
        )
    if not names:
        found = ", ".join(f"{name} {header.shape}" for name, header in headers.items()) or "nothing"
        raise InputFileError(path, "", expected="arrays of two axes or more", found=found)
    for name in _motion_like(headers, names):
        values = archive.read(name, largest=_LARGEST)
        if values.ndim == 4 and values.shape[2:] == (N_JOINTS, 3):
            yield from (NamedMotion(name, sample, motion) for sample, motion in enumerate(values))
        else:
            yield from _unbatched(name, values)


def _motion_like(headers: dict[str, ArrayHeader], names: list[str]) -> list[str]:
    """Choose the arrays with 22 joints, else the poses of a body's parameters, else all."""
    joints = [name for name in names if len(headers[name].shape) > 2 and headers[name].shape[-2:] == (N_JOINTS, 3)]
    return joints or [name for name in names if name == "poses"] or names


def _npz_columns(archive: Archive) -> Iterator[NamedMotion]:
    """Read one array ``joints`` beside ids and lengths, padded or one motion after another."""
    joints = _numbers(archive.read("joints", largest=_LARGEST), archive.path, "'joints'")
    columns = {name: archive.read(name, largest=_LARGEST) for name in archive.members if name != "joints"}
    lengths = columns.get("n_frames")
    id_name = next((name for name in _IDS if name in columns), None)
    ids = [str(name) for name in np.atleast_1d(columns[id_name])] if id_name else None
    if ids is None and lengths is None:
        yield from _unbatched("joints", joints)
        return
    rows = _rows_of_columns(joints, lengths, len(ids) if ids is not None else None)
    names = ids if ids is not None and len(ids) == len(rows) else [f"joints[{row}]" for row in range(len(rows))]
    samples = np.atleast_1d(columns["sample"]) if "sample" in columns else np.zeros(len(rows), dtype=int)
    if len(samples) != len(rows):
        samples = np.zeros(len(rows), dtype=int)
    for name, sample, motion in zip(names, samples, rows, strict=True):
        yield NamedMotion(name, int(sample), motion)


def _rows_of_columns(joints: np.ndarray, lengths: np.ndarray | None, n_ids: int | None) -> Sequence[np.ndarray]:
    if lengths is None:
        return list(joints) if len(joints) == n_ids else [joints]
    lengths = np.atleast_1d(lengths).astype(np.int64)
    if len(joints) == lengths.sum() and joints.ndim <= 3:
        return np.split(joints, np.cumsum(lengths)[:-1])
    if len(joints) == len(lengths):
        return [motion[: max(length, 0)] for motion, length in zip(joints, lengths, strict=True)]
    return [joints]


def _parquet(path: Path) -> Iterator[NamedMotion]:
    try:
        table = read_parquet(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputFileError(path, "", expected="a readable Parquet file", found=str(error).splitlines()[0]) from error
    if "joints" not in table.column_names:
        found = ", ".join(table.column_names)
        raise InputFileError(path, "", expected="a column 'joints'", found=found, remedy="Rename the column.")
    id_name = next((name for name in _IDS if name in table.column_names), None)
    names = table[id_name].to_pylist() if id_name else [f"row {row}" for row in range(table.num_rows)]
    samples = table["sample"].to_pylist() if "sample" in table.column_names else [0] * table.num_rows
    for row, (name, sample) in enumerate(zip(names, samples, strict=True)):
        yield NamedMotion(str(name), int(sample or 0), _frames(table["joints"][row], path, row))


def _frames(cell: pa.Scalar, path: Path, row: int) -> np.ndarray:
    """Return the frames of one row, however deeply their numbers are nested."""
    where = f"row {row}, column 'joints'"
    if not cell.is_valid or not pa.types.is_nested(cell.type):
        raise InputFileError(
            path, where, expected="a list of frames", found=str(cell.type) if cell.is_valid else "null"
        )
    values = cell.values
    count = len(cell.values)
    while pa.types.is_nested(values.type):
        if pa.types.is_struct(values.type) or pa.types.is_map(values.type):
            raise InputFileError(path, where, expected="lists of numbers", found=str(values.type))
        values = values.flatten()
    numbers = _numbers(values.to_numpy(zero_copy_only=False), path, where)
    if numbers.size == count and count % _POSE_SIZE == 0:
        count //= _POSE_SIZE  # one flat list
    if count == 0 or numbers.size % count:
        raise InputFileError(
            path, where, expected="frames of one size", found=f"{numbers.size} numbers in {count} frames"
        )
    frames = numbers.reshape(count, -1)
    return frames.reshape(count, N_JOINTS, 3) if frames.shape[1] == _POSE_SIZE else frames


def _examine_time(motion_set: MotionSet) -> Finding:
    """Return one diagnosis of time: uneven time also changes speeds, and a wrong rate also moves instants."""
    findings = []
    for examine in (examine_clock, examine_recorded_clock):  # a proof by the recording outweighs a suspicion
        findings.append(examine(motion_set))
        if any(diagnosis.certain for diagnosis in findings[-1].diagnoses):
            return findings[-1]
    suspicion = next((finding for finding in findings if finding.diagnoses), Finding((), motion_set))
    rest = examine_frame_rate(suspicion.motion_set)
    return Finding((*suspicion.diagnoses, *rest.diagnoses), rest.motion_set)


_EXAMINATIONS: tuple[Examination, ...] = (
    examine_shape,
    examine_finite,
    examine_body,
    examine_unit,
    examine_joint_order,
    examine_scale,
    examine_up_axis,
    examine_left_right,
    examine_root,
    examine_first_frame,
    examine_facing,
    examine_position,
    examine_floor,
    examine_length,
    _examine_time,
    examine_quality,
)
"""In the order in which faults hide one another."""


def diagnose(
    motions: Sequence[np.ndarray], expected: Sequence[Expected] | None, *, fps: float
) -> tuple[Diagnosis, ...]:
    """Say from the numbers what is wrong with motions.

    Args:
        motions: Normally each (frames, 22, 3), canonical frame, metres; any other shape is diagnosed, too.
        expected: What is known beside each motion; None = nothing.
        fps: Frames a second that the motions are said to have.

    Returns:
        Diagnoses in the order in which faults have to be repaired; empty if nothing was found. A fault that explains
        others comes alone: what is looked at later is looked at with that fault undone.

    Raises:
        ValueError: if ``expected`` has another length than ``motions``.
    """
    if expected is not None and len(expected) != len(motions):
        raise ValueError(f"{len(motions)} motions, but expectations of {len(expected)}")
    if not motions:
        return ()
    known = tuple(expected) if expected is not None else (NOTHING_KNOWN,) * len(motions)
    motion_set = MotionSet(tuple(np.asarray(motion, dtype=np.float64) for motion in motions), known, fps)
    diagnoses: list[Diagnosis] = []
    # Each examination gets the motions with the earlier faults undone, or it would report them again.
    for examine in _EXAMINATIONS:
        finding = examine(motion_set)
        diagnoses += finding.diagnoses
        if finding.unreadable:
            break
        motion_set = finding.motion_set
    return tuple(diagnoses)


_COLUMNS = ("fps", "joints", "previous_joints", "goal_location")
DEFAULT_LIMIT = 200
_DEFAULT_FPS = 20.0
"""The protocol's rate, for files that nothing else is known of."""


@dataclass(frozen=True)
class _Known:
    """Expectations for some motions."""

    expected: tuple[Expected, ...]
    """One expectation for each motion, in their order."""
    matched: int
    """Number of motions with a known expectation."""
    fps: float | None
    """The rate that they were asked for at, if they agree."""


@dataclass(frozen=True)
class DoctorRequest:
    """A file to examine, and what to compare it with."""

    path: Path
    data: tuple[Path, ...] = ()
    conditions: Path | None = None
    seed: int = 0
    fps: float | None = None
    limit: int = DEFAULT_LIMIT

    def __post_init__(self) -> None:
        turn_into_paths(self, "path", "data", "conditions")


@dataclass(frozen=True)
class DoctorReport:
    """The result of examining a file."""

    path: Path
    """The file, or the folder."""
    total: int
    """Motions in the file."""
    examined: int
    """Number of motions that were looked at."""
    compared: int
    """Number of motions that were compared with what was asked for."""
    shapes: tuple[str, ...]
    """Different shapes of the arrays, in the order of the file; at most five."""
    fps: float
    """Frame rate by which the motions were read, in frames per second."""
    diagnoses: tuple[Diagnosis, ...]
    """Findings; empty if there are none. Where one is certain, the exit code is 1."""

    @property
    def certain(self) -> bool:
        """True if a diagnosis is certain."""
        return any(diagnosis.certain for diagnosis in self.diagnoses)


def examine_file(request: DoctorRequest) -> DoctorReport:
    """Read motions and diagnose them.

    Raises:
        InputFileError: if nothing can be read.
        UsageError: if expectations were given that belong to none of the motions.
    """
    read = read_motions(request.path, limit=request.limit)
    known = _known(read.motions, request)
    fps = request.fps or (known.fps if known is not None else None) or _DEFAULT_FPS
    found = diagnose([each.values for each in read.motions], known.expected if known else None, fps=fps)
    shapes = tuple(dict.fromkeys(str(each.values.shape) for each in read.motions))[:5]
    compared = known.matched if known else 0
    return DoctorReport(request.path, read.total, len(read.motions), compared, shapes, fps, found)


def _known(motions: tuple[NamedMotion, ...], request: DoctorRequest) -> _Known | None:
    conditions = None if request.conditions is None else _from_conditions(motions, request.conditions)
    table = _from_table(motions, request.data, seed=request.seed) if request.data else None
    if conditions is not None and table is not None:
        # Join both: lengths and rates are those of the conditions, and the table adds the recorded motion.
        expected = tuple(
            replace(mine, recorded=theirs.recorded if mine.n_frames == theirs.n_frames else None)
            for mine, theirs in zip(conditions.expected, table.expected, strict=True)
        )
        return _Known(expected, conditions.matched, conditions.fps)
    return conditions or table


def _from_table(motions: Sequence[NamedMotion], folders: Sequence[Path], *, seed: int) -> _Known:
    """Match motions with rows of tables, by sequence id or by opaque id.

    Args:
        motions: With their names.
        folders: Built datasets.
        seed: Behind opaque ids.

    Raises:
        UsageError: if no motion is of these tables.
        TableError: if a table cannot be read.
    """
    wanted = {motion.name for motion in motions}
    found: dict[str, Expected] = {}
    for folder in folders:
        table = SequenceTable.open(folder).with_sequences()
        ids = table.scalars(columns=["sequence_id"])["sequence_id"].to_pylist()
        names = {name: name for name in ids if name in wanted}
        if not names:
            opaque = opaque_ids(ids, run_salt(seed, table.identity))
            names = {name: hidden for name, hidden in zip(ids, opaque, strict=True) if hidden in wanted}
        if names:
            found |= {names[name]: expected for name, expected in _rows(table, frozenset(names))}
    return _matched(motions, found, f"a sequence of {', '.join(str(folder) for folder in folders)}")


def _rows(table: SequenceTable, ids: frozenset[str]) -> list[tuple[str, Expected]]:
    rows = []
    for chunk in table.chunks(columns=_COLUMNS, ids=ids):
        joints = chunk.joints
        offsets = chunk.offsets
        previous = chunk.poses("previous_joints")
        goals = chunk.vectors("goal_location")
        rates = chunk.numbers("fps")
        for row, name in enumerate(chunk.sequence_ids):
            recorded = np.array(joints[offsets[row] : offsets[row + 1]], dtype=np.float64)
            expected = Expected(
                initial_joints=recorded[0],
                previous_joints=np.array(previous[row], dtype=np.float64),
                goal_joints=recorded[-1],
                goal_location=np.array(goals[row], dtype=np.float64),
                n_frames=len(recorded),
                fps=float(rates[row]),
                recorded=recorded,
            )
            rows.append((name, expected))
    return rows


def _from_conditions(motions: Sequence[NamedMotion], path: Path) -> _Known:
    """Match motions with rows of a conditions file: by opaque id, by number, or in order where there are no names.

    Raises:
        UsageError: if no motion is of this file.
        InputFileError: if the file cannot be read.
    """
    conditions = read_conditions_file(path)
    expected = [_of_row(conditions, row) for row in range(len(conditions))]
    found = dict(zip(conditions.opaque_id, expected, strict=True))
    # The names that `motions/%010d.npy` files have.
    found |= {f"{row:010d}": each for row, each in enumerate(expected)}
    if not any(motion.name in found for motion in motions) and len(motions) == len(expected):
        found = {motion.name: each for motion, each in zip(motions, expected, strict=True)}
    return _matched(motions, found, f"a row of {path}")


def _of_row(conditions: ConditionsFile, row: int) -> Expected:
    given = {}
    for name in ("initial_joints", "previous_joints", "goal_joints", "goal_location"):
        values = getattr(conditions, name)
        given[name] = None if values is None else np.asarray(values[row], dtype=np.float64)
    return Expected(n_frames=int(conditions.n_frames[row]), fps=float(conditions.fps[row]), **given)


def _matched(motions: Sequence[NamedMotion], found: dict[str, Expected], what: str) -> _Known:
    expected = tuple(found.get(motion.name, NOTHING_KNOWN) for motion in motions)
    matched = sum(each is not NOTHING_KNOWN for each in expected)
    if not matched:
        names = ", ".join(repr(motion.name) for motion in motions[:2])
        raise UsageError(
            f"none of the {len(motions)} motions is {what}: they are named {names} … Give them a column sequence_id or"
            " opaque_id (with the right --seed), or leave --data and --conditions out."
        )
    rates = {each.fps for each in expected if each.fps is not None}
    return _Known(expected, matched, rates.pop() if len(rates) == 1 else None)
