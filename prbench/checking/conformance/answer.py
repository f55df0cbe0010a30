"""Asks a method for motions, notes everything that happens during the call, and compares two answers."""

from __future__ import annotations

import dataclasses
import math
import random
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from prbench.contract import Adapter, ConditionBatch, Motions
from prbench.errors import PrbenchError
from prbench.methods.motions import generate_checked
from prbench.methods.users_environment import computing_threads

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
        states = _generator_states()
        started = time.perf_counter()
        try:
            self.returned = self.adapter.generate(batch, seed=seed)
            self.answered = True
        finally:
            self.seconds += time.perf_counter() - started
            self.drew_from.update(_generators_touched(states))
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
        with computing_threads(threads), _generators_set_to(state_seed):
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


def _generators_touched(before: dict[str, bytes]) -> tuple[str, ...]:
    """Return the names of the generators whose state differs from ``before``."""
    return tuple(name for name, state in _generator_states().items() if before.get(name, state) != state)


def _generator_states() -> dict[str, bytes]:
    """Map the name of each global generator to its state."""
    # The key changes every 624 draws only; the place in it changes with each.
    _, key, *place = np.random.get_state(legacy=True)  # noqa: NPY002 - only looked at
    found = {
        "random": repr(random.getstate()).encode(),
        "numpy.random": np.asarray(key).tobytes() + repr(place).encode(),
    }
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "random"):
        found["torch"] = torch.random.get_rng_state().numpy().tobytes()
    return found


@contextmanager
def _generators_set_to(seed: int) -> Iterator[None]:
    """Seed all global generators, and restore their states at the end."""
    python = random.getstate()
    legacy = np.random.get_state()  # noqa: NPY002 - put back as it was
    torch = sys.modules.get("torch")
    drawn = torch.random.get_rng_state() if torch is not None and hasattr(torch, "random") else None
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - a method that draws from it is found out by another seed
    if torch is not None and drawn is not None:
        torch.random.manual_seed(seed)
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(legacy)  # noqa: NPY002 - put back as it was
        if torch is not None and drawn is not None:
            torch.random.set_rng_state(drawn)


def largest_changes(first: Answer, second: Answer, rows: list[int] | None = None) -> Float[np.ndarray, " rows"]:
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


def same_bytes(first: Answer, second: Answer) -> bool:
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
