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
    return {
        "python": platform.python_version(),
        "prbench": _version("prbench"),
        "code": _code_digest(),
        "packages": {name: _version(name) for name in wanted["packages"]},
        "reads": {path: _fingerprint(path) for path in wanted["reads"]},
        "marks": {path: _read_soon(path, text) for path, text in wanted["marks"].items()},
        "room": {path: _free(path) for path in (*wanted["room"], tempfile.gettempdir())},
        "folder": not wanted["folder"] or os.path.isdir(wanted["folder"]),  # noqa: PTH112
        "time": time.time(),
    }


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _code_digest() -> str:
    """Digest of the installed code: two working copies may have the same version and differ."""
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
    return digest.hexdigest()


def _fingerprint(path: str) -> str:
    """Tell whether another machine means the same by a path: the size of a file, the names in a folder."""
    try:
        if os.path.isdir(path):  # noqa: PTH112 - texts come in, and go out
            with os.scandir(path) as entries:
                # A build keeps its parts and locks in names with a dot, which come and go.
                names = sorted(entry.name for entry in entries if not entry.name.startswith("."))
            return "folder " + hashlib.sha256("\0".join(names[:_NAMES]).encode()).hexdigest()
        return f"file of {os.stat(path).st_size} bytes"  # noqa: PTH116
    except OSError:
        return ""


def _read_soon(path: str, expected: str) -> str:
    """Read a short file that another machine has just written; empty if it does not appear."""
    until = time.monotonic() + _PATIENCE_S
    while True:
        with contextlib.suppress(OSError):
            text = Path(path).read_text(encoding="utf-8")
            if text == expected:
                return text
        if time.monotonic() > until or not Path(path).parent.is_dir():
            return ""
        time.sleep(0.1)


def _free(path: str) -> int | None:
    try:
        return shutil.disk_usage(path).free
    except OSError:
        return None
