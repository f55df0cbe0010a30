"""Pictures and replays that show themselves below a notebook's cell and save themselves into files."""

from __future__ import annotations

import html
import tempfile
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from prbench.api.arguments import PathLike, output_file
from prbench.api.progress import progress
from prbench.errors import UsageError
from prbench.viewing.replay.scene import Scene

_REPLAY_HEIGHT = 560
"""Pixels of a replay below a cell."""


@dataclass(frozen=True, eq=False, repr=False)
class Picture:
    """A picture: a notebook shows it below the cell, :meth:`save` writes it into a file."""

    title: str
    """What is shown, in a few words."""
    _draw: Callable[[Path], object]
    """Writes the picture as PNG."""
    scenes: tuple[Scene, ...] = ()
    """What is drawn, where sequences are; a film or page can be made of them too."""

    @cached_property
    def png(self) -> bytes:
        """The picture as the bytes of a PNG file."""
        with tempfile.TemporaryDirectory(prefix="prbench-") as folder:
            path = Path(folder) / "picture.png"
            self._draw(path)
            return path.read_bytes()

    def save(self, path: PathLike) -> Path:
        """Write the picture into a file; one that exists is replaced.

        Args:
            path: The file. It ends in ``.png``; where sequences are drawn, ``.mp4`` writes a film and ``.html`` a page
                to turn and play, as ``prbench view --out`` does.

        Returns:
            The file.

        Raises:
            UsageError: for another ending.
            MissingExtraError: if a film or page is asked for without the extra ``view``.
            StorageError: if the file cannot be written.
        """
        with output_file(path) as file:
            return _save_scenes(self.scenes, file) if self.scenes else self._save_png(file)

    def _save_png(self, path: Path) -> Path:
        if path.suffix.lower() != ".png":
            raise UsageError(f"{path}: expected a file that ends in .png, found '{path.suffix}'.")
        self._draw(path)
        return path

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        return f"<Picture of {self.title}; .save('picture.png') writes it>"


@dataclass(frozen=True, eq=False, repr=False)
class Replay:
    """Motions in a 3-D view to turn and play: a notebook shows it below the cell, :meth:`save` writes it into a file.

    Needs the extra ``view`` (``pip install 'prbench[view]'``).
    """

    title: str
    """What is shown, in a few words."""
    scenes: tuple[Scene, ...] = field(repr=False)
    """The sequences, each with its motions, in the order in which they are played."""

    @cached_property
    def page(self) -> str:
        """The view as one HTML page that needs no network."""
        with tempfile.TemporaryDirectory(prefix="prbench-") as folder:
            return _save_scenes(self.scenes, Path(folder) / "replay.html").read_text(encoding="utf-8")

    def save(self, path: PathLike) -> Path:
        """Write the replay into a file; one that exists is replaced.

        Args:
            path: The file: ``.html`` is a page to turn and play, ``.mp4`` a film, ``.png`` a sheet of poses.

        Returns:
            The file.

        Raises:
            UsageError: for another ending.
            MissingExtraError: without the extra ``view``, except for a PNG.
            StorageError: if the file cannot be written.
        """
        with output_file(path) as file:
            return _save_scenes(self.scenes, file)

    def _repr_html_(self) -> str:
        # The page of a viewer brings styles and scripts of its own, so it gets a frame of its own.
        page = html.escape(self.page, quote=True)
        return f'<iframe srcdoc="{page}" width="100%" height="{_REPLAY_HEIGHT}" style="border:none"></iframe>'

    def __repr__(self) -> str:
        return f"<Replay of {self.title}; .save('replay.html') writes it>"


def _save_scenes(scenes: tuple[Scene, ...], path: Path) -> Path:
    from prbench.viewing.replay.write import file_kind, write_view

    kind = file_kind(path)
    with progress(f"drawing {path.name}") as show:
        write_view(scenes, path, kind, show)
    return path


def picture_of(scenes: tuple[Scene, ...]) -> Picture:
    """Return the sheet of some sequences: poses over time, the way from above, distances from the goal, and scores.

    Args:
        scenes: What is drawn, from top to bottom.
    """
    return Picture(_titles(scenes), lambda path: _save_scenes(scenes, path), scenes)


def replay_of(scenes: tuple[Scene, ...]) -> Replay:
    """Return the 3-D view of some sequences, one after another.

    Args:
        scenes: What is played.

    Raises:
        MissingExtraError: if the extra ``view`` is not installed.
    """
    from prbench.viewing.replay.write import file_kind

    file_kind(Path("replay.html"))  # asks for the package before anything is drawn
    return Replay(_titles(scenes), scenes)


def _titles(scenes: Collection[Scene]) -> str:
    first = next(iter(scenes)).title
    return first if len(scenes) == 1 else f"{len(scenes)} sequences, first {first}"
