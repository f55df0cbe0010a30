"""Predictors are checked: sound ones keep the contract, and each fault is found by the check that is for it."""

from __future__ import annotations

import sys
import textwrap
from pathlib import Path

import pytest

from prbench.checking.conformance import CheckRequest, Outcome
from prbench.checking.conformance.findings import examine
from prbench.checking.conformance.session import check, judge_of
from prbench.errors import TableError, UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench_benchmarks.motion_prediction.conformance import (
    BENCHMARK,
    AskedWindows,
    PredictorSubject,
    synthetic_windows,
    windows_of_table,
)
from tests.benchmarks.motion_prediction.test_run import PROGRAM
from tests.benchmarks.motion_prediction.windows import walking, write

CHECKS = judge_of(BENCHMARK).checks
DRIFT = """
    import numpy as np
    from prbench_benchmarks.motion_prediction.batch import Condition, Futures, sample_generator
    from prbench_benchmarks.motion_prediction.table import WindowsTable

    class Drift:
        name = "drift"
        conditions = frozenset({Condition.POSE, Condition.POSE_GAZE})
        MORE

        def predict(self, batch, *, n_samples, seed):
            last = batch.observed_joints[:, -1].astype(np.float64)
            step = last - batch.observed_joints[:, -2]
            frames = np.minimum(np.arange(1, batch.n_future + 1), 5)[:, None, None]
            joints = np.empty((len(batch), n_samples, batch.n_future, *last.shape[1:]), dtype=np.float32)
            for row, key in enumerate(batch.key):
                for k in range(n_samples):
                    speed = sample_generator(seed, key, k).uniform(0.0, 1.5)
                    joints[row, k] = last[row] + speed * frames * step[row]
            FAULT
            return Futures(joints=joints)

    def load(weights, *, options, device):
        if options or weights:
            raise ValueError("drift has neither options nor weights")
        return Drift()
"""
_PEEKS = """
    def fit(self, train):
        table = WindowsTable.open(train.folder)
        self.known = next(table.batches(Condition.POSE, table.chosen(split="test"), size=12))[1].joints
"""
FAULTS = {
    "shapes": "joints = joints[:, :, 1:]",
    "finite": "joints[0, 0, 0, 0, 0] = np.nan",
    "past": "joints[:, :, : batch.shape[1]] = batch.observed_joints[:, None]",
    "predicts": "raise IndexError('beyond the end')",
    "determinism": "joints += np.random.default_rng().normal(size=joints.shape)",
    "global-random": "joints += np.random.normal(size=joints.shape)",
    "seed": "joints[0] = last[0]",
    "samples": "joints += np.random.default_rng(seed).normal(size=(n_samples, 1, 1, 1)) + n_samples",
    "batch": "joints += np.arange(len(batch))[:, None, None, None, None]",
    "single-row": "joints = joints if len(batch) > 1 else joints[0]",
    "first-frame": "joints *= 1000",
    "bone-lengths": "joints = joints[..., ::-1, :].copy()",
    "firewall": "joints[:] = np.nan_to_num(self.known[: len(batch), None, : batch.n_future])",
}


@pytest.fixture(scope="module")
def cases(tmp_path_factory) -> AskedWindows:
    return synthetic_windows(tmp_path_factory.mktemp("cases"))


@pytest.fixture
def findings(tmp_path, cases):
    """Check a predictor in a Python file, in this process."""

    def found(name: str, fault: str = "", more: str = "", *, only: tuple[str, ...] = ()):
        path = tmp_path / f"{name.replace('-', '_')}.py"
        path.write_text(textwrap.dedent(DRIFT).replace("FAULT", fault or "pass").replace("    MORE\n", more))
        subject = PredictorSubject(
            method_spec(str(path), group=load_benchmark(BENCHMARK).methods), cases, tmp_path / "check"
        )
        subject.folder.mkdir()
        wanted = [one for one in CHECKS if not only or one.name in only]
        return {finding.check: finding for finding in examine(subject, wanted)}

    forget_loaded_methods()
    yield found
    forget_loaded_methods()


def test_a_sound_predictor_keeps_the_contract(findings):
    found = findings("drift")
    wrong = {name: each.said for name, each in found.items() if each.outcome in (Outcome.FAILED, Outcome.WARNING)}
    assert wrong == {}
    assert found["firewall"].outcome is found["samples"].outcome is Outcome.PASSED


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_found(findings, name):
    needs = {
        "load",
        "predicts",
        "shapes",
        "dtype",
        "finite",
        "determinism",
        "global-random",
        "seed",
        "single-row",
        name,
    }
    more = _PEEKS if name == "firewall" else ""
    found = findings(name, FAULTS[name], more, only=tuple(needs))
    failed = [each for each, finding in found.items() if finding.outcome is Outcome.FAILED]
    assert failed == [name]
    assert found[name].remedy


def test_samples_of_one_design_need_no_prefix(findings):
    found = findings("designed", FAULTS["samples"], "    one_design = True\n", only=("load", "predicts", "samples"))
    assert found["samples"].outcome is Outcome.SKIPPED
    assert "50 futures" in found["predicts"].said


def test_a_program_over_arrow_is_checked(tmp_path, cases):
    program = tmp_path / "stays.py"
    program.write_text(PROGRAM)
    spec = method_spec(f"cmd:{sys.executable} {program}", group=load_benchmark(BENCHMARK).methods)
    subject = PredictorSubject(spec, cases, tmp_path)
    quick = ("load", "settings", "predicts", "shapes", "dtype", "finite", "past", "firewall")
    wanted = [one for one in CHECKS if one.name in quick]
    found = {finding.check: finding for finding in examine(subject, wanted)}
    forget_loaded_methods()
    assert [name for name, each in found.items() if each.outcome is Outcome.FAILED] == ["settings"]  # it takes any
    assert found["firewall"].outcome is Outcome.PASSED


def test_windows_of_a_table_are_asked_about(tmp_path):
    table = write(tmp_path / "w", walking("a", 180), walking("b", 150, split="train", number=1))
    (tmp_path / "check").mkdir()
    cases = windows_of_table(table, tmp_path / "check")
    assert len(cases.table.chosen(split="test")) == 7
    assert len(cases.blind.chosen(split="train")) == 5
    with pytest.raises(UsageError, match="no window"):
        check(
            CheckRequest(
                "zero-velocity", benchmark=BENCHMARK, data=write(tmp_path / "t", walking("c", 90, split="train"))
            )
        )
    with pytest.raises(TableError, match="expected a built table of windows"):
        check(CheckRequest("zero-velocity", benchmark=BENCHMARK, data=tmp_path))


def test_each_check_has_a_test_of_the_suite():
    from prbench.checking.conformance.suite import PredictorConformance

    tests = [name for name in vars(PredictorConformance) if name.startswith("test_")]
    assert len(tests) == len(CHECKS)
    assert "test_firewall" in tests


def test_the_page_names_every_check():
    page = (Path(__file__).parents[3] / "docs" / "conformance.md").read_text(encoding="utf-8")
    missing = [one.name for one in CHECKS if f"`{one.name}`" not in page]
    assert missing == []
