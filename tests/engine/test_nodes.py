"""A node that would not do the same as this machine is found out before work starts, by what it says of itself."""

from __future__ import annotations

import copy
import shutil
import sys
import time
from pathlib import Path

import pytest

import prbench
from prbench.engine import node_facts
from prbench.engine.nodes import LEAST_FREE, Needs, problems, question


@pytest.fixture
def asked(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "P01").touch()
    (tmp_path / "weights").write_bytes(b"1234")
    needs = Needs(
        reads=(tmp_path / "data", tmp_path / "weights"), writes=(tmp_path / "tables" / "adt",), packages=("pytest",)
    )
    with question(needs) as asked:
        yield asked


def answers(asked, **forged):
    """What a node answers that does not differ but for what is forged."""
    return {**copy.deepcopy(dict(asked.here)), **forged}


def found(asked, **forged):
    facts = answers(asked, **forged)
    return problems(facts, asked, answered=facts["time"] if "time" not in forged else time.time())


def test_a_node_that_answers_as_this_machine_does_is_fit(asked):
    assert found(asked) == []


@pytest.mark.parametrize(
    ("forged", "said"),
    [
        ({"prbench": "0.1.0"}, f"prbench 0.1.0 is installed there, and {prbench.__version__} here. Install the same"),
        ({"prbench": "", "code": ""}, f"prbench is not installed there. Install version {prbench.__version__}"),
        ({"code": "0" * 64}, "is installed there with other source files than here. Install the same commit on both"),
        ({"python": "3.99.0"}, "Python 3.99.0 runs there"),
    ],
)
def test_other_code_is_named_with_what_to_install(asked, forged, said):
    (line,) = found(asked, **forged)
    assert said in line


def test_another_patch_of_python_makes_no_difference(asked):
    same = ".".join((*map(str, sys.version_info[:2]), "99"))
    assert found(asked, python=same) == []


@pytest.mark.parametrize(("version", "said"), [("1.0.0", "torch 1.0.0 is installed"), ("", "torch is not installed")])
def test_another_version_of_a_package_is_named_with_the_command_that_helps(asked, version, said):
    (line,) = found(asked, packages={**asked.here["packages"], "torch": version})
    assert line.startswith(said)
    assert line.endswith(f"Run there: pip install torch=={asked.here['packages']['torch']}")


def test_a_package_that_only_this_work_needs_is_asked_for(asked):
    (line,) = found(asked, packages={**asked.here["packages"], "pytest": ""})
    assert line.startswith("pytest is not installed there")


def test_data_that_is_not_there_or_is_other_data_is_named(asked):
    data, weights = sorted(asked.here["reads"])
    missing, other = found(asked, reads={data: "", weights: "file of 5 bytes"})
    assert missing == f"{data} is not there. Mount the data at the same path on every node."
    assert other.startswith(f"{weights} holds something else there than here.")


def test_a_folder_of_the_same_name_on_another_disk_is_found_out(asked, tmp_path):
    (line,) = found(asked, marks=dict.fromkeys(asked.here["marks"], ""))
    assert line.startswith(f"{tmp_path} is not the same folder there: a file written here is not seen.")


def test_a_full_disk_is_named(asked):
    folder = next(iter(asked.here["room"]))
    (line,) = found(asked, room={folder: LEAST_FREE // 2})
    assert line == f"{folder} has 0.5 GB of free disk there; at least 1 GB are needed. Free some space."


@pytest.mark.parametrize(("off", "said"), [(-3600, "behind"), (3600, "ahead")])
def test_a_wrong_clock_is_named(asked, off, said):
    (line,) = found(asked, time=time.time() + off)
    assert line.startswith(f"its clock is 3600 s {said}; at most 30 s are allowed.")


def test_a_clock_a_little_off_and_a_slow_answer_are_no_wrong_clock(asked):
    assert found(asked, time=asked.asked - 5) == []
    assert problems(answers(asked, time=asked.asked + 50), asked, answered=asked.asked + 100) == []


def test_relative_paths_need_the_folder_that_they_start_in(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with question(Needs(writes=(Path("runs/static"),))) as asked:
        (line,) = found(asked, folder=False)
    assert line.startswith(f"{tmp_path}, where the command was started, is not there.")


def test_what_a_node_says_is_shown_without_what_steers_a_terminal(asked):
    (line,) = found(asked, prbench="\x1b[31m1")
    assert "\x1b" not in line


def test_the_marks_are_gone_afterwards(tmp_path):
    with question(Needs(writes=(tmp_path / "out",))):
        assert len(list(tmp_path.iterdir())) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_node_without_prbench_can_be_asked(tmp_path):
    """The text of the module is all that a node is given."""
    names = {"__name__": "elsewhere"}
    exec(Path(node_facts.__file__).read_text("utf-8"), names)
    wanted = {"packages": ["no-such-package"], "reads": [str(tmp_path / "x")], "marks": {}, "room": [], "folder": ""}
    facts = names["node_facts"](wanted)
    assert facts["packages"] == {"no-such-package": ""}
    assert facts["reads"] == {str(tmp_path / "x"): ""}


def test_the_digest_of_the_code_is_that_of_all_its_files(tmp_path, monkeypatch):
    for name in ("prbench", "prbench_adapters"):
        package = tmp_path / name
        package.mkdir()
        (package / "__init__.py").write_text("x = 1\n")
    monkeypatch.setattr(node_facts.importlib.util, "find_spec", lambda name: _Spec(tmp_path / name))
    asked = {"packages": [], "reads": [], "marks": {}, "room": [], "folder": ""}
    before = node_facts.node_facts(asked)["code"]
    assert node_facts.node_facts(asked)["code"] == before
    shutil.copy(tmp_path / "prbench/__init__.py", tmp_path / "prbench_adapters/other.py")
    assert node_facts.node_facts(asked)["code"] != before


class _Spec:
    def __init__(self, folder):
        self.submodule_search_locations = [str(folder)] if folder.is_dir() else None
