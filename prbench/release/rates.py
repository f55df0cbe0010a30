"""Infer the frame rate of a release, and the number from which its primed frames count (0 or 1).

Source: docs/specification/pr-release.md#what-is-unknown.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.release.known import KnownDataset, KnownRelease, load_known
from prbench.release.report import Inference

LEAD = 2.0
"""Seconds before the prime at which a sequence begins (Prime and Reach, section 3.2)."""


@dataclass(frozen=True)
class PrimedFrames:
    """Meaning of the primed-frame field."""

    in_seconds: bool
    base: int
    """0 or 1; 0 where it holds seconds."""
    inference: Inference


@dataclass(frozen=True)
class FrameRateEvidence:
    """Everything from which the frame rate can be inferred."""

    n_frames: Int[np.ndarray, " n"]
    primed: Float[np.ndarray, " n"]
    """Primed frames as the release writes them."""
    stated: Float[np.ndarray, " stated"]
    """Values of a frame-rate field."""
    durations: Float[np.ndarray, " n"] | None
    """Values of a duration field, seconds."""
    known: KnownDataset | None


def read_primed_frames(primed: Float[np.ndarray, " n"], n_frames: Int[np.ndarray, " n"]) -> PrimedFrames:
    """Decide between frames from 0, frames from 1, and seconds."""
    whole = primed == np.rint(primed)
    # Frame numbers are whole. Sequences last some seconds, so values below 30 with fractions are seconds.
    if not whole.all() and primed.max() < 30:
        share = 1 - whole.mean()
        evidence = f"{share:.0%} of the values are no whole numbers, and all are below 30"
        return PrimedFrames(True, 0, Inference("primed_frame", "seconds", "likely", evidence))
    none_is_zero = primed.min() > 0
    at_end = int((primed == n_frames).sum())
    mode = _mode(primed)
    # A prime 2 s after the start is frame 2 · rate counted from 0, one more counted from 1.
    odd = {round(LEAD * rate) + 1 for rate in load_known().frame_rates}
    if none_is_zero and (at_end or (primed.min() == 1 and mode in odd)):
        evidence = f"{at_end} values equal the number of frames, none is 0; most frequent: {mode:g}"
        return PrimedFrames(False, 1, Inference("primed_frame", "frames from 1", "likely", evidence))
    evidence = f"no sign of counting from 1: smallest {primed.min():g}, most frequent {mode:g}"
    return PrimedFrames(False, 0, Inference("primed_frame", "frames from 0", "assumed", evidence))


def infer_frame_rate(evidence: FrameRateEvidence, primed: PrimedFrames) -> tuple[float | None, Inference]:
    """Infer the frame rate; None if the evidence is missing or contradicts itself.

    Stated rates count most; then stated durations; then (a) the most frequent primed frame, 2 s after the start, and
    (b) the mean length against the study's mean duration.
    """
    constants = load_known()
    if len(evidence.stated) and (evidence.stated == evidence.stated[0]).all():
        rate = float(evidence.stated[0])
        return rate, Inference("fps", f"{rate:g}", "certain", f"stated by {len(evidence.stated)} entries")
    possible = {
        "lengths and durations": _by_durations(evidence, constants),
        "primed frames": _by_primes(evidence, primed, constants),
        "mean length": _by_mean_length(evidence, constants),
    }
    votes = {name: vote for name, vote in possible.items() if vote is not None}
    said = "; ".join(f"{name}: {value:.2f} Hz, near {rate:g}" for name, (rate, value) in votes.items())
    rates = {rate for rate, _ in votes.values()}
    # Two signs for different rates are worse than none: the user has to say which holds.
    if len(rates) != 1:
        reason = "the signs contradict each other" if rates else "nothing tells"
        return None, Inference("fps", "unknown", "unknown", said or reason)
    certainty = "likely" if len(votes) > 1 or "lengths and durations" in votes else "assumed"
    (rate,) = rates
    return rate, Inference("fps", f"{rate:g}", certainty, said)


def _by_durations(evidence: FrameRateEvidence, constants: KnownRelease) -> tuple[float, float] | None:
    if evidence.durations is None or (evidence.durations <= 0).any():
        return None
    return _near(float(np.median((evidence.n_frames - 1) / evidence.durations)), constants)


def _by_primes(
    evidence: FrameRateEvidence, primed: PrimedFrames, constants: KnownRelease
) -> tuple[float, float] | None:
    if primed.in_seconds:
        return None
    frames = evidence.primed - primed.base
    mode = _mode(frames)
    if (np.abs(frames - mode) <= 1).mean() < constants.agreeing_primes:
        return None
    return _near(mode / LEAD, constants)


def _by_mean_length(evidence: FrameRateEvidence, constants: KnownRelease) -> tuple[float, float] | None:
    """Return no rate where there are too few sequences for a precise mean."""
    known = evidence.known
    n = len(evidence.n_frames)
    # Standard error of the mean, relative to it: with few sequences the mean length tells nothing.
    if known is None or known.duration_sd / (known.duration * np.sqrt(n)) > constants.mean_precision:
        return None
    return _near(float(evidence.n_frames.mean()) / known.duration, constants)


def _near(value: float, constants: KnownRelease) -> tuple[float, float] | None:
    """Return the considered rate nearest to a measured one, and the measured one; None outside the tolerance."""
    nearest = min(constants.frame_rates, key=lambda rate: abs(value - rate))
    return (nearest, value) if abs(value - nearest) <= constants.frame_rate_tolerance * nearest else None


def _mode(values: Float[np.ndarray, " n"]) -> float:
    return float(Counter(values.tolist()).most_common(1)[0][0])
