"""Pictures and replays that show themselves below a notebook's cell and save themselves into files.

Rows as pandas frames, and frames as the tables that a notebook shows.

Progress of long work: a bar in a terminal or below a notebook's cell, and nothing anywhere else.
"""

from __future__ import annotations

import base64
import contextlib
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pyarrow as pa

from prbench.api.arguments import PathLike, output_file
from prbench.progress_bar import ProgressCallback, progress_bar
from prbench.sequences.sequence import row_values
from prbench.shown import html
from prbench.viewing.replay.scene import Scene

if TYPE_CHECKING:
    import pandas as pd


# Pixels of a replay below a cell, and bytes of motions in it.
_REPLAY_HEIGHT = 640
_LARGEST_IN_A_CELL = 4_000_000


@dataclass(frozen=True, eq=False, repr=False)
class Picture:
    """A picture: a notebook shows it below the cell, :meth:`save` writes it into a file.

    Attributes:
        title: What is shown, in a few words.
        _draw: Writes the picture as PNG.
        scenes: What is drawn, where sequences are; a film or page can be made of them too.
    """

    title: str
    _draw: Callable[[Path], object]
    scenes: tuple[Scene, ...] = ()
    _example: ClassVar[str] = "picture.png"

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
            path: The file, ``.png``, ``.svg`` or ``.pdf``. Where sequences are drawn, ``.mp4`` writes a film and
                ``.html`` a page to turn and play, as ``prbench view --out`` does; all sequences stand in it.

        Returns:
            The file.

        Raises:
            UsageError: for another ending.
            MissingExtraError: if a film is asked for without the extra ``view``.
            StorageError: if the file cannot be written.
        """
        from prbench.viewing.figures import require_drawable

        with output_file(path) as file:
            if self.scenes:
                return _save_scenes(self.scenes, file)
            require_drawable(file)
            self._draw(file)
            return file

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.title}; .save('{self._example}') writes it>"


@dataclass(frozen=True, eq=False, repr=False)
class Replay(Picture):
    """Motions in a player to turn and play: a notebook shows it below the cell, :meth:`save` writes it into a file."""

    _example: ClassVar[str] = "replay.html"

    @cached_property
    def page(self) -> str:
        """The player as one HTML page that needs no network; the first sequences, as many as a notebook should hold."""
        from prbench.viewing.player.document import player_sequence, within
        from prbench.viewing.player.page import page_text

        return page_text(within(map(player_sequence, self.scenes), _LARGEST_IN_A_CELL), self.title)

    def _repr_html_(self) -> str:
        # The frame is a page of its own, which cannot reach the notebook. Where a site takes frames out, as GitHub
        # does, the picture behind it is seen.
        shown = "position:absolute;top:0;left:0;width:100%;height:100%;border:none;background:white"
        frame = (
            f'<iframe sandbox="allow-scripts allow-downloads" srcdoc="{escape(self.page)}" style="{shown}"></iframe>'
        )
        source = f"data:image/png;base64,{base64.b64encode(self.png).decode()}"
        picture = f'<img alt="{html(self.title)}" style="max-width:100%;max-height:100%" src="{source}">'
        return f'<div style="position:relative;height:{_REPLAY_HEIGHT}px">{picture}{frame}</div>'


def _save_scenes(scenes: tuple[Scene, ...], path: Path) -> Path:
    from prbench.viewing.view import file_kind, write_view

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
    """Return the player of some sequences.

    Args:
        scenes: What its menu offers.
    """
    return Replay(_titles(scenes), lambda path: _save_scenes(scenes, path), scenes)


def _titles(scenes: Collection[Scene]) -> str:
    first = next(iter(scenes)).title
    return first if len(scenes) == 1 else f"{len(scenes)} sequences, first {first}"


_SHOWN_ROWS = 20


def frame_of(table: pa.Table) -> pd.DataFrame:
    """Return an Arrow table as a pandas frame.

    A column of vectors holds one read-only array a cell; a missing value is None, NaN or NaT, as pandas has it.

    Args:
        table: Rows with plain values and vectors of a fixed size.
    """
    import pandas as pd

    columns = {}
    for name in table.column_names:
        column = table[name]
        if pa.types.is_fixed_size_list(column.type):
            columns[name] = pd.Series(row_values(column.combine_chunks()), dtype=object)
        else:
            columns[name] = column.to_pandas()
    return pd.DataFrame(columns, columns=pd.Index(table.column_names))


def frozen(array: np.ndarray) -> np.ndarray:
    """Make an array read-only and return it.

    Args:
        array: An array that nobody else holds.
    """
    array.setflags(write=False)
    return array


def frame_from_rows(rows: Iterable[tuple], columns: Iterable[str]) -> pd.DataFrame:
    """Return rows as a pandas frame that has its columns without a row, too.

    Args:
        rows: The values of each row.
        columns: Names of the columns, in their order.
    """
    import pandas as pd

    return pd.DataFrame(list(rows), columns=pd.Index(list(columns)))


def notebook_table(title: str, frame: pd.DataFrame, remarks: Iterable[str] = ()) -> str:
    """Return what a notebook shows of an object: a line, a table and further lines.

    Args:
        title: The line above.
        frame: The table; pandas leaves out its middle where it is long.
        remarks: Lines below.
    """
    below = "".join(f"<p>{html(remark)}</p>" for remark in remarks)
    table = frame.to_html(
        index=False, max_rows=_SHOWN_ROWS, na_rep="", border=0, justify="left", float_format="{:.2f}".format
    )
    return f"<p><b>{html(title)}</b></p>{table}{below}"


# A notebook redraws its page for every update, which would take longer than the work itself.
_SECONDS_BETWEEN_UPDATES = 0.2


@contextlib.contextmanager
def progress(description: str) -> Iterator[ProgressCallback]:
    """Show the progress of one piece of work while the block runs; the bar is gone afterwards.

    Args:
        description: What is being done, in a few words.
    """
    # In a Jupyter kernel IPython is there already; it is never imported for this question.
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if getattr(shell, "kernel", None) is not None:
        from IPython.display import HTML, display  # type: ignore[import-not-found] - there in a notebook alone

        handle = display(HTML(_bar(description, 0, 0, "")), display_id=True)
        assert handle is not None, "a display with an id can be updated"
        shown_at = time.monotonic()

        def update(done: int, total: int, last: str) -> None:
            nonlocal shown_at
            now = time.monotonic()
            if now - shown_at >= _SECONDS_BETWEEN_UPDATES:
                shown_at = now
                handle.update(HTML(_bar(description, done, total, last)))

        try:
            yield update
        finally:
            handle.update(HTML(""))
    elif sys.stderr is not None and sys.stderr.isatty():
        from rich.console import Console

        with progress_bar(description, Console(stderr=True)) as callback:
            yield callback
    else:
        yield _silent


def _silent(done: int, total: int, last: str) -> None:
    """Say nothing: a script's output and a log belong to whoever wrote the script."""


def _bar(description: str, done: int, total: int, last: str) -> str:
    bar = f'<progress value="{done}" max="{total}"></progress>' if total else "<progress></progress>"
    count = f" {done}/{total}" if total else ""
    return f"<div>{html(description)} {bar}{count} {html(last)}</div>"
