"""What a check says about a method, and all of it together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum


class Outcome(StrEnum):
    """How a check ended, from good to bad."""

    PASSED = "passed"
    SKIPPED = "skipped"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True)
class Finding:
    """One sentence about a method, and what its author can do about it."""

    check: str
    """Name of the check; one check may find several things."""
    outcome: Outcome
    said: str
    """What was seen, with its numbers; of a skipped check, why."""
    remedy: str = ""
    """What to change; empty where there is nothing."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """What was measured, by a name that ends in its unit."""


@dataclass(frozen=True)
class Report:
    """All findings about one method, in the order of the checks."""

    method: str
    findings: tuple[Finding, ...]
    seconds: float

    @property
    def failed(self) -> tuple[Finding, ...]:
        """What has to be changed."""
        return self.of(Outcome.FAILED)

    def of(self, outcome: Outcome) -> tuple[Finding, ...]:
        """The findings of one outcome."""
        return tuple(finding for finding in self.findings if finding.outcome is outcome)

    def about(self, check: str) -> tuple[Finding, ...]:
        """The findings of one check."""
        return tuple(finding for finding in self.findings if finding.check == check)

    def as_json(self) -> dict[str, object]:
        """The report as plain values."""
        counts = {outcome.value: len(self.of(outcome)) for outcome in Outcome}
        findings = [asdict(finding) | {"outcome": finding.outcome.value} for finding in self.findings]
        return {"method": self.method, "seconds": round(self.seconds, 3), "counts": counts, "findings": findings}


@dataclass(frozen=True)
class Remedy:
    """What to change, told otherwise to the author of an adapter in Python than to the author of a program."""

    adapter: str
    program: str

    def then(self, text: str) -> Remedy:
        """The same with a sentence for both behind it."""
        return Remedy(f"{self.adapter} {text}", f"{self.program} {text}")

    def after(self, text: str) -> Remedy:
        """The same with a sentence for both before it."""
        return Remedy(f"{text} {self.adapter}", f"{text} {self.program}")


@dataclass(frozen=True)
class Observation:
    """A finding before the runner has put the name of its check to it."""

    outcome: Outcome
    said: str
    remedy: str | Remedy = ""
    numbers: Mapping[str, float] = field(default_factory=dict)

    def of(self, check: str, *, by_program: bool = False) -> Finding:
        """As the finding of a check, about a program of the user's own or an adapter."""
        numbers = {name: float(value) for name, value in self.numbers.items()}
        remedy = self.remedy
        if isinstance(remedy, Remedy):
            remedy = remedy.program if by_program else remedy.adapter
        return Finding(check, self.outcome, self.said, remedy, numbers)


def passed(said: str, **numbers: float) -> Observation:
    """All is well; ``said`` holds the evidence."""
    return Observation(Outcome.PASSED, said, numbers=numbers)


def skipped(said: str) -> Observation:
    """Not looked at, and why."""
    return Observation(Outcome.SKIPPED, said)


def warning(said: str, remedy: str | Remedy, **numbers: float) -> Observation:
    """Allowed, but its author should know."""
    return Observation(Outcome.WARNING, said, remedy, numbers)


def failed(said: str, remedy: str | Remedy, **numbers: float) -> Observation:
    """Against the contract, or a wrong number in every table that shows this method."""
    return Observation(Outcome.FAILED, said, remedy, numbers)
