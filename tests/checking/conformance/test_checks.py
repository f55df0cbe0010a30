"""Every fault is named by the check that it belongs to, and by no other, of installed methods and of programs."""

from __future__ import annotations

import json
import sys
import textwrap

import msgspec
import numpy as np
import pytest

from prbench.checking.conformance import Outcome
from prbench.checking.conformance.cases import synthetic_cases
from prbench.checking.conformance.checks import CHECKS
from prbench.checking.conformance.checks.body import growth_per_round
from prbench.checking.conformance.findings import CheckRequest, examine
from prbench.checking.conformance.subject import Subject
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench.harness.methods.training_split import TrainingSplit
from prbench.sequences import SequenceTable

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


PROGRAM = """
    import os, sys
    import numpy as np
    from prbench.contract import Condition, Motions
    from prbench.harness.methods.messages import batch_of, motions_payload, read_message, write_message

    served = 0
    hello, _ = read_message(sys.stdin.buffer)
    if hello["options"]:
        write_message(sys.stdout.buffer, {"message": "error", "text": "unknown option"})
        sys.exit()
    if hello["weights"]:
        write_message(sys.stdout.buffer, {"message": "error", "text": "no such weights"})
        sys.exit()
    END = 0
    answer = {"message": "hello", "wire": 1, "name": "stand", "version": "1.0", "conditions": ["goal-loc"]}
    write_message(sys.stdout.buffer, answer)
    while True:
        message = read_message(sys.stdin.buffer)
        if message is None:
            sys.exit(END)
        header, payload = message
        batch = batch_of(header, payload)
        joints = np.repeat(batch.initial_joints[:, None], batch.n_frames.max(), axis=1)
        n_frames = batch.n_frames
        served += 1
        FAULT
        answer = {"message": "motions", "batch": header["batch"]}
        write_message(sys.stdout.buffer, answer, motions_payload(batch.opaque_id, Motions(joints, n_frames)))
"""

WANTED = ("load", "settings", "weights", "generates", "shapes", "dtype", "finite", "global-random")


@pytest.fixture
def found_in_program(cases, tmp_path):
    def _found(
        fault="pass",
        *,
        takes_anything=False,
        wanted=("load", "generates", "shapes", "finite", "determinism", "global-random"),
    ):
        program = tmp_path / "stand.py"
        source = textwrap.dedent(PROGRAM).replace("FAULT", fault)
        if takes_anything:
            source = source.replace('if hello["options"]', "if False")
        program.write_text(source)
        forget_loaded_methods()
        subject = Subject(method_spec(f"cmd:{sys.executable} {program}"), cases, tmp_path)
        return list(examine(subject, [one for one in CHECKS if one.name in wanted]))

    yield _found
    forget_loaded_methods()


def test_a_right_program_passes_what_can_be_seen_of_it(found_in_program):
    outcomes = {finding.check: finding.outcome for finding in found_in_program(wanted=WANTED)}
    skipped = {name for name, outcome in outcomes.items() if outcome is Outcome.SKIPPED}
    assert skipped == {"weights", "global-random"}
    assert set(outcomes.values()) == {Outcome.SKIPPED, Outcome.PASSED}


@pytest.mark.parametrize(
    ("fault", "check", "told"),
    [
        ("n_frames = n_frames - 1", "shapes", "frames"),
        ("os._exit(3)", "generates", "ended with exit status 3"),
        ("joints[:, :, 5] += served", "determinism", "a second time"),
    ],
)
def test_a_fault_of_a_program_fails_its_check_and_no_other(found_in_program, fault, check, told):
    failed = [finding for finding in found_in_program(fault) if finding.outcome is Outcome.FAILED]
    assert {finding.check for finding in failed} == {check}, failed
    assert told in failed[0].said


def test_remedies_speak_of_the_wire_to_authors_of_programs(found_in_program):
    fault = "hello.clear()"
    findings = found_in_program(fault, wanted=("load", "settings"), takes_anything=True)
    (failed,) = [finding for finding in findings if finding.outcome is Outcome.FAILED]
    assert failed.check == "settings"
    assert failed.remedy.startswith('Answer the hello with {"message": "error"')
    for remedy in _remedies():
        assert "generate()" not in remedy.program
        assert "load()" not in remedy.program
        assert "batch." not in remedy.program


def _remedies():
    from prbench.checking.conformance.checks import form, reproducibility
    from prbench.checking.conformance.findings import Remedy

    modules = (form, reproducibility)
    return [value for module in modules for value in vars(module).values() if isinstance(value, Remedy)]


MIB = 2**20


def test_cases_are_sorted_by_length_and_of_two_people(people):
    source = people.source
    assert len(source.n_frames) == 12
    assert (np.diff(source.n_frames) >= 0).all()
    table = SequenceTable.open(people.folder)
    rows = table.scalars(split="test").to_pylist()
    assert len({row["participant_id"] for row in rows if row["sequence_id"] in source.sequence_ids}) == 2


def test_what_a_method_learns_from_is_disjoint_from_what_it_is_asked_about(people):
    table = TrainingSplit.open(people.folder)
    learnt = {name for chunk in table.chunks() for name in chunk.sequence_ids}
    teachers = set(table.scalars()["participant_id"].to_pylist())
    assert len(learnt) >= 12
    assert not learnt & set(people.source.sequence_ids)
    asked = SequenceTable.open(people.folder).scalars(split="test")["participant_id"].to_pylist()
    assert not teachers & set(asked)


def test_steady_growth_is_measured_and_noise_is_not():
    rounds = np.arange(12)
    assert growth_per_round(200.0 * MIB + 2 * MIB * rounds) == pytest.approx(2 * MIB)
    noise = np.random.default_rng(0).normal(size=12) * 3 * MIB
    assert growth_per_round(200.0 * MIB + noise) == 0
    assert growth_per_round(200.0 * MIB + np.where(rounds < 1, 0, 8 * MIB)) == 0  # settles late
    assert growth_per_round(200.0 * MIB + 0.1 * MIB * rounds) == 0  # too little to tell


def test_a_request_survives_the_way_into_another_process(tmp_path):
    request = CheckRequest("cmd:python glide.py", options={"a": "b"}, data=tmp_path, threads=2, time_limit=3.0)
    sent = json.loads(json.dumps(msgspec.to_builtins(request, enc_hook=str)))
    assert msgspec.convert(sent, CheckRequest, dec_hook=lambda kind, text: kind(text)) == request


def test_a_slow_method_is_asked_about_few_and_short_sequences(site, people, tmp_path, monkeypatch):
    quick = Subject(method_spec("glide"), people, tmp_path)
    assert quick.rows == tuple(range(12))
    monkeypatch.setattr("prbench.checking.conformance.subject._BATCH_SECONDS", 1e-6)
    slow = Subject(method_spec("glide"), people, tmp_path)
    assert slow.rows == (0, 6)


def test_lengths_are_those_of_the_protocol_and_of_max_frames(site, cases, tmp_path):
    glide = Subject(method_spec("glide"), cases, tmp_path)
    assert (glide.shortest, glide.protocols_longest, glide.longest) == (41, 241, 241)
    assert Subject(method_spec("limited"), cases, tmp_path).longest == 196


def test_the_table_of_a_check_is_written_once(cases):
    before = {path: path.stat().st_mtime_ns for path in cases.folder.rglob("*")}
    again = synthetic_cases(cases.folder.parent, limit=3)
    assert again.source.sequence_ids == cases.source.sequence_ids
    assert {path: path.stat().st_mtime_ns for path in cases.folder.rglob("*")} == before
