"""Nightly: each command that takes ``--engine ray`` writes on two nodes what it writes in one process."""

from __future__ import annotations

import os
import sys
from contextlib import closing

import pytest

from prbench.engine.on_ray import RayEngine
from tests.engine.work import visible_gpus
from tests.laws.killed_cases import WRITING, make_inputs, run
from tests.parsing import all_commands

pytest.importorskip("ray", reason="Ray is not installed (pip install -c constraints.txt -e '.[ray]')")
pytestmark = [
    pytest.mark.fuzz,
    pytest.mark.skipif("PRBENCH_FUZZ" not in os.environ, reason="takes minutes: set PRBENCH_FUZZ to run it"),
    pytest.mark.skipif("PYTEST_XDIST_WORKER" in os.environ, reason="they share one cluster: run this file with -n 0"),
    pytest.mark.skipif(sys.platform == "win32", reason="clusters of several nodes on one machine need Linux or macOS"),
]

_NAMES = {
    "build-dataset --out",
    "build-dataset all --out",
    "build-dataset --out, a shard",
    "build-windows --out",
    "build-corpus --out",
    "run --out",
    "run --out, a shard",
    "run --method all --out",
    "score --out",
    "train --out",
}
CASES = [writing for writing in WRITING if writing.name in _NAMES]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    return make_inputs(tmp_path_factory.mktemp("inputs"))


@pytest.mark.parametrize("writing", CASES, ids=lambda each: each.name)
def test_a_command_writes_on_two_nodes_what_it_writes_in_one_process(writing, connected, inputs, tmp_path):
    results = []
    for name, engine in (("one", ()), ("two", ("--engine", "ray", "--address", connected.address))):
        folder = tmp_path / name
        folder.mkdir()
        run(folder, *writing.words(inputs, folder / writing.result), *engine)
        results.append(writing.same(folder))
    assert results[0] == results[1]


def test_each_worker_sees_the_gpu_that_it_was_given_and_a_run_keeps_its_bytes(connected, inputs, tmp_path):
    with closing(RayEngine(connected.address, gpus_per_worker=1.0)) as engine:
        assert {given for _, given in engine.map(visible_gpus, range(4))} == {"0"}
    results = []
    for name, more in (("one", ()), ("two", ("--engine", "ray", "--gpus-per-worker", 0.5))):
        folder = tmp_path / name
        folder.mkdir()
        words = ("run", "--method", "pr", "--condition", "goal-loc", "--data", inputs / "table", "--split", "train")
        where = ("--address", connected.address) if more else ()
        run(folder, *words, "--batch-size", 1, *more, *where, "--out", folder / "run")
        results.append({path.name: path.read_bytes() for path in (folder / "run").rglob("part-*.parquet")})
    assert results[0] == results[1]
    assert len(results[0]) > 1


def test_no_command_that_takes_an_engine_is_forgotten():
    taking = {name for name, command in all_commands().items() if any("--engine" in p.opts for p in command.params)}
    assert len(CASES) == len(_NAMES)
    assert {writing.name.split()[0] for writing in CASES} == taking
