"""Write scenes as PNG, MP4 or HTML, whichever the file's name asks for."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from prbench.errors import MissingExtraError, StorageError, UsageError
from prbench.viewing.replay.scene import Progress, Scene
from prbench.viewing.replay.sheet import MOST_SCENES, draw_sheet

_PACKAGES = {".png": "", ".mp4": "imageio-ffmpeg", ".html": "viser"}
"""The kinds of files, and the package that each needs beside the required ones."""


def file_kind(path: Path) -> str:
    """Return the kind of file, ``png``, ``mp4`` or ``html``, that a path asks for.

    A command calls it first: everything that it refuses would otherwise fail after minutes of drawing.

    Raises:
        UsageError: if the path ends in something else.
        StorageError: if it is a folder.
        MissingExtraError: if a package is needed that is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in _PACKAGES:
        found = f"'{suffix}'" if suffix else "no suffix"
        raise UsageError(f"{path}: expected a file that ends in .png, .mp4 or .html, found {found}.")
    if path.is_dir():
        raise StorageError(f"{path}: is a folder. Choose a file for --out.")
    kind = suffix[1:]
    package = _PACKAGES[suffix]
    # Only looked for, not imported: whether it is there is all that is asked yet.
    if package and find_spec(package.replace("-", "_")) is None:
        raise MissingExtraError(package, "view", f"writing {kind.upper()}")
    return kind


def write_view(scenes: Sequence[Scene], path: Path, kind: str, progress: Progress) -> None:
    """Render scenes into one file.

    Args:
        scenes: Scenes to show, in order.
        path: The file; replaced when it exists.
        kind: As :func:`file_kind` returned it.
        progress: Called after every step.

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
