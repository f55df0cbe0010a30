"""The checks as pytest tests: import :class:`AdapterConformance`, name a method, run pytest (``docs/conformance.md``).

from prbench.checking.conformance.suite import AdapterConformance

class TestGlide(AdapterConformance):
    method = "glide"
"""

from __future__ import annotations

import unittest
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar

from prbench.checking.conformance.judges import judge_of
from prbench.checking.conformance.predictors.subject import BENCHMARK
from prbench.checking.conformance.report import START_LIMIT, TIME_LIMIT, CheckRequest, Finding, Outcome, Report
from prbench.checking.conformance.session import check
from prbench.errors import UsageError
from prbench.protocol.manifests import default_benchmark


class ConformanceWarning(UserWarning):
    """A check that passed with a remark."""


class _Conformance:
    """Examines a method with the first of its tests; the others read the report."""

    benchmark: ClassVar[str]

    method: ClassVar[str]
    """Installed name, ``cmd:`` and a command, or path of a TOML file."""
    options: ClassVar[Mapping[str, str]] = {}
    weights: ClassVar[Path | None] = None
    device: ClassVar[str] = "cpu"
    data: ClassVar[Path | None] = None
    """A table whose test cases are asked about; None for synthetic people."""

    time_limit: ClassVar[float] = TIME_LIMIT
    """Seconds for each call of the method."""

    start_limit: ClassVar[float] = START_LIMIT
    """Seconds for importing an installed method, and for loading it."""

    _report: ClassVar[Report | None] = None

    @classmethod
    def report(cls) -> Report:
        """Return the report, made once for each class.

        Raises:
            UsageError: if the class names no method.
        """
        if "_report" not in cls.__dict__ or cls._report is None:
            if not hasattr(cls, "method"):
                raise UsageError(f'class {cls.__name__} names no method; write  method = "glide"  into it.')
            request = CheckRequest(
                cls.method,
                benchmark=cls.benchmark,
                weights=cls.weights,
                options=cls.options,
                device=cls.device,
                data=cls.data,
                time_limit=cls.time_limit,
                start_limit=cls.start_limit,
            )
            cls._report = check(request)
        return cls._report


class AdapterConformance(_Conformance):
    """Holds one test for each check of a method of prime-and-reach.

    A subclass, whose name begins with ``Test``, says what to check.
    """

    benchmark = default_benchmark().name


class PredictorConformance(_Conformance):
    """Holds one test for each check of a predictor of motion prediction; used like :class:`AdapterConformance`."""

    benchmark = BENCHMARK


def _test_of(name: str, title: str) -> Callable[[_Conformance], None]:
    def test(self: _Conformance) -> None:
        _require(self.report().about(name))

    test.__name__ = f"test_{name.replace('-', '_')}"
    test.__doc__ = f"{title[0].upper()}{title[1:]}."
    return test


def _require(findings: tuple[Finding, ...]) -> None:
    """Turn the findings of one check into pytest's terms."""
    for finding in findings:
        if finding.outcome is Outcome.WARNING:
            warnings.warn(f"{finding.check}: {finding.said} {finding.remedy}", ConformanceWarning, stacklevel=3)
    wrong = [f"{finding.said} {finding.remedy}" for finding in findings if finding.outcome is Outcome.FAILED]
    if wrong:
        raise AssertionError("\n".join(wrong))
    if all(finding.outcome is Outcome.SKIPPED for finding in findings):
        raise unittest.SkipTest("; ".join(finding.said for finding in findings))


for _suite in (AdapterConformance, PredictorConformance):
    for _check in judge_of(_suite.benchmark).checks:
        _test = _test_of(_check.name, _check.title)
        setattr(_suite, _test.__name__, _test)
