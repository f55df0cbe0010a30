"""What the methods of each benchmark are asked, and about which cases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from prbench.checking.conformance.cases import cases_of_table, kept_synthetic_cases
from prbench.checking.conformance.check import Check
from prbench.checking.conformance.checks import CHECKS, loading, reproducibility, resources
from prbench.checking.conformance.method_subject import MethodSubject
from prbench.checking.conformance.predictors import body, chance, form
from prbench.checking.conformance.predictors.cases import require_windows, synthetic_windows, windows_of_table
from prbench.checking.conformance.predictors.subject import BENCHMARK, PredictorSubject
from prbench.checking.conformance.report import CheckRequest
from prbench.checking.conformance.subject import Subject
from prbench.errors import UsageError
from prbench.harness.methods.loading import MethodSpec
from prbench.protocol.manifests import default_benchmark


@dataclass(frozen=True)
class Judge:
    """The checks of one benchmark."""

    checks: tuple[Check, ...]
    subject: Callable[[MethodSpec, CheckRequest, Path], MethodSubject]
    """Makes the method under examination: how to make it, the request, the folder of the check."""
    require_table: Callable[[Path], object]
    """Refuses a folder that holds no cases."""


def _motions(spec: MethodSpec, request: CheckRequest, folder: Path) -> Subject:
    cases = kept_synthetic_cases(folder) if request.data is None else cases_of_table(request.data)
    return Subject(spec, cases, folder)


def _futures(spec: MethodSpec, request: CheckRequest, folder: Path) -> PredictorSubject:
    cases = synthetic_windows(folder) if request.data is None else windows_of_table(request.data, folder)
    return PredictorSubject(spec, cases, folder)


_OF_PREDICTORS = (
    *loading.CHECKS,
    *form.CHECKS,
    reproducibility.determinism,
    reproducibility.global_random,
    *chance.CHECKS,
    reproducibility.single_row,
    reproducibility.batch,
    *body.CHECKS,
    *resources.CHECKS,
    reproducibility.process,  # in a process of its own, so last
)
_JUDGES = {
    default_benchmark().name: Judge(CHECKS, _motions, cases_of_table),
    BENCHMARK: Judge(_OF_PREDICTORS, _futures, require_windows),
}


def judge_of(benchmark: str) -> Judge:
    """Return the checks of a benchmark's methods.

    Raises:
        UsageError: for a benchmark whose methods cannot be checked.
    """
    if benchmark not in _JUDGES:
        raise UsageError(
            f"--benchmark {benchmark}: its methods cannot be checked; expected one of {', '.join(_JUDGES)}."
        )
    return _JUDGES[benchmark]
