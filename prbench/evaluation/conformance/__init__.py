"""Does a method keep the contract? ``prbench adapters check``, and the same as pytest tests (docs/conformance.md)."""

from prbench.evaluation.conformance.finding import Finding, Outcome, Report
from prbench.evaluation.conformance.request import CheckRequest
from prbench.evaluation.conformance.session import check

__all__ = ["CheckRequest", "Finding", "Outcome", "Report", "check"]
