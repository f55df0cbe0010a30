"""Conditions by name: what a method is given."""

from __future__ import annotations

from prbench.contract import Condition
from prbench.errors import UsageError, did_you_mean


def condition_of(name: str) -> Condition:
    """Return a condition by its name.

    Args:
        name: ``none``, ``text``, ``goal-pose`` or ``goal-loc``.

    Raises:
        UsageError: for an unknown name, with the nearest known one.
    """
    known = [condition.value for condition in Condition]
    if name not in known:
        raise UsageError(f"unknown condition '{name}'; there are: {', '.join(known)}.{did_you_mean(name, known)}")
    return Condition(name)
