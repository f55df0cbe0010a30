"""A method in one plain file, as the user's own program, and a proof that nothing of it is left running."""

from __future__ import annotations

import os
import sys
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

MARK = "PROGRAM_TEST_MARK"

SOURCE = """
import json, os, sys, time
import numpy as np
import pyarrow as pa

stdin, stdout = sys.stdin.buffer, sys.stdout.buffer

def read():
    line = stdin.readline()
    if not line:
        sys.exit(0)
    header = json.loads(line)
    return header, stdin.read(header.get("bytes") or 0)

def write(header, payload=b""):
    if payload:
        header["bytes"] = len(payload)
    stdout.write(json.dumps(header).encode() + b"\\n" + payload)
    stdout.flush()

settings, _ = read()
introduction = {"message": "hello", "wire": 1, "name": "drawn", "version": "2.1", "conditions": ["none", "goal-loc"]}
%(hello)s
write(introduction)
while True:
    header, payload = read()
    rows = pa.ipc.open_stream(payload).read_next_batch().to_pydict()
    joints = []
    for seed, n_frames in zip(rows["noise_seed"], rows["n_frames"]):
        joints.append(np.random.default_rng(seed).normal(size=n_frames * 66).astype(np.float32))
    answer = {"message": "motions", "batch": header["batch"], "network_passes": 3}
    %(body)s
    batch = pa.record_batch([pa.array(rows["opaque_id"]), pa.array(joints, pa.list_(pa.float32()))],
                            names=["opaque_id", "joints"])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    write(answer, sink.getvalue().to_pybytes())
"""


@dataclass(frozen=True)
class OwnProgram:
    """A folder with a program, and the mark that all its processes carry."""

    folder: Path
    mark: str

    @property
    def method(self) -> str:
        """For ``--method``."""
        return f'cmd:"{sys.executable}" "{self.folder / "drawn.py"}"'

    def write(self, *, hello: str = "", body: str = "") -> str:
        """Write ``drawn.py``; ``hello`` changes ``introduction``, ``body`` runs before a batch is answered."""
        self.folder.mkdir(exist_ok=True)
        text = SOURCE % {"hello": hello, "body": body.replace("\n", "\n    ")}
        (self.folder / "drawn.py").write_text(text)
        return self.method

    def running(self) -> list[psutil.Process]:
        """What carries the mark: this program and its kin, in this process or below another one."""
        found = []
        for process in psutil.process_iter():
            try:
                if process.pid != os.getpid() and process.environ().get(MARK) == self.mark:
                    found.append(process)
            except psutil.Error:
                continue
        return [process for process in found if "drawn.py" in " ".join(_words(process))]


def _words(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[OwnProgram]:
    """A program of the user's own; nothing of it may be left when the test is over."""
    program = OwnProgram(tmp_path / "method", uuid.uuid4().hex)
    monkeypatch.setenv(MARK, program.mark)
    yield program
    until = time.monotonic() + 5
    while (left := program.running()) and time.monotonic() < until:
        time.sleep(0.05)
    for process in left:
        process.kill()
    assert not left, "a program is left behind"
