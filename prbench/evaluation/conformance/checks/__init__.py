"""The checks, one file a subject, in the order in which faults have to be repaired."""

from prbench.evaluation.conformance.check import Check
from prbench.evaluation.conformance.checks import batches, body, form, inputs, loading, reproducibility, resources

CHECKS: tuple[Check, ...] = (
    *loading.CHECKS,
    *form.CHECKS,
    *reproducibility.CHECKS,
    *batches.CHECKS,
    *inputs.CHECKS,
    *body.CHECKS,
    *resources.CHECKS,
)
