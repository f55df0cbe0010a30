"""What a machine says of itself before it is given work.

A node runs this file's text, so it works where prbench is missing or of another version: the standard library alone.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import importlib.util
import os
import platform
import shutil
import tempfile
import time
from pathlib import Path

_CODE = ("prbench", "prbench_adapters", "prbench_benchmarks", "prbench_data_manifests")
_SUFFIXES = (".py", ".toml")
# Names of a folder that are compared at most.
_NAMES = 10_000
# Seconds in which a file that another machine has written must be seen: network file systems look up now and then.
_PATIENCE_S = 10.0


def node_facts(wanted: dict) -> dict:
    """Answer what is asked of this machine.

    Args:
        wanted: ``packages``: names of distributions; ``reads``: paths; ``marks``: a text by the path of the file that
            must hold it; ``room``: folders whose free disk is asked for;
            ``folder``: where relative paths start, or empty.

    Returns:
        Versions, digests and sizes by name or path; what is missing is empty, or None for a number.
    """
    # Digest of the installed code: two working copies may have the same version and differ.
    digest = hashlib.sha256()
    for package in _CODE:
        try:
            found = importlib.util.find_spec(package)
        except (ImportError, ValueError):
            found = None
        for root in (found.submodule_search_locations or ()) if found is not None else ():
            for path in sorted(Path(root).rglob("*")):
                if path.suffix in _SUFFIXES:
                    digest.update(f"{package}/{path.relative_to(root).as_posix()}".encode() + b"\0")
                    digest.update(path.read_bytes() + b"\0")
    # Whether another machine means the same by a path: the size of a file, the names in a folder.
    reads = dict.fromkeys(wanted["reads"], "")
    for name in reads:
        with contextlib.suppress(OSError):
            if os.path.isdir(name):  # noqa: PTH112 - texts come in, and go out
                with os.scandir(name) as entries:
                    # A build keeps its parts and locks in names with a dot, which come and go.
                    names = sorted(entry.name for entry in entries if not entry.name.startswith("."))
                reads[name] = "folder " + hashlib.sha256("\0".join(names[:_NAMES]).encode()).hexdigest()
            else:
                reads[name] = f"file of {os.stat(name).st_size} bytes"  # noqa: PTH116
    # Short files that another machine has just written; empty where they do not appear.
    marks = dict.fromkeys(wanted["marks"], "")
    for name, text in wanted["marks"].items():
        until = time.monotonic() + _PATIENCE_S
        while not marks[name] and time.monotonic() < until and Path(name).parent.is_dir():
            with contextlib.suppress(OSError):
                marks[name] = text if Path(name).read_text(encoding="utf-8") == text else ""
            if not marks[name]:
                time.sleep(0.1)
    room: dict[str, int | None] = dict.fromkeys((*wanted["room"], tempfile.gettempdir()))
    for name in room:
        with contextlib.suppress(OSError):
            room[name] = shutil.disk_usage(name).free
    return {
        "python": platform.python_version(),
        "prbench": _version("prbench"),
        "code": digest.hexdigest(),
        "packages": {name: _version(name) for name in wanted["packages"]},
        "reads": reads,
        "marks": marks,
        "room": room,
        "folder": not wanted["folder"] or os.path.isdir(wanted["folder"]),  # noqa: PTH112
        "time": time.time(),
    }


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""
