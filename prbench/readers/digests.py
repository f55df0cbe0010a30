"""Digests of input files, remembered: hashing a gigabyte takes longer than reading what is needed of it.

A digest is always that of a file's content. It is remembered together with the file's size, times of change (of content
and of status) and number on the disk, and taken again as soon as one of them differs; so it follows every change that
the file system knows of. ``PRBENCH_PARSE_CACHE=off`` switches the memory off.
"""

from __future__ import annotations

import contextlib
import json
import time
from pathlib import Path

from prbench.errors import StorageError
from prbench.locks import sole_writer
from prbench.readers.parse_cache import limit_bytes
from prbench.storage import cache_folder, file_digest, text_digest, write_json

_WORTH_REMEMBERING = 2**20  # bytes; a smaller file is hashed in a millisecond
_SETTLED_NS = 2_000_000_000


def remembered_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, as hexadecimal text.

    Raises:
        FileNotFoundError: if there is no such file.
        InputFileError: if it is a folder, a pipe or a device.
    """
    before, now = _identity(path), time.time_ns()
    if before["size"] < _WORTH_REMEMBERING or not limit_bytes():
        return file_digest(path)
    entry = cache_folder() / "digests" / f"{text_digest(str(path.resolve()))[:32]}.json"
    known = _load(entry)
    if known.get("identity") == before and isinstance(known.get("sha256"), str):
        return known["sha256"]
    digest = file_digest(path)
    settled = now - max(before["mtime_ns"], before["ctime_ns"]) > _SETTLED_NS  # else it may change within one tick
    if settled and _identity(path) == before:
        with contextlib.suppress(StorageError), sole_writer(entry):
            write_json(entry, {"identity": before, "sha256": digest})
    return digest


def _identity(path: Path) -> dict[str, int]:
    status = path.stat()
    return {
        "size": status.st_size,
        "mtime_ns": status.st_mtime_ns,
        "ctime_ns": status.st_ctime_ns,
        "inode": status.st_ino,
        "device": status.st_dev,
    }


def _load(entry: Path) -> dict:
    try:
        known = json.loads(entry.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # none, or a damaged one
        return {}
    return known if isinstance(known, dict) else {}
