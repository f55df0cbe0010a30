"""Everything that a third party imports to add a method: the contract, and all that a method is given.

An installed package offers a method by an entry point in the group ``prbench.adapters`` that names a callable
``load(weights, *, options, device) -> Adapter``. Importing the module must be cheap: weights and heavy packages load
on first use. :class:`ConditionBatch` is the firewall between a method and the recorded motion, as a type.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, Shaped

from prbench.entry_points import ADAPTERS
from prbench.sequences.table import SequenceTable

_INITIAL_STATE = frozenset({"initial_joints", "previous_joints"})


class Condition(StrEnum):
    """The four conditions of the protocol (*Prime and Reach*, table 2)."""

    NONE = "none"
    TEXT = "text"
    GOAL_POSE = "goal-pose"
    GOAL_LOCATION = "goal-loc"


# Fields of a :class:`ConditionBatch` that each condition fills; all the others are None.
GIVEN: dict[Condition, frozenset[str]] = {
    Condition.NONE: frozenset(),
    Condition.TEXT: frozenset({"text"}),
    Condition.GOAL_POSE: frozenset({"text", "goal_joints"}) | _INITIAL_STATE,
    Condition.GOAL_LOCATION: frozenset({"text", "goal_location"}) | _INITIAL_STATE,
}


@dataclass(frozen=True, kw_only=True)
class ConditionBatch:
    """Everything that a method may know about B sequences. Canonical frame, metres.

    There is no ground truth here, no gaze, no prime time, no path, and no id that leads to them. Where the initial
    state is given, whoever has the table can still recognise a sequence by it; the firewall prevents accidents.

    Attributes:
        n_frames: Frames to generate, at ``fps``.
        opaque_id: Names the sequences within one run without telling which they are.
        noise_seed: One per sequence, 63 bits: the only source of randomness
            (``prbench.randomness.sequence_generator``).
        initial_joints: The recorded first frame.
        previous_joints: The frame before it, for the initial velocity.
        goal_joints: The recorded last frame (``goal-pose`` only).
        goal_location: Centre of the object, or of the place it is put to (``goal-loc`` only).
    """

    condition: Condition
    n_frames: Int[np.ndarray, " batch"]
    fps: float
    opaque_id: tuple[str, ...]
    noise_seed: tuple[int, ...]
    text: tuple[str, ...] | None = None
    initial_joints: Float[np.ndarray, "batch 22 3"] | None = None
    previous_joints: Float[np.ndarray, "batch 22 3"] | None = None
    goal_joints: Float[np.ndarray, "batch 22 3"] | None = None
    goal_location: Float[np.ndarray, "batch 3"] | None = None

    def __post_init__(self) -> None:
        for name in sorted(frozenset().union(*GIVEN.values())):
            given = getattr(self, name) is not None
            if given is not (name in GIVEN[self.condition]):
                raise ValueError(f"condition {self.condition.value}: '{name}' must {'not ' if given else ''}be given")
            if given and len(getattr(self, name)) != len(self):
                raise ValueError(f"'{name}' has {len(getattr(self, name))} rows, the batch has {len(self)}")
        if len(self.opaque_id) != len(self) or len(self.noise_seed) != len(self):
            raise ValueError("opaque_id and noise_seed need one entry a sequence")

    def __len__(self) -> int:
        return len(self.n_frames)

    def rows(self, start: int, stop: int) -> ConditionBatch:
        """Return a part of the batch; every row is complete in itself."""
        part = slice(start, stop)
        return ConditionBatch(
            condition=self.condition,
            n_frames=self.n_frames[part],
            fps=self.fps,
            opaque_id=self.opaque_id[part],
            noise_seed=self.noise_seed[part],
            **{name: getattr(self, name)[part] for name in GIVEN[self.condition]},
        )


ENTRY_POINT_GROUP = ADAPTERS


@dataclass(frozen=True)
class Cost:
    """The effort that a method declares itself; time and memory are measured by the harness."""

    network_passes: int


@dataclass(frozen=True)
class Gaze:
    """Generated gaze of a batch: one ray a frame, in the frame of the motions (docs/specification/protocol.md#gaze).

    Padding is that of the motions and is never looked at.

    Attributes:
        origin: Between the eyes, within 0.3 m of the motion's own head joint; metres.
        direction: Unit vectors.
    """

    origin: Float[np.ndarray, "batch frames 3"]
    direction: Float[np.ndarray, "batch frames 3"]


@dataclass(frozen=True)
class Motions:
    """Generated joint positions of a batch, in the canonical frame of each sequence's first frame, metres.

    Row i is valid up to ``n_frames[i]``; what stands behind is padding and is never looked at.

    Attributes:
        gaze: Generated gaze of a method that declares ``gaze``; None for all others.
    """

    joints: Float[np.ndarray, "batch frames 22 3"]
    n_frames: Int[np.ndarray, " batch"]
    cost: Cost | None = None
    gaze: Gaze | None = None

    def ragged(self) -> Shaped[np.ndarray, "total 22 3"]:
        """Return the valid frames of all rows after one another."""
        return self.joints[np.arange(self.joints.shape[1]) < self.n_frames[:, None]]


@dataclass(frozen=True)
class TrainingRun:
    """Given to :meth:`prbench.contract.Trainable.fit`.

    Attributes:
        folder: Folder for checkpoints and logs; kept per table identity, so that a fit is done once.
    """

    folder: Path
    seed: int
    device: str


@runtime_checkable
class Adapter(Protocol):
    """A motion generator.

    Optional attributes are honoured when present: ``max_frames`` (longer sequences are counted as unsupported,
    never cut), ``native_fps`` (the harness then gives ``n_frames`` and ``fps`` at that rate and resamples the
    result to the table's grid), ``motionless`` (true for a method whose motions stand still; its Foot Skating is
    printed as a dash) and ``gaze`` (true for a method whose motions bring :class:`Gaze`; its runs are marked and ranked
    nowhere).

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


@contextmanager
def sequence_noise(noise_seed: int) -> Iterator[None]:
    """Seed the global generators for one sequence; behind the block they go on as if nothing had been drawn.

    These are torch's, on the CPU and on CUDA devices (where torch is installed), ``numpy.random`` and ``random``.
    A sampler then makes the same motion in any batch, at any place and in any process, if it is called for one
    sequence at a time.

    Args:
        noise_seed: Seed of the sequence (``batch.noise_seed[row]``), 63 bits. On the CPU torch takes the lower 32 of
            them: of 10,000 sequences two draw the same noise with a probability of 1 %.
    """
    torch: Any = None
    with suppress(ImportError):
        import torch
    python_state = random.getstate()
    numpy_state = np.random.get_state()  # noqa: NPY002 - the generator that other people's samplers draw from
    with ExitStack() as stack:
        if torch is not None:
            devices = range(torch.cuda.device_count()) if torch.cuda.is_available() else ()
            # fork_rng puts the states back, so that a method leaves no trace in the generators of others.
            stack.enter_context(torch.random.fork_rng(devices=list(devices)))
            torch.manual_seed(noise_seed)
        random.seed(noise_seed)
        np.random.seed([noise_seed & 0xFFFFFFFF, noise_seed >> 32])  # noqa: NPY002 - likewise; it takes 32 bits a word
        try:
            yield
        finally:
            random.setstate(python_state)
            np.random.set_state(numpy_state)  # noqa: NPY002 - likewise


@contextmanager
def batch_noise(noise_seeds: Sequence[int]) -> Iterator[None]:
    """Let ``torch.randn`` and ``torch.randn_like`` draw each row of a batch from its own sequence.

    For samplers that work on a whole batch. Within the block both functions are replaced by such that draw one row
    after the other, on the CPU, each from a generator of its own ``noise_seed``; so a row gets the same noise in any
    batch, and on any device. The shape of a row must not depend on the batch: a sampler that draws as many frames as
    the longest sequence has gives other noise beside a longer one. Other draws from global generators
    (``torch.rand``, ``normal_``, dropout) follow the first row and differ with the batch: work on single sequences
    then (:func:`sequence_noise`).

    Args:
        noise_seeds: Seeds of the sequences (``batch.noise_seed``).

    Raises:
        ImportError: if there is no torch.
        ValueError: in the block, if something is drawn whose first dimension is not the batch.
    """
    import torch

    generators = [torch.Generator().manual_seed(noise_seed) for noise_seed in noise_seeds]
    randn = torch.randn

    def row_by_row(shape: Sequence[int], dtype: Any, device: Any, settings: dict[str, Any]) -> Any:
        if not len(shape) or shape[0] != len(generators):
            problem = f"expected a draw for the {len(generators)} sequences of the batch, one a row, found one of the"
            problem += f" shape {tuple(shape)}. Call the sampler for one sequence at a time, in"
            raise ValueError(f"{problem} sequence_noise(noise_seed).")
        # On the CPU whatever the device is: generators of a GPU draw other numbers from the same seed.
        rows = [randn(tuple(shape[1:]), generator=generator, dtype=dtype) for generator in generators]
        drawn = torch.stack(rows).to(device if device is not None else torch.empty(0).device)
        return drawn.requires_grad_() if settings.get("requires_grad") else drawn

    def randn_of_rows(*size: Any, dtype: Any = None, device: Any = None, **settings: Any) -> Any:
        if settings.get("generator") is not None:
            return randn(*size, dtype=dtype, device=device, **settings)
        shape = settings.pop("size", size)
        nested = len(shape) == 1 and not isinstance(shape[0], int)
        return row_by_row(shape[0] if nested else shape, dtype, device, settings)

    def randn_like_rows(like: Any, *, dtype: Any = None, device: Any = None, **settings: Any) -> Any:
        return row_by_row(like.shape, dtype or like.dtype, device if device is not None else like.device, settings)

    replaced = {"randn": randn_of_rows, "randn_like": randn_like_rows}
    kept = {name: getattr(torch, name) for name in replaced}
    with sequence_noise(noise_seeds[0]):
        try:
            for name, function in replaced.items():
                setattr(torch, name, function)
            yield
        finally:
            for name, function in kept.items():
                setattr(torch, name, function)
