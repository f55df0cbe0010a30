"""Finding and loading methods."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from prbench.contract import Condition
from prbench.errors import AdapterError, MissingExtraError, RunError, UsageError
from prbench.files.storage import file_digest
from prbench.harness.methods.loading import InstalledEntry, chosen_condition, find_adapter, list_adapters, load_adapter
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import RunRecord
from tests.harness.test_run import request
from tests.method_fixtures import adapter_source


def test_listing_imports_no_adapter_and_no_torch(install):
    install("explosive", "raise SystemError('imported')")
    assert "explosive" in [adapter.name for adapter in list_adapters()]
    program = (
        "import sys; from prbench.harness.methods.loading import list_adapters; assert list_adapters();"
        "loaded = [m for m in sys.modules if m.split('.')[0] in ('torch', 'prbench_adapters', 'scipy')];"
        "assert not loaded, loaded"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_third_party_package_adds_a_method(install):
    install("made", adapter_source())
    assert find_adapter("made") == InstalledEntry("made", "prbench_made", "1.2", "prbench_made:load")
    assert load_adapter("made", None, {}, "cpu").name == "made"


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(AdapterError) as caught:
        find_adapter("statik")
    assert str(caught.value) == (
        "adapter 'statik' is not installed. Did you mean 'static'? `prbench adapters list` shows all of them."
    )
    with pytest.raises(AdapterError, match=r"Did you mean 'ground-truth'"):
        find_adapter("groundtruth", also_known=["ground-truth"])
    with pytest.raises(AdapterError, match=r"is not installed. A program is given as"):
        find_adapter("zzzzzz")


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        ("import surely_not_installed", "load", r"cannot be imported: ModuleNotFoundError: No module named 'surely"),
        ("x = 1 / 0", "load", "cannot be imported: ZeroDivisionError"),
        ("", "load", "cannot be imported: AttributeError"),
        ("def load(weights, *, options, device): raise RuntimeError('no GPU')", "load", "cannot be loaded: .*no GPU"),
        ("def load(weights, *, options, device): return 3", "load", r"expected an object with .* found int"),
        ("def load(): pass", "load", "cannot be loaded: TypeError"),
        ("raise SystemExit('needs a GPU')", "load", "cannot be imported: SystemExit: needs a GPU"),
    ],
)
def test_a_broken_plug_in_is_named_with_its_package_and_cause(install, source, target, message):
    install("broken", source, target=target)
    with pytest.raises(AdapterError, match=rf"adapter 'broken' \(package prbench_broken 1\.2, .*{message}"):
        load_adapter("broken", None, {}, "cpu")


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ("conditions = None", "expected 'conditions' to be some of goal-loc, .*, text, found None"),
        ("conditions = frozenset({'walk'})", r"expected 'conditions' .*, found frozenset\(\{'walk'\}\)"),
        ("conditions = 'none'", "expected 'conditions' .*, found 'none'"),
        ("max_frames = 'many'", "expected 'max_frames' to be a whole number of 1 or more, or None, found 'many'"),
        ("max_frames = 0", "expected 'max_frames' .*, found 0"),
        ("native_fps = 0", "expected 'native_fps' to be frames per second above 0, or None, found 0"),
        ("native_fps = float('nan')", "expected 'native_fps' .*, found nan"),
        ("native_fps = '30'", "expected 'native_fps' .*, found '30'"),
    ],
)
def test_an_attribute_that_is_not_what_the_contract_asks_for_is_named(install, attributes, message):
    install("made", adapter_source(attributes=attributes))
    with pytest.raises(AdapterError, match=rf"adapter 'made' \(package prbench_made 1\.2, .*{message}"):
        load_adapter("made", None, {}, "cpu")


def test_an_error_that_the_user_can_repair_passes_as_it_is(install):
    install(
        "needy",
        "from prbench.errors import MissingExtraError\n"
        "def load(weights, *, options, device): raise MissingExtraError('transformers', 'text', 'needy')",
    )
    with pytest.raises(MissingExtraError, match=r"prbench\[text\]"):
        load_adapter("needy", None, {}, "cpu")


def test_an_unsupported_condition_names_the_supported_ones(install):
    install("made", adapter_source())
    adapter = load_adapter("made", None, {}, "cpu")
    chosen_condition("made", adapter, Condition.GOAL_LOCATION)
    with pytest.raises(AdapterError, match=r"does not take the condition 'text'. Choose one of: goal-loc, none"):
        chosen_condition("made", adapter, Condition.TEXT)


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
