"""Damages change files, and are undone."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from tests.fuzz.mutations import KINDS, Undo, files_by_kind


@pytest.fixture
def root(tmp_path):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "hidden.csv").write_text("1\n")
    for number in range(3):
        (tmp_path / f"frame{number}.csv").write_text("time,x\n" + "".join(f"{i},{i / 3}\n" for i in range(50)))
    (tmp_path / "a.json").write_text('{"name": "cup", "sizes": [1, 2.5, 3], "deep": {"a": null}}')
    np.savez(tmp_path / "arrays.npz", one=np.arange(6.0).reshape(2, 3))
    return tmp_path


def test_files_that_differ_in_digits_alone_are_one_group(root):
    assert [len(group) for group in files_by_kind(root)] == [1, 1, 3]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_kind_changes_a_file_and_can_be_undone(kind, root):
    groups = files_by_kind(root)
    changed = False
    for group in groups:
        path = group[0]
        content = path.read_bytes()
        beside = set(path.parent.iterdir())
        for seed in range(8):
            undo = Undo(path)
            kind(path, content, Random(seed), groups)
            changed |= path.is_symlink() or not path.is_file() or path.stat().st_size != len(content)
            changed = changed or path.read_bytes() != content or set(path.parent.iterdir()) != beside
            undo.restore()
            assert path.read_bytes() == content
            assert set(path.parent.iterdir()) == beside
    assert changed, f"{kind.__name__} changes nothing"


def test_the_same_seed_damages_the_same_way(root):
    groups = files_by_kind(root)
    path = groups[0][0]
    made = []
    for _ in range(2):
        undo = Undo(path)
        made.append((KINDS[0](path, undo.content, Random("x"), groups), path.read_bytes()))
        undo.restore()
    assert made[0] == made[1]
