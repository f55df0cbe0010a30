"""The checks, one file a subject, in the order in which faults have to be repaired."""

from prbench.checking.conformance.checks import body, form, reproducibility
from prbench.checking.conformance.findings import Check

_OF_DRAWING = (*reproducibility.CHECKS, *reproducibility.INPUTS)
_BY_SUBJECT = (*form.LOADING, *form.CHECKS, *_OF_DRAWING, *body.CHECKS, *body.RESOURCES)
# All checks in their order: those that need a process of their own come last
CHECKS: tuple[Check, ...] = tuple(sorted(_BY_SUBJECT, key=lambda one: one.fresh))
