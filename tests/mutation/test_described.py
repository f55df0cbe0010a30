"""Every described change is whole, has a name of its own, and is found in this tree at one place."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import pytest

from tests.mutation.described import ROOT, Change, find_places, load_changes, nearest_tests

CHANGES = load_changes()
KEYS = {"name", "function", "change", "find", "replace", "tests"}
OPTIONAL_KEYS = {"inside", "slow", "killed", "killed_by"}

MODULE = """
class Walk:
    def length(self, steps):
        return (
            len(steps)
            - 1
        )


def length(steps):
    return _counted(steps)


def _counted(steps):
    return len(steps)
"""


def test_every_entry_has_the_needed_keys_and_a_name_of_its_own() -> None:
    assert len(CHANGES) == 60
    for change in CHANGES:
        assert change.keys() >= KEYS, change
        assert change.keys() <= KEYS | OPTIONAL_KEYS, change
        assert change["find"] != change["replace"]
        assert change["tests"], change
    repeated = [name for name, count in Counter(change["name"] for change in CHANGES).items() if count > 1]
    assert not repeated


@pytest.mark.parametrize("change", CHANGES, ids=[change["name"] for change in CHANGES])
def test_every_change_is_found_at_one_place_has_tests_near_it_and_leaves_python(change: Change) -> None:
    places = find_places(change, ROOT)
    assert len(places) == 1, f"place it by hand: {[module for module, _ in places]}"
    module, source = places[0]
    ast.parse(source)
    assert nearest_tests(change, module, ROOT)


def _change(**values: str) -> Change:
    return {"find": "len(steps)", "replace": "0", **values}


def test_a_change_is_found_by_name_and_fragment_however_lines_are_broken(tmp_path: Path) -> None:
    (tmp_path / "prbench").mkdir()
    (tmp_path / "prbench/walks.py").write_text(MODULE, encoding="utf-8")
    ((_, method),) = find_places(_change(function="Walk.length", find="len(steps) - 1"), tmp_path)
    assert "return (\n            0\n        )" in method
    ((module, helper),) = find_places(_change(function="length", inside="_counted"), tmp_path)
    assert module == "prbench/walks.py"
    assert helper.endswith("def _counted(steps):\n    return 0\n")
    assert not find_places(_change(function="width"), tmp_path)
    assert not find_places(_change(function="length", find="steps[1:]"), tmp_path)


def test_a_change_of_a_helper_is_found_in_the_function_that_took_it_back(tmp_path: Path) -> None:
    (tmp_path / "adapters").mkdir()
    (tmp_path / "adapters/walks.py").write_text("def length(steps):\n    return len(steps)\n", encoding="utf-8")
    places = find_places(_change(function="length", inside="_counted"), tmp_path)
    assert places == [("adapters/walks.py", "def length(steps):\n    return 0\n")]
