"""R-precision: whether a text finds its own motion among 32 (docs/specification/text-to-motion-eval.md#metrics)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

BATCH = 32
"""Pairs that are ranked together. Part of the metric: the number means nothing with another one."""
TOP = 3


@dataclass(frozen=True, eq=False)
class RPrecision:
    """R-precision and what it was counted over."""

    top: Float[np.ndarray, " 3"]
    """Share of texts whose own motion is the nearest, among the two nearest, among the three nearest."""
    n_pairs: int
    """Pairs that were ranked: whole batches only."""
    n_dropped: int
    """Pairs of the last, incomplete batch."""
    n_duplicates: int
    """Ranked texts that another text of their batch equals. The other's motion counts as a wrong one."""


def r_precision(
    text: Float[np.ndarray, "pairs dimension"],
    motion: Float[np.ndarray, "pairs dimension"],
    captions: Sequence[str] | None = None,
) -> RPrecision:
    """Rank the motions of each batch of 32 pairs for each of its texts.

    A motion exactly as near as the text's own counts as nearer, so that equal embeddings earn nothing.

    Args:
        text: Embeddings of the texts.
        motion: Embeddings of the motions; row i belongs to text i.
        captions: The texts, to count how many are not unique in their batch.

    Raises:
        ValueError: if there are fewer than 32 pairs.
    """
    n = len(text) // BATCH * BATCH
    if n == 0:
        raise ValueError(f"R-precision needs at least {BATCH} pairs, found {len(text)}")
    ranks = np.concatenate([_ranks(text[i : i + BATCH], motion[i : i + BATCH]) for i in range(0, n, BATCH)])
    top = np.array([np.mean(ranks < k) for k in range(1, TOP + 1)])
    duplicates = sum(_duplicates(captions[i : i + BATCH]) for i in range(0, n, BATCH)) if captions is not None else 0
    return RPrecision(top, n, len(text) - n, duplicates)


def _ranks(
    text: Float[np.ndarray, "batch dimension"], motion: Float[np.ndarray, "batch dimension"]
) -> Int[np.ndarray, " batch"]:
    """How many other motions are as near to each text as its own, or nearer."""
    difference = text[:, None].astype(np.float64) - motion[None].astype(np.float64)
    distances = np.sqrt(np.square(difference).sum(axis=-1))  # (texts, motions)
    return (distances <= distances.diagonal()[:, None]).sum(axis=1) - 1


def _duplicates(captions: Sequence[str]) -> int:
    return sum(count for count in Counter(captions).values() if count > 1)
