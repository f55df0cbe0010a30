"""Asks a predictor for futures, and notes everything that happens during the call."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.checking.conformance.generators import generator_states, generators_set_to, generators_touched
from prbench.errors import PrbenchError
from prbench.harness.methods.motions import told
from prbench.harness.methods.process import computing_threads
from prbench.prediction.batch import Futures, ObservedBatch, Predictor, require_futures


@dataclass(frozen=True)
class FuturesAnswer:
    """The answer of a predictor to a batch."""

    batch: ObservedBatch
    n_samples: int
    motions: Futures | None
    """As the harness accepts them, float32; None if it does not."""
    error: str = ""
    """The reason, as the harness words it."""
    returned: object = None
    """The object that the predictor itself returned."""
    answered: bool = False
    """True if it returned without raising."""
    seconds: float = 0.0
    drew_from: tuple[str, ...] = ()
    """Global generators whose state moved."""

    def motion(self, row: int) -> Float[np.ndarray, "samples future joints 3"]:
        """Return the futures of one window, metres."""
        assert self.motions is not None
        return self.motions.joints[row]

    @property
    def given_joints(self) -> np.ndarray | None:
        """The positions as the predictor returned them; None if it returned nothing with such."""
        joints = getattr(self.returned, "joints", None)
        return None if joints is None else np.asarray(joints)


def ask_predictor(
    predictor: Predictor, batch: ObservedBatch, *, n_samples: int, seed: int, state_seed: int, threads: int
) -> FuturesAnswer:
    """Call the predictor as a run does; whatever it raises becomes part of the answer.

    Args:
        predictor: The predictor.
        batch: What it is asked.
        n_samples: Futures of each window.
        seed: The run's seed.
        state_seed: Of the global generators.
        threads: Of NumPy's and torch's libraries.
    """
    returned: object = None
    motions = None
    answered = False
    error = ""
    drew: tuple[str, ...] = ()
    started = time.perf_counter()
    try:
        with computing_threads(threads), generators_set_to(state_seed):
            before = generator_states()
            try:
                returned = predictor.predict(batch, n_samples=n_samples, seed=seed)
                answered = True
            finally:
                drew = generators_touched(before)
        futures = require_futures(returned, batch, n_samples, predictor=str(getattr(predictor, "name", "?")))
        motions = Futures(joints=np.asarray(futures.joints, dtype=np.float32))
    except PrbenchError as raised:
        error = str(raised)
    except (Exception, SystemExit) as raised:
        error = f"it raised {told(raised)}."
    seconds = time.perf_counter() - started
    return FuturesAnswer(batch, n_samples, motions, error, returned, answered, seconds, drew)
