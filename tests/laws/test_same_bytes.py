"""Same input, same seed: same bytes, whatever the order, the batch, the number of workers, shards or machines."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.comparing import differences
from tests.laws import listed
from tests.laws.cases import SameBytes

CASES: dict[str, SameBytes] = {case.name: case for case in listed("SAME_BYTES")}


def _result(way: Callable[[Path], object], folder: Path, unequal: tuple[str, ...]) -> dict[str, object]:
    """Make a result in a folder: what was returned, and the bytes of each file."""
    folder.mkdir()
    returned = way(folder)
    files = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    kept = {name: content for name, content in files.items() if not name.endswith(unequal)} if unequal else files
    result = {"returned": returned, **kept}
    assert returned is not None or kept, "nothing was made, so nothing is compared"
    return result


@functools.cache
def _reference(name: str, folder: Path) -> dict[str, object]:
    case = CASES[name]
    return _result(next(iter(case.ways.values())), folder / name.replace("/", "-"), case.unequal)


@pytest.fixture(scope="module")
def references(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("references")


@pytest.mark.parametrize(("name", "way"), [(case.name, way) for case in CASES.values() for way in list(case.ways)[1:]])
def test_every_way_makes_the_same_bytes(name: str, way: str, references: Path, tmp_path: Path) -> None:
    case = CASES[name]
    made = _result(case.ways[way], tmp_path / "made", case.unequal)
    assert list(differences(_reference(name, references), made)) == []


@pytest.mark.parametrize(("name", "way"), [(case.name, way) for case in CASES.values() for way in case.differs or {}])
def test_what_has_to_change_the_result_changes_it(name: str, way: str, references: Path, tmp_path: Path) -> None:
    case = CASES[name]
    made = _result((case.differs or {})[way], tmp_path / "made", case.unequal)
    assert list(differences(_reference(name, references), made)) != []
