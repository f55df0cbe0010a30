"""The contract of a method: what a third party implements.

An installed package offers a method by an entry point in the group ``prbench.adapters`` that names a callable
``load(weights, *, options, device) -> Adapter``. Importing the module must be cheap: weights and heavy packages load
on first use.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, Shaped

from prbench.contract.conditions import Condition, ConditionBatch
from prbench.entry_points import ADAPTERS
from prbench.sequences.table import SequenceTable

ENTRY_POINT_GROUP = ADAPTERS


@dataclass(frozen=True)
class Cost:
    """The effort that a method declares itself; time and memory are measured by the harness."""

    network_passes: int


@dataclass(frozen=True)
class Gaze:
    """Generated gaze of a batch: one ray a frame, in the frame of the motions (docs/specification/protocol.md#gaze).

    Padding is that of the motions and is never looked at.
    """

    origin: Float[np.ndarray, "batch frames 3"]
    """Between the eyes, within 0.3 m of the motion's own head joint; metres."""
    direction: Float[np.ndarray, "batch frames 3"]
    """Unit vectors."""


@dataclass(frozen=True)
class Motions:
    """Generated joint positions of a batch, in the canonical frame of each sequence's first frame, metres.

    Row i is valid up to ``n_frames[i]``; what stands behind is padding and is never looked at.
    """

    joints: Float[np.ndarray, "batch frames 22 3"]
    n_frames: Int[np.ndarray, " batch"]
    cost: Cost | None = None
    gaze: Gaze | None = None
    """Of a method that declares ``gaze``; None for all others."""

    def ragged(self) -> Shaped[np.ndarray, "total 22 3"]:
        """The valid frames of all rows after one another."""
        valid = np.arange(self.joints.shape[1]) < self.n_frames[:, None]
        return self.joints[valid]


@dataclass(frozen=True)
class TrainingRun:
    """Given to :meth:`prbench.contract.adapter.Trainable.fit`."""

    folder: Path
    """Folder for checkpoints and logs; kept per table identity, so that a fit is done once."""
    seed: int
    device: str


@runtime_checkable
class Adapter(Protocol):
    """A motion generator.

    Optional attributes are honoured when present: ``max_frames`` (longer sequences are counted as unsupported,
    never cut), ``native_fps`` (the harness then gives ``n_frames`` and ``fps`` at that rate and resamples the
    result to the table's grid), ``motionless`` (true for a method whose motions stand still; its Foot Skating is
    printed as a dash), ``gaze`` (true for a method whose motions bring :class:`Gaze`) and ``wants_obstacles`` (true to
    be given ``batch.obstacles``, the solid boxes around each sequence). Runs of either kind are marked and ranked
    nowhere.

    So is one optional method, ``weights_for(condition) -> Path | None``: the file or folder of the weights that the
    method will use under this condition. ``run.json`` then records their name and digest, and a run is not resumed
    with others. A method that comes with weights needs it, and so does one that accepts names of weights where a path
    is expected (``--weights NAME``); otherwise the path that the user gave is recorded.
    """

    name: str
    conditions: frozenset[Condition]

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:
        """Generate one motion for each row, of exactly ``batch.n_frames`` frames.

        Args:
            batch: What the method may know. ``batch.noise_seed`` is the only source of randomness, so that neither
                batch size nor order changes a motion.
            seed: The run's seed, for the record only.
        """
        ...


@runtime_checkable
class Trainable(Adapter, Protocol):
    """A method that learns from a table before it generates."""

    def fit(self, train: SequenceTable, *, validation: SequenceTable | None, run: TrainingRun) -> None:
        """Learn from ``train``; a run hands over a table that shows the rows of split ``train`` only.

        Leave what was learnt in ``run.folder``, and take it from there if it already holds a finished fit: every
        process of a run calls this once. A run fits a method by itself if it was given no weights.
        """
        ...


@runtime_checkable
class LoadAdapter(Protocol):
    """The function that an entry point names."""

    def __call__(self, weights: Path | None, *, options: Mapping[str, str], device: str) -> Adapter:
        """Make the adapter.

        Args:
            weights: A file or folder given by the user, or None for the method's default. A single word that is no
                path may come too, as the name of weights that the method knows; refuse unknown ones.
            options: ``--option key=value`` as given; unknown keys must be refused with a ``ValueError``.
            device: ``cpu``, ``cuda``, ``cuda:1`` …
        """
        ...
