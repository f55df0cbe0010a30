"""Mutants are found where they are expected, and a test that notices one kills it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.mutation.mutants import Mutant, draw, mutants_of, mutated_source

MODULE = '''
"""Numbers in a docstring, 1 and 2, are no constants."""

LIMIT = 3.0


def inside(values: Float[np.ndarray, " 4"], limit: int) -> bool:
    if not values or limit > 0:
        return max(values[1:]) < limit + 1
    return True
'''


def _module(folder: Path, name: str, source: str) -> Path:
    path = folder / "prbench" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(source, encoding="utf-8")
    return path


def _find_one(mutants: list[Mutant], operator: str, before: str) -> Mutant:
    (found,) = [mutant for mutant in mutants if (mutant.operator, mutant.before) == (operator, before)]
    return found


def test_every_kind_of_mistake_is_found_and_annotations_are_left_alone(tmp_path: Path) -> None:
    mutants = mutants_of(tmp_path, _module(tmp_path, "ranges/limits.py", MODULE))
    changes = {(mutant.operator, mutant.before, mutant.after) for mutant in mutants}
    assert changes == {
        ("constant", "3.0", "4.0"),
        ("and/or", "not values or limit > 0", "not values and limit > 0"),
        ("not", "not values", "values"),
        ("comparison", "limit > 0", "limit >= 0"),
        ("constant", "0", "1"),
        ("return", "return max(values[1:]) < limit + 1", "return not max(values[1:]) < limit + 1"),
        ("comparison", "max(values[1:]) < limit + 1", "max(values[1:]) <= limit + 1"),
        ("min/max", "max", "min"),
        ("slice", "1:", "1 + 1:"),
        ("constant", "1", "0"),
        ("arithmetic", "limit + 1", "limit - 1"),
        ("return", "return True", "return not True"),
    }
    assert {mutant.package for mutant in mutants} == {"ranges"}


def test_a_mutated_module_differs_in_that_one_place(tmp_path: Path) -> None:
    module = _module(tmp_path, "ranges/limits.py", MODULE)
    sound = ast.unparse(ast.parse(MODULE))
    for mutant in mutants_of(tmp_path, module):
        source = mutated_source(tmp_path, mutant)
        differing = [pair for pair in zip(sound.split("\n"), source.split("\n"), strict=True) if pair[0] != pair[1]]
        assert len(differing) == 1


def test_a_draw_is_decided_by_its_seed_and_takes_each_package_in_turn(tmp_path: Path) -> None:
    mutants = [
        mutant
        for package in ("one", "two")
        for mutant in mutants_of(tmp_path, _module(tmp_path, f"{package}/limits.py", MODULE))
    ]
    drawn = draw(mutants, packages=("one", "two"), seed=3, count=8)
    assert [mutant.package for mutant in drawn] == ["one", "two"] * 4
    assert len(set(drawn)) == 8
    assert drawn == draw(mutants, packages=("one", "two"), seed=3, count=8)
    assert drawn != draw(mutants, packages=("one", "two"), seed=4, count=8)


@pytest.mark.slow
def test_a_mistake_is_killed_by_the_test_that_notices_it_and_else_survives(tmp_path: Path) -> None:
    pytest.importorskip("resource", reason="computing time is limited on POSIX only")
    from tests.mutation.running import MutatedCopy

    tree = tmp_path / "sound"
    for folder in ("adapters", "benchmarks", "data_manifests", "tests/sums"):
        (tree / folder).mkdir(parents=True)
    _module(tree, "__init__.py", "")
    module = _module(tree, "sums/add.py", "def add(a, b):\n    return a + b\n\n\ndef half(a):\n    return a / 2\n")
    module.with_name("__init__.py").write_text("")
    (tree / "setup.py").write_text("from setuptools import setup\nsetup(name='prbench', packages=['prbench'])\n")
    test = "from prbench.sums.add import add\n\n\ndef test_sum():\n    assert add(2, 2) == 4\n"
    (tree / "tests/sums/test_add.py").write_text(test)
    mutants = mutants_of(tree, module)
    copied = MutatedCopy(tree, tmp_path / "work", 30)
    noticed = copied.judge(_find_one(mutants, "arithmetic", "a + b"))
    assert (noticed.verdict, noticed.test) == ("killed", "tests/sums/test_add.py::test_sum")
    assert copied.judge(_find_one(mutants, "arithmetic", "a / 2")).verdict == "survived"
