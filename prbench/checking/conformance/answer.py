"""One call of a method, with everything that was seen while it was under way."""

from __future__ import annotations

import dataclasses
import math
import time
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from prbench.checking.conformance import global_random
from prbench.contract import Adapter, ConditionBatch, Motions
from prbench.errors import PrbenchError
from prbench.methods.motions import generate_checked
from prbench.methods.threads import computing_threads

STATE_SEED = 20_240_607
"""Of the global generators before every call, so that only the check that is about them sees them at work."""
_COPIED = ("n_frames", "initial_joints", "previous_joints", "goal_joints", "goal_location")


@dataclass(frozen=True)
class Answer:
    """What a method made of a batch."""

    batch: ConditionBatch
    """At the table's rate."""
    motions: Motions | None
    """Checked but for their distance from the origin, float32, at the table's rate; None if they are no motions."""
    error: str = ""
    """Why, in the harness's words."""
    returned: object = None
    """What the method itself gave back."""
    answered: bool = False
    """It came to its end without raising."""
    seconds: float = 0.0
    halvings: int = 0
    overwritten: tuple[str, ...] = ()
    """Fields of the batch that it wrote into."""
    drew_from: tuple[str, ...] = ()
    """Global generators whose state moved."""

    @property
    def raised(self) -> bool:
        """The method gave nothing back."""
        return not self.answered

    def motion(self, row: int) -> Float[np.ndarray, "frames 22 3"]:
        """One motion without padding."""
        assert self.motions is not None
        return self.motions.joints[row, : int(self.batch.n_frames[row])]


@dataclass
class _Watched:
    """The method as the harness sees it, with an eye on what goes in and comes out."""

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
        states = global_random.states()
        started = time.perf_counter()
        try:
            self.returned = self.adapter.generate(batch, seed=seed)
            self.answered = True
        finally:
            self.seconds += time.perf_counter() - started
            self.drew_from.update(global_random.touched(states))
            after = {name: getattr(batch, name) for name in before}
            self.overwritten |= {name for name in before if not np.array_equal(before[name], after[name])}
        return self.returned  # type: ignore[return-value] - whatever it is, the harness checks it


def ask(adapter: Adapter, batch: ConditionBatch, *, seed: int, state_seed: int, threads: int) -> Answer:
    """One call, as a run makes it; whatever the method raises becomes part of the answer.

    Args:
        adapter: The method.
        batch: What it is asked, at the table's rate.
        seed: The run's seed.
        state_seed: Of the global generators.
        threads: Of NumPy's and torch's libraries.
    """
    watched = _Watched(adapter)
    motions, halvings, error = None, 0, ""
    own = dataclasses.replace(batch)
    try:
        with computing_threads(threads), global_random.set_to(state_seed):
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
