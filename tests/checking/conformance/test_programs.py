"""Programs behind the wire protocol are checked like any other method."""

from __future__ import annotations

import sys
import textwrap

import pytest

from prbench.checking.conformance import Outcome
from prbench.checking.conformance.checks import CHECKS
from prbench.checking.conformance.findings import examine
from prbench.checking.conformance.subject import Subject
from prbench.harness.methods.loading import forget_loaded_methods, method_spec

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
