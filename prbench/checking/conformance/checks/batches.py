"""A sequence's motion does not depend on the batch around it; a batch of one is a batch."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from prbench.checking.conformance.answer import Answer
from prbench.checking.conformance.check import check
from prbench.checking.conformance.comparing import TOLERANCE, largest_changes, metres
from prbench.checking.conformance.finding import Observation, failed, passed, skipped, warning
from prbench.checking.conformance.subject import Subject
from prbench.contract import ConditionBatch

_ROUNDING = np.float32(1e-6)  # metres; about the last digit of a float32 position some metres away
_AMPLIFIED = 30.0  # how much more than such a nudge another batch may move a motion of a method that amplifies rounding
_OWN_ROW = (
    "Every row is complete in itself: draw its noise from its own noise_seed, mask padding in attention, losses and"
    " averages, and let no statistic (batch normalisation, the longest row, a common stopping rule) run over rows."
)


@check("single-row", "a batch of one sequence works", of_motions=True)
def single_row(subject: Subject) -> Iterator[Observation]:
    """The first sequence alone."""
    answer = subject.ask(subject.batch(subject.rows[:1], subject.main))
    if answer.motions is None:
        yield failed(
            f"a batch of one sequence: {answer.error}",
            "Keep the first axis: squeeze() without an axis and indexing by a boolean lose it when there is one row.",
        )
    else:
        yield passed("one sequence alone works.")


@check(
    "batch",
    "neither order nor size of the batch changes a motion",
    needs=("determinism", "global-random", "noise-seed", "single-row"),
    of_motions=True,
)
def batch(subject: Subject) -> Iterator[Observation]:
    """The usual sequences in reverse, and in two parts."""
    first = subject.standard(subject.main)
    n = len(first.batch)
    if n < 2:
        yield skipped("there is only one sequence to ask about.")
        return
    orders = {"in reverse order": [list(range(n))[::-1]], "in two parts": [list(range(n // 2)), list(range(n // 2, n))]}
    moved: dict[str, float] = {}
    for name, parts in orders.items():
        for part in parts:
            answer = subject.ask(_rows(first.batch, part))
            if answer.motions is None:
                yield failed(f"the same sequences {name}: {answer.error}", _OWN_ROW)
                return
            moved[name] = max(moved.get(name, 0.0), largest_changes(first, answer, part).max())
    yield _judged(subject, first, moved)


def _judged(subject: Subject, first: Answer, moved: dict[str, float]) -> Observation:
    most = max(moved.values())
    told = " and ".join(f"by {metres(distance)} {name}" for name, distance in moved.items() if distance > TOLERANCE)
    if most <= TOLERANCE:
        return passed(f"the same within {metres(most)} (tolerance {metres(TOLERANCE)}).", change_m=most)
    amplified = _amplified(subject, first)
    if most <= _AMPLIFIED * amplified:
        return warning(
            f"the same sequences move {told}; but a nudge of {_ROUNDING:.0e} m of their input alone moves them by"
            f" {metres(amplified)}: the method amplifies rounding, as optimisation does.",
            "Only scores can be compared between batch sizes, not motions; name the batch size beside your results.",
            change_m=most,
            amplified_m=amplified,
        )
    return failed(f"the same sequences move {told}.", _OWN_ROW, change_m=most, amplified_m=amplified)


def _amplified(subject: Subject, first: Answer) -> float:
    """How far motions move if their input changes in the last digit: nothing but rounding differs then."""
    if first.batch.initial_joints is None:
        return 0.0
    nudged = dataclasses.replace(first.batch, initial_joints=first.batch.initial_joints + _ROUNDING)
    answer = subject.ask(nudged)
    return 0.0 if answer.motions is None else float(largest_changes(first, answer).max())


def _rows(whole: ConditionBatch, rows: list[int]) -> ConditionBatch:
    """Some rows of a batch in another order."""
    changed: dict[str, object] = {}
    for field in dataclasses.fields(whole):
        values = getattr(whole, field.name)
        if isinstance(values, tuple):
            changed[field.name] = tuple(values[row] for row in rows)
        elif isinstance(values, np.ndarray):
            changed[field.name] = values[rows]
    return dataclasses.replace(whole, **changed)


CHECKS = (single_row, batch)
