"""Synthetic trees of the two datasets."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.adapters.corpora.suits import corpus_tree


@pytest.fixture(scope="session")
def nymeria_tree() -> Path:
    return corpus_tree("nymeria")


@pytest.fixture(scope="session")
def humanml3d_tree() -> Path:
    return corpus_tree("humanml3d")
