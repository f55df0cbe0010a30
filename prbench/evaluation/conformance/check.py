"""What a check is, and how checks register."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from prbench.evaluation.conformance.finding import Observation
from prbench.evaluation.conformance.subject import Subject

Examine = Callable[[Subject], Iterable[Observation]]


@dataclass(frozen=True)
class Check:
    """One question to a method."""

    name: str
    title: str
    """What is asked, for lists and headings."""
    examine: Examine
    needs: tuple[str, ...] = ()
    """Checks that must not have failed; a fault that explains others is reported alone."""


def check(name: str, title: str, *, needs: tuple[str, ...] = ()) -> Callable[[Examine], Check]:
    """Make a check of a function."""

    def made(examine: Examine) -> Check:
        return Check(name, title, examine, needs)

    return made
