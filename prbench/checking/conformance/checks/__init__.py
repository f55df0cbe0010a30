"""The checks, one file a subject, in the order in which faults have to be repaired."""

from prbench.checking.conformance.check import Check
from prbench.checking.conformance.checks import body, form, inputs, loading, reproducibility, resources

_BY_SUBJECT = (
    *loading.CHECKS,
    *form.CHECKS,
    *reproducibility.CHECKS,
    *inputs.CHECKS,
    *body.CHECKS,
    *resources.CHECKS,
)
CHECKS: tuple[Check, ...] = tuple(sorted(_BY_SUBJECT, key=lambda one: one.fresh))
"""In the order in which they are made: those that need a process of their own come last."""
