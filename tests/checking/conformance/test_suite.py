"""The checks as pytest tests of somebody else's package."""

from __future__ import annotations

import unittest
import warnings

import pytest

from prbench.checking.conformance import Finding, Outcome, Report
from prbench.checking.conformance.checks import CHECKS
from prbench.checking.conformance.suite import AdapterConformance, ConformanceWarning
from prbench.errors import UsageError


class TestGlide(AdapterConformance):
    """As an author writes it; pytest collects a test for each check."""

    method = "glide"

    @pytest.fixture(autouse=True)
    def _installed(self, site, data):
        type(self).data = data


def test_there_is_a_test_for_each_check():
    names = {name for name in dir(TestGlide) if name.startswith("test_")}
    assert names == {f"test_{one.name.replace('-', '_')}" for one in CHECKS}


def reported(*findings: Finding) -> AdapterConformance:
    class Reported(AdapterConformance):
        method = "reported"
        _report = Report("reported", findings, 0.0)

    return Reported()


def test_a_failure_says_what_was_found_and_what_to_change():
    suite = reported(
        Finding("text", Outcome.FAILED, "no words, no motion.", "Treat it as no text."),
        Finding("memory", Outcome.PASSED, "no growth."),
    )
    with pytest.raises(AssertionError, match=r"no words, no motion\. Treat it as no text\."):
        suite.test_text()
    suite.test_memory()


def test_a_skipped_check_is_a_skipped_test_with_its_reason():
    with pytest.raises(unittest.SkipTest, match="takes no text"):
        reported(Finding("text", Outcome.SKIPPED, "it takes no text.")).test_text()


def test_a_warning_is_a_warning_of_pytest():
    suite = reported(Finding("lengths", Outcome.WARNING, "leaves some out.", "Take them."))
    with pytest.warns(ConformanceWarning, match=r"lengths: leaves some out\. Take them\."):
        suite.test_lengths()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reported(Finding("lengths", Outcome.PASSED, "fine.")).test_lengths()


def test_a_class_without_a_method_is_told_so():
    class Nameless(AdapterConformance):
        pass

    with pytest.raises(UsageError, match="names no method"):
        Nameless.report()
