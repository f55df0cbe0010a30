"""Fréchet distance between two sets of motion embeddings (docs/specification/text-to-motion-eval.md#metrics)."""

from __future__ import annotations

import warnings

import numpy as np
from jaxtyping import Float

FEWEST = 1000
"""Below this many samples a warning says that the number is biased upwards."""


class FewSamplesWarning(UserWarning):
    """The covariance of an embedding is estimated from few samples."""


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
    fewest = min(len(real), len(generated))
    if fewest < 2:
        raise ValueError(f"FID needs two samples or more of each kind, found {len(real)} and {len(generated)}")
    if fewest < FEWEST:
        message = f"FID of {len(real)} and {len(generated)} samples: biased upwards below {FEWEST}."
        warnings.warn(message, FewSamplesWarning, stacklevel=2)
    real, generated = real.astype(np.float64), generated.astype(np.float64)
    if not (np.isfinite(real).all() and np.isfinite(generated).all()):
        raise ValueError("FID: an embedding is not finite")
    first, second = np.atleast_2d(np.cov(real, rowvar=False)), np.atleast_2d(np.cov(generated, rowvar=False))
    means = np.square(real.mean(axis=0) - generated.mean(axis=0)).sum()
    return float(means + np.trace(first) + np.trace(second) - 2.0 * _trace_of_root(first, second))


def _trace_of_root(first: Float[np.ndarray, "d d"], second: Float[np.ndarray, "d d"]) -> float:
    values, vectors = np.linalg.eigh(first)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    eigenvalues = np.linalg.eigvalsh(root.T @ second @ root)
    return float(np.sqrt(np.clip(eigenvalues, 0.0, None)).sum())
