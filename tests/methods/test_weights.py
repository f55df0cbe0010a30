"""Which weights a method uses: what it says itself, what is recorded, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.contract import Condition
from prbench.errors import AdapterError, RunError, UsageError
from prbench.evaluation.run import run_method
from prbench.runs.record import RunRecord
from prbench.storage import file_digest
from tests.evaluation.test_run import request
from tests.method_fixtures import adapter_source

NAMING = """
        weights = None

        def weights_for(self, condition):
            from pathlib import Path
            return Path({folder!r}) / f"{{self.weights or 'own'}}-{{condition.value}}.bin"
"""


@pytest.fixture
def naming(tmp_path, install) -> Path:
    """A method with bundled weights ``own-*`` and ``other-*`` for each condition; the folder that they lie in."""
    folder = tmp_path / "bundled"
    folder.mkdir()
    for name in ("own-none", "own-goal-loc", "other-none"):
        (folder / f"{name}.bin").write_text(name)
    source = adapter_source(attributes=NAMING.format(folder=str(folder)))
    install("made", source.replace("return Made()", "made = Made(); made.weights = weights; return made"))
    return folder


def _record(tmp_path: Path) -> RunRecord:
    return RunRecord.read(tmp_path / "out")


@pytest.mark.parametrize("condition", [Condition.NONE, Condition.GOAL_LOCATION])
def test_a_run_records_the_weights_that_the_method_chose_for_the_condition(table, tmp_path, naming, condition):
    run_method(request(table, tmp_path / "out", "made", condition=condition, limit=2))
    method = _record(tmp_path).method
    assert method.weights == f"own-{condition.value}.bin"
    assert method.weights_digest == file_digest(naming / method.weights)


def test_a_name_that_is_no_path_is_left_to_the_method(table, tmp_path, naming):
    run_method(request(table, tmp_path / "out", "made", weights=Path("other"), limit=2))
    assert _record(tmp_path).method.weights == "other-none.bin"


def test_a_run_is_not_resumed_once_the_methods_own_weights_have_changed(table, tmp_path, naming):
    run_method(request(table, tmp_path / "out", "made", limit=2))
    (naming / "own-none.bin").write_text("retrained")
    with pytest.raises(RunError, match=r"method\.weights_digest"):
        run_method(request(table, tmp_path / "out", "made", limit=2))


def test_a_run_is_not_resumed_with_weights_of_another_name(table, tmp_path, naming):
    run_method(request(table, tmp_path / "out", "made", limit=2))
    with pytest.raises(RunError, match=r"method\.weights: expected other-none\.bin for this run, found own-none\.bin"):
        run_method(request(table, tmp_path / "out", "made", weights=Path("other"), limit=2))


def test_a_word_that_the_method_does_not_resolve_is_no_path(table, tmp_path, install):
    install("made", adapter_source())
    with pytest.raises(UsageError, match="--weights small: expected a file or folder, found neither"):
        run_method(request(table, tmp_path / "out", "made", weights=Path("small")))


def test_a_method_that_uses_no_weights_may_say_so(table, tmp_path, install):
    install("made", adapter_source(attributes="weights_for = staticmethod(lambda condition: None)"))
    run_method(request(table, tmp_path / "out", "made", limit=2))
    assert _record(tmp_path).method.weights is None


def test_weights_that_are_no_path_break_the_contract(table, tmp_path, install):
    install("made", adapter_source(attributes="weights_for = staticmethod(lambda condition: 'small')"))
    with pytest.raises(AdapterError, match=r"weights_for\(\) to return a pathlib\.Path or None, found 'small'"):
        run_method(request(table, tmp_path / "out", "made"))
