from __future__ import annotations

from pathlib import Path

import pytest

from prbench.synthetic.write_tree import synthesize_tree


@pytest.fixture(scope="session")
def adt_tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small synthetic recordings in ADT's layout, below a folder that holds nothing else; not to be changed."""
    root = tmp_path_factory.mktemp("copies") / "ADT"
    return synthesize_tree("adt", root, recordings=2, seed=3, n_events=3).root
