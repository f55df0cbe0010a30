"""Files written whole or not at all, and digests of what they hold.

One process at a time writes a result: a lock beside it, held by the operating system and named after its owner.

The lock is a file ``.NAME.lock`` beside the result ``NAME``. The operating system lets go of it however its owner ends,
so a killed process never blocks; the file itself is removed when the work ends. Where the parent folder cannot be
written, it stands in the cache folder and keeps this user's processes on this machine apart. A file system without
locks is worked on without one.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import platformdirs
from filelock import FileLock, Timeout

from prbench.errors import ErrorOfParts, InputFileError, StorageError
from prbench.files.bounded import foreign_input, open_regular, read_text, read_whole
from prbench.limits import LARGEST_ARCHIVE, LARGEST_JSON, LONGEST_NAME
from prbench.shown import clean

CACHE_VARIABLE = "PRBENCH_CACHE"
# Why nothing more can be written
_FULL = {
    getattr(errno, "EDQUOT", errno.ENOSPC): "the disk quota is used up",
    errno.ENOSPC: "no space left on the device",
    errno.EFBIG: "larger than a file may be here (`ulimit -f`, or the file system)",
}
_FORBIDDEN = {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EISDIR, errno.EEXIST}


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that takes its name when the block ends well, else vanishes.

    The temporary file keeps the suffix of ``path``, so that writers which look at suffixes still work.

    Raises:
        StorageError: if the folder cannot be written or the disk is full.
    """
    with _storage_errors(path, every_kind=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=f".partial{path.suffix}", dir=path.parent)
        os.close(handle)
    temporary = Path(name)
    try:
        with _storage_errors(path):
            yield temporary
            temporary.chmod(0o666 & ~_umask())  # mkstemp makes files that only their owner can read
            with open(temporary, "r+b") as written:  # Windows syncs only what may be written
                os.fsync(written.fileno())
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(path: Path, *, told_by: str | None = None) -> Iterator[Path]:
    """Yield a temporary folder beside ``path`` that takes its name when the block ends well, replacing what was there.

    Args:
        path: The folder.
        told_by: File whose equal bytes tell that the folder which stands there is the same; then it stays. Two machines
            may make the same folder at the same time, and neither may take it away from under the other's readers.

    Raises:
        StorageError: if the folder cannot be written or the disk is full.
    """
    with _storage_errors(path, every_kind=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}-", suffix=".partial", dir=path.parent))
    try:
        with _storage_errors(path):
            yield temporary
            temporary.chmod(0o777 & ~_umask())
            if _told_equal(path, temporary, told_by):
                return
            replaced = temporary.with_suffix(".replaced")
            if path.exists():
                path.replace(replaced)
            try:
                temporary.replace(path)
            except OSError:  # not empty: another machine was a moment faster
                if not _told_equal(path, temporary, told_by):
                    raise
                shutil.rmtree(replaced, ignore_errors=True)
                return
            if replaced.exists():
                replaced.replace(temporary)  # from here on half of it may be gone, so it is never put back
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _told_equal(one: Path, other: Path, told_by: str | None) -> bool:
    if told_by is None:
        return False
    try:
        return read_whole(one / told_by) == read_whole(other / told_by)
    except (OSError, InputFileError):
        return False


def remove_folder(path: Path) -> None:
    """Delete a folder; whoever looks for it while it goes, or after a kill, finds none rather than half of it.

    What a kill leaves is cleared by :func:`remove_leftovers`. A folder that cannot be moved or deleted stays.
    """
    if not path.is_dir():
        return
    with contextlib.suppress(OSError):
        going = Path(tempfile.mkdtemp(prefix=f".{path.name}-", suffix=".partial", dir=path.parent))
        try:
            path.replace(going / path.name)
        finally:
            shutil.rmtree(going, ignore_errors=True)


def remove_leftovers(path: Path) -> None:
    """Clear away what a process that was killed left beside ``path``; call it before writing there again.

    Half-written files and folders are deleted. A folder that was just about to be replaced gets its name back.
    """
    of_file = rf"{re.escape(path.stem)}-[a-z0-9_]{{8}}\.partial{re.escape(path.suffix)}"
    of_folder = rf"{re.escape(path.name)}-[a-z0-9_]{{8}}\.(partial|replaced)"
    mine = re.compile(rf"\.({of_file}|{of_folder})")
    for left in path.parent.glob(".*-*.*") if path.parent.is_dir() else ():
        match = mine.fullmatch(left.name)
        if match and match[2] == "replaced" and not path.exists():
            left.replace(path)
        elif match and left.is_dir():
            shutil.rmtree(left, ignore_errors=True)
        elif match:
            left.unlink(missing_ok=True)


def remove_half_written(folder: Path) -> None:
    """Delete the files that a process which was killed left half-written anywhere in a folder that it alone wrote."""
    for left in folder.rglob(".*.partial*"):
        left.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@contextlib.contextmanager
def _storage_errors(path: Path, *, every_kind: bool = False) -> Iterator[None]:
    """Turn what went wrong with writing into a StorageError.

    Inside a user's block only errors that writing alone can cause are turned; with ``every_kind`` all of them are.
    """
    try:
        yield
    except OSError as error:
        refused = storage_error(error, path, every_kind=every_kind)
        if refused is None:
            raise
        raise refused from error


def storage_error(error: OSError, path: Path | str, *, every_kind: bool = False) -> StorageError | None:
    """Return the error that says why something cannot be written; None for what writing alone does not cause.

    Args:
        error: An error of the operating system.
        path: The file or folder that was being written.
        every_kind: Return one for any error.
    """
    full = _FULL.get(error.errno or 0)
    if error.errno is None and str(error).endswith("written"):  # how NumPy says that it could write a part alone
        full = "no more could be written"
    if full is not None:
        why = "free some space, raise the limit or ask for less (--limit), and run the same command again."
        return StorageError(f"{path}: {full}. Nothing half-written was kept; {why}")
    if every_kind or error.errno in _FORBIDDEN:
        return StorageError(f"{path}: cannot be written ({error.strerror}). Choose another folder.")
    return None


def require_replaceable(folder: Path, marker: str, *, kind: str) -> None:
    """Refuse, before hours of work, a folder that a result could not replace.

    Args:
        folder: Folder that the result will stand in.
        marker: File that marks a folder as an earlier result.
        kind: What such a result is called, for the message.

    Raises:
        StorageError: if it holds something else, or is a file.
    """
    if folder.is_file():
        raise StorageError(f"{folder}: is a file. Choose an empty or new folder for --out.")
    if folder.is_dir() and any(folder.iterdir()) and not (folder / marker).is_file():
        why = f"so it is no {kind} that may be replaced. Choose an empty or new folder for --out."
        raise StorageError(f"{folder}: is not empty and holds no {marker}, {why}")


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all.

    Raises:
        StorageError: if the folder cannot be written or the disk is full.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text, line ends as they are, whole or not at all.

    Raises:
        StorageError: if the folder cannot be written or the disk is full.
    """
    write_bytes(path, text.encode())


def write_json(path: Path, value: object) -> None:
    """Write JSON with sorted keys, two-space indent and a final newline; equal values give equal bytes."""
    write_text(path, json.dumps(value, indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n")


@foreign_input()
def read_json(path: Path, *, as_object: Callable[[list[tuple[str, Any]]], object] | None = None) -> object:
    """Read a JSON file.

    Args:
        path: The file.
        as_object: Makes an object of its pairs; None for a dictionary with the last value of every key.

    Raises:
        InputFileError: if the file is missing, or is not JSON (naming line and column).
    """
    try:
        text = read_text(path, expected="a JSON file", largest=LARGEST_JSON)
        return json.loads(text, object_pairs_hook=as_object)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno} column {error.colno}"
        remedy = "The file may be truncated; copy or download it again."
        raise InputFileError(path, where, expected="valid JSON", found=str(error), remedy=remedy) from error


def file_digest(path: Path, *, largest: int = LARGEST_ARCHIVE) -> str:
    """SHA-256 of a file's bytes, as hexadecimal text.

    Raises:
        InputFileError: if it is a folder, a pipe or a device, or larger than ``largest`` bytes.
        FileNotFoundError: if there is no such file.
    """
    with open_regular(path, largest=largest) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def bytes_digest(content: bytes) -> str:
    """SHA-256 of some bytes, as hexadecimal text."""
    return hashlib.sha256(content).hexdigest()


def text_digest(*parts: str) -> str:
    """SHA-256 of texts, joined so that no two different lists of parts agree."""
    digest = hashlib.sha256()
    for part in parts:
        encoded = part.encode()
        digest.update(len(encoded).to_bytes(8, "little"))
        digest.update(encoded)
    return digest.hexdigest()


def inside(root: Path, relative: str) -> Path:
    """Return a path below ``root``; names taken from files are resolved with this and never lead out.

    Raises:
        InputFileError: if ``relative`` is absolute or climbs out of ``root``.
    """
    # Not Path.resolve, which raises for a link that leads to itself: whoever reads the path reports that.
    target = Path(os.path.realpath(root / relative))
    if not target.is_relative_to(os.path.realpath(root)):
        raise InputFileError(root, relative, expected="a path inside this folder", found="a path that leads out of it")
    return target


def is_path_part(name: str) -> bool:
    """Return True if a name can be that of one folder or file: it leads nowhere else and is not taken for an option."""
    leads_away = any(letter in name for letter in "/\\:")
    return 0 < len(name) <= LONGEST_NAME and name[0] not in ".-" and not leads_away and clean(name) == name


def cache_folder() -> Path:
    """Return the folder of what prbench can make again: ``PRBENCH_CACHE``, else the user's cache."""
    return Path(os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_dir("prbench", appauthor=False))


def turn_into_paths(request: object, *names: str) -> None:
    """Turn text in some attributes of a frozen data class into paths; for its ``__post_init__``.

    Args:
        request: The instance.
        names: Attributes that hold a path, several paths, or None.
    """
    for name in names:
        value = getattr(request, name)
        if isinstance(value, str):
            object.__setattr__(request, name, Path(value))
        elif isinstance(value, tuple | list):
            object.__setattr__(request, name, tuple(Path(each) for each in value))


_OWNER = re.compile(rb"(\d+) ([^\s]{1,255})\n")
# Position of the owner's name in the file: Windows lets nobody read the first byte, which is the locked one.
_OWNER_AT = 1
# Seconds that an owner may take from getting the lock to writing its name, and between two looks while waiting.
_PATIENCE_S = 0.2


@contextlib.contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Hold a result, file or folder, that this process is going to write; what a killed one left there is cleared away.

    Processes hold a result once: whoever calls something that holds it too must not hold it.

    Raises:
        StorageError: if another process holds it; names that process and its machine.
    """
    made = [parent for parent in path.absolute().parents if not parent.exists()]
    lock = None
    try:
        lock = _acquired(path)
        remove_leftovers(path)
        yield
    finally:
        if lock is not None:
            # The file is removed while it is still held, so that nobody can be holding it. Whoever opened it before
            # finds out that it has no name any more, and tries again with a new one. Windows removes no file that is
            # open; there it goes afterwards, unless somebody has opened it again.
            with contextlib.suppress(OSError):
                Path(lock.lock_file).unlink()
            lock.release()
            if os.name == "nt":
                with contextlib.suppress(OSError):
                    Path(lock.lock_file).unlink()
        # Folders that the lock has made go where the work has put nothing there.
        for parent in made:
            with contextlib.suppress(OSError):
                parent.rmdir()


@contextlib.contextmanager
def sole_file(path: Path) -> Iterator[Path]:
    """:func:`sole_writer` of a file that is written whole or not at all, as ``storage.atomic_path`` does.

    Raises:
        StorageError: if another process is writing it, the folder cannot be written or the disk is full.
    """
    with sole_writer(path), atomic_path(path) as temporary:
        yield temporary


@contextlib.contextmanager
def in_turn(path: Path, tell: Callable[[str], None] = lambda _: None) -> Iterator[None]:
    """:func:`sole_writer` that waits until no other process holds the result.

    Args:
        path: File or folder.
        tell: Called once for every process that is waited for, with a line that names it and its machine.
    """
    waited_for = ""
    with contextlib.ExitStack() as held:
        while True:
            try:
                held.enter_context(sole_writer(path))
                break
            except _HeldByAnotherError as refused:
                if refused.owner != waited_for:
                    waited_for = refused.owner
                    tell(f"{clean(path)}: waiting until {waited_for} has written it.")
            time.sleep(_PATIENCE_S)
        yield


def lock_file(path: Path) -> Path:
    """Return the file beside a result that is there while a process writes it, or after one was killed."""
    return path.with_name(f".{path.name}.lock")


class _HeldByAnotherError(ErrorOfParts, StorageError):
    """Another process writes there."""

    def __init__(self, path: Path, owner: str) -> None:
        self.path, self.owner = path, owner
        super().__init__(
            f"{clean(path)}: {owner} is writing there. Wait until it is through, or choose another folder or file."
        )


def _acquired(path: Path) -> FileLock | None:
    """Return the lock of a result; None where no lock can be made, as in a folder that can only be read.

    Raises:
        _HeldByAnotherError: if another process has it.
    """
    path = Path(os.path.abspath(path))  # noqa: PTH100 - a result may replace a link, whose own name counts
    for file in (lock_file(path), cache_folder() / "locks" / f"{text_digest(str(path))[:32]}.lock"):
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            # A lock that is no more than a file would outlive a killed owner, so none is better.
            lock = FileLock(file, mode=0o666, fallback_to_soft=False)
            lock.acquire(blocking=False)
        except Timeout as error:
            raise _HeldByAnotherError(path, _owner(file)) from error
        except (OSError, NotImplementedError):
            continue
        # Write down who holds a lock; a full disk costs the others this name, not us the work.
        with contextlib.suppress(OSError), open(file, "r+b", buffering=0) as opened:
            opened.seek(_OWNER_AT)
            opened.write(f"{os.getpid()} {socket.gethostname()}\n".encode())
        return lock
    return None


def _owner(file: Path) -> str:
    """Process and machine that hold a lock, for a message."""
    until = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until:
        with contextlib.suppress(OSError), open(file, "rb", buffering=0) as opened:
            opened.seek(_OWNER_AT)
            match = _OWNER.match(opened.read(300))
            if match:
                return f"process {int(match[1])} on {clean(match[2].decode(errors='replace'))}"
        time.sleep(_PATIENCE_S / 10)
    return "another process"
