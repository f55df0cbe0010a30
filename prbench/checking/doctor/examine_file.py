"""Reads a file of motions, finds what was expected of them, and diagnoses them: ``prbench doctor``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from prbench.checking.doctor.diagnose import diagnose
from prbench.checking.doctor.motion_set import NOTHING_KNOWN, Diagnosis, Expected
from prbench.checking.doctor.reading import NamedMotion, read_motions
from prbench.errors import UsageError
from prbench.files.storage import turn_into_paths
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.offline import read_conditions_file
from prbench.harness.offline.conditions_file import ConditionsFile
from prbench.sequences import SequenceTable

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
        return _joined(table, conditions)
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


def _joined(table: _Known, conditions: _Known) -> _Known:
    """Join both: lengths and rates are those of the conditions, and the table adds the recorded motion."""
    expected = tuple(
        replace(mine, recorded=theirs.recorded if mine.n_frames == theirs.n_frames else None)
        for mine, theirs in zip(conditions.expected, table.expected, strict=True)
    )
    return _Known(expected, conditions.matched, conditions.fps)
