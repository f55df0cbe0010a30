"""Asks a method for motions, notes everything that happens during the call, and compares two answers."""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from prbench.checking.conformance.generators import generator_states, generators_set_to, generators_touched
from prbench.contract import Adapter, ConditionBatch, Motions
from prbench.errors import PrbenchError
from prbench.harness.methods.motions import generate_checked
from prbench.harness.methods.process import computing_threads

STATE_SEED = 20_240_607
"""Seed of the global generators before every call. Only the check of global generators uses another one."""
_COPIED = ("n_frames", "initial_joints", "previous_joints", "goal_joints", "goal_location")
TOLERANCE = 1e-4
"""Metres by which a motion may change where only rounding differs (docs/specification/protocol.md#reproducibility)."""


@dataclass(frozen=True)
class Answer:
    """The answer of a method to a batch."""

    batch: ConditionBatch
    """At the table's rate."""
    motions: Motions | None
    """Checked but for their distance from the origin, float32, at the table's rate; None if they are no motions."""
    error: str = ""
    """The reason, as the harness words it."""
    returned: object = None
    """The object that the method itself returned."""
    answered: bool = False
    """True if the method returned without raising."""
    seconds: float = 0.0
    halvings: int = 0
    overwritten: tuple[str, ...] = ()
    """Fields of the batch that it wrote into."""
    drew_from: tuple[str, ...] = ()
    """Global generators whose state moved."""

    @property
    def raised(self) -> bool:
        """True if the method returned nothing."""
        return not self.answered

    def motion(self, row: int) -> Float[np.ndarray, "frames 22 3"]:
        """Return one motion without padding, metres."""
        assert self.motions is not None
        return self.motions.joints[row, : int(self.batch.n_frames[row])]


@dataclass
class _Watched:
    """Wraps a method and records what goes in and what comes out."""

    adapter: Adapter
    returned: object = None
    answered: bool = False
    overwritten: set[str] = field(default_factory=set)
    drew_from: set[str] = field(default_factory=set)
    seconds: float = 0.0

    def __getattr__(self, name: str) -> object:
        return getattr(self.adapter, name)

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:
        """Generate, and compare the batch and the global generators with what they were."""
        before = {name: getattr(batch, name).copy() for name in _COPIED if getattr(batch, name) is not None}
        states = generator_states()
        started = time.perf_counter()
        try:
            self.returned = self.adapter.generate(batch, seed=seed)
            self.answered = True
        finally:
            self.seconds += time.perf_counter() - started
            self.drew_from.update(generators_touched(states))
            after = {name: getattr(batch, name) for name in before}
            self.overwritten |= {name for name in before if not np.array_equal(before[name], after[name])}
        return self.returned  # type: ignore[return-value] - whatever it is, the harness checks it


def ask(adapter: Adapter, batch: ConditionBatch, *, seed: int, state_seed: int, threads: int) -> Answer:
    """Call the method as a run does; whatever it raises becomes part of the answer.

    Args:
        adapter: The method.
        batch: What it is asked, at the table's rate.
        seed: The run's seed.
        state_seed: Of the global generators.
        threads: Of NumPy's and torch's libraries.
    """
    watched = _Watched(adapter)
    motions = None
    halvings = 0
    error = ""
    # A method may keep or change its batch; the answer holds the one that was meant.
    own = dataclasses.replace(batch)
    try:
        with computing_threads(threads), generators_set_to(state_seed):
            motions, halvings = generate_checked(
                watched,  # type: ignore[arg-type] - its other attributes are the method's
                own,
                seed=seed,
                method=str(getattr(adapter, "name", "?")),
                sequence_ids=[f"#{row}" for row in range(len(batch))],
                farthest=math.inf,  # how far out a body is, and in which unit, is the doctor's to say
            )
    except PrbenchError as raised:
        error = str(raised)
    return Answer(
        batch,
        motions,
        error,
        watched.returned,
        watched.answered,
        watched.seconds,
        halvings,
        overwritten=tuple(sorted(watched.overwritten)),
        drew_from=tuple(sorted(watched.drew_from)),
    )


@runtime_checkable
class AnyAnswer(Protocol):
    """What comparisons need of an answer, whatever was asked."""

    @property
    def batch(self) -> Any:
        """Return what was asked."""
        ...

    @property
    def motions(self) -> Any:
        """Return what was answered, as far as the harness accepts it; else None."""
        ...

    @property
    def error(self) -> str:
        """Return why the harness does not accept it; empty where it does."""
        ...

    @property
    def seconds(self) -> float:
        """Return how long the answer took."""
        ...

    def motion(self, row: int) -> Float[np.ndarray, "*frames joints 3"]:
        """Return what was answered to one row, metres."""
        ...


def largest_changes(first: AnyAnswer, second: AnyAnswer, rows: list[int] | None = None) -> Float[np.ndarray, " rows"]:
    """Return for each motion the largest distance of any joint in any frame between two answers, metres.

    Args:
        first: Any answer with motions.
        second: Answers rows of the same lengths.
        rows: Where in ``first`` each row of ``second`` stands; None for the same order.
    """
    places = range(len(second.batch)) if rows is None else rows
    return np.array(
        [
            float(np.linalg.norm(first.motion(place) - second.motion(row), axis=-1).max())
            for row, place in enumerate(places)
        ]
    )


def same_bytes(first: AnyAnswer, second: AnyAnswer) -> bool:
    """Return True if two answers to the same batch hold the same numbers to the last bit."""
    return all(np.array_equal(first.motion(row), second.motion(row)) for row in range(len(first.batch)))


def metres(distance: float) -> str:
    """Write a distance in a unit that is easy to read.

    >>> metres(0.034)
    '3.4 cm'
    """
    if distance >= 1:
        return f"{distance:.2f} m"
    if distance >= 0.001:
        return f"{distance * 100:.1f} cm"
    return f"{distance:.1e} m" if distance else "0 m"
