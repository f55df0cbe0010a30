"""Small tables: of synthetic people, as users meet them, and made-up ones where only rows matter."""

from __future__ import annotations

from pathlib import Path

import pytest

import prbench
from prbench.harness.synthetic_table import build_synthetic_table
from tests.fakes import fake_dataset


@pytest.fixture(scope="session")
def synthetic_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of three recordings of synthetic people."""
    folder = tmp_path_factory.mktemp("api") / "synthetic"
    build_synthetic_table("adt", 3, 0, folder)
    return folder


@pytest.fixture(scope="session")
def synthetic(synthetic_folder: Path) -> prbench.Table:
    return prbench.open_table(synthetic_folder)


@pytest.fixture(scope="session")
def table(tmp_path_factory: pytest.TempPathFactory) -> prbench.Table:
    """48 made-up sequences of 12 recordings."""
    folder = tmp_path_factory.mktemp("api") / "table"
    fake_dataset(folder, 48)
    return prbench.open_table(folder)


@pytest.fixture(scope="session")
def empty(tmp_path_factory: pytest.TempPathFactory) -> prbench.Table:
    """A table without a sequence."""
    folder = tmp_path_factory.mktemp("api") / "empty"
    fake_dataset(folder, 0)
    return prbench.open_table(folder)


@pytest.fixture(scope="session")
def runs(table: prbench.Table, tmp_path_factory: pytest.TempPathFactory) -> tuple[prbench.Run, prbench.Run]:
    """``ground-truth`` and ``scripted`` on six sequences."""
    folder = tmp_path_factory.mktemp("api") / "runs"
    first = prbench.run("ground-truth", data=table, limit=6, out=folder / "truth")
    second = prbench.run(
        "scripted", condition="goal-loc", data=str(table.folder), limit=6, out=str(folder / "scripted")
    )
    return first, second
