"""Methods in a Python file or a module, which no package offers."""

from __future__ import annotations

import textwrap

import pytest

from prbench.errors import AdapterError, UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.installed import is_python_method
from prbench.harness.methods.loading import find_adapter, forget_loaded_methods, method_spec
from prbench.harness.methods.programs import short_name

GROUP = load_benchmark("motion-prediction").methods
SOURCE = """
    from prbench_benchmarks.motion_prediction.predictors import ZeroVelocity

    def load(weights, *, options, device):
        return ZeroVelocity(name="NAME")

    make = load
"""


@pytest.fixture
def file(tmp_path):
    def write(name: str = "mine"):
        path = tmp_path / "still_one.py"
        path.write_text(textwrap.dedent(SOURCE).replace("NAME", name))
        return path

    yield write
    forget_loaded_methods()


@pytest.mark.parametrize("suffix", ["", ":make"])
def test_a_file_is_a_method_by_the_name_that_it_gives_itself(file, suffix):
    method = f"{file()}{suffix}"
    spec = method_spec(method, group=GROUP)
    assert spec.load().name == "mine"
    found = find_adapter(method, entry_points=GROUP.entry_points)
    assert (found.package, len(found.version)) == ("still_one.py", 12)
    assert short_name(method) == "still_one"


def test_a_file_without_the_function_is_not_run(tmp_path):
    program = tmp_path / "reads.py"
    program.write_text("import sys\nsys.exit('it ran')\n")
    with pytest.raises(AdapterError, match=r"found none in this file. A program is given .* 'cmd:python reads.py'"):
        method_spec(str(program), group=GROUP)
    program.write_text("def load(:\n")
    with pytest.raises(AdapterError, match="expected Python, found"):
        method_spec(str(program), group=GROUP)


def test_names_of_prbench_and_isolation_are_refused(file):
    with pytest.raises(AdapterError, match="'still_one': 'zero-velocity' is a method of prbench itself"):
        method_spec(str(file("zero-velocity")), group=GROUP).load()
    with pytest.raises(UsageError, match=r"still_one\.py is no package"):
        method_spec(str(file()), group=GROUP, isolate=True)


def test_other_words_are_no_python_methods(tmp_path):
    assert not any(map(is_python_method, ("static", "gone.py", "cmd:python x", str(tmp_path), "a b:c")))
