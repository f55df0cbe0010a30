"""What is known beside motions that came from files: the table's rows, or those of a conditions file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from prbench.checking.doctor.reading import NamedMotion
from prbench.checking.doctor.types import NOTHING_KNOWN, Expected
from prbench.errors import UsageError
from prbench.evaluation.conditions import opaque_ids, run_salt
from prbench.sequences import SequenceTable
from prbench.submitted.offline import read_conditions_file
from prbench.submitted.offline.conditions_file import ConditionsFile

_COLUMNS = ("fps", "joints", "previous_joints", "goal_location")


@dataclass(frozen=True)
class Known:
    """Expectations for some motions."""

    expected: tuple[Expected, ...]
    """One a motion, in their order."""
    matched: int
    """How many of them are known."""
    fps: float | None
    """The rate that they were asked for at, if they agree."""


def from_table(motions: Sequence[NamedMotion], folders: Sequence[Path], *, seed: int) -> Known:
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
        ids = table.scalars()["sequence_id"].to_pylist()
        names = {name: name for name in ids if name in wanted}
        if not names:
            opaque = opaque_ids(ids, run_salt(seed, table.identity))
            names = {name: hidden for name, hidden in zip(ids, opaque, strict=True) if hidden in wanted}
        if names:
            found |= {names[name]: expected for name, expected in _rows(table, frozenset(names))}
    return _known(motions, found, f"a sequence of {', '.join(str(folder) for folder in folders)}")


def _rows(table: SequenceTable, ids: frozenset[str]) -> list[tuple[str, Expected]]:
    rows = []
    for chunk in table.chunks(columns=_COLUMNS, ids=ids):
        joints, offsets = chunk.joints, chunk.offsets
        previous, goals, rates = chunk.poses("previous_joints"), chunk.vectors("goal_location"), chunk.numbers("fps")
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


def from_conditions(motions: Sequence[NamedMotion], path: Path) -> Known:
    """Match motions with rows of a conditions file: by opaque id, by number, or in order where there are no names.

    Raises:
        UsageError: if no motion is of this file.
        InputFileError: if the file cannot be read.
    """
    conditions = read_conditions_file(path)
    expected = [_of_row(conditions, row) for row in range(len(conditions))]
    found = dict(zip(conditions.opaque_id, expected, strict=True))
    found |= {f"{row:010d}": each for row, each in enumerate(expected)}
    if not any(motion.name in found for motion in motions) and len(motions) == len(expected):
        found = {motion.name: each for motion, each in zip(motions, expected, strict=True)}
    return _known(motions, found, f"a row of {path}")


def _of_row(conditions: ConditionsFile, row: int) -> Expected:
    given = {}
    for name in ("initial_joints", "previous_joints", "goal_joints", "goal_location"):
        values = getattr(conditions, name)
        given[name] = None if values is None else np.asarray(values[row], dtype=np.float64)
    return Expected(n_frames=int(conditions.n_frames[row]), fps=float(conditions.fps[row]), **given)


def _known(motions: Sequence[NamedMotion], found: dict[str, Expected], what: str) -> Known:
    expected = tuple(found.get(motion.name, NOTHING_KNOWN) for motion in motions)
    matched = sum(each is not NOTHING_KNOWN for each in expected)
    if not matched:
        names = ", ".join(repr(motion.name) for motion in motions[:2])
        raise UsageError(
            f"none of the {len(motions)} motions is {what}: they are named {names} … Give them a column sequence_id or"
            " opaque_id (with the right --seed), or leave --data and --conditions out."
        )
    rates = {each.fps for each in expected if each.fps is not None}
    return Known(expected, matched, rates.pop() if len(rates) == 1 else None)


def joined(table: Known, conditions: Known) -> Known:
    """Both together; what the conditions asked for (length and rate) counts, and the table adds the recorded motion."""
    expected = tuple(
        replace(mine, recorded=theirs.recorded if mine.n_frames == theirs.n_frames else None)
        for mine, theirs in zip(conditions.expected, table.expected, strict=True)
    )
    return Known(expected, conditions.matched, conditions.fps)
