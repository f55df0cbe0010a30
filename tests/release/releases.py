"""Releases as somebody else would write them, from the same sequences, and what an import makes of one."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from prbench.geometry.skeleton import transform_points
from prbench.release.importing import import_release
from prbench.release.reading import ImportOptions
from prbench.release.report import ImportReport
from prbench.sequences import Sequence as Row
from prbench.sequences import SequenceTable
from tests.release.tables import looking_sequence

NAMES = {
    "goal": "goal_location", "text": "text_prompt", "subset": "subset", "primed_frame": "primed_frame",
    "action": "action",
}  # fmt: skip


@dataclass(frozen=True)
class Style:
    """How a release is written."""

    names: dict[str, str] = field(default_factory=lambda: dict(NAMES))
    key: Callable[[int], Any] = lambda index: f"{index:010d}"
    goal: Callable[[list[float]], Any] = list
    subset: Callable[[str], Any] = str


def rows(n: int = 12, dataset: str = "synthetic-adt") -> list[Row]:
    """Sequences in the order of their numbers."""
    return [looking_sequence(index, dataset) for index in range(n)]


ROWS = rows(6)


def write_release(
    folder: Path,
    sequences: Sequence[Row] = ROWS,
    style: Style | None = None,
    *,
    fields: Mapping[str, Any] | Callable[[Row], Mapping[str, Any]] | None = None,
    motion: Callable[[Row], np.ndarray] = lambda row: row.joints,
    gaze: Callable[[Row], np.ndarray] = lambda row: np.where(row.gaze_valid[:, None], row.gaze_direction, np.nan),
) -> Path:
    """Write one dataset's folder: what the layout promises of each sequence, its action, and further ``fields``.

    A further field of None leaves the field out.
    """
    style = style or Style()
    (folder / "motions").mkdir(parents=True)
    (folder / "gazes").mkdir()
    content = {}
    for index, row in enumerate(sequences):
        np.save(folder / "motions" / f"{index:010d}.npy", motion(row).astype(np.float32))
        np.save(folder / "gazes" / f"{index:010d}.npy", gaze(row).astype(np.float32))
        values = {
            "goal": style.goal(row.goal_location.tolist()),
            "text": row.text,
            "subset": style.subset("test" if row.split == "validation" else row.split),
            "primed_frame": row.prime_frame,
            "action": row.action,
        }
        entry = {name: values[canonical] for canonical, name in style.names.items()}
        entry |= (fields(row) if callable(fields) else fields) or {}
        content[style.key(index)] = {name: value for name, value in entry.items() if value is not None}
    (folder / "target_information.json").write_text(json.dumps(content), encoding="utf-8")
    return folder


def change_targets(release: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Change the content of ``target_information.json``."""
    path = release / "target_information.json"
    entries = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps(change(entries) or entries), encoding="utf-8")


def in_world(row: Row) -> Row:
    """Motion, goal and gaze of a sequence in the world of its recording."""
    turn = row.world_from_canonical.copy()
    turn[:3, 3] = 0.0
    return dataclasses.replace(
        row,
        joints=transform_points(row.world_from_canonical, row.joints.astype(np.float64)),
        goal_location=transform_points(row.world_from_canonical, row.goal_location),
        gaze_direction=transform_points(turn, row.gaze_direction),
    )


def imported(
    folder: Path,
    sequences: Sequence[Row] = ROWS,
    style: Style | None = None,
    *,
    spoil: Callable[[Path], object] = lambda release: None,
    options: ImportOptions | None = None,
    **kinds: Any,
) -> ImportReport:
    """Write a release into a folder, damage it, import it as ``table`` beside it, and return the report."""
    release = write_release(folder / "release", sequences, style, **kinds)
    spoil(release)
    result = import_release(release, folder / "table", dataset="synthetic-adt", options=options or ImportOptions())
    return result.tables[0]


def table_of(folder: Path) -> SequenceTable:
    """Open what :func:`imported` made."""
    return SequenceTable.open(folder / "table")


def value(report: ImportReport, name: str) -> tuple[str, str]:
    """Return what was inferred, and how surely."""
    found = next(each for each in report.inferred if each.name == name)
    return found.value, found.how_surely
