"""The cheating method, run over a small table in each of three ways; what it brought home."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import socket
import subprocess
import sys
import threading
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest

from prbench.harness.run_folder import DatasetSummary
from prbench.sequences import SequenceTable
from tests.fakes import fake_dataset
from tests.harness.firewall.cheater import ATTEMPTS

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[3]
COLUMNS = ("in process", "process", "bubblewrap")
WORKERS = "process, two workers"
BATCH_SIZE = 8


@dataclass(frozen=True)
class Outing:
    """One column: the digests that came home, and what the harness made of the motions."""

    claims: dict[str, dict[str, bytes | None]]
    """attempt → sequence id → digest of what was claimed; None where nothing was."""
    n_frames: dict[str, int]
    reach_success: float
    """As the run itself scored it."""
    survivors: int
    """Processes of the method that were alive after the run."""
    folder: Path
    log: str


@dataclass
class Playground:
    """A user's home with a table in it, and a made-up package that cheats."""

    home: Path
    site: Path
    table: SequenceTable
    port: int
    _outings: dict[str, Outing] = field(default_factory=dict)

    def outing(self, column: str) -> Outing:
        """Run the method in one of the ways; once a session."""
        if column not in self._outings:
            self._outings[column] = self._sent_out(column)
        return self._outings[column]

    def _sent_out(self, column: str) -> Outing:
        mark = uuid.uuid4().hex
        out = self.home / "work" / "runs" / column.replace(" ", "-")
        options = {
            "home": os.fsencode(self.home).hex(),
            "port": str(self.port),
            "mark": mark,
            "outside": str(os.getpid()),
        }
        options["weights"] = str(self.home / "work" / "weights" / "weights.bin")
        words = [sys.executable, "-m", "prbench", "run", "--method", "cheater", "--condition", "goal-loc"]
        words += ["--data", str(self.table.folder), "--out", str(out), "--batch-size", str(BATCH_SIZE)]
        words += [word for key, value in options.items() for word in ("--option", f"{key}={value}")]
        words += ["--isolate"] * (column != "in process") + ["--workers", "2"] * (column == WORKERS)
        # Somebody else's program, which was called with the table, and has nothing to do with the run.
        other = [sys.executable, "-S", "-c", "input()", str(self.table.folder)]
        with subprocess.Popen(other, stdin=subprocess.PIPE) as bystander:
            done = subprocess.run(words, cwd=self.home, env=self._environment(column), capture_output=True, text=True)
            bystander.kill()
        survivors = _ended(mark)
        assert done.returncode == 0, done.stderr
        summary = DatasetSummary.read(out / "synthetic-adt")
        reach = next(item.mean for item in summary.metrics if item.metric == "reach_success")
        return Outing(*_brought_home(out), reach, survivors, out, done.stderr)

    def _environment(self, column: str) -> dict[str, str]:
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("PRBENCH", "XDG"))}
        kept |= {"HOME": str(self.home), "MY_TABLE": str(self.table.folder), "PYTHONPATH": str(self.site)}
        if column in ("process", WORKERS):  # as on a machine without bubblewrap
            kept["PATH"] = str(Path(sys.executable).parent)
        return kept


def _brought_home(out: Path) -> tuple[dict[str, dict[str, bytes | None]], dict[str, int]]:
    rows = pq.read_table(out / "synthetic-adt/predictions", columns=["sequence_id", "joints"])
    claims: dict[str, dict[str, bytes | None]] = {name: {} for name in ATTEMPTS}
    n_frames = {}
    for name, joints in zip(rows["sequence_id"].to_pylist(), rows["joints"]):
        motion = joints.values.flatten().to_numpy().reshape(-1, 66)
        n_frames[name] = len(motion)
        for attempt, numbers in zip(ATTEMPTS, motion):
            claims[attempt][name] = _decoded(numbers) if numbers[0] == 1.0 else None
    return claims, n_frames


def _decoded(numbers: np.ndarray) -> bytes:
    """The digest that the cheater's ``encoded`` made coordinates of."""
    return bytes(np.rint(10 * numbers[1:33]).astype(np.uint8))


def _ended(mark: str) -> int:
    """How many processes with this word on their command line are alive; they are ended."""
    found = [process for process in psutil.process_iter(["cmdline"]) if mark in (process.info["cmdline"] or ())]
    for process in found:
        process.kill()
    return len(found)


@pytest.fixture(scope="session")
def playground(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Playground]:
    """60 sequences, 15 of them in the test split."""
    folder = tmp_path_factory.mktemp("firewall")
    home, site = folder / "home", folder / "site"
    table = fake_dataset(home / "work" / "table", 60)
    shutil.copytree(table.folder, home / ".cache" / "prbench" / "tables" / "embedded")
    (home / "work" / "weights").mkdir()
    (home / "work" / "weights" / "weights.bin").write_bytes(b"1")
    _install(site, table)
    with _whisperer() as port:
        yield Playground(home, site, table, port)


def _install(site: Path, table: SequenceTable) -> None:
    """What pip would leave behind, and the facts that the package brings along."""
    info = site / "prbench_cheater-1.0.dist-info"
    info.mkdir(parents=True)
    shutil.copy(HERE / "cheater.py", site / "prbench_cheater.py")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: prbench_cheater\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[prbench.adapters]\ncheater = prbench_cheater:load\n")
    (chunk,) = table.chunks(split="test")
    np.savez(
        site / "known.npz",
        identity=table.identity,
        ids=np.array(chunk.sequence_ids),
        n_frames=chunk.n_frames,
        initial_joints=chunk.joints[chunk.offsets[:-1]],
        goal_location=chunk.vectors("goal_location"),
    )


@contextlib.contextmanager
def _whisperer() -> Iterator[int]:
    """Somebody on the network who tells the answer to everybody that connects."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    line, _ = server.accept()
                    with line:
                        line.sendall(b"the answer")

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]


def digest(claim: str) -> bytes:
    return hashlib.sha256(claim.encode()).digest()
