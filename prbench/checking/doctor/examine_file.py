"""From a file to its diagnoses: what ``prbench doctor`` does."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.checking.doctor.diagnose import diagnose
from prbench.checking.doctor.expectations import Known, from_conditions, from_table, joined
from prbench.checking.doctor.reading import NamedMotion, read_motions
from prbench.checking.doctor.types import Diagnosis
from prbench.paths import turn_into_paths

DEFAULT_LIMIT = 200
DEFAULT_FPS = 20.0
"""The protocol's rate, for files that nothing else is known of."""


@dataclass(frozen=True)
class DoctorRequest:
    """What to look at, and what to compare it with."""

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
    """What was looked at and what was found."""

    path: Path
    total: int
    """Motions in the file."""
    examined: int
    compared: int
    """How many of them were compared with what was asked for."""
    shapes: tuple[str, ...]
    """Of the arrays, each once, in the order of the file; at most five."""
    fps: float
    diagnoses: tuple[Diagnosis, ...]

    @property
    def certain(self) -> bool:
        """Whether something is wrong for sure."""
        return any(diagnosis.certain for diagnosis in self.diagnoses)


def examine_file(request: DoctorRequest) -> DoctorReport:
    """Read motions and diagnose them.

    Raises:
        InputFileError: if nothing can be read.
        UsageError: if expectations were given that belong to none of the motions.
    """
    read = read_motions(request.path, limit=request.limit)
    known = _known(read.motions, request)
    fps = request.fps or (known.fps if known is not None else None) or DEFAULT_FPS
    found = diagnose([each.values for each in read.motions], known.expected if known else None, fps=fps)
    shapes = tuple(dict.fromkeys(str(each.values.shape) for each in read.motions))[:5]
    compared = known.matched if known else 0
    return DoctorReport(request.path, read.total, len(read.motions), compared, shapes, fps, found)


def _known(motions: tuple[NamedMotion, ...], request: DoctorRequest) -> Known | None:
    conditions = None if request.conditions is None else from_conditions(motions, request.conditions)
    table = from_table(motions, request.data, seed=request.seed) if request.data else None
    if conditions is not None and table is not None:
        return joined(table, conditions)
    return conditions or table
