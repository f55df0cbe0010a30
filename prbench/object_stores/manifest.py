"""The manifest of a folder at a URL: names, sizes and digests of its files, written last.

Files of an earlier manifest are never overwritten. Whoever reads while a folder is written again finds the earlier
files under the earlier manifest, or all new ones under the new one.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath

import msgspec

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input
from prbench.files.storage import bytes_digest
from prbench.limits import LARGEST_JSON
from prbench.shown import clean

FINISHED = "prbench-manifest.json"
"""Name of the manifest of a finished folder."""
UNFINISHED = "prbench-unfinished.json"
"""Name of the manifest of what an unfinished command has uploaded."""
OWN_PREFIX = ".prbench/"
"""Names of objects that are no file of the folder: intermediate parts, and files beside an older one of their name."""
WORK_PREFIX = f"{OWN_PREFIX}work/"
_VERSION = 1


class StoredFile(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One file of a folder."""

    size: int
    """Bytes."""
    sha256: str
    object: str | None = None
    """Name of the object that holds it, relative to the URL; None for the file's own name."""


class FolderManifest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """All files of a folder."""

    schema_version: int
    files: dict[str, StoredFile]
    """By path relative to the folder."""
    writer: str | None = None
    """Drawn by each command that writes; tells two at once apart. None in a finished folder."""
    begun_from: str | None = None
    """Digest of the finished manifest that stood there when the command began; empty for none."""
    coming: tuple[str, ...] = ()
    """Objects that are being uploaded, and belong to nothing yet."""

    @classmethod
    def of(cls, files: Mapping[str, StoredFile]) -> FolderManifest:
        """The manifest of a finished folder."""
        return cls(schema_version=_VERSION, files=dict(sorted(files.items())))

    def encoded(self) -> bytes:
        """Return the bytes of the manifest; equal manifests give equal bytes."""
        return msgspec.json.format(msgspec.json.encode(self, order="sorted"), indent=2) + b"\n"

    @property
    def digest(self) -> str:
        """SHA-256 of the manifest."""
        return bytes_digest(self.encoded())

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
                raise InputFileError(
                    shown, name, expected="a path inside this folder", found=f"{path}, which may lead out of it"
                )
        if file.size < 0 or len(file.sha256) != 64:
            raise InputFileError(shown, name, expected="a size and a SHA-256", found=f"{file.size} and {file.sha256}")
    return manifest


def stays_inside(name: str) -> bool:
    """Return True if a relative path stays in its folder, on every system, and can be shown."""
    path = PurePosixPath(name)
    parts_are_plain = path.as_posix() == name and ".." not in path.parts and not path.is_absolute()
    return bool(path.parts) and parts_are_plain and not set(name) & set("\\:") and clean(name) == name


LARGEST_MANIFEST = LARGEST_JSON
