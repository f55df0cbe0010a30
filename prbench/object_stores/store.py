"""Objects below one URL, read and written through fsspec; what goes wrong there gets one clear line."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import importlib.util
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from prbench.errors import ErrorOfParts, InputFileError, MissingExtraError, PrbenchError, StorageError, UsageError
from prbench.files.storage import atomic_path
from prbench.object_stores.urls import StoreUrl
from prbench.shown import quoted

_BLOCK = 8 * 2**20
"""Bytes that are asked for at once."""
_TRIES = 5
"""Attempts at reading a small object that is being replaced again and again."""
_OF_VERSION = ("ETag", "etag", "md5Hash", "content_md5", "sha", "LastModified", "updated", "last_modified", "mtime")
"""Keys of an object's description that change with its content, the best first; each protocol has its own."""
_DENIED = re.compile(
    r"credential|access ?denied|forbidden|unauthori[sz]ed|signature|access ?key|token|authentication|\b40[13]\b", re.I
)
_OF_THIS_DISK = {errno.ENOSPC, errno.EROFS, getattr(errno, "EDQUOT", errno.ENOSPC)}
_QUERY = re.compile(r"\?\S+")
"""Query of a URL in a library's message; it may hold a signature."""


class ObjectStoreError(StorageError):
    """An object store cannot be reached, refuses access, or lost the connection."""


class ProtocolPackageError(ErrorOfParts):
    """The package that knows a URL's protocol is not installed.

    Args:
        url: The URL.
        reason: What fsspec says, which names the package.
    """

    exit_code = MissingExtraError.exit_code

    def __init__(self, url: str, reason: str) -> None:
        self.url, self.reason = url, reason
        super().__init__(f"{url}: its protocol needs a package that is not installed: {reason}")


@dataclass(frozen=True)
class StoredObject:
    """One object below a URL."""

    name: str
    """Path relative to the URL."""
    size: int
    """Bytes."""
    version: str
    """Changes with the content; empty where the store tells nothing of the kind."""


@dataclass(frozen=True)
class Store:
    """Everything below one URL; names are relative to it, and the empty name is the URL itself."""

    url: StoreUrl

    @cached_property
    def _opened(self) -> tuple[Any, str]:
        """Fsspec's file system and the URL's path in it; a new one, as a kept one would keep an old endpoint."""
        if importlib.util.find_spec("fsspec") is None:
            raise MissingExtraError("fsspec", "remote", str(self.url))
        import fsspec

        try:
            system = fsspec.filesystem(self.url.protocol, skip_instance_cache=True, use_listings_cache=False)
            return system, system._strip_protocol(self.url.text)
        except ImportError as error:
            if self.url.protocol in ("s3", "s3a"):
                raise MissingExtraError("s3fs", "remote", str(self.url)) from error
            raise ProtocolPackageError(str(self.url), quoted(error)) from error
        except ValueError as error:
            raise UsageError(f"{self.url}: expected a protocol that fsspec knows, such as s3://: {error}.") from error

    @property
    def _system(self) -> Any:
        return self._opened[0]

    def _path(self, name: str) -> str:
        return f"{self._opened[1]}/{name}" if name else self._opened[1]

    def read(self, name: str, *, largest: int) -> bytes | None:
        """Read a small object; None if there is none.

        Raises:
            InputFileError: if it is larger than it may be.
            ObjectStoreError: if the store cannot be read.
        """
        try:
            with self._errors(f"read {name}"):
                content = self._beginning(name, largest + 1)
        except FileNotFoundError:
            return None
        if len(content) > largest:
            raise InputFileError(f"{self.url}/{name}", "", expected=f"at most {largest:,} bytes", found="more")
        return content

    def _beginning(self, name: str, length: int) -> bytes:
        """Read the first bytes of an object, again where a writer has replaced it between opening and reading."""
        for _ in range(_TRIES - 1):
            try:
                return self._opened_and_read(name, length)
            except OSError as error:
                if error.errno != errno.EBUSY:  # s3fs means by it that the object is another one now
                    raise
        return self._opened_and_read(name, length)

    def _opened_and_read(self, name: str, length: int) -> bytes:
        with self._system.open(self._path(name), "rb", block_size=_BLOCK) as file:
            return file.read(length)

    def write(self, name: str, content: bytes) -> None:
        """Write a small object, whole or not at all.

        Raises:
            ObjectStoreError: if it cannot be written.
        """
        with self._errors(f"write {name}", absent="there is no such bucket"):
            self._system.pipe_file(self._path(name), content)

    def upload(self, path: Path, name: str) -> None:
        """Write a local file as an object, whole or not at all.

        Raises:
            ObjectStoreError: if it cannot be written.
            FileNotFoundError: if the local file has vanished.
        """
        path.stat()
        with self._errors(f"write {name}", absent="there is no such bucket"):
            self._system.put_file(str(path), self._path(name))

    def remove(self, names: Iterable[str]) -> None:
        """Delete objects; those that are not there are passed over.

        Raises:
            ObjectStoreError: if the store refuses.
        """
        for name in names:
            with contextlib.suppress(FileNotFoundError), self._errors(f"delete {name}"):
                self._system.rm_file(self._path(name))

    def download(self, name: str, target: Path, *, size: int, sha256: str | None = None) -> None:
        """Copy an object into a file, whole or not at all.

        Args:
            name: The object.
            target: The file.
            size: Its size, bytes. An object of another size is refused before it is read, and reading stops there.
            sha256: Its digest; not checked where it is not known.

        Raises:
            InputFileError: if the object is missing, or has another size or digest.
            ObjectStoreError: if the connection is lost.
        """
        shown = self.url.text if not name else f"{self.url}/{name}"
        digest = hashlib.sha256()
        try:
            with atomic_path(target) as temporary, open(temporary, "wb") as written, self._errors(f"read {name}"):
                with self._system.open(self._path(name), "rb", block_size=_BLOCK) as file:
                    there = getattr(file, "size", None)
                    if there is not None and there != size:
                        raise _other(shown, f"{size:,} bytes", f"{there:,}")
                    left = size
                    while block := file.read(min(_BLOCK, left + 1)):
                        left -= len(block)
                        if left < 0:
                            raise _other(shown, f"{size:,} bytes", "more")
                        digest.update(block)
                        written.write(block)
                if left:
                    raise _other(shown, f"{size:,} bytes", f"{size - left:,}")
                if sha256 is not None and digest.hexdigest() != sha256:
                    raise _other(shown, f"the SHA-256 {sha256}", digest.hexdigest())
        except FileNotFoundError as error:
            raise _other(shown, "this object", "none") from error

    def describe(self) -> StoredObject | None:
        """Describe the object at the URL itself; None if there is none."""
        try:
            with self._errors("read"):
                found = self._system.info(self._path(""))
        except FileNotFoundError:
            return None
        return _described("", found) if found["type"] == "file" else None

    def is_empty(self) -> bool:
        """Return True if nothing lies below the URL.

        Raises:
            ObjectStoreError: if the store cannot be read, or the bucket does not exist.
        """
        top = self._path("")
        try:
            with self._errors("list"):
                found = self._system.ls(top, detail=False)
        except FileNotFoundError as error:
            if "bucket" in str(error).lower():
                raise ObjectStoreError(f"{self.url}: there is no such bucket. Make it, or correct the URL.") from error
            return True
        return not {str(path).strip("/") for path in found} - {top.strip("/")}  # consoles make an object of a folder

    def listing(self) -> list[StoredObject]:
        """List everything below the URL, sorted by name; an empty list for nothing.

        Raises:
            ObjectStoreError: if the store cannot be read.
        """
        top = self._path("")
        try:
            with self._errors("list"):
                found = self._system.find(top, detail=True)
        except FileNotFoundError:
            return []
        names = {path[len(top) :].lstrip("/"): each for path, each in found.items() if path.startswith(f"{top}/")}
        return [_described(name, each) for name, each in sorted(names.items()) if each.get("type", "file") == "file"]

    @contextlib.contextmanager
    def _errors(self, doing: str, *, absent: str = "") -> Iterator[None]:
        """Turn what any protocol's library raises into one line, but for an object that is not there.

        Raises:
            FileNotFoundError: as it came, unless ``absent`` says what it means here.
            ObjectStoreError: for everything else.
        """
        try:
            yield
        except PrbenchError:
            raise
        except (
            FileNotFoundError,
            NotADirectoryError,
            FileExistsError,
        ) as error:  # a file where a folder was looked for
            if not absent:
                raise FileNotFoundError(*error.args) from error
            raise ObjectStoreError(f"{self.url}: cannot {doing}: {absent}. Make it, or correct the URL.") from error
        except OSError as error:
            if error.errno in _OF_THIS_DISK:  # whoever writes the local file tells that
                raise
            raise self._told(doing.strip(), error) from error
        except Exception as error:  # each protocol has a library with errors of its own, most of them no OSError
            raise self._told(doing.strip(), error) from error

    def _told(self, doing: str, error: Exception) -> ObjectStoreError:
        reason = _QUERY.sub("", str(error) or type(error).__name__)
        denied = isinstance(error, PermissionError) or _DENIED.search(f"{type(error).__name__} {reason}")
        reason = quoted(reason)
        if denied:
            return ObjectStoreError(
                f"{self.url}: cannot {doing}: access is denied ({reason}). Check the credentials of the protocol's"
                " library and the rights of their account (docs/object-stores.md#credentials)."
            )
        return ObjectStoreError(
            f"{self.url}: cannot {doing}: the store cannot be reached, or the connection was lost ({reason}). Is the"
            " endpoint right (AWS_ENDPOINT_URL for s3), and the store running? Then run the same command again."
        )


def _described(name: str, found: dict[str, Any]) -> StoredObject:
    version = next((str(found[key]) for key in _OF_VERSION if found.get(key) is not None), "")
    return StoredObject(name, int(found["size"]), version)


def _other(shown: str, expected: str, found: str) -> InputFileError:
    remedy = "It was changed or cut while it lay there; run the same command again, or write the folder again."
    return InputFileError(shown, "", expected=expected, found=found, remedy=remedy)
