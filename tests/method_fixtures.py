"""Fixtures of tests that run methods: a small dataset, an own cache, and methods installed for one test."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from prbench.sequences import SequenceTable
from tests.fakes import fake_dataset


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache folder of this test's own."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("PRBENCH_CACHE", str(folder))
    return folder


@pytest.fixture(scope="session")
def table(tmp_path_factory: pytest.TempPathFactory) -> SequenceTable:
    """60 sequences, 15 of them in the test split, of three recordings."""
    return fake_dataset(tmp_path_factory.mktemp("data") / "table", 60)


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Installs a made-up package with one adapter, found through real package metadata, in workers too."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))

    def _install(name: str, source: str, *, target: str = "load", package: str | None = None) -> None:
        write_package(site, name, source, target=target, package=package)
        monkeypatch.delitem(sys.modules, package or f"prbench_{name}", raising=False)

    return _install


def write_package(site: Path, name: str, source: str, *, target: str = "load", package: str | None = None) -> None:
    """Write a package with one adapter, and the metadata by which it is found, into a folder of packages."""
    package = package or f"prbench_{name}"
    info = site / f"{package}-1.2.dist-info"
    info.mkdir(parents=True)
    (site / f"{package}.py").write_text(textwrap.dedent(source))
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(f"[prbench.adapters]\n{name} = {package}:{target}\n")


ADAPTER = """
    import numpy as np
    from prbench.contract import Condition, Cost, Motions

    class Made:
        name = "made"
        conditions = frozenset({{Condition.NONE, Condition.GOAL_LOCATION}})
        {attributes}

        def generate(self, batch, *, seed):
            joints = np.zeros((len(batch), int(batch.n_frames.max()), 22, 3))
            for row, noise_seed in enumerate(batch.noise_seed):
                joints[row] = np.random.default_rng(noise_seed).normal(size=joints[row].shape)
            n_frames = batch.n_frames
            {body}
            return Motions(joints, n_frames)

    def load(weights, *, options, device):
        return Made()
"""


def adapter_source(*, body: str = "", attributes: str = "") -> str:
    """Source of a package with an adapter that draws noise; ``body`` runs before it returns."""
    return ADAPTER.format(body=body, attributes=attributes)
