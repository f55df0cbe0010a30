"""Kill workers, a node and the driver of work on Ray at random moments, and compare what comes out with one process.

``python -m tests.engine.ray_kills FOLDER --moments 20 --seed 1`` prints a row a victim.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import shutil
import subprocess
import sys
import textwrap
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from tests.curation.sources import folder_bytes
from tests.engine.local_cluster import ROOT, LocalCluster, local_cluster
from tests.fakes import fake_dataset
from tests.method_fixtures import adapter_source

VICTIMS = ("worker", "node", "worker", "driver")
"""Killed during one piece of work, in this order."""
_MEASURED = ("cost.json",)
"""Files that hold seconds and memory, which no two runs share."""
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
class Found:
    """What came of the kills."""

    killed: Counter[str] = field(default_factory=Counter)
    late: int = 0
    """Moments at which the work had just ended."""
    unequal: list[str] = field(default_factory=list)
    """Pieces of work that ended in other bytes, or not at all."""

    def rows(self) -> list[str]:
        """A line a victim, for the table in docs/reliability.md."""
        return [f"{victim}: {count} killed" for victim, count in sorted(self.killed.items())] + [
            f"the work had just ended: {self.late}",
            f"other bytes or no end: {len(self.unequal)} {self.unequal}",
        ]


@dataclass
class _Work:
    """A command that is killed and started again until it has ended."""

    source: str
    words: list[str]
    log: Path
    process: subprocess.Popen | None = None

    def start(self) -> None:
        """Start it, or start it again."""
        with open(self.log, "ab") as log:
            words = [sys.executable, "-c", self.source, *self.words]
            self.process = subprocess.Popen(words, cwd=ROOT, stdout=log, stderr=log)

    def whole(self) -> None:
        """Run it undisturbed."""
        self.start()
        assert self.end() == 0, self.log.read_text()

    def steps(self) -> int:
        """Lines of progress until now, of all its starts."""
        return self.log.read_text(errors="replace").count(": ") if self.log.is_file() else 0

    def await_work(self, steps: int) -> bool:
        """Wait until it is at work, with more lines of progress than that; False if it ended before."""
        assert self.process is not None
        until = time.monotonic() + _ENDS_WITHIN_S
        while self.process.poll() is None and time.monotonic() < until:
            if self.steps() > steps and workers():
                return True
            time.sleep(0.05)
        return False

    def end(self) -> int:
        """Wait for its end."""
        assert self.process is not None
        try:
            return self.process.wait(timeout=_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return -1


def check(folder: Path, *, moments: int, seed: int) -> Found:
    """Kill at so many moments; builds and runs take turns."""
    site = folder / "site"
    _install(site)
    table = fake_dataset(folder / "table", 60)
    os.environ["PYTHONPATH"] = os.pathsep.join((str(site), str(ROOT)))
    os.environ["PRBENCH_CACHE"] = str(folder / "cache")
    jobs = {"build": (_BUILD, []), "run": (_RUN, ["--data", str(table.folder)])}
    for name, (source, words) in jobs.items():
        _Work(source, [str(folder / f"{name}-one"), *words], folder / f"{name}-one.log").whole()
    chance = random.Random(seed)
    found = Found()
    with local_cluster(2) as cluster:
        for number in range(100):
            left = moments - found.killed.total()
            if left <= 0:
                break
            name = ("build", "run")[number % 2]
            source, words = jobs[name]
            out = folder / f"{name}-{number}"
            ray = ["--engine", "ray", "--address", cluster.address]
            work = _Work(source, [str(out), *words, *ray], folder / f"{out.name}.log")
            _kill_during(work, VICTIMS[:left], cluster, chance, found)
            same = work.end() == 0 and _bytes(out) == _bytes(folder / f"{name}-one")
            if not same or _left_behind(out):
                found.unequal.append(f"{out} ({work.log})")
            shutil.rmtree(out, ignore_errors=not same)
            sys.stderr.write(f"{name} {number}: {'same' if same else 'OTHER'} bytes; {dict(found.killed)}\n")
    return found


def _kill_during(
    work: _Work, victims: tuple[str, ...], cluster: LocalCluster, chance: random.Random, found: Found
) -> None:
    work.start()
    for victim in victims:
        if not work.await_work(work.steps()):
            found.late += 1
            return
        time.sleep(chance.uniform(0.0, 1.5))
        assert work.process is not None
        if work.process.poll() is not None:
            found.late += 1
            return
        if victim == "worker":
            there = workers()
            if not there:
                found.late += 1
                continue
            chance.choice(there).kill()
        elif victim == "node":
            cluster.kill_node()
            with contextlib.suppress(Exception):  # a busy machine may not start it in the time that Ray gives
                cluster.add_node()
        else:
            work.process.kill()
            work.end()
            work.start()
        found.killed[victim] += 1


def workers() -> list[psutil.Process]:
    """Return the workers of our own cluster, whose nodes are children of this process."""
    found = []
    for process in psutil.Process().children(recursive=True):
        try:
            if "RayWorker" in " ".join(process.cmdline()):
                found.append(process)
        except psutil.Error:
            continue
    return found


def _bytes(folder: Path) -> dict[str, bytes]:
    return {name: content for name, content in folder_bytes(folder).items() if Path(name).name not in _MEASURED}


def _left_behind(out: Path) -> list[Path]:
    """Parts, locks and half-written files that should be gone."""
    return [*out.parent.glob(f".{out.name}*"), *out.rglob("*.partial*"), *out.rglob(".costs")]


def _install(site: Path) -> None:
    """Install a slow method, found through real package metadata."""
    info = site / "prbench_made-1.2.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: prbench_made\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text("[prbench.adapters]\nmade = prbench_made:load\n")
    source = adapter_source(body="import time; time.sleep(1.0)")
    (site / "prbench_made.py").write_text(textwrap.dedent(source))


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--moments", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    found = check(given.folder.absolute(), moments=given.moments, seed=given.seed)
    sys.stdout.write("\n".join(found.rows()) + "\n")
    sys.exit(bool(found.unequal))


if __name__ == "__main__":
    main()
