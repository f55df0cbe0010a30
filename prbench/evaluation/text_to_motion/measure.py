"""All text-to-motion metrics of one set of embedded pairs: one repetition."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.evaluation.text_to_motion.metrics import (
    DIVERSITY_PAIRS,
    TOP,
    FewSamplesWarning,
    RPrecision,
    diversity,
    draw_diversity_pairs,
    fid,
    multimodal_distance,
    r_precision,
)

_R_PRECISION = tuple(f"r_precision_top_{k}" for k in range(1, TOP + 1))
FID = "fid"
_DISTANCE = "multimodal_distance"
_DIVERSITY = "diversity"
MULTIMODALITY = "multimodality"
METRICS = (*_R_PRECISION, FID, _DISTANCE, _DIVERSITY, MULTIMODALITY)
"""Ids in the order in which they are shown; R-precision as shares from 0 to 1."""


@dataclass(frozen=True)
class EmbeddedPairs:
    """Texts with their motions in the evaluator's space."""

    captions: tuple[str, ...]
    text: Float[np.ndarray, "pairs dimension"]
    motion: Float[np.ndarray, "pairs dimension"]

    def shuffled(self, generator: np.random.Generator) -> EmbeddedPairs:
        """Return the same pairs in another order: it decides which 32 are ranked together."""
        order = generator.permutation(len(self.captions))
        return EmbeddedPairs(tuple(self.captions[i] for i in order), self.text[order], self.motion[order])

    def mismatched(self) -> EmbeddedPairs:
        """Every motion with the text of the pair before: what chance scores."""
        captions = (self.captions[-1], *self.captions[:-1])
        return EmbeddedPairs(captions, np.roll(self.text, 1, axis=0), self.motion)


@dataclass(frozen=True)
class Measured:
    """One repetition."""

    values: dict[str, float]
    """Values by the ids of :data:`METRICS`."""
    ranking: RPrecision


def measure_pairs(pairs: EmbeddedPairs) -> Measured:
    """R-precision and multimodal distance.

    Raises:
        ValueError: if there are fewer than 32 pairs.
    """
    ranking = r_precision(pairs.text, pairs.motion, pairs.captions)
    values = dict(zip(_R_PRECISION, ranking.top.tolist()))
    return Measured(values | {_DISTANCE: multimodal_distance(pairs.text, pairs.motion)}, ranking)


def measure_motions(
    motion: Float[np.ndarray, "motions dimension"],
    recorded: Float[np.ndarray, "recorded dimension"],
    generator: np.random.Generator,
    *,
    diversity_pairs: int = DIVERSITY_PAIRS,
) -> dict[str, float]:
    """FID to recorded motions, and diversity. That few samples bias FID is said once, by whoever reports it.

    Raises:
        ValueError: if there are not more motions than pairs.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)
        distance = fid(recorded, motion)
    pairs = draw_diversity_pairs(len(motion), generator, n_pairs=diversity_pairs)
    return {FID: distance, _DIVERSITY: diversity(motion, pairs)}


@dataclass(frozen=True)
class Repeated:
    """One number over repetitions of the whole evaluation. The interval says how far chance moves the mean of these
    repetitions; it knows nothing of the choice of recordings or of training.
    """  # noqa: D205

    mean: float
    half_width: float | None
    """1.96 · population standard deviation / √repetitions; None for a single one."""
    values: tuple[float, ...]
    """One a repetition."""

    @classmethod
    def of(cls, values: Sequence[float]) -> Repeated:
        """Summarise the values of at least one repetition."""
        numbers = np.asarray(values, dtype=np.float64)
        half = 1.96 * float(numbers.std()) / float(np.sqrt(len(numbers))) if len(numbers) > 1 else None
        return cls(float(numbers.mean()), half, tuple(float(number) for number in numbers))
