"""The levels of sensor noise at which curation is held against the synthetic truth, and what it must reach there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from prbench.checking.verify_synthetic import LEVELS, SensorLevel, Verification
from prbench.protocol.manifests import load_manifest

_SLACK = 1e-4
"""Seconds by which clocks and rounding may move a sample."""

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
