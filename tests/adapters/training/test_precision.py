"""The precision ``auto``: measured once a machine, kept by a training that goes on."""

from __future__ import annotations

import pytest

from prbench_adapters.training import run as under_test
from prbench_adapters.training.run import chosen_precision, quicker_precision


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch, tmp_path) -> list[str]:
    """Counts the measurements, whose answer is bfloat16."""
    calls: list[str] = []

    def measure() -> str:
        calls.append("measured")
        return "bf16-mixed"

    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(under_test, "quicker_precision", measure)
    return calls


def test_a_named_precision_is_taken_as_it_is(measured, tmp_path):
    assert chosen_precision("32-true", device="cpu", out=tmp_path) == "32-true"
    assert measured == []


def test_a_machine_is_measured_once(measured, tmp_path):
    for _ in range(2):
        assert chosen_precision("auto", device="cpu", out=tmp_path) == "bf16-mixed"
    assert measured == ["measured"]


def test_gpus_are_not_measured(measured, tmp_path):
    assert chosen_precision("auto", device="cuda:0", out=tmp_path) == "bf16-mixed"
    assert measured == []


def test_the_measurement_names_one_of_the_two():
    assert quicker_precision() in ("32-true", "bf16-mixed")
