"""Every fault is named by the check that it belongs to, and by no other."""

from __future__ import annotations

import pytest

from prbench.checking.conformance import Outcome

FAILURES = {
    "cannotimport": "load",
    "cannotload": "load",
    "noconditions": "load",
    "impossiblemaxframes": "load",
    "takesanyoption": "settings",
    "missingweights": "weights",
    "weightsastext": "weights",
    "weightsofonecondition": "weights",
    "raises": "generates",
    "exits": "generates",
    "tooshort": "generates",
    "forgetstoreturn": "shapes",
    "barearray": "shapes",
    "frameshort": "shapes",
    "flatjoints": "shapes",
    "framesfirst": "shapes",
    "allaslongasthelongest": "shapes",
    "wholemillimetres": "dtype",
    "notanumber": "finite",
    "systementropy": "determinism",
    "owngenerator": "determinism",
    "globalnumpy": "global-random",
    "runseed": "noise-seed",
    "opaqueids": "noise-seed",
    "firstnoiseseed": "batch",
    "batchmean": "batch",
    "paceofthelongest": "batch",
    "squeezes": "single-row",
    "nolongsequences": "lengths",
    "spoiltbyotherconditions": "conditions",
    "needswords": "text",
    "depthup": "doctor",
    "centimetres": "doctor",
    "onejointfarout": "doctor",
    "leftandrightswapped": "doctor",
    "elsewhere": "doctor",
    "floats": "doctor",
    "anyheading": "doctor",
    "nothingfilledin": "doctor",
    "leaks": "memory",
}
WARNINGS = {
    "slowimport": "import",
    "misnamed": "load",
    "takesanyweights": "settings",
    "halfprecision": "dtype",
    "seedsglobalnumpy": "global-random",
    "amplifiesrounding": "batch",
    "limited": "lengths",
    "startsfromastandingpose": "initial-pose",
    "stretches": "bone-lengths",
}


@pytest.mark.parametrize(("method", "check"), FAILURES.items())
def test_a_fault_fails_its_check_and_no_other(found, method, check):
    findings = found(method)
    failed = [finding for finding in findings if finding.outcome is Outcome.FAILED]
    assert {finding.check for finding in failed} == {check}, failed
    assert all(finding.remedy for finding in failed)


@pytest.mark.parametrize(("method", "check"), WARNINGS.items())
def test_what_is_allowed_but_unwise_is_a_warning(found, method, check):
    findings = found(method)
    remarks = [finding for finding in findings if finding.outcome in (Outcome.FAILED, Outcome.WARNING)]
    assert {(finding.check, finding.outcome) for finding in remarks} == {(check, Outcome.WARNING)}, remarks


@pytest.mark.parametrize("method", ["glide", "nativerate"])
def test_the_right_method_passes_everything(found, method):
    findings = found(method)
    assert {finding.outcome for finding in findings} == {Outcome.PASSED, Outcome.SKIPPED}, findings
    assert [finding.check for finding in findings if finding.outcome is Outcome.SKIPPED] == ["weights"]


def test_only_what_a_diagnosis_would_repeat_waits_for_the_doctor(found):
    findings = {finding.check: finding for finding in found("floats")}
    for name in ("initial-pose", "bone-lengths"):
        assert findings[name].numbers, name
    assert findings["initial-pose"].numbers["error_m"] == pytest.approx(0.3, abs=0.02)
    sized = {finding.check: finding for finding in found("centimetres")}
    for name in ("initial-pose", "bone-lengths"):
        assert sized[name].said == "not looked at before 'doctor' passes (unit)."


def test_a_method_that_learns_is_fitted_to_other_people(found):
    findings = found("static")
    assert not [finding for finding in findings if finding.outcome in (Outcome.FAILED, Outcome.WARNING)], findings


def test_numbers_are_reported_beside_the_sentences(found):
    numbers = {finding.check: finding.numbers for finding in found("glide")}
    assert numbers["initial-pose"]["error_m"] == pytest.approx(0.0, abs=1e-6)
    assert numbers["lengths"] == {"longest_frames": 241.0}
