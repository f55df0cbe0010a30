"""Nightly: work on Ray whose workers, node and driver are killed at random moments ends in the bytes of one process.

``PRBENCH_FUZZ_SEED`` chooses other moments.
"""

from __future__ import annotations

import contextlib
import os
import random
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.curation.sources import folder_bytes
from tests.engine.local_cluster import ROOT, LocalCluster, local_cluster, workers
from tests.fakes import fake_dataset
from tests.method_fixtures import adapter_source, write_package

pytest.importorskip("ray", reason="Ray is not installed (pip install -c constraints.txt -e '.[ray]')")
pytestmark = [
    pytest.mark.fuzz,
    pytest.mark.skipif("PRBENCH_FUZZ" not in os.environ, reason="takes ten minutes: set PRBENCH_FUZZ to run it"),
    pytest.mark.skipif(sys.platform == "win32", reason="clusters of several nodes on one machine need Linux or macOS"),
]
_VICTIMS = ("worker", "node", "worker", "driver")  # killed during one piece of work, in this order
_MOMENTS = 20
_ENDS_WITHIN_S = 600
_BUILD = """
import sys
from prbench.cli.main import main
from prbench.curation import build
from tests.curation.sources import some_sources
build.native_sources = lambda *_: some_sources(24, seconds=0.5)
sys.exit(main(["-v", "build-dataset", "adt", "--root", ".", "--out", *sys.argv[1:]]))
"""
_RUN = """
import sys
from prbench.cli.main import main
sys.exit(main(["-v", "run", "--method", "made", "--condition", "none", "--batch-size", "1", "--out", *sys.argv[1:]]))
"""


@dataclass
class _Work:
    """A command that is killed and started again until it has ended."""

    source: str
    words: list[str]
    log: Path
    process: subprocess.Popen | None = None

    def start(self) -> subprocess.Popen:
        with open(self.log, "ab") as log:
            words = [sys.executable, "-c", self.source, *self.words]
            self.process = subprocess.Popen(words, cwd=ROOT, stdout=log, stderr=log)
        return self.process

    def steps(self) -> int:
        """Lines of progress until now, of all its starts."""
        return self.log.read_text(errors="replace").count(": ") if self.log.is_file() else 0

    def is_at_work(self) -> bool:
        """Wait until it is at work and has made some more progress; False if it ended before."""
        before, until = self.steps(), time.monotonic() + _ENDS_WITHIN_S
        while self.process is not None and self.process.poll() is None and time.monotonic() < until:
            if self.steps() > before and workers():
                return True
            time.sleep(0.05)
        return False


def test_work_that_is_killed_at_twenty_random_moments_ends_in_the_same_bytes(tmp_path, monkeypatch):
    write_package(tmp_path / "site", "made", adapter_source(body="import time; time.sleep(1.0)"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(tmp_path / "site"), str(ROOT))))
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    jobs = {"build": (_BUILD, []), "run": (_RUN, ["--data", str(fake_dataset(tmp_path / "table", 60).folder)])}
    for name, (source, words) in jobs.items():
        undisturbed = _Work(source, [str(tmp_path / f"{name}-one"), *words], tmp_path / f"{name}-one.log")
        assert undisturbed.start().wait(_ENDS_WITHIN_S) == 0, undisturbed.log.read_text()
    chance = random.Random(int(os.environ.get("PRBENCH_FUZZ_SEED", "1")))
    killed: Counter[str] = Counter()
    with local_cluster(2) as cluster:
        for number in range(100):
            left = _MOMENTS - killed.total()
            if left <= 0:
                break
            name = ("build", "run")[number % 2]
            source, words = jobs[name]
            out = tmp_path / f"{name}-{number}"
            ray = ["--engine", "ray", "--address", cluster.address]
            work = _Work(source, [str(out), *words, *ray], tmp_path / f"{out.name}.log")
            work.start()
            for victim in _VICTIMS[:left]:
                if work.is_at_work():
                    time.sleep(chance.uniform(0.0, 1.5))
                    killed[victim] += _kill(victim, work, cluster, chance)
            assert work.process is not None
            assert work.process.wait(_ENDS_WITHIN_S) == 0, work.log.read_text()
            assert _bytes(out) == _bytes(tmp_path / f"{name}-one"), f"{out} after {dict(killed)}"
            assert [*tmp_path.glob(f".{out.name}*"), *out.rglob("*.partial*"), *out.rglob(".costs")] == []
    assert killed.total() == _MOMENTS
    assert set(killed) == {"worker", "node", "driver"}


def _kill(victim: str, work: _Work, cluster: LocalCluster, chance: random.Random) -> bool:
    """Kill a worker, a node (another one joins) or the command; False if the work has just ended."""
    assert work.process is not None
    there = workers()
    if work.process.poll() is not None or not there:
        return False
    if victim == "worker":
        chance.choice(there).kill()
    elif victim == "node":
        cluster.kill_node()
        with contextlib.suppress(Exception):  # a busy machine may not start it in the time that Ray gives
            cluster.add_node()
    else:
        work.process.kill()
        work.process.wait()
        work.start()
    return True


def _bytes(folder: Path) -> dict[str, bytes]:
    return {name: content for name, content in folder_bytes(folder).items() if not name.endswith("cost.json")}
