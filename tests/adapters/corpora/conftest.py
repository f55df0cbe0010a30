"""Synthetic trees of the two datasets, written once."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench_adapters.corpora.synthetic import synthesize_corpus_tree

SEED = 5


@pytest.fixture(scope="session")
def nymeria_tree(tmp_path_factory) -> Path:
    """Three sequences, the last one without the glasses' trajectory."""
    root = tmp_path_factory.mktemp("nymeria") / "tree"
    synthesize_corpus_tree("nymeria", root, recordings=3, seed=SEED)
    return root


@pytest.fixture(scope="session")
def humanml3d_tree(tmp_path_factory) -> Path:
    """Two recordings cut into captioned motions, with mirrored copies."""
    root = tmp_path_factory.mktemp("humanml3d") / "tree"
    synthesize_corpus_tree("humanml3d", root, recordings=2, seed=SEED)
    return root
