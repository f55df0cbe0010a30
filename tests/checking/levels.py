"""The levels of sensor noise at which curation is held against the synthetic truth."""

from __future__ import annotations

import pytest

from prbench.checking.verify_synthetic import LEVELS

MOSTLY_SLOW = [
    pytest.param(level, id=level.name, marks=[pytest.mark.slow] if level is not LEVELS[2] else []) for level in LEVELS
]
"""All levels; the gate runs them all, and other calls the one with default noise and provocations alone."""
