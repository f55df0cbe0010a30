"""Turns table rows into what a method may know: the firewall between a method and the recorded motion.

A :class:`ConditionSource` holds what conditions are made of (first, previous and last frame, text, goal), about 1 kB a
sequence. It copies these out of the table, so that nothing that a batch refers to leads back to the recorded frames in
between. A :class:`ConditionStream` holds one window of sequences at a time.
"""

from __future__ import annotations

import dataclasses
import hashlib
import hmac
import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.contract import GIVEN, Condition, ConditionBatch
from prbench.errors import UsageError
from prbench.files.storage import text_digest
from prbench.geometry.shapes import Boxes
from prbench.geometry.skeleton import invert_rigid
from prbench.harness.planning import Selection
from prbench.protocol.manifests import load_scene_constants
from prbench.randomness import named_generator, noise_seed
from prbench.sequences import SequenceChunk, SequenceTable

# Columns of the table that place the boxes of a recording in the frames of its sequences.
SCENE_COLUMNS = ["recording_id", "world_from_canonical"]
_NONE = Boxes(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 3)), np.array([0, 0]))


def solid_boxes(table: SequenceTable) -> dict[str, Boxes] | None:
    """Return the solid boxes of every recording of a table, world frame, metres; None where it knows of no boxes."""
    if not table.has_scenes:
        return None
    scenes = table.scenes()
    places: dict[str, list[int]] = {}
    for place in np.flatnonzero(is_solid(scenes)).tolist():
        places.setdefault(scenes["recording_id"][place].as_py(), []).append(place)
    found = {}
    for name in sorted(places):
        columns = SequenceChunk(scenes.take(pa.array(places[name])).combine_chunks().to_batches()[0])
        rotation = Rotation.from_quat(columns.vectors("rotation"), scalar_first=True).as_matrix()
        ends = np.array([0, len(columns)])
        found[name] = Boxes(columns.vectors("centre"), rotation, columns.vectors("half_extents"), ends)
    return found


def boxes_around(chunk: SequenceChunk, boxes: Mapping[str, Boxes]) -> Boxes:
    """Return the solid boxes of each sequence of a chunk with :data:`SCENE_COLUMNS`, in its canonical frame."""
    pairs = zip(chunk.strings("recording_id"), chunk.vectors("world_from_canonical").reshape(-1, 4, 4), strict=True)
    return Boxes.joined([boxes.get(name, _NONE).placed(invert_rigid(place)) for name, place in pairs])


def is_solid(scenes: pa.Table) -> Bool[np.ndarray, " boxes"]:
    """Return True for each box that the recorded person never enters deeper than ``passable``.

    Args:
        scenes: Rows of the ``scenes`` table.
    """
    # Without a recorded body nobody has shown that a box is hollow.
    entered = np.array(scenes["entered"].to_pylist(), dtype=np.float64)  # NaN where it is null
    return ~(entered > load_scene_constants()["passable"])


_COLUMNS = ["text", "goal_location", "joints", "previous_joints", "head_tilt_deg"]
_ARRAYS = ("initial_joints", "previous_joints", "goal_joints", "goal_location", "head_tilt_deg")


@dataclass(frozen=True)
class ConditionSource:
    """The makings of conditions, one row a chosen sequence; canonical frame, metres.

    Attributes:
        head_tilt_deg: Never part of a condition; the harness's own scripted motion needs it.
    """

    sequence_ids: tuple[str, ...]
    n_frames: Int[np.ndarray, " n"]
    fps: float
    text: tuple[str, ...]
    initial_joints: Float[np.ndarray, "n 22 3"]
    previous_joints: Float[np.ndarray, "n 22 3"]
    goal_joints: Float[np.ndarray, "n 22 3"]
    goal_location: Float[np.ndarray, "n 3"]
    head_tilt_deg: Float[np.ndarray, " n"]

    @classmethod
    def read(cls, selection: Selection) -> ConditionSource:
        """Stream the chosen rows of a table once and keep what conditions need."""
        windows = list(_sources(selection))
        joined = {name: np.concatenate([getattr(source, name) for _, source in windows]) for name in _ARRAYS}
        text = tuple(itertools.chain.from_iterable(source.text for _, source in windows))
        return cls(selection.sequence_ids, selection.n_frames, selection.fps, text, **joined)

    def around(self, rows: Int[np.ndarray, " rows"]) -> tuple[ConditionSource, Int[np.ndarray, " rows"]]:
        """See :meth:`ConditionStream.around`; here it is all sequences."""
        return self, rows

    def with_goals_of(self, other: Int[np.ndarray, " n"]) -> ConditionSource:
        """Row i gets the goal of row ``other[i]``, each in its own canonical frame."""
        return dataclasses.replace(self, goal_joints=self.goal_joints[other], goal_location=self.goal_location[other])

    def batch(
        self, rows: Int[np.ndarray, " rows"], condition: Condition, *, seed: int, salt: bytes, sample: int
    ) -> ConditionBatch:
        """Return what a method may know about some sequences.

        Args:
            rows: Places in the selection.
            condition: Decides which fields are filled (``prbench.contract.GIVEN``).
            seed: The run's seed.
            salt: Result of :func:`run_salt`.
            sample: Index of the motion drawn for each sequence.
        """
        ids = [self.sequence_ids[row] for row in rows]
        given: dict[str, Any] = {"condition": condition, "fps": self.fps, "n_frames": self.n_frames[rows]}
        given["noise_seed"] = tuple(noise_seed(seed, name, sample) for name in ids)
        for name in GIVEN[condition]:
            values = getattr(self, name)
            given[name] = tuple(values[row] for row in rows) if isinstance(values, tuple) else values[rows]
        return ConditionBatch(opaque_id=tuple(opaque_ids(ids, salt)), **given)

    def redrawn(
        self, batch: ConditionBatch, rows: Int[np.ndarray, " rows"], *, seed: int, sample: int
    ) -> ConditionBatch:
        """Return the batch of the same rows for another sample: only the noise seeds differ."""
        seeds = tuple(noise_seed(seed, self.sequence_ids[row], sample) for row in rows)
        return dataclasses.replace(batch, noise_seed=seeds)


class ConditionStream:
    """The makings of conditions of a selection, one window in memory at a time."""

    def __init__(self, selection: Selection) -> None:
        """Prepare to read."""
        self._selection = selection
        self._windows: Iterator[tuple[slice, ConditionSource]] = iter(())
        self._place = slice(0, 0)
        self._source: ConditionSource | None = None

    def around(self, rows: Int[np.ndarray, " rows"]) -> tuple[ConditionSource, Int[np.ndarray, " rows"]]:
        """Return the makings of some sequences and of those around them.

        Args:
            rows: Places in the selection, all of one window; windows that are asked for in order are each read once.

        Returns:
            The makings of the window, and the places of the rows among them.
        """
        if self._source is None or rows[0] < self._place.start:
            self._windows = _sources(self._selection)
            self._place, self._source = next(self._windows)
        while rows[0] >= self._place.stop:
            self._place, self._source = next(self._windows)
        assert rows.max() < self._place.stop, "rows of two windows"
        return self._source, rows - self._place.start


def _sources(selection: Selection) -> Iterator[tuple[slice, ConditionSource]]:
    """Yield the makings of the conditions of each window, with its places in the selection."""
    for place, chunk in selection.windows(_COLUMNS):
        joints, offsets = chunk.joints, chunk.offsets
        about = selection.sequence_ids[place], selection.n_frames[place], selection.fps, tuple(chunk.strings("text"))
        poses = {"initial_joints": joints[offsets[:-1]], "goal_joints": joints[offsets[1:] - 1]}
        poses["previous_joints"] = chunk.poses("previous_joints").copy()
        location, tilt = chunk.vectors("goal_location").copy(), chunk.numbers("head_tilt_deg").copy()
        yield place, ConditionSource(*about, **poses, goal_location=location, head_tilt_deg=tilt)


def run_salt(seed: int, table_identity: str) -> bytes:
    """Key of the opaque ids; resumed, isolated and offline runs of one seed and table agree on it."""
    return hashlib.sha256(f"prbench opaque ids/{seed}/{table_identity}".encode()).digest()


def opaque_ids(sequence_ids: Iterable[str], salt: bytes) -> list[str]:
    """HMAC-SHA256 of each id: tells sequences apart without telling which they are."""
    return [hmac.new(salt, name.encode(), hashlib.sha256).hexdigest() for name in sequence_ids]


def derangement(selection: Selection, *, seed: int) -> Int[np.ndarray, " n"]:
    """Assign another sequence to each chosen one: a single cycle through all of them (Sattolo's algorithm).

    Depends on the seed and on which sequences of the table were chosen.

    Raises:
        UsageError: if there is no other sequence.
    """
    n = len(selection)
    if n < 2:
        found = f"found {n} in split '{selection.split}' of {selection.table.folder}"
        raise UsageError(f"shuffled goals need two sequences or more, {found}. Raise --limit or choose another split.")
    # The digest of the choice is part of the seed: with another --limit the goals are dealt anew.
    generator = named_generator("shuffled-goal", seed, text_digest(selection.table.identity, selection.digest))
    order = np.arange(n)
    # integers(last) never gives `last` itself, so no sequence keeps its own goal (Sattolo).
    for last in range(n - 1, 0, -1):
        chosen = int(generator.integers(last))
        order[last], order[chosen] = order[chosen], order[last]
    return order
