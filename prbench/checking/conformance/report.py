"""The request of a check, its findings about a method, and the report that holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from prbench.protocol.manifests import default_benchmark

TIME_LIMIT = 600.0
"""Default limit of each call of the method, seconds."""
START_LIMIT = 120.0
"""Default limit of importing and of loading a method, seconds; programs have the same for their hello."""


class Outcome(StrEnum):
    """The result of a check, from good to bad."""

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
    """How it came out."""
    said: str
    """The observation with its numbers; for a skipped check, the reason."""
    remedy: str = ""
    """The change to make; empty where there is none."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Maps names that end in their unit to measured numbers."""


@dataclass(frozen=True)
class Report:
    """All findings about one method."""

    method: str
    """The method, as it was named."""
    findings: tuple[Finding, ...]
    """In the order of the checks. The exit code is 5 if one failed."""
    seconds: float
    """How long the checks took."""

    @property
    def failed(self) -> tuple[Finding, ...]:
        """The findings that need a change."""
        return self.of(Outcome.FAILED)

    def of(self, outcome: Outcome) -> tuple[Finding, ...]:
        """Return the findings of one outcome."""
        return tuple(finding for finding in self.findings if finding.outcome is outcome)

    def about(self, check: str) -> tuple[Finding, ...]:
        """Return the findings of one check."""
        return tuple(finding for finding in self.findings if finding.check == check)


@dataclass(frozen=True)
class Remedy:
    """A change to make, worded for the author of an adapter in Python and for the author of a program."""

    adapter: str
    program: str

    def then(self, text: str) -> Remedy:
        """Return the remedy with ``text`` appended to both wordings."""
        return Remedy(f"{self.adapter} {text}", f"{self.program} {text}")

    def after(self, text: str) -> Remedy:
        """Return the remedy with ``text`` before both wordings."""
        return Remedy(f"{text} {self.adapter}", f"{text} {self.program}")


@dataclass(frozen=True)
class Observation:
    """A finding before the runner has put the name of its check to it."""

    outcome: Outcome
    said: str
    remedy: str | Remedy = ""
    numbers: Mapping[str, float] = field(default_factory=dict)

    def of(self, check: str, *, by_program: bool = False) -> Finding:
        """Make it the finding of a check, worded for a user's own program or for an adapter."""
        numbers = {name: float(value) for name, value in self.numbers.items()}
        remedy = self.remedy
        if isinstance(remedy, Remedy):
            remedy = remedy.program if by_program else remedy.adapter
        return Finding(check, self.outcome, self.said, remedy, numbers)


@dataclass(frozen=True)
class CheckRequest:
    """A method, and how to check it."""

    method: str
    """Installed name, ``cmd:`` and a command, or a TOML file."""
    weights: Path | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    device: str = "cpu"
    threads: int = 1
    isolate: bool = False
    benchmark: str = default_benchmark().name
    """The benchmark that it is a method of."""
    data: Path | None = None
    """A table whose test cases are asked about; None for synthetic people."""
    time_limit: float = TIME_LIMIT
    """Seconds for each call of the method."""
    start_limit: float = START_LIMIT
    """Seconds for importing it, and for loading it; a program's own are in its TOML file."""

    def as_json(self) -> dict[str, object]:
        """Return the request as plain values, for another process."""
        weights = None if self.weights is None else str(self.weights)
        data = None if self.data is None else str(self.data.absolute())
        return asdict(self) | {"options": dict(self.options), "weights": weights, "data": data}

    @classmethod
    def of_json(cls, values: Mapping[str, Any]) -> CheckRequest:
        """Read the request that :meth:`as_json` wrote."""
        paths = {name: None if values[name] is None else Path(values[name]) for name in ("weights", "data")}
        return cls(**{**values, **paths})


def passed(said: str, **numbers: float) -> Observation:
    """Make the observation that all is well; ``said`` holds the evidence."""
    return Observation(Outcome.PASSED, said, numbers=numbers)


def skipped(said: str) -> Observation:
    """Make the observation that a check did not apply, with the reason."""
    return Observation(Outcome.SKIPPED, said)


def warning(said: str, remedy: str | Remedy, **numbers: float) -> Observation:
    """Make an observation that is allowed but that the author should know."""
    return Observation(Outcome.WARNING, said, remedy, numbers)


def failed(said: str, remedy: str | Remedy, **numbers: float) -> Observation:
    """Make an observation against the contract, which makes numbers of this method wrong."""
    return Observation(Outcome.FAILED, said, remedy, numbers)
