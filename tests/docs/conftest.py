"""Programs of the documentation, run on made-up conditions."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest

from prbench.contract import Condition, ConditionBatch
from prbench.harness.conditions import ConditionSource, run_salt
from prbench.harness.planning import select
from prbench.sequences import SequenceTable
from tests.docs.by_hand import ByHand
from tests.docs.interpreters import EXAMPLES
from tests.fakes import fake_dataset


@pytest.fixture(scope="session")
def table(tmp_path_factory: pytest.TempPathFactory) -> SequenceTable:
    """40 sequences, ten of them in the test split."""
    return fake_dataset(tmp_path_factory.mktemp("docs") / "table", 40)


@pytest.fixture(scope="session")
def batch(table: SequenceTable) -> Callable[..., ConditionBatch]:
    """Makes a batch of some rows of the test split."""
    selection = select(table, split="test", limit=None)
    source = ConditionSource.read(selection)

    def _batch(condition: Condition, rows: list[int] | None = None, *, seed: int = 0) -> ConditionBatch:
        chosen = np.arange(len(selection)) if rows is None else np.array(rows)
        return source.batch(chosen, condition, seed=seed, salt=run_salt(seed, table.identity), sample=0)

    return _batch


@pytest.fixture(scope="session")
def glide(tmp_path_factory: pytest.TempPathFactory) -> ByHand:
    """The Python example, running in this environment's interpreter."""
    with ByHand([sys.executable, str(EXAMPLES / "glide.py")], tmp_path_factory.mktemp("docs") / "glide.log") as program:
        yield program
