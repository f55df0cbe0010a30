"""The checks, one file a subject, in the order in which faults have to be repaired."""

from prbench.evaluation.conformance.check import Check
from prbench.evaluation.conformance.checks import form, loading, reproducibility

CHECKS: tuple[Check, ...] = (*loading.CHECKS, *form.CHECKS, *reproducibility.CHECKS)
