"""Write scenes as PNG, MP4 or HTML, whichever the file's name asks for."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from prbench.errors import MissingExtraError, StorageError, UsageError
from prbench.viewing.replay.scene import Progress, Scene
from prbench.viewing.replay.sheet import MOST_SCENES, draw_sheet

_FileKind = Literal["png", "mp4", "html"]

_PACKAGES: dict[_FileKind, tuple[str, str]] = {
    "mp4": ("imageio_ffmpeg", "imageio-ffmpeg"),
    "html": ("viser", "viser"),
}
"""Import name and package that a kind needs."""


def file_kind(path: Path) -> _FileKind:
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


def _kind(path: Path) -> _FileKind:
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


def write_view(scenes: Sequence[Scene], path: Path, kind: _FileKind, progress: Progress) -> None:
    """Render scenes into one file.

    Args:
        scenes: What to show, in order.
        path: The file; replaced when it exists.
        kind: Of the file.
        progress: Called with finished steps, all steps, and what was finished last.

    Raises:
        UsageError: if a PNG would become too large.
        StorageError: if the file cannot be written.
    """
    if kind == "png":
        if len(scenes) > MOST_SCENES:
            raise UsageError(f"{path}: expected at most {MOST_SCENES} sequences in one PNG, found {len(scenes)}.")
        draw_sheet(scenes, path, progress=progress)
    elif kind == "mp4":
        from prbench.viewing.replay.film import film_scenes

        film_scenes(scenes, path, progress)
    else:
        from prbench.viewing.replay.page import write_page

        write_page(scenes, path, progress)
