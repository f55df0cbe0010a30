"""The checks as pytest tests: import :class:`AdapterConformance`, name a method, run pytest (``docs/conformance.md``).

from prbench.checking.conformance.suite import AdapterConformance

class TestGlide(AdapterConformance):
    method = "glide"
"""

from __future__ import annotations

import unittest
import warnings
from collections.abc import Callable
from dataclasses import fields
from typing import ClassVar

from prbench.checking.conformance.findings import CheckRequest, Outcome, Report
from prbench.checking.conformance.session import check, judge_of
from prbench.errors import UsageError
from prbench.protocol.manifests import default_benchmark


class ConformanceWarning(UserWarning):
    """A check that passed with a remark."""


class _Conformance:
    """Examines a method with the first of its tests; the others read the report.

    Every field of :class:`CheckRequest` may be given as an attribute of the class: ``method`` (installed name, ``cmd:``
    and a command, or path of a TOML file), ``options``, ``weights``, ``device``, ``data``, ``time_limit`` …
    """

    benchmark: ClassVar[str]

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
            given = {each.name: getattr(cls, each.name) for each in fields(CheckRequest) if hasattr(cls, each.name)}
            cls._report = check(CheckRequest(**given))
        return cls._report


class AdapterConformance(_Conformance):
    """Holds one test for each check of a method of prime-and-reach.

    A subclass, whose name begins with ``Test``, says what to check.
    """

    benchmark = default_benchmark().name


class PredictorConformance(_Conformance):
    """Holds one test for each check of a predictor of motion prediction; used like :class:`AdapterConformance`."""

    benchmark = "motion-prediction"


def _test_of(name: str, title: str) -> Callable[[_Conformance], None]:
    def test(self: _Conformance) -> None:
        # The findings of one check, in pytest's terms.
        findings = [finding for finding in self.report().findings if finding.check == name]
        for finding in findings:
            if finding.outcome is Outcome.WARNING:
                warnings.warn(f"{name}: {finding.said} {finding.remedy}", ConformanceWarning, stacklevel=2)
        wrong = [f"{finding.said} {finding.remedy}" for finding in findings if finding.outcome is Outcome.FAILED]
        if wrong:
            raise AssertionError("\n".join(wrong))
        if all(finding.outcome is Outcome.SKIPPED for finding in findings):
            raise unittest.SkipTest("; ".join(finding.said for finding in findings))

    test.__name__ = f"test_{name.replace('-', '_')}"
    test.__doc__ = f"{title[0].upper()}{title[1:]}."
    return test


for _suite in (AdapterConformance, PredictorConformance):
    for _check in judge_of(_suite.benchmark).checks:
        _test = _test_of(_check.name, _check.title)
        setattr(_suite, _test.__name__, _test)
