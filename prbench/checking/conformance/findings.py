"""One engine of findings: the request of a check, checks declared as data, one loop that makes them, one report."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from prbench.errors import PrbenchError
from prbench.protocol.manifests import default_benchmark

TIME_LIMIT = 600.0  # default limit of each call of the method, seconds
# Default limit of importing and of loading a method, seconds; a program has as long for its hello
START_LIMIT = 120.0


class Outcome(StrEnum):
    """The result of a check, from good to bad."""

    PASSED = "passed"
    SKIPPED = "skipped"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True)
class Finding:
    """One sentence about a method, and what its author can do about it.

    Attributes:
        check: Name of the check; one check may find several things.
        outcome: How it came out.
        said: The observation with its numbers; for a skipped check, the reason.
        remedy: The change to make; empty where there is none.
        numbers: Maps names that end in their unit to measured numbers.
    """

    check: str
    outcome: Outcome
    said: str
    remedy: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Report:
    """All findings about one method, or one dataset's reader.

    Attributes:
        method: The method, or the dataset, as it was named.
        findings: All findings, in the order of the checks. The exit code is 5 (of a dataset 3) if one failed.
        seconds: How long the checks took.
    """

    method: str
    findings: tuple[Finding, ...]
    seconds: float

    @property
    def failed(self) -> tuple[Finding, ...]:
        """The findings that need a change."""
        return tuple(finding for finding in self.findings if finding.outcome is Outcome.FAILED)


class Remedy(str):
    """A change to make, worded for the author of an adapter in Python; ``program`` words it for that of a program."""

    program: str

    def __new__(cls, adapter: str, program: str) -> Remedy:
        """Hold both wordings."""
        remedy = super().__new__(cls, adapter)
        remedy.program = program
        return remedy

    def then(self, text: str) -> Remedy:
        """Return the remedy with ``text`` appended to both wordings."""
        return Remedy(f"{self} {text}", f"{self.program} {text}")

    def after(self, text: str) -> Remedy:
        """Return the remedy with ``text`` before both wordings."""
        return Remedy(f"{text} {self}", f"{text} {self.program}")


@dataclass(frozen=True)
class CheckRequest:
    """A method, and how to check it.

    Attributes:
        method: Installed name, ``cmd:`` and a command, or a TOML file.
        benchmark: The benchmark that it is a method of.
        data: A table whose test cases are asked about; None for synthetic people.
        time_limit: Seconds for each call of the method.
        start_limit: Seconds for importing it, and for loading it; a program's own are in its TOML file.
    """

    method: str
    weights: Path | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    device: str = "cpu"
    threads: int = 1
    isolate: bool = False
    benchmark: str = default_benchmark().name
    data: Path | None = None
    time_limit: float = TIME_LIMIT
    start_limit: float = START_LIMIT


def passed(said: str, **numbers: float) -> Finding:
    """Find that all is well; ``said`` holds the evidence. The loop puts the name of the check to it."""
    return Finding("", Outcome.PASSED, said, numbers=numbers)


def skipped(said: str) -> Finding:
    """Find that a check did not apply, with the reason."""
    return Finding("", Outcome.SKIPPED, said)


def warning(said: str, remedy: str, **numbers: float) -> Finding:
    """Find what is allowed but what the author should know."""
    return Finding("", Outcome.WARNING, said, remedy, numbers)


def failed(said: str, remedy: str, **numbers: float) -> Finding:
    """Find what is against the contract and makes numbers of this method wrong."""
    return Finding("", Outcome.FAILED, said, remedy, numbers)


_Examine = Callable[[Any], Iterable[Finding]]
# Checks without which there is nothing to look at
FORM = ("generates", "predicts", "shapes", "dtype", "finite", "past")


@dataclass(frozen=True)
class Check:
    """One question to a method.

    Attributes:
        title: The question, for lists and headings.
        needs: Checks that must not have failed; a fault that explains others is reported alone.
        of_motions: True if it needs a condition under which the method generates motions that the harness accepts.
        fresh: True if it looks at a method in a process that has done nothing else.
    """

    name: str
    title: str
    examine: _Examine
    needs: tuple[str, ...] = ()
    of_motions: bool = False
    fresh: bool = False


def check(name: str, title: str, **settings: Any) -> Callable[[_Examine], Check]:
    """Make a check of a function; the arguments are those of :class:`Check`."""
    return lambda examine: Check(name, title, examine, **settings)


def examine(
    subject: Any,
    checks: Iterable[Check],
    *,
    known: Mapping[str, Outcome] | None = None,
    announce: Callable[[Check], None] | None = None,
) -> Iterator[Finding]:
    """Make checks and yield their findings.

    Args:
        subject: The method, of whichever benchmark: what the checks ask, and ``is_installed``, ``working``, ``asks``.
        checks: What to look at, in this order.
        known: How earlier checks ended, by name.
        announce: Called before each check.
    """
    # Earlier processes have made some checks already; later ones build on them.
    worst = dict(known or {})
    for one in checks:
        if announce is not None:
            announce(one)
        findings = []
        for found in _found(one, subject, worst):
            remedy = found.remedy
            # Who wrote a program is told what to change in the program, others what to change in the adapter.
            if isinstance(remedy, Remedy) and not subject.is_installed:
                remedy = remedy.program
            numbers = {name: float(value) for name, value in found.numbers.items()}
            findings.append(Finding(one.name, found.outcome, found.said, str(remedy), numbers))
        worst[one.name] = worst_of(findings)
        yield from findings


def worst_of(findings: Iterable[Finding]) -> Outcome:
    """Return the worst outcome of the findings of one check."""
    order = (Outcome.SKIPPED, Outcome.PASSED, Outcome.WARNING, Outcome.FAILED)
    return max((finding.outcome for finding in findings), key=order.index, default=Outcome.SKIPPED)


def _found(one: Check, subject: Any, worst: Mapping[str, Outcome]) -> list[Finding]:
    """Make one check, unless an earlier failure explains what it would find."""
    missing = [name for name in one.needs if worst.get(name) is Outcome.FAILED]
    if one.of_motions and worst.get("load") is Outcome.FAILED:
        missing.append("load")
    if missing:
        return [skipped(f"not looked at before '{missing[0]}' passes.")]
    try:
        if one.of_motions and not subject.working:
            broken = [name for name in FORM if worst.get(name) is Outcome.FAILED]
            first = broken[0] if broken else repr(subject.asks)
            return [skipped(f"there are no motions to look at before {first} passes.")]
        return list(one.examine(subject))
    except PrbenchError as error:  # which says what to change
        return [failed(str(error), "")]
    except Exception as error:  # a method may answer in ways that no check expects
        found = f"the check could not make sense of the answers: {type(error).__name__}: {error}"
        remedy = "Look at the failures above first; if there are none, this is a defect of prbench: please report it."
        return [failed(found, remedy)]
