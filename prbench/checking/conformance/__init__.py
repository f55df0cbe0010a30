"""Checks that a method keeps the contract: ``prbench adapters check``, and pytest tests (docs/conformance.md)."""

from prbench.checking.conformance.findings import CheckRequest, Finding, Outcome, Report
from prbench.checking.conformance.session import check
