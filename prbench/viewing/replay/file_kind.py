"""Which kind of file a view is written as."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from prbench.errors import MissingExtraError, StorageError, UsageError

FileKind = Literal["png", "mp4", "html"]

_PACKAGES: dict[FileKind, tuple[str, str]] = {
    "mp4": ("imageio_ffmpeg", "imageio-ffmpeg"),
    "html": ("viser", "viser"),
}
"""Import name and package that a kind needs."""


def file_kind(path: Path) -> FileKind:
    """The kind that a file's name asks for; says at once what would fail after minutes of drawing.

    Raises:
        UsageError: if it ends in something else.
        StorageError: if it is a folder.
        MissingExtraError: if a package is needed that is not installed.
    """
    kind = _kind(path)
    if path.is_dir():
        raise StorageError(f"{path}: is a folder. Choose a file for --out.")
    if kind in _PACKAGES:
        module, package = _PACKAGES[kind]
        if find_spec(module) is None:
            raise MissingExtraError(package, "view", f"writing {kind.upper()}")
    return kind


def _kind(path: Path) -> FileKind:
    match path.suffix.lower():
        case ".png":
            return "png"
        case ".mp4":
            return "mp4"
        case ".html":
            return "html"
        case suffix:
            found = f"'{suffix}'" if suffix else "no suffix"
            raise UsageError(f"{path}: expected a file that ends in .png, .mp4 or .html, found {found}.")
