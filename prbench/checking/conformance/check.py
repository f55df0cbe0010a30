"""What a check is, and how a function becomes one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from prbench.checking.conformance.finding import Observation
from prbench.checking.conformance.subject import Subject

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
    of_motions: bool = False
    """It needs a condition under which the method generates motions that the harness accepts."""
    fresh: bool = False
    """It looks at a method in a process that has done nothing else."""


def check(
    name: str, title: str, *, needs: tuple[str, ...] = (), of_motions: bool = False, fresh: bool = False
) -> Callable[[Examine], Check]:
    """Make a check of a function; the arguments are those of :class:`Check`."""

    def made(examine: Examine) -> Check:
        return Check(name, title, examine, needs, of_motions, fresh)

    return made
