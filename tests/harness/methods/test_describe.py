"""Asking methods what they declare, each in a process of its own: nothing that a package does takes the list down."""

from __future__ import annotations

import json

import pytest

from prbench.cli import main
from prbench.harness.methods.loading import describe_adapters
from tests.method_fixtures import adapter_source

ENDINGS = {
    "missing": (
        "import surely_not_installed",
        "cannot be imported: ModuleNotFoundError: No module named 'surely_not_in",
    ),
    "quits": ("raise SystemExit('needs a GPU')", "cannot be imported: SystemExit: needs a GPU"),
    "no_gpu": (
        "def load(weights, *, options, device):\n raise RuntimeError('line one\\nline two')",
        "line one line two",
    ),
    "long": (f"raise ValueError({'x' * 50 + ' '!r} * 1000)", "ValueError: xxxxx"),
}


@pytest.mark.parametrize("name", ENDINGS)
def test_whatever_a_package_does_becomes_one_line(install, name):
    install(name, ENDINGS[name][0])
    (described,) = describe_adapters([name])
    error = described.error
    assert ENDINGS[name][1] in error
    assert "\n" not in error
    assert len(error) <= 300
    assert described.conditions == ()


def test_a_method_says_what_it_declares(install):
    body = """
        max_frames, native_fps, motionless = 196, 30.0, True
        def fit(self, train, *, validation, run): ...
        def weights_for(self, condition):
            from pathlib import Path
            return Path(f"/somewhere/{condition.value}.safetensors")
    """
    install("made", adapter_source(attributes=body.strip()) + "\n    import time; time.sleep(0.2)\n")
    (made,) = describe_adapters(["made"])
    assert made.error == ""
    assert made.conditions == ("goal-loc", "none")
    assert (made.max_frames, made.native_fps, made.motionless, made.fitted) == (196, 30.0, True, True)
    assert made.weights == ("goal-loc.safetensors", "none.safetensors")


def test_predictors_say_what_they_take_and_whether_they_learn_from_a_table():
    found = describe_adapters(["nearest-past", "zero-velocity"], benchmark="motion-prediction")
    assert [(one.method.name, one.fitted, one.error) for one in found] == [
        ("nearest-past", True, ""),
        ("zero-velocity", False, ""),
    ]
    assert {one.conditions for one in found} == {("pose", "pose+gaze", "pose+head")}


def test_what_a_package_prints_never_reaches_the_list(install, capfd):
    install("loud", "import sys\nprint('x' * 99_999)\nprint('y', file=sys.stderr)\n" + PLAIN)
    (loud,) = describe_adapters(["loud"])
    assert (loud.error, loud.conditions) == ("", ("none",))
    assert capfd.readouterr() == ("", "")


PLAIN = """
class Plain:
    name = "plain"
    conditions = frozenset({"none"})
    def generate(self, batch, *, seed): ...
def load(weights, *, options, device): return Plain()
"""


def test_many_are_described_in_the_order_of_their_names(install):
    for name in ("b", "a", "c"):
        install(name, PLAIN)
    found = describe_adapters(["c", "b", "a"])
    assert [one.method.name for one in found] == ["a", "b", "c"]
    assert not any(one.error for one in found)


def test_a_name_that_two_packages_offer_is_not_imported_at_all(install, tmp_path):
    touched = tmp_path / "touched"
    for package in ("prbench_one", "prbench_two"):
        install("same", f"import pathlib; pathlib.Path({str(touched)!r}).touch()", package=package)
    found = describe_adapters(["same"])
    assert [one.error for one in found] == ["another package offers the same name"] * 2
    assert not touched.exists()


def test_the_list_shows_good_and_bad_methods_and_controls(install, capsys):
    install("good", PLAIN)
    install("bad", "1 / 0")
    assert main(["adapters", "list", "--details", "good", "bad"]) == 0
    text = capsys.readouterr().out
    assert "good  prbench_good 1.2  none" in text
    assert "! bad (prbench_bad 1.2): cannot be imported: ZeroDivisionError: division by zero" in text
    assert "controls" not in text, "only what was asked for"
    assert main(["adapters", "list", "--details", "--json", "good", "bad"]) == 0
    bad, good = json.loads(capsys.readouterr().out)["report"]
    assert (good["conditions"], good["fitted"], good["error"]) == (["none"], False, "")
    assert bad["error"].startswith("cannot be imported")


def test_a_name_that_nobody_offers_is_answered_with_the_nearest(capsys):
    assert main(["adapters", "list", "--details", "statik"]) == 5
    assert "Did you mean 'static'?" in capsys.readouterr().err
