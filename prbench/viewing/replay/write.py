"""Write scenes as the kind of file that was asked for; the writers of MP4 and HTML are imported when used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from prbench.errors import UsageError
from prbench.viewing.replay.file_kind import FileKind
from prbench.viewing.replay.scene import Scene
from prbench.viewing.replay.sheet import MOST_SCENES, draw_sheet

Progress = Callable[[int, int, str], None]


def write_view(scenes: Sequence[Scene], path: Path, kind: FileKind, progress: Progress) -> None:
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
