"""The text-to-motion metrics (FID, R-precision, retrieval, diversity …); one repetition of all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist

Embeddings = Float[np.ndarray, "pairs dimension"]
Rows = Float[np.ndarray, "*rows dimension"]
Pairs = Int[np.ndarray, "2 pairs"]

FEWEST = 1000  # FID of fewer samples is biased upwards; whoever reports it says so.
DIVERSITY_PAIRS = 300
MULTIMODALITY_PROMPTS = 100
MULTIMODALITY_SAMPLES = 30  # Motions generated for each prompt.
_MULTIMODALITY_PAIRS = 10  # Pairs of them that are compared.
BATCH = 32  # Pairs that are ranked together. Part of the metric: the number means nothing with another one.
TOP = 3
FID = "fid"
DISTANCE = "multimodal_distance"
DIVERSITY = "diversity"
MULTIMODALITY = "multimodality"


def fid(real: Float[np.ndarray, "real dimension"], generated: Float[np.ndarray, "generated dimension"]) -> float:
    """‖μ₁ − μ₂‖² + Tr(C₁ + C₂ − 2(C₁C₂)^½), with sample covariances (n − 1), in float64.

    The trace of the root is the sum of the roots of the eigenvalues of C₁C₂. They are those of the symmetric matrix
    RᵀC₂R where C₁ = RRᵀ, so none is complex, and matrices of too few samples need no jitter; what rounding makes
    negative is 0.

    Args:
        real: Embeddings of recorded motions, two or more.
        generated: Embeddings of generated motions, two or more.

    Raises:
        ValueError: if a set has fewer than two samples or holds NaN or infinity.
    """
    if min(len(real), len(generated)) < 2:
        raise ValueError(f"FID needs two samples or more of each kind, found {len(real)} and {len(generated)}")
    real = real.astype(np.float64)
    generated = generated.astype(np.float64)
    if not (np.isfinite(real).all() and np.isfinite(generated).all()):
        raise ValueError("FID: an embedding is not finite")
    first = np.atleast_2d(np.cov(real, rowvar=False))
    second = np.atleast_2d(np.cov(generated, rowvar=False))
    means = np.square(real.mean(axis=0) - generated.mean(axis=0)).sum()
    # The root of a symmetric matrix instead of that of C1 C2: no complex numbers, no jitter.
    values, vectors = np.linalg.eigh(first)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    trace = float(np.sqrt(np.clip(np.linalg.eigvalsh(root.T @ second @ root), 0.0, None)).sum())
    return float(means + np.trace(first) + np.trace(second) - 2.0 * trace)


def multimodal_distance(text: Rows, motion: Rows) -> float:
    """Mean distance between each text and its own motion, also called the matching score; lower is better."""
    difference = text.astype(np.float64) - motion.astype(np.float64)
    return float(np.sqrt(np.square(difference).sum(axis=-1)).mean())


def diversity(motion: Float[np.ndarray, "motions dimension"], pairs: Pairs) -> float:
    """Mean distance of random pairs of motions; best near that of recorded motions.

    Args:
        motion: Embeddings.
        pairs: Indices of :func:`draw_diversity_pairs`.
    """
    return multimodal_distance(motion[pairs[0]], motion[pairs[1]])


def draw_diversity_pairs(n_motions: int, generator: np.random.Generator, *, n_pairs: int = DIVERSITY_PAIRS) -> Pairs:
    """Two sets of motions, each without repetition. They may overlap, and a motion may meet itself.

    Raises:
        ValueError: if there are not more motions than pairs.
    """
    if n_motions <= n_pairs:
        raise ValueError(f"diversity over {n_pairs} pairs needs more than {n_pairs} motions, found {n_motions}")
    return np.stack([generator.choice(n_motions, n_pairs, replace=False) for _ in range(2)])


def multimodality(motion: Float[np.ndarray, "prompts samples dimension"], pairs: Pairs) -> float:
    """Mean distance of random pairs among the motions of one prompt, over all prompts.

    Args:
        motion: Embeddings of several motions of each prompt.
        pairs: Indices of :func:`draw_multimodality_pairs`; the same for all prompts.
    """
    return multimodal_distance(motion[:, pairs[0]], motion[:, pairs[1]])


def draw_multimodality_pairs(
    n_samples: int, generator: np.random.Generator, *, n_pairs: int = _MULTIMODALITY_PAIRS
) -> Pairs:
    """Two sets of samples, each without repetition.

    Raises:
        ValueError: if there are fewer samples than pairs.
    """
    if n_samples < n_pairs:
        raise ValueError(f"multimodality over {n_pairs} pairs needs at least {n_pairs} samples, found {n_samples}")
    return np.stack([generator.choice(n_samples, n_pairs, replace=False) for _ in range(2)])


@dataclass(frozen=True, eq=False)
class RPrecision:
    """R-precision and what it was counted over.

    Attributes:
        top: Share of texts whose own motion is the nearest, among the two nearest, among the three nearest.
        n_pairs: Pairs that were ranked: whole batches only.
        n_dropped: Pairs of the last, incomplete batch.
        n_duplicates: Ranked texts that another text of their batch equals. The other's motion counts as a wrong one.
    """

    top: Float[np.ndarray, " 3"]
    n_pairs: int
    n_dropped: int
    n_duplicates: int


def r_precision(text: Embeddings, motion: Embeddings, captions: Sequence[str] | None = None) -> RPrecision:
    """Rank the motions of each batch of 32 pairs for each of its texts.

    A motion exactly as near as the text's own counts as nearer, so that equal embeddings earn nothing.

    Args:
        text: Embeddings of the texts.
        motion: Embeddings of the motions; row i belongs to text i.
        captions: The texts, to count how many are not unique in their batch.

    Raises:
        ValueError: if there are fewer than 32 pairs.
    """
    if len(text) < BATCH:
        raise ValueError(f"R-precision needs at least {BATCH} pairs, found {len(text)}")
    names = range(len(text)) if captions is None else captions
    own = ranks(text, motion, names, candidates=BATCH)[0, 0]
    n = len(own)
    batches = (Counter(names[start : start + BATCH]) for start in range(0, n, BATCH))
    duplicates = sum(count for batch in batches for count in batch.values() if count > 1)
    top = np.array([np.mean(own <= k) for k in range(1, TOP + 1)])
    return RPrecision(top, n, len(text) - n, duplicates)


_QUERIES_AT_ONCE = 512  # Bounds the memory for distances to a whole split.


def ranks(
    text: Embeddings, motion: Embeddings, captions: Sequence[str] | Sequence[int], *, candidates: int
) -> Int[np.ndarray, "2 2 ranked"]:
    """Rank motions for each text and texts for each motion, among the pairs of a batch; the nearest has rank 1.

    Whatever is exactly as near as a hit counts as nearer, so that equal embeddings earn nothing.

    Args:
        text: Embeddings of the texts.
        motion: Embeddings of the motions; row i belongs to text i.
        captions: The texts.
        candidates: Pairs of a batch; the last, incomplete batch is left out.

    Returns:
        First axis: texts ask, motions ask. Second axis: rank of the query's own partner, and rank of the nearest
        partner with the same caption, before which only others are counted. Third axis: whole batches only.

    Raises:
        ValueError: if an embedding is not finite.
    """
    if not (np.isfinite(text).all() and np.isfinite(motion).all()):
        raise ValueError("retrieval: an embedding is not finite")
    _, codes = np.unique(captions, return_inverse=True)
    starts = range(0, len(text) // candidates * candidates, candidates)
    batches = [slice(start, start + candidates) for start in starts]
    for_texts = [_ranks_in_batch(text[batch], motion[batch], codes[batch]) for batch in batches]
    for_motions = [_ranks_in_batch(motion[batch], text[batch], codes[batch]) for batch in batches]
    return np.stack([np.concatenate(found, axis=1) for found in (for_texts, for_motions)])


def _ranks_in_batch(queries: Embeddings, asked: Embeddings, codes: Int[np.ndarray, " pairs"]) -> np.ndarray:
    """Return the two ranks of each query (2, queries) among what is asked; equal codes stand for equal captions."""
    found = np.empty((2, len(queries)), dtype=np.int64)
    for start in range(0, len(queries), _QUERIES_AT_ONCE):
        part = slice(start, start + _QUERIES_AT_ONCE)
        # Of differences, not of the expanded square, whose cancellation would break ties by rounding.
        distances = cdist(queries[part], asked)  # float64
        same = codes[part, None] == codes
        own = distances.diagonal(start)[:, None]
        nearest = np.where(same, distances, np.inf).min(axis=1, keepdims=True)
        found[0, part] = (distances <= own).sum(axis=1)
        found[1, part] = 1 + ((distances <= nearest) & ~same).sum(axis=1)
    return found


_RECALLS = {"r_at_1": 1, "r_at_5": 5, "r_at_10": 10}  # Among so many of the nearest.
_MEDIAN_RANK = "median_rank"
RETRIEVAL = (*_RECALLS, _MEDIAN_RANK)
Retrieved = dict[tuple[str, int, str], dict[str, float]]


def retrieval(pairs: EmbeddedPairs) -> Retrieved:
    """Measure retrieval in both directions (docs/specification/text-to-motion-eval.md#retrieval).

    Returns:
        Maps what asks (``text`` or ``motion``), the number of candidates (32, and all pairs) and what counts as a hit
        (``own`` or ``same caption``) to the shares of queries with a hit among the nearest 1, 5 and 10, and to the
        median rank of the first hit. Where there are just 32 pairs, both numbers of candidates are one.
    """
    found = {}
    for candidates in (BATCH, len(pairs.captions)):
        ranked = ranks(pairs.text, pairs.motion, pairs.captions, candidates=candidates)
        for query, of_query in zip(("text", "motion"), ranked):
            for hit, of_hit in zip(("own", "same caption"), of_query):
                measured = {name: float(np.mean(of_hit <= k)) for name, k in _RECALLS.items()}
                found[query, candidates, hit] = measured | {_MEDIAN_RANK: float(np.median(of_hit))}
    return found


R_PRECISION = tuple(f"r_precision_top_{k}" for k in range(1, TOP + 1))
# Ids in the order in which they are shown; R-precision as shares from 0 to 1.
METRICS = (*R_PRECISION, FID, DISTANCE, DIVERSITY, MULTIMODALITY)


@dataclass(frozen=True)
class EmbeddedPairs:
    """Texts with their motions in the evaluator's space."""

    captions: tuple[str, ...]
    text: Embeddings
    motion: Embeddings

    def shuffled(self, generator: np.random.Generator) -> EmbeddedPairs:
        """Return the same pairs in another order: it decides which 32 are ranked together."""
        order = generator.permutation(len(self.captions))
        return EmbeddedPairs(tuple(self.captions[i] for i in order), self.text[order], self.motion[order])

    def mismatched(self) -> EmbeddedPairs:
        """Every motion with the text of the pair before: what chance scores."""
        return EmbeddedPairs((self.captions[-1], *self.captions[:-1]), np.roll(self.text, 1, axis=0), self.motion)


class Repeated(msgspec.Struct, frozen=True):
    """A metric over repetitions of the whole evaluation.

    The interval says how far chance moves the mean of these repetitions. It knows nothing of the choice of recordings
    or of training.

    Attributes:
        mean: Mean over repetitions; R-precision from 0 to 1, all others in units of the evaluator.
        half_width: 1.96 times the population standard deviation over the root of the number of repetitions; null for
            a single repetition.
        values: The value of each repetition.
    """

    mean: float
    half_width: float | None
    values: tuple[float, ...]

    @classmethod
    def of(cls, values: Sequence[float]) -> Repeated:
        """Summarise the values of at least one repetition."""
        numbers = np.asarray(values, dtype=np.float64)
        half = 1.96 * float(numbers.std()) / float(np.sqrt(len(numbers))) if len(numbers) > 1 else None
        return cls(float(numbers.mean()), half, tuple(float(number) for number in numbers))
