"""The solid boxes around the sequences of a table (docs/specification/scene.md#solid-boxes)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa
from jaxtyping import Bool
from scipy.spatial.transform import Rotation

from prbench.geometry.shapes import Boxes
from prbench.geometry.skeleton import invert_rigid
from prbench.protocol.manifests import load_scene_constants
from prbench.sequences import SequenceChunk, SequenceTable

SCENE_COLUMNS = ["recording_id", "world_from_canonical"]
"""Columns of the table that place the boxes of a recording in the frames of its sequences."""
_NONE = Boxes(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 3)), np.array([0, 0]))


@dataclass(frozen=True)
class SolidBoxes:
    """The solid boxes of every recording of a table, world frame, metres."""

    table: SequenceTable

    @classmethod
    def of(cls, table: SequenceTable) -> SolidBoxes | None:
        """The boxes of a table; None where it knows of none."""
        return cls(table) if table.has_scenes else None

    @cached_property
    def _by_recording(self) -> dict[str, Boxes]:
        rows = self.table.scenes()
        solid = np.flatnonzero(is_solid(rows))
        places: dict[str, list[int]] = {}
        for name, place in zip(rows["recording_id"].take(pa.array(solid)).to_pylist(), solid.tolist(), strict=True):
            places.setdefault(name, []).append(place)
        return {name: _boxes(rows.take(pa.array(places[name]))) for name in sorted(places)}

    def around(self, chunk: SequenceChunk) -> Boxes:
        """The solid boxes of each sequence of a chunk with :data:`SCENE_COLUMNS`, in its canonical frame."""
        world_from_canonical = chunk.vectors("world_from_canonical").reshape(-1, 4, 4)
        names = chunk.strings("recording_id")
        return Boxes.joined(
            [
                self._by_recording.get(name, _NONE).placed(invert_rigid(place))
                for name, place in zip(names, world_from_canonical, strict=True)
            ]
        )


def is_solid(scenes: pa.Table) -> Bool[np.ndarray, " boxes"]:
    """Return True for each box that the recorded person never enters deeper than ``passable``.

    Args:
        scenes: Rows of the ``scenes`` table.
    """
    # Without a recorded body nobody has shown that a box is hollow.
    entered = np.array(scenes["entered"].to_pylist(), dtype=np.float64)  # NaN where it is null
    return ~(entered > load_scene_constants().passable)


def _boxes(rows: pa.Table) -> Boxes:
    columns = SequenceChunk(rows.combine_chunks().to_batches()[0])
    rotation = Rotation.from_quat(columns.vectors("rotation"), scalar_first=True).as_matrix()
    return Boxes(columns.vectors("centre"), rotation, columns.vectors("half_extents"), np.array([0, len(columns)]))
