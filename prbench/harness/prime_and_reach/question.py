"""The sequences of one batch as a method of prime-and-reach may see them, and the motions that are kept of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.contract import ConditionBatch, Motions
from prbench.harness.benchmark import Answer
from prbench.harness.best_of import ChoiceRules, best_motions
from prbench.harness.carry_on import placed
from prbench.harness.methods.loaded_methods import LoadedMethod
from prbench.harness.methods.motions import generate_checked
from prbench.harness.run_folder.predictions import PredictionRows


@dataclass(frozen=True)
class MotionQuestion:
    """See :class:`prbench.harness.benchmark.Question`; the method sees nothing but ``conditions``."""

    conditions: tuple[ConditionBatch, ...]
    """One batch for each motion drawn of a sequence; they differ in their noise seeds only."""
    choice: ChoiceRules
    """What is kept of them, which the method never sees."""
    given: Motions | None
    """Motions that the harness itself supplies (controls), instead of the method's."""
    placements: tuple[Float[np.ndarray, "batch 4 4"], ...] = ()
    """For each sample the frames of the table from those of the conditions; empty where they are the same."""

    def ask(
        self, method: LoadedMethod | None, *, seed: int, sequence_ids: tuple[str, ...], measure: Callable[[], None]
    ) -> Answer:
        """See :class:`prbench.harness.benchmark.Question`."""
        if method is None:
            assert self.given is not None
            rows = _rows(self.given)
            return Answer([rows] * len(self.conditions), [batch.noise_seed for batch in self.conditions])
        samples: list[Motions] = []
        seeds: list[tuple[int, ...]] = []
        halvings = 0
        for first in range(0, len(self.conditions), self.choice.best_of):
            batches = self.conditions[first : first + self.choice.best_of]
            draws: list[Motions] = []
            for batch in batches:
                motions, halved = generate_checked(
                    method.adapter, batch, seed=seed, method=method.name, sequence_ids=sequence_ids
                )
                draws.append(motions)
                halvings += halved
                measure()
            kept, chosen = best_motions(draws, batches, self.choice) if len(draws) > 1 else _only(draws)
            if self.placements:
                kept = placed(kept, self.placements[len(samples)])
            samples.append(kept)
            seeds.append(tuple(batches[draw].noise_seed[row] for row, draw in enumerate(chosen)))
        declared = [motions.cost.network_passes for motions in samples if motions.cost is not None]
        return Answer(list(map(_rows, samples)), seeds, halvings, sum(declared) if declared else None)


def _rows(motions: Motions) -> PredictionRows:
    rays = None
    if motions.gaze is not None:
        rays = np.stack((motions.gaze.origin, motions.gaze.direction), axis=2)
    return PredictionRows.from_padded(motions.joints, motions.n_frames, gaze=rays)


def _only(draws: list[Motions]) -> tuple[Motions, Int[np.ndarray, " batch"]]:
    """The one draw there is; under a condition without goal there is nothing to choose by."""
    return draws[0], np.zeros(len(draws[0].n_frames), dtype=np.int64)
