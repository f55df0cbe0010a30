"""Keep what was parsed from large text files in the user's cache, so that the next read is a small binary one.

An entry belongs to one file and is used only while that file is the same: path, size, times of change (of content and
of status), and a digest of its first and last bytes (of a file in an archive: its checksum and the archive's times).
``PRBENCH_PARSE_CACHE`` switches it off (``off``) or bounds it (megabytes; 2048 by default); the least recently used
entries go first.

Digests of files are remembered likewise: hashing a gigabyte takes longer than reading what is needed of it. A digest is
always that of a file's content, and is taken again as soon as size, times of change or number on the disk differ.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import time
import zipfile
from pathlib import Path

import pyarrow as pa
import pyarrow.ipc

from prbench.errors import StorageError, UsageError
from prbench.files.storage import cache_folder, file_digest, sole_file, sole_writer, text_digest, write_json
from prbench.readers.files import Source, ZippedFile

CACHE_VARIABLE = "PRBENCH_PARSE_CACHE"
_DEFAULT_MEGABYTES = 2048
_VERSION = "1"  # of what is kept; raise it when parsing changes
_FINGERPRINT = b"prbench.fingerprint"
_EDGE = 65_536  # bytes at the beginning and the end of a file that are compared
_SETTLED_NS = 2_000_000_000
"""A file that changed less than this ago may change again without a new time; its content is not kept."""
_WORTH_REMEMBERING = 2**20  # bytes; a smaller file is hashed in a millisecond


def load_parsed(source: Source, wish: bytes) -> pa.Table | None:
    """Return what was parsed from a source before; None if that is not known, or the source or the wish has changed.

    Args:
        source: A plain file, or one in an archive.
        wish: What of it was parsed, and how.
    """
    if not limit_bytes():
        return None
    path = _entry(source)
    try:
        with pa.OSFile(str(path)) as file:
            table = pyarrow.ipc.open_file(file).read_all()
        if (table.schema.metadata or {}).get(_FINGERPRINT) != _fingerprint(source, wish):
            return None
        os.utime(path)  # used now
    except (OSError, pa.ArrowInvalid):  # no entry, or a damaged one
        return None
    return table


def limit_bytes() -> int:
    """Most bytes to keep; 0 when the cache is off.

    Raises:
        UsageError: if ``PRBENCH_PARSE_CACHE`` is neither ``off`` nor a number of megabytes.
    """
    setting = os.environ.get(CACHE_VARIABLE, str(_DEFAULT_MEGABYTES)).strip().lower()
    if setting in ("off", "no", "false"):
        return 0
    if not setting.isdecimal():
        raise UsageError(f"{CACHE_VARIABLE} is '{setting}'; set it to off, or to a number of megabytes.")
    return int(setting) * 10**6


def _entry(source: Source) -> Path:
    member = source.member if isinstance(source, ZippedFile) else ""
    return (cache_folder() / "parsed") / f"{text_digest(str(_file(source).resolve()), member)[:32]}.arrow"


def _file(source: Source) -> Path:
    return source.archive if isinstance(source, ZippedFile) else source


def _fingerprint(source: Source, wish: bytes) -> bytes:
    status = _file(source).stat()
    content = _checksum(source) if isinstance(source, ZippedFile) else _edges(source)
    wished = hashlib.sha256(wish).hexdigest()
    times = f"{status.st_mtime_ns} {status.st_ctime_ns}"
    return text_digest(_VERSION, str(status.st_size), times, content, wished).encode()


def _checksum(source: ZippedFile) -> str:
    try:
        with zipfile.ZipFile(source.archive) as archive:
            entry = archive.getinfo(source.member)
    except (KeyError, zipfile.BadZipFile) as error:
        raise OSError(str(error)) from error
    return f"{entry.CRC} {entry.file_size}"


def _edges(path: Path) -> str:
    with open(path, "rb") as file:
        digest = hashlib.sha256(file.read(_EDGE))
        file.seek(max(path.stat().st_size - _EDGE, 0))
        digest.update(file.read(_EDGE))
    return digest.hexdigest()


def keep_parsed(source: Source, wish: bytes, table: pa.Table) -> None:
    """Keep what was parsed from a source; where that cannot be written, or the source just changed, nothing is kept.

    Args:
        source: A plain file, or one in an archive.
        wish: What of it was parsed, and how.
        table: The result; its metadata is kept too.
    """
    limit = limit_bytes()
    if not limit or time.time_ns() - _file(source).stat().st_mtime_ns < _SETTLED_NS:
        return
    path = _entry(source)
    marked = table.replace_schema_metadata({**(table.schema.metadata or {}), _FINGERPRINT: _fingerprint(source, wish)})
    with contextlib.suppress(StorageError):  # a full or read-only disk makes reading slower, never impossible
        with sole_file(path) as temporary, pyarrow.ipc.new_file(str(temporary), marked.schema) as writer:
            writer.write_table(marked)
        _shrink(path.parent, limit)


def _shrink(folder: Path, limit: int) -> None:
    """Delete the least recently used entries until the others fit; another process may do the same."""
    entries = []
    for path in folder.glob("[!.]*.arrow"):  # those with a dot are being written
        with contextlib.suppress(FileNotFoundError):
            entries.append((path.stat().st_mtime_ns, path.stat().st_size, path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= limit:
            return
        with contextlib.suppress(OSError):  # in use, on systems that then keep it
            path.unlink()
        total -= size


def remembered_digest(path: Path) -> str:
    """SHA-256 of a file's bytes, as hexadecimal text.

    Raises:
        FileNotFoundError: if there is no such file.
        InputFileError: if it is a folder, a pipe or a device.
    """
    before = _identity(path)
    now = time.time_ns()
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
