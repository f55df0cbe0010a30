"""Turns table rows into what a method may know: the firewall between a method and the recorded motion.

A :class:`ConditionSource` holds what conditions are made of for all chosen sequences (first, previous and last frame,
text, goal), about 1 kB a sequence. It copies these out of the table, so that nothing that a batch refers to leads back
to the recorded frames in between.
"""

from __future__ import annotations

import dataclasses
import hashlib
import hmac
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from prbench.boxes import Boxes
from prbench.contract import GIVEN, Condition, ConditionBatch
from prbench.errors import UsageError
from prbench.evaluation.obstacles import SCENE_COLUMNS, SolidBoxes
from prbench.evaluation.planning import Selection
from prbench.randomness import named_generator, noise_seed
from prbench.storage import text_digest

_COLUMNS = ["text", "goal_location", "joints", "previous_joints", "head_tilt_deg"]


@dataclass(frozen=True)
class ConditionSource:
    """The makings of conditions, one row a chosen sequence; canonical frame, metres."""

    sequence_ids: tuple[str, ...]
    n_frames: Int[np.ndarray, " n"]
    fps: float
    text: tuple[str, ...]
    initial_joints: Float[np.ndarray, "n 22 3"]
    previous_joints: Float[np.ndarray, "n 22 3"]
    goal_joints: Float[np.ndarray, "n 22 3"]
    goal_location: Float[np.ndarray, "n 3"]
    head_tilt_deg: Float[np.ndarray, " n"]
    """Never part of a condition; the harness's own scripted motion needs it."""
    obstacles: Boxes | None = None
    """The solid boxes around each sequence, where the method asks for them."""

    @classmethod
    def read(cls, selection: Selection, *, obstacles: bool = False) -> ConditionSource:
        """Stream the chosen rows of a table once and keep what conditions need.

        Args:
            selection: The sequences.
            obstacles: Keep the solid boxes around them, too.

        Raises:
            UsageError: if boxes are wanted and the table knows of none.
        """
        scene = SolidBoxes.of(selection.table) if obstacles else None
        if obstacles and scene is None:
            raise UsageError(
                f"{selection.table.folder}: expected the boxes of the scene (scenes.parquet), which the method"
                " asks for, found none. Build the table again (ADT, MoGaze, synthetic people), or leave the method's"
                " option out."
            )
        boxes: list[Boxes] = []
        text: list[str] = []
        parts: dict[str, list[np.ndarray]] = {name: [] for name in ("initial", "previous", "last", "goal", "tilt")}
        for _, chunk in selection.windows(_COLUMNS + (SCENE_COLUMNS if scene else [])):
            boxes += [scene.around(chunk)] if scene else []
            text += chunk.strings("text")
            joints = chunk.joints
            offsets = chunk.offsets
            parts["initial"].append(joints[offsets[:-1]])
            parts["last"].append(joints[offsets[1:] - 1])
            parts["previous"].append(chunk.poses("previous_joints"))
            parts["goal"].append(chunk.vectors("goal_location"))
            parts["tilt"].append(chunk.numbers("head_tilt_deg"))
        joined = {name: np.concatenate(arrays) for name, arrays in parts.items()}
        return cls(
            selection.sequence_ids,
            selection.n_frames,
            selection.fps,
            tuple(text),
            joined["initial"],
            joined["previous"],
            joined["last"],
            joined["goal"],
            joined["tilt"],
            Boxes.joined(boxes) if scene else None,
        )

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
            salt: Of :func:`run_salt`.
            sample: Index of the motion drawn for each sequence.
        """
        ids = [self.sequence_ids[row] for row in rows]
        given: dict[str, Any] = {name: _rows_of(getattr(self, name), rows) for name in GIVEN[condition]}
        return ConditionBatch(
            condition=condition,
            n_frames=self.n_frames[rows],
            fps=self.fps,
            opaque_id=tuple(opaque_ids(ids, salt)),
            noise_seed=tuple(noise_seed(seed, name, sample) for name in ids),
            obstacles=None if self.obstacles is None else self.obstacles.of_rows(rows),
            **given,
        )

    def redrawn(
        self, batch: ConditionBatch, rows: Int[np.ndarray, " rows"], *, seed: int, sample: int
    ) -> ConditionBatch:
        """The batch of the same rows for another sample: only the noise seeds differ."""
        seeds = tuple(noise_seed(seed, self.sequence_ids[row], sample) for row in rows)
        return dataclasses.replace(batch, noise_seed=seeds)


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
        raise UsageError(
            f"shuffled goals need two sequences or more, found {n} in split '{selection.split}' of"
            f" {selection.table.folder}. Raise --limit or choose another split."
        )
    # The digest of the choice is part of the seed: with another --limit the goals are dealt anew.
    generator = named_generator("shuffled-goal", seed, text_digest(selection.table.identity, selection.digest))
    order = np.arange(n)
    # integers(last) never gives `last` itself, so no sequence keeps its own goal (Sattolo).
    for last in range(n - 1, 0, -1):
        chosen = int(generator.integers(last))
        order[last], order[chosen] = order[chosen], order[last]
    return order


def _rows_of(values: tuple[str, ...] | np.ndarray, rows: np.ndarray) -> tuple[str, ...] | np.ndarray:
    return tuple(values[row] for row in rows) if isinstance(values, tuple) else values[rows]
