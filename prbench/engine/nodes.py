"""Check, before work starts, that every node of a cluster would do the same as this machine.

A node is asked for its facts (:mod:`prbench.engine.node_facts`), and they are compared with those of this machine. What
is unfit is named, with the node and with what to do.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from prbench.engine.node_facts import node_facts
from prbench.shown import quoted

# Bytes that must be free where a node writes, and where Ray puts what the memory cannot hold.
LEAST_FREE = 1_000_000_000
# Seconds by which a node's clock may be off: locks and leftovers of killed work are judged by the age of files.
CLOCK_TOLERANCE_S = 30.0
# Packages whose version decides results, or whether processes understand one another.
_PACKAGES = ("numpy", "torch", "pyarrow", "scipy", "h5py", "safetensors", "ray")
_MARK = ".prbench-node-check-"


@dataclass(frozen=True)
class Needs:
    """What the work needs on every node.

    Attributes:
        reads: Files and folders that it reads; absolute.
        writes: Files and folders that it makes; the nearest folder there is must be shared by all nodes.
        packages: Distributions beside the usual ones, for example of a method.
    """

    reads: tuple[Path, ...] = ()
    writes: tuple[Path, ...] = ()
    packages: tuple[str, ...] = ()


@dataclass(frozen=True)
class Question:
    """What every node is asked, and what this machine answers itself.

    Attributes:
        asked: When the question went out, by this machine's clock.
    """

    wanted: dict[str, Any]
    here: Mapping[str, Any]
    asked: float = field(default_factory=time.time)


@contextlib.contextmanager
def question(needs: Needs) -> Iterator[Question]:
    """Ask with marks, small files that nodes must see; they are deleted in the end."""
    marks: dict[str, str] = {}
    nearest = set()  # the folder above each result that is there already
    for path in needs.writes:
        folder = path.expanduser().absolute().parent
        while not folder.is_dir():
            folder = folder.parent
        nearest.add(str(folder))
    folders = sorted(nearest)
    try:
        for folder in folders:
            text = secrets.token_hex(16)
            with contextlib.suppress(OSError):  # a folder that cannot be written is refused by the work itself
                handle, name = tempfile.mkstemp(prefix=_MARK, dir=folder)
                marks[name] = text
                with os.fdopen(handle, "w", encoding="utf-8") as file:
                    file.write(text)
        start = "" if all(map(Path.is_absolute, (*needs.reads, *needs.writes))) else str(Path.cwd())
        reads = sorted(str(Path(path).absolute()) for path in needs.reads)
        packages = sorted({*_PACKAGES, *needs.packages})
        wanted = {"packages": packages, "reads": reads, "marks": marks, "room": folders, "folder": start}
        yield Question(wanted, node_facts(wanted))
    finally:
        for name in marks:
            Path(name).unlink(missing_ok=True)


def problems(facts: Mapping[str, Any], asked: Question, answered: float) -> list[str]:
    """Return what makes a node unfit, each with what to do about it.

    Args:
        facts: What the node answered.
        asked: What it was asked.
        answered: When the answer was there, by this machine's clock.
    """
    found: list[str] = []
    here = asked.here
    if not facts["prbench"]:
        remedy = f"Install version {here['prbench']} there, into the Python that runs Ray."
        found.append(f"prbench is not installed there. {remedy}")
    elif facts["prbench"] != here["prbench"]:
        told = f"prbench {_said(facts['prbench'])} is installed there, and {here['prbench']} here."
        found.append(f"{told} Install the same version on both.")
    elif facts["code"] != here["code"]:
        told = f"prbench {here['prbench']} is installed there with other source files than here."
        found.append(f"{told} Install the same commit on both, best into a folder that all nodes share.")
    if facts["python"].split(".")[:2] != here["python"].split(".")[:2]:
        found.append(f"Python {_said(facts['python'])} runs there, and {here['python']} here. Use the same on both.")
    for name, version in here["packages"].items():
        there = facts["packages"].get(name, "")
        if version and there != version:
            told = f"{name} is not installed there."
            if there:
                told = f"{name} {_said(there)} is installed there, and {version} here."
            found.append(f"{told} Run there: pip install {name}=={version}")
    for path, print_here in asked.here["reads"].items():
        there = facts["reads"].get(path, "")
        if there == print_here or not print_here:
            continue
        told = f"{path} is not there. Mount the data at the same path on every node."
        if there:
            told = f"{path} holds something else there than here. Put the data on a file system that all nodes share."
        found.append(told)
    if not facts["folder"]:
        remedy = "Name files by absolute paths, or start it in a folder that all nodes share."
        found.append(f"{asked.wanted['folder']}, where the command was started, is not there. {remedy}")
    for mark, text in asked.wanted["marks"].items():
        if facts["marks"].get(mark, "") != text:
            told = f"{Path(mark).parent} is not the same folder there: a file written here is not seen."
            found.append(f"{told} Choose an --out on a file system that all nodes share.")
    for path, free in facts["room"].items():
        if free is not None and free < LEAST_FREE:
            least = f"at least {LEAST_FREE / 1e9:.0f} GB are needed. Free some space."
            found.append(f"{path} has {free / 1e9:.1f} GB of free disk there; {least}")
    there = facts["time"]
    off = max(asked.asked - there, there - answered)  # it was read at some moment between the two
    if off > CLOCK_TOLERANCE_S:
        direction = "behind" if there < asked.asked else "ahead"
        remedy = f"at most {CLOCK_TOLERANCE_S:.0f} s are allowed. Set it, for example by chrony or systemd-timesyncd."
        found.append(f"its clock is {off:.0f} s {direction}; {remedy}")
    return found


def _said(text: object) -> str:
    return quoted(text, longest=60)
