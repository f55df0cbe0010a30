"""Defines checks and makes them one after the other; an error in one of them never ends the others."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from prbench.checking.conformance.method_subject import MethodSubject
from prbench.checking.conformance.report import Finding, Observation, Outcome, failed, skipped

_Examine = Callable[[Any], Iterable[Observation]]
FORM = ("generates", "predicts", "shapes", "dtype", "finite", "past")
"""Checks without which there is nothing to look at."""


@dataclass(frozen=True)
class Check:
    """One question to a method."""

    name: str
    title: str
    """The question, for lists and headings."""
    examine: _Examine
    needs: tuple[str, ...] = ()
    """Checks that must not have failed; a fault that explains others is reported alone."""
    of_motions: bool = False
    """True if it needs a condition under which the method generates motions that the harness accepts."""
    fresh: bool = False
    """True if it looks at a method in a process that has done nothing else."""


def check(
    name: str, title: str, *, needs: tuple[str, ...] = (), of_motions: bool = False, fresh: bool = False
) -> Callable[[_Examine], Check]:
    """Make a check of a function; the arguments are those of :class:`Check`."""

    def made(examine: _Examine) -> Check:
        return Check(name, title, examine, needs, of_motions, fresh)

    return made


def examine(
    subject: MethodSubject,
    checks: Iterable[Check],
    *,
    known: Mapping[str, Outcome] | None = None,
    announce: Callable[[Check], None] | None = None,
) -> Iterator[Finding]:
    """Make checks and yield their findings.

    Args:
        subject: The method.
        checks: What to look at, in this order.
        known: How earlier checks ended, by name.
        announce: Called before each check.
    """
    # Earlier processes have made some checks already; later ones build on them.
    worst = dict(known or {})
    for one in checks:
        if announce is not None:
            announce(one)
        by_program = not subject.is_installed
        findings = [observation.of(one.name, by_program=by_program) for observation in _observed(one, subject, worst)]
        worst[one.name] = worst_of(findings)
        yield from findings


def worst_of(findings: Iterable[Finding]) -> Outcome:
    """Return the worst outcome of the findings of one check."""
    order = (Outcome.SKIPPED, Outcome.PASSED, Outcome.WARNING, Outcome.FAILED)
    return max((finding.outcome for finding in findings), key=order.index, default=Outcome.SKIPPED)


def _observed(one: Check, subject: MethodSubject, worst: Mapping[str, Outcome]) -> list[Observation]:
    missing = [name for name in one.needs if worst.get(name) is Outcome.FAILED]
    if missing:
        return [skipped(f"not looked at before '{missing[0]}' passes.")]
    try:
        if one.of_motions and (why := _no_motions(subject, worst)):
            return [skipped(why)]
        return list(one.examine(subject))
    except Exception as error:  # a method may answer in ways that no check expects
        return [
            failed(
                f"the check could not make sense of the method's answers: {type(error).__name__}: {error}",
                "Look at the failures above first; if there are none, this is a defect of prbench: please report it.",
            )
        ]


def _no_motions(subject: MethodSubject, worst: Mapping[str, Outcome]) -> str:
    if worst.get("load") is Outcome.FAILED:
        return "not looked at before 'load' passes."
    if not subject.working:
        broken = [name for name in FORM if worst.get(name) is Outcome.FAILED]
        return f"there are no motions to look at before {broken[0] if broken else subject.asks!r} passes."
    return ""
