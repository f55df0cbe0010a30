"""Releases as somebody else would write them: with any known names, from the same sequences."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from prbench.geometry.skeleton import transform_points
from prbench.sequences import Sequence as Row
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


def plain_entry(row: Row, style: Style) -> dict[str, Any]:
    """What the layout promises of one sequence, and action."""
    names = style.names
    split = "test" if row.split == "validation" else row.split
    entry = {
        names["goal"]: style.goal(row.goal_location.tolist()),
        names["text"]: row.text,
        names["subset"]: style.subset(split),
        names["primed_frame"]: row.prime_frame,
    }
    if "action" in names:
        entry[names["action"]] = row.action
    return entry


def write_release(
    folder: Path,
    sequences: Sequence[Row],
    style: Style | None = None,
    *,
    entry: Callable[[Row, Style], dict[str, Any]] = plain_entry,
    motion: Callable[[Row], np.ndarray] = lambda row: row.joints,
    gaze: Callable[[Row], np.ndarray] = lambda row: np.where(row.gaze_valid[:, None], row.gaze_direction, np.nan),
) -> Path:
    """Write one dataset's folder."""
    style = style or Style()
    (folder / "motions").mkdir(parents=True)
    (folder / "gazes").mkdir()
    keyed = []
    for index, row in enumerate(sequences):
        np.save(folder / "motions" / f"{index:010d}.npy", motion(row).astype(np.float32))
        np.save(folder / "gazes" / f"{index:010d}.npy", gaze(row).astype(np.float32))
        keyed.append((style.key(index), entry(row, style)))
    content = dict(keyed)
    (folder / "target_information.json").write_text(json.dumps(content), encoding="utf-8")
    return folder


def in_world(row: Row) -> Row:
    """Motion, goal and gaze of a sequence in the world of its recording."""
    import dataclasses

    turn = row.world_from_canonical.copy()
    turn[:3, 3] = 0.0
    return dataclasses.replace(
        row,
        joints=transform_points(row.world_from_canonical, row.joints.astype(np.float64)),
        goal_location=transform_points(row.world_from_canonical, row.goal_location),
        gaze_direction=transform_points(turn, row.gaze_direction),
    )
