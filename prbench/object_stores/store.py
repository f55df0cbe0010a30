"""Object stores: their URLs, their objects, and the manifest by which a folder in them is whole or not there."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import importlib.util
import json
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

import msgspec

from prbench.errors import InputFileError, MissingExtraError, PrbenchError, StorageError, UsageError
from prbench.files import storage
from prbench.files.bounded import foreign_input
from prbench.limits import LARGEST_JSON
from prbench.shown import clean, quoted

_URL = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]+(::[^/]*)?://")
# How ``pathlib.Path`` spells the URL of a store: it makes one slash of two.
_SWALLOWED = re.compile(r"(s3a?|gs|gcs|az|abfss?|hf|https?|memory):/(?!/)")
# Protocols that write ``container@account`` where others write ``user:password@host``.
_ACCOUNT_BEHIND_AT = frozenset({"abfs", "abfss", "az"})


def is_url(text: object) -> bool:
    """Return True for text such as ``s3://bucket/folder``; paths of this machine are none.

    Raises:
        UsageError: for a URL that went through :class:`pathlib.Path`, which makes one slash of two.
    """
    if isinstance(text, Path):
        text = str(text)
        if _SWALLOWED.match(text):
            raise UsageError(f"{clean(text)}: give a URL as text, not as a Path, which makes one slash of two.")
        return False
    return isinstance(text, str) and _URL.match(text) is not None


@dataclass(frozen=True)
class StoreUrl:
    """The URL of a folder or file, without anything secret.

    Args:
        text: The URL, without a slash at the end.
    """

    text: str

    @classmethod
    def parse(cls, text: str) -> StoreUrl:
        """Check a URL.

        Raises:
            UsageError: if it holds a password, a query or a fragment, chains protocols, or names nothing; what might be
                secret is not repeated.
        """
        protocol, _, rest = text.partition("://")
        server, slash, path = rest.partition("/")
        # The container of abfs stands where the password might.
        place = re.split(r"[?#]", server.rpartition("@")[2] + slash + path)[0]
        shown = f"{clean(protocol)}://{quoted(place)}"
        if "::" in protocol:
            raise UsageError(f"{shown}: expected one protocol, found several joined by '::'.")
        if ("@" in server and protocol not in _ACCOUNT_BEHIND_AT) or ":" in server.rpartition("@")[0]:
            own = "from its environment variables and files (docs/object-stores.md#credentials)."
            remedy = f"Leave it out: credentials are those of the protocol's own library, {own}"
            raise UsageError(f"{shown}: the URL holds a name or a password. {remedy}")
        if "?" in rest or "#" in rest:
            why = "credentials come from the environment (docs/object-stores.md#credentials)."
            expected = "expected a URL without '?' and '#', which could hold a token"
            raise UsageError(f"{shown}: {expected}. Leave what follows out: {why}")
        if not rest.strip("/") or any(part in (".", "..") for part in rest.split("/")):
            raise UsageError(f"{shown}: expected a bucket and a folder or file, such as s3://bucket/folder.")
        return cls(text.rstrip("/"))

    def __str__(self) -> str:
        return clean(self.text)

    @property
    def protocol(self) -> str:
        """What stands before ``://``."""
        return self.text.partition("://")[0]

    @property
    def name(self) -> str:
        """Last part of the path, as the name of a local folder or file."""
        name = self.text.rpartition("/")[2]
        return name if storage.is_path_part(name) else "copy"

    @property
    def parent(self) -> StoreUrl:
        """The URL one level up."""
        return StoreUrl(self.text.rpartition("/")[0])

    @property
    def cache(self) -> Path:
        """Folder of the local copies of what lies there."""
        return storage.cache_folder() / "object-stores" / storage.text_digest(self.text)[:32]


# Environment variable that tells the processes that a command starts: JSON, from URLs to local copies. They write there
# and leave the uploading to the command.
VARIABLE = "PRBENCH_LOCAL_COPIES"


def opened_elsewhere(text: str) -> Path | None:
    """Return the local copy of a URL that is worked on already; None for any other."""
    copies = _copies()
    return Path(copies[text]) if text in copies else None


@contextlib.contextmanager
def opened(text: str, path: Path) -> Iterator[None]:
    """Tell the processes that the block starts about a local copy."""
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = json.dumps({**_copies(), text: str(path)})
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(VARIABLE, None)
        else:
            os.environ[VARIABLE] = before


def _copies() -> dict[str, str]:
    return json.loads(os.environ.get(VARIABLE) or "{}")


# Bytes that are asked for at once.
_BLOCK = 8 * 2**20
# Attempts at reading a small object that is being replaced again and again.
_TRIES = 5
# Keys of an object's description that change with its content, the best first; each protocol has its own.
_OF_VERSION = ("ETag", "etag", "md5Hash", "content_md5", "sha", "LastModified", "updated", "last_modified", "mtime")
_DENIED = re.compile(
    r"credential|access ?denied|forbidden|unauthori[sz]ed|signature|access ?key|token|authentication|\b40[13]\b", re.I
)
_OF_THIS_DISK = {errno.ENOSPC, errno.EROFS, getattr(errno, "EDQUOT", errno.ENOSPC)}
# Query of a URL in a library's message; it may hold a signature.
_QUERY = re.compile(r"\?\S+")


class ObjectStoreError(StorageError):
    """An object store cannot be reached, refuses access, or lost the connection."""


@dataclass(frozen=True)
class StoredObject:
    """One object below a URL.

    Attributes:
        name: Path relative to the URL.
        size: Bytes.
        version: Changes with the content; empty where the store tells nothing of the kind.
    """

    name: str
    size: int
    version: str


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
            raise MissingExtraError(f"of its protocol ({quoted(error)})", "remote", str(self.url)) from error
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
                content = self._read(name, largest + 1)
        except FileNotFoundError:
            return None
        if len(content) > largest:
            raise InputFileError(f"{self.url}/{name}", "", expected=f"at most {largest:,} bytes", found="more")
        return content

    def _read(self, name: str, length: int, tries: int = _TRIES) -> bytes:
        """Read the first bytes of an object, again where a writer has replaced it between opening and reading."""
        try:
            with self._system.open(self._path(name), "rb", block_size=_BLOCK) as file:
                return file.read(length)
        except OSError as error:
            if error.errno != errno.EBUSY or tries == 1:  # s3fs means by it that the object is another one now
                raise
        return self._read(name, length, tries - 1)

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
            with (
                storage.atomic_path(target) as temporary,
                open(temporary, "wb") as written,
                self._errors(f"read {name}"),
            ):
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
        except (FileNotFoundError, NotADirectoryError, FileExistsError) as error:  # or a file in place of a folder
            if not absent:
                raise FileNotFoundError(*error.args) from error
            raise ObjectStoreError(f"{self.url}: cannot {doing}: {absent}. Make it, or correct the URL.") from error
        except Exception as error:  # each protocol has a library with errors of its own, most of them no OSError
            if isinstance(error, OSError) and error.errno in _OF_THIS_DISK:
                raise  # whoever writes the local file tells that
            reason = _QUERY.sub("", str(error) or type(error).__name__)
            if isinstance(error, PermissionError) or _DENIED.search(f"{type(error).__name__} {reason}"):
                rights = "the rights of their account (docs/object-stores.md#credentials)"
                remedy = f"Check the credentials of the protocol's library and {rights}."
                denied = f"access is denied ({quoted(reason)})"
                raise ObjectStoreError(f"{self.url}: cannot {doing}: {denied}. {remedy}") from error
            why = f"the store cannot be reached, or the connection was lost ({quoted(reason)})"
            remedy = "Is the endpoint right (AWS_ENDPOINT_URL for s3), and the store running?"
            told = f"{self.url}: cannot {doing}: {why}. {remedy}"
            raise ObjectStoreError(f"{told} Then run the same command again.") from error


def _described(name: str, found: dict[str, Any]) -> StoredObject:
    version = next((str(found[key]) for key in _OF_VERSION if found.get(key) is not None), "")
    return StoredObject(name, int(found["size"]), version)


def _other(shown: str, expected: str, found: str) -> InputFileError:
    remedy = "It was changed or cut while it lay there; run the same command again, or write the folder again."
    return InputFileError(shown, "", expected=expected, found=found, remedy=remedy)


# Name of the manifest of a finished folder.
FINISHED = "prbench-manifest.json"
# Name of the manifest of what an unfinished command has uploaded.
UNFINISHED = "prbench-unfinished.json"
# Names of objects that are no file of the folder: intermediate parts, and files beside an older one of their name.
OWN_PREFIX = ".prbench/"
WORK_PREFIX = f"{OWN_PREFIX}work/"
_VERSION = 1


class StoredFile(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One file of a folder.

    Attributes:
        size: Bytes.
        object: Name of the object that holds it, relative to the URL; None for the file's own name.
    """

    size: int
    sha256: str
    object: str | None = None


class FolderManifest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """All files of a folder.

    Attributes:
        files: Maps paths relative to the folder to files.
        writer: Drawn by each command that writes; tells two at once apart. None in a finished folder.
        begun_from: Digest of the finished manifest that stood there when the command began; empty for none.
    """

    schema_version: int
    files: dict[str, StoredFile]
    writer: str | None = None
    begun_from: str | None = None

    @classmethod
    def of(cls, files: Mapping[str, StoredFile]) -> FolderManifest:
        """Return the manifest of a finished folder."""
        return cls(schema_version=_VERSION, files=dict(sorted(files.items())))

    def encoded(self) -> bytes:
        """Return the bytes of the manifest; equal manifests give equal bytes."""
        return msgspec.json.format(msgspec.json.encode(self, order="sorted"), indent=2) + b"\n"

    @property
    def digest(self) -> str:
        """SHA-256 of the manifest."""
        return storage.bytes_digest(self.encoded())

    def object_of(self, name: str) -> str:
        """Name of the object that holds a file."""
        return self.files[name].object or name

    @property
    def objects(self) -> dict[str, str]:
        """Maps the name of each object to its digest."""
        return {self.object_of(name): file.sha256 for name, file in self.files.items()}


@foreign_input()
def decode_manifest(content: bytes, shown: str) -> FolderManifest:
    """Check a manifest that was read at a URL.

    Args:
        content: Its bytes.
        shown: Its URL, for messages.

    Raises:
        InputFileError: if it is no manifest, of another version, or a name in it leads out of the folder.
    """
    try:
        manifest = msgspec.json.decode(content, type=FolderManifest)
    except (msgspec.ValidationError, msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputFileError(shown, "", expected="a manifest of prbench", found=str(error)) from error
    if manifest.schema_version != _VERSION:
        found = f"version {manifest.schema_version}"
        raise InputFileError(shown, "", expected=f"version {_VERSION}", found=found, remedy="Update prbench.")
    for name, file in manifest.files.items():
        for path in (name, file.object or name):
            if not stays_inside(path):
                found = f"{path}, which may lead out of it"
                raise InputFileError(shown, name, expected="a path inside this folder", found=found)
        if file.size < 0 or len(file.sha256) != 64:
            raise InputFileError(shown, name, expected="a size and a SHA-256", found=f"{file.size} and {file.sha256}")
    return manifest


def stays_inside(name: str) -> bool:
    """Return True if a relative path stays in its folder, on every system, and can be shown."""
    path = PurePosixPath(name)
    parts_are_plain = path.as_posix() == name and ".." not in path.parts and not path.is_absolute()
    return bool(path.parts) and parts_are_plain and not set(name) & set("\\:") and clean(name) == name


LARGEST_MANIFEST = LARGEST_JSON


def describe(folder: Path) -> FolderManifest:
    """Write the manifest of all files in a folder into it.

    Args:
        folder: The folder; hidden files and folders are left out.

    Raises:
        InputFileError: if it is no folder.
        StorageError: if it cannot be written.
    """
    if not folder.is_dir():
        raise InputFileError(folder, "", expected="a folder", found="none")
    files = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != FINISHED and not any(part.startswith(".") for part in name.split("/")):
            files[name] = StoredFile(size=path.stat().st_size, sha256=storage.file_digest(path))
    manifest = FolderManifest.of(files)
    storage.write_bytes(folder / FINISHED, manifest.encoded())
    return manifest


if __name__ == "__main__":
    for each in sys.argv[1:]:
        describe(Path(each))
