"""Does a method keep the contract? ``prbench adapters check``, and the same as pytest tests (docs/conformance.md)."""

from prbench.checking.conformance.finding import Finding, Outcome, Report
from prbench.checking.conformance.request import CheckRequest
from prbench.checking.conformance.session import check

__all__ = ["CheckRequest", "Finding", "Outcome", "Report", "check"]
