"""Work on two Ray nodes ends as in one process does, with workers and a node that are killed.

All tests share one cluster, which takes 20 s to start, so they run in one process: with ``-n 0``.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import prbench
from prbench.cli.main import main
from prbench.curation import build_from_sources
from prbench.engine.nodes import Needs
from prbench.engine.on_ray import RayEngine
from prbench.errors import ClusterError, InputFileError, MemoryFullError
from tests.curation.sources import folder_bytes, some_sources
from tests.engine.local_cluster import ROOT, workers
from tests.engine.work import Short, fail_on_three, first_and_last, where
from tests.fakes import fake_dataset

pytest.importorskip("ray", reason="Ray is not installed (pip install -c constraints.txt -e '.[ray]')")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("PYTEST_XDIST_WORKER" in os.environ, reason="they share one cluster: run this file with -n 0"),
    pytest.mark.skipif(sys.platform == "win32", reason="clusters of several nodes on one machine need Linux or macOS"),
]


@pytest.fixture(scope="session")
def told():
    return []


@pytest.fixture(scope="session")
def engine(connected, told):
    made = RayEngine(connected.address, tell=told.append)
    yield made
    made.close()


def test_both_nodes_work_and_results_come_in_order(engine):
    found = list(engine.map(where, range(12)))
    assert [value for value, _ in found] == list(range(12))
    assert len({node for _, node in found}) == 2


def test_an_error_of_a_user_keeps_its_words(engine):
    results = engine.map(fail_on_three, range(6))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputFileError, match=r"x\.csv, row 3: expected a number, found three\. Count again\."):
        next(results)


@pytest.mark.parametrize("how", ["killed", "full"])
def test_a_worker_that_is_killed_is_replaced_and_an_item_that_does_not_fit_is_tried_alone(engine, how, tmp_path):
    assert list(engine.map(Short(tmp_path, 1, how), range(6))) == list(range(6))
    assert len(list(tmp_path.iterdir())) == 1


def test_an_item_that_does_not_fit_alone_either_is_named(engine, tmp_path):
    found = engine.map(Short(tmp_path, 9, "full"), range(6))
    assert [next(found) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(MemoryFullError, match="the memory of this machine does not suffice"):
        next(found)


def test_items_that_ray_has_no_memory_for_are_spilled_and_come_back(engine):
    block = 60_000_000  # two of them are more than a node's store has
    items = (bytes([value]) * block for value in range(4))
    assert list(engine.map(first_and_last, items)) == [(value, value) for value in range(4)]


def test_unfit_nodes_are_named_before_work_starts(connected, monkeypatch, tmp_path):
    from prbench.engine import nodes

    genuine = nodes.node_facts

    def of_another_version(wanted):
        return {**genuine(wanted), "prbench": "99.0.0", "code": "0" * 64}

    monkeypatch.setattr(nodes, "node_facts", of_another_version)
    engine = RayEngine(connected.address, needs=Needs(reads=(tmp_path,), writes=(tmp_path / "out",)))
    with pytest.raises(ClusterError) as refused:
        list(engine.map(fail_on_three, range(2)))
    lines = str(refused.value).splitlines()
    assert lines[0] == "the cluster is not fit for this work, so nothing was started."
    assert len(lines) == 3  # a line a node
    assert all("is installed there, and 99.0.0 here. Install the same version on both." in line for line in lines[1:])


def test_more_gpus_than_there_are_are_refused(connected):
    engine = RayEngine(connected.address, gpus_per_worker=1.5)
    with pytest.raises(ClusterError, match=r"1 processors and 1\.5 GPUs for a worker, found 127\.0\.0\.1"):
        list(engine.map(fail_on_three, range(2)))


def test_a_build_during_which_a_node_is_killed_has_the_bytes_of_one_in_one_process(connected, engine, told, tmp_path):
    build_from_sources(some_sources(12), tmp_path / "one")
    killed = []
    told.clear()

    def kill_a_node(done, *_):
        if done == 3:
            killed.append(threading.Thread(target=connected.kill_node))
            killed[0].start()

    build_from_sources(some_sources(12, seconds=0.3), tmp_path / "two", engine=engine, progress=kill_a_node)
    killed[0].join()
    connected.add_node()
    assert folder_bytes(tmp_path / "two") == folder_bytes(tmp_path / "one")
    assert {entry.name for entry in tmp_path.iterdir()} == {"one", "two"}
    assert told


def test_a_run_and_its_scores_have_the_bytes_of_one_process(connected, tmp_path, capsys):
    fake_dataset(tmp_path / "table", 24)
    table = tmp_path / "table"
    common = ("run", "--method", "static", "--condition", "none", "--data", str(table), "--batch-size", "4")
    assert main([*common, "--out", str(tmp_path / "one")]) == 0
    assert main([*common, "--out", str(tmp_path / "two"), "--engine", "ray", "--address", connected.address]) == 0
    different = {"cost.json"}  # seconds and memory
    one, two = (
        {name: content for name, content in folder_bytes(tmp_path / out).items() if Path(name).name not in different}
        for out in ("one", "two")
    )
    assert one == two
    assert "running static: 6/6 score" in capsys.readouterr().err


def test_python_runs_and_scores_on_a_cluster(connected, tmp_path):
    cluster = prbench.Cluster(connected.address)
    table = fake_dataset(tmp_path / "table", 24).folder
    one = prbench.run("static", condition="none", data=table, out=tmp_path / "one", batch_size=4)
    two = prbench.run("static", condition="none", data=table, out=tmp_path / "two", batch_size=4, workers=cluster)
    assert two.to_pandas().equals(one.to_pandas())
    assert prbench.score(two.folder, table, workers=cluster).to_pandas().equals(one.to_pandas())


_DRIVER = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells take it away in the background
from prbench.cli.main import main
from prbench.curation import build
from tests.curation.sources import some_sources
build.native_sources = lambda *_: some_sources(40, seconds=0.5)
sys.exit(main(["build-dataset", "adt", "--root", ".", "--out", *sys.argv[1:2], "--engine", "ray", *sys.argv[2:]]))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_a_driver_that_is_asked_to_stop_ends_its_workers_and_keeps_what_is_finished(connected, tmp_path, number, code):
    before = _numbers()
    process = subprocess.Popen(
        [sys.executable, "-c", _DRIVER, str(tmp_path / "out"), "--address", connected.address],
        cwd=ROOT, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    for line in process.stderr:
        if "building adt: 1/" in line:
            break
    process.send_signal(number)
    said = process.stderr.read()
    assert process.wait(timeout=30) == code, said
    assert "finished parts are kept" in said
    assert "Traceback" not in said
    assert len(list((tmp_path / ".out.work").glob("*/receipt.json"))) >= 1
    until = time.monotonic() + 10
    while _numbers() - before and time.monotonic() < until:
        time.sleep(0.2)
    assert _numbers() <= before


def _numbers() -> set[int]:
    """Process numbers of all workers, those of the tests before included."""
    return {worker.pid for worker in workers()}
