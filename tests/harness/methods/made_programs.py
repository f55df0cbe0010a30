"""Small programs for tests, honest and hostile: a common beginning, then what the test is about."""

from __future__ import annotations

import contextlib
import os
import sys
import textwrap
import uuid
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil

from prbench.contract import GIVEN, Condition, ConditionBatch, Motions
from prbench.harness.methods.messages import motions_payload
from prbench.harness.methods.process import Program
from prbench.harness.methods.remote import RemoteAdapter

MARK = "REMOTE_TEST_MARK"
"""Variable by which a test finds the processes that its program has left behind."""

READ_AND_WRITE = """
import json, os, subprocess, sys, time
stdin, stdout = sys.stdin.buffer, sys.stdout.buffer

def read():
    line = stdin.readline()
    if not line:
        sys.exit(0)
    header = json.loads(line)
    return header, stdin.read(header.get("bytes") or 0)

def write(header, payload=None):
    if payload is not None:
        header["bytes"] = len(payload)
    stdout.write(json.dumps(header).encode() + b"\\n" + (payload or b""))
    stdout.flush()
"""

BEGINNING = (
    READ_AND_WRITE
    + """
GOOD = open(sys.argv[1], "rb").read()  # the right answer to the first batch of the tests
INTRODUCTION = {"message": "hello", "wire": 1, "name": "made", "version": "1.0", "conditions": ["goal-loc"]}

def hello(**changes):
    read()
    write({**INTRODUCTION, **changes})

def motions(header, payload=GOOD, **changes):
    write({"message": "motions", "batch": header["batch"], **changes}, payload)
"""
)

HONEST = """
hello()
while True:
    motions(read()[0])
"""


class Case(NamedTuple):
    """What a hostile program does, and what the message about it says."""

    name: str
    source: str
    says: str
    waits: bool = False
    """Only a time limit ends it."""


def standard_batch(rows: int = 3) -> ConditionBatch:
    """Sequences of 4, 5 … frames under ``goal-loc``."""
    generator = np.random.default_rng(0)
    joints = generator.normal(size=(2, rows, 22, 3)).astype(np.float32)
    return ConditionBatch(
        condition=Condition.GOAL_LOCATION,
        n_frames=np.arange(4, 4 + rows),
        fps=20.0,
        opaque_id=tuple(f"{row:064x}" for row in range(rows)),
        noise_seed=tuple(range(rows)),
        text=("The person reaches.",) * rows,
        initial_joints=joints[0],
        previous_joints=joints[1],
        goal_location=generator.normal(size=(rows, 3)),
    )


def under(condition: Condition, batch: ConditionBatch) -> ConditionBatch:
    """The same sequences under another condition; goal poses are the initial ones."""
    given: dict[str, Any] = dict.fromkeys(("text", "initial_joints", "previous_joints", "goal_location"))
    given |= {name: getattr(batch, name) for name in GIVEN[condition] if name != "goal_joints"}
    goal = batch.initial_joints if condition is Condition.GOAL_POSE else None
    return replace(batch, condition=condition, goal_joints=goal, **given)


def standing_motions(batch: ConditionBatch) -> Motions:
    """The initial pose held still: the right answer of the programs here."""
    assert batch.initial_joints is not None
    return Motions(np.repeat(batch.initial_joints[:, None], int(batch.n_frames.max()), axis=1), batch.n_frames)


@dataclass(frozen=True)
class Workshop:
    """Makes programs in a folder of its own and knows which of their processes are left."""

    folder: Path
    mark: str
    started: list[RemoteAdapter] = field(default_factory=list)

    @property
    def cache(self) -> Path:
        """The cache folder of this test."""
        return Path(os.environ["PRBENCH_CACHE"])

    @classmethod
    def in_folder(cls, folder: Path) -> Workshop:
        """With the right answer to :func:`standard_batch` at hand."""
        batch = standard_batch()
        (folder / "good.bin").write_bytes(motions_payload(batch.opaque_id, standing_motions(batch)))
        return cls(folder, uuid.uuid4().hex)

    def program(self, source: str, *, start_timeout: float = 20.0, batch_timeout: float = 20.0) -> Program:
        """A program of these lines, behind the common beginning."""
        path = self.folder / "made.py"
        path.write_text(BEGINNING + textwrap.dedent(source), encoding="utf-8")
        return Program(
            name="cmd:made",
            words=(sys.executable, "-S", "-E", str(path), str(self.folder / "good.bin")),
            directory=self.folder,
            environment=(*_SYSTEM, (MARK, self.mark)),
            start_timeout=start_timeout,
            batch_timeout=batch_timeout,
        )

    def start(self, source: str, *, start_timeout: float = 20.0, batch_timeout: float = 20.0) -> RemoteAdapter:
        """The program as an adapter."""
        adapter = started(self.program(source, start_timeout=start_timeout, batch_timeout=batch_timeout))
        self.started.append(adapter)
        return adapter

    def left_behind(self) -> list[psutil.Process]:
        """Processes with the mark of this test in their environment."""
        return marked(self.mark)


def marked(mark: str) -> list[psutil.Process]:
    """Return the processes with this mark in their environment, apart from this one."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.pid != os.getpid() and process.environ().get(MARK) == mark:
                found.append(process)
    return found


_SYSTEM = tuple((key, value) for key, value in os.environ.items() if key.upper() in ("PATH", "SYSTEMROOT"))


def started(program: Program) -> RemoteAdapter:
    """With settings that do not matter."""
    return RemoteAdapter.start(program, weights=None, options={}, device="cpu", threads=1)


def with_libraries(program: Program) -> Program:
    """The same program with installed packages (NumPy, PyArrow) on its path."""
    return replace(program, words=(program.words[0], *program.words[3:]))
