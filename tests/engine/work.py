"""Work for tests of engines; little is imported, since every worker has to."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from prbench.errors import InputFileError


def where(value: int) -> tuple[int, str]:
    from ray import get_runtime_context

    time.sleep(0.2)
    return value, get_runtime_context().get_node_id()


def fail_on_three(value: int) -> int:
    if value == 3:
        raise InputFileError("x.csv", "row 3", expected="a number", found="three", remedy="Count again.")
    return value


@dataclass(frozen=True)
class Short:
    """Work for whose item 3 the memory does not suffice, so many times; a file a try counts them."""

    folder: Path
    times: int
    how: str

    def __call__(self, value: int) -> int:
        tries = len(list(self.folder.iterdir()))
        if value == 3 and tries < self.times:
            (self.folder / str(tries)).touch()
            if self.how == "killed":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.how == "told":
                raise InputFileError("x.csv", "", expected="less", found="too much") from MemoryError()
            if self.how == "arrow":
                raise pa.lib.ArrowMemoryError("malloc of size 4398046511104 failed")
            raise MemoryError("malloc of size 4398046511104 failed")
        return value


def first_and_last(block: bytes) -> tuple[int, int]:
    return block[0], block[-1]


def visible_gpus(value: int) -> tuple[int, str]:
    """Return the value, and the GPUs that this worker may use."""
    return value, os.environ.get("CUDA_VISIBLE_DEVICES", "")
