"""Shared fixtures; every array annotation of prbench is checked while the tests run."""

from __future__ import annotations

import gc
import importlib.util
import json
import os
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.shapes import check_array_annotations, unchecked
from tests.shared import open_folder

open_folder()

if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):  # hundreds of interpreters are started, which would each compile anew
    sys.dont_write_bytecode = False

os.fsync = lambda _file: None  # no test outlives a power failure, which is all that waiting for the disk is for

os.environ.setdefault("OMP_NUM_THREADS", "1")  # each processor runs a test; more of PyTorch's threads only wait

if os.environ.get("PRBENCH_CHECK_SHAPES", "1") == "1":
    check_array_annotations("prbench", "prbench_adapters")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect garbage seldom, and never among what imports have made: looking through it took a tenth of the time."""
    gc.disable()
    found = yield
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)
    gc.enable()
    return found


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """The marker ``unchecked_shapes``, for a test with the fixtures that it is the first to ask for."""
    if item.get_closest_marker("unchecked_shapes") is None:
        return (yield)
    with unchecked():
        return (yield)


@pytest.fixture(scope="session")
def samples() -> Path:
    """Folder of small real recordings and golden values; tests that need it are skipped without it."""
    folder = os.environ.get("PRBENCH_SAMPLES", "")
    if not folder:
        pytest.skip("set PRBENCH_SAMPLES to the folder of sample recordings to run this test")
    if not Path(folder).is_dir():
        pytest.fail(f"PRBENCH_SAMPLES={folder} is no folder")
    return Path(folder)


@pytest.fixture(scope="session")
def reference_values(samples: Path) -> dict[str, dict]:
    """Expected values of the native formats, by id."""
    path = samples.parent / "formats" / "reference-values.json"
    if not path.is_file():
        pytest.skip(f"the values to compare with are not there: {path}")
    items = json.loads(path.read_text(encoding="utf-8"))["items"]
    return {item["id"]: item for item in items}


@pytest.fixture(
    params=[
        "slow loop",
        pytest.param(
            "Open3D",
            marks=pytest.mark.skipif(importlib.util.find_spec("open3d") is None, reason="needs the extra open3d"),
        ),
    ]
)
def open3d_or_slow_loop(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """What answers questions about meshes: the tests of curation run with both, and without Open3D with the loop."""
    if request.param == "slow loop":
        from tests.slow_meshes import SlowMesh  # not before the import hook

        monkeypatch.setattr("prbench.curation.in_hand.TriangleMesh", SlowMesh)
        monkeypatch.setattr("prbench.curation.options.import_open3d", lambda purpose: None)
    return request.param


@pytest.fixture(scope="session")
def adt_tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small synthetic recordings in ADT's layout, below a folder that holds nothing else; not to be changed."""
    from prbench.synthetic.write_tree import synthesize_tree  # not before the import hook

    root = tmp_path_factory.mktemp("copies") / "ADT"
    return synthesize_tree("adt", root, recordings=2, seed=3, n_events=3).root
