"""Multimodal distance, diversity and multimodality. Euclidean, float64.

Source: docs/specification/text-to-motion-eval.md#metrics.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

DIVERSITY_PAIRS = 300
MULTIMODALITY_PROMPTS = 100
MULTIMODALITY_SAMPLES = 30
"""Motions generated for each prompt."""
MULTIMODALITY_PAIRS = 10
"""Pairs of them that are compared."""


def multimodal_distance(
    text: Float[np.ndarray, "pairs dimension"], motion: Float[np.ndarray, "pairs dimension"]
) -> float:
    """Mean distance between each text and its own motion, also called the matching score; lower is better."""
    return _mean_distance(text, motion)


def diversity(motion: Float[np.ndarray, "motions dimension"], pairs: Int[np.ndarray, "2 pairs"]) -> float:
    """Mean distance of random pairs of motions; best near that of recorded motions.

    Args:
        motion: Embeddings.
        pairs: From :func:`draw_diversity_pairs`.
    """
    return _mean_distance(motion[pairs[0]], motion[pairs[1]])


def draw_diversity_pairs(
    n_motions: int, generator: np.random.Generator, *, n_pairs: int = DIVERSITY_PAIRS
) -> Int[np.ndarray, "2 pairs"]:
    """Two sets of motions, each without repetition. They may overlap, and a motion may meet itself.

    Raises:
        ValueError: if there are not more motions than pairs.
    """
    if n_motions <= n_pairs:
        raise ValueError(f"diversity over {n_pairs} pairs needs more than {n_pairs} motions, found {n_motions}")
    return np.stack([generator.choice(n_motions, n_pairs, replace=False) for _ in range(2)])


def multimodality(motion: Float[np.ndarray, "prompts samples dimension"], pairs: Int[np.ndarray, "2 pairs"]) -> float:
    """Mean distance of random pairs among the motions of one prompt, over all prompts.

    Args:
        motion: Embeddings of several motions of each prompt.
        pairs: From :func:`draw_multimodality_pairs`; the same for all prompts.
    """
    return _mean_distance(motion[:, pairs[0]], motion[:, pairs[1]])


def draw_multimodality_pairs(
    n_samples: int, generator: np.random.Generator, *, n_pairs: int = MULTIMODALITY_PAIRS
) -> Int[np.ndarray, "2 pairs"]:
    """Two sets of samples, each without repetition.

    Raises:
        ValueError: if there are fewer samples than pairs.
    """
    if n_samples < n_pairs:
        raise ValueError(f"multimodality over {n_pairs} pairs needs at least {n_pairs} samples, found {n_samples}")
    return np.stack([generator.choice(n_samples, n_pairs, replace=False) for _ in range(2)])


def _mean_distance(first: Float[np.ndarray, "*rows dimension"], second: Float[np.ndarray, "*rows dimension"]) -> float:
    difference = first.astype(np.float64) - second.astype(np.float64)
    return float(np.sqrt(np.square(difference).sum(axis=-1)).mean())
