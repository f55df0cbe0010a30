"""The levels of sensor noise at which curation is held against the synthetic truth, and what it must reach there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from prbench.checking.verify_synthetic import Verification, staged_matches, verification
from prbench.harness.synthetic_table import Staging
from prbench.protocol.manifests import load_manifest

_SLACK = 1e-4
"""Seconds by which clocks and rounding may move a sample."""


@dataclass(frozen=True)
class SensorLevel:
    """One of the conditions under which curation is checked."""

    name: str
    noise: float
    provoked: bool
    """True if provocations are on, at their default share (docs/specification/synthetic-recordings.md#provocations)."""


LEVELS = (
    SensorLevel("ideal sensors", 0.0, provoked=False),
    SensorLevel("default noise", 1.0, provoked=False),
    SensorLevel("default noise, provocations", 1.0, provoked=True),
    SensorLevel("twice the noise, provocations", 2.0, provoked=True),
)


def verify_level(
    level: SensorLevel, *, preset: str = "adt", recordings: int, seed: int, n_events: int = 10
) -> Verification:
    """Act out recordings, sense them, curate them, and compare with what was acted out."""
    staging = Staging(preset, seed, "default", n_events, level.noise, None if level.provoked else ())
    matches = [match for index in range(recordings) for match in staged_matches(staging, index)]
    return verification(matches, recordings=recordings)


MOSTLY_SLOW = [
    pytest.param(level, id=level.name, marks=[pytest.mark.slow] if level is not LEVELS[2] else []) for level in LEVELS
]
"""All levels; the gate runs them all, and other calls the one with default noise and provocations alone."""


@dataclass(frozen=True)
class Limit:
    """One line of the verdict: a number, and what it must reach."""

    name: str
    value: float
    bound: float
    at_least: bool

    @property
    def holds(self) -> bool:
        """Return True if the number is on the right side of its bound; a number without sample counts as right."""
        return bool(np.isnan(self.value)) or (self.value >= self.bound if self.at_least else self.value <= self.bound)


def limits(level: SensorLevel, result: Verification, *, preset: str = "adt") -> list[Limit]:
    """The limits asserted at this level; periods are those of the dataset.

    Source: docs/specification/synthetic-recordings.md#truth-record.
    """
    rates = load_manifest(preset).rates_hz
    objects, gaze = (1.0 / rates.get(stream, 30.0) for stream in ("objects", "gaze"))
    if level.noise == 0:
        return [
            Limit("recall", result.recall, 1.0, at_least=True),
            Limit("precision", result.precision, 1.0, at_least=True),
            Limit("largest timing error, s", result.timing.largest, 2 * objects, at_least=False),
            Limit("priming recall", result.priming_recall, 1.0, at_least=True),
            Limit("largest prime time error, s", result.prime_first.largest, gaze + _SLACK, at_least=False),
        ]
    # Beyond the datasets' own noise nothing is asserted about times: the page bounds detection alone.
    share = 0.95 if level.noise <= 1 else 0.90
    detection = [
        Limit("recall", result.recall, share, at_least=True),
        Limit("precision", result.precision, share, at_least=True),
    ]
    if level.noise > 1:
        return detection
    return [
        *detection,
        Limit("median timing error, s", result.timing.median, 0.05, at_least=False),
        Limit("priming recall", result.priming_recall, 0.97, at_least=True),
        Limit("false primes", result.false_primes, 0.06, at_least=False),
        Limit("median prime time error, s", result.prime.median, 0.08, at_least=False),
    ]
