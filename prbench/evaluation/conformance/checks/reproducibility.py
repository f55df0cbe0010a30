"""Same input and seed, same motion: whatever was generated before, beside it, and by which run."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from prbench.evaluation.conformance.answer import Answer
from prbench.evaluation.conformance.check import check
from prbench.evaluation.conformance.finding import Observation, failed, passed, warning
from prbench.evaluation.conformance.subject import Subject

TOLERANCE = 1e-4
"""Metres by which a motion may change where only rounding differs (design, section 3, "Reproducibility")."""


@check("determinism", "the same batch gives the same motions", needs=("load", "generates", "shapes", "dtype", "finite"))
def determinism(subject: Subject) -> Iterator[Observation]:
    """The usual batch again, after another one."""
    first = subject.standard(subject.main)
    subject.ask(subject.batch(subject.rows[:1], subject.main, sample=7))
    again = subject.ask(first.batch)
    if again.motions is None:
        yield failed(
            f"asked for the same batch a second time: {again.error}", "Let no call change what the next finds."
        )
        return
    moved = largest_change(first, again)
    if first.motions is not None and np.array_equal(first.motions.joints, again.motions.joints):
        yield passed("the same batch gave the same bytes.", change_m=0.0)
    elif moved <= TOLERANCE:
        yield warning(
            f"the same batch gave motions that differ by up to {moved:.1e} m.",
            "Rounding differs from call to call; torch.use_deterministic_algorithms(True) says which operations.",
            change_m=moved,
        )
    else:
        yield failed(
            f"the same batch, asked a second time, moved joints by up to {metres(moved)}.",
            "Draw from generators made of batch.noise_seed alone (prbench.randomness.sequence_generator, or"
            " torch.Generator().manual_seed(noise_seed)), not from time, the system or what earlier calls left.",
            change_m=moved,
        )


def largest_change(first: Answer, second: Answer) -> float:
    """Largest distance of any joint in any frame between two answers of the same lengths, metres."""
    return max(
        float(np.linalg.norm(first.motion(row) - second.motion(row), axis=-1).max()) for row in range(len(first.batch))
    )


def metres(distance: float) -> str:
    """A distance in the unit in which it is easily read."""
    if distance >= 1:
        return f"{distance:.2f} m"
    return f"{distance * 100:.2g} cm" if distance >= 0.001 else f"{distance:.1e} m"


CHECKS = (determinism,)
