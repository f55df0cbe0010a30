"""Events and recordings of a table, accepted or not, and the story of one event."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar, overload

import pyarrow as pa

from prbench.api.arguments import PathLike
from prbench.api.frames import frame_of, notebook_table
from prbench.api.pictures import Picture
from prbench.sequences import Event, Recording
from prbench.sequences.sequence import event_of, recording_of
from prbench.shown import html

if TYPE_CHECKING:
    import pandas as pd

    from prbench.viewing.event_story import EventStory

Record = TypeVar("Record")
_SHOWN_COLUMNS = ("object_name", "action", "hand", "event_time", "prime_time", "outcome", "stage", "event_id")


class _Records(Generic[Record]):
    """Rows of a table that are read one by one, in table order."""

    _read: ClassVar[Callable[[pa.Table, int], Any]]

    def __init__(self, rows: pa.Table) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return self._rows.num_rows

    def __iter__(self) -> Iterator[Record]:
        return (self[number] for number in range(len(self)))

    @overload
    def __getitem__(self, number: int) -> Record: ...
    @overload
    def __getitem__(self, number: slice) -> list[Record]: ...
    def __getitem__(self, number: int | slice) -> Record | list[Record]:
        if isinstance(number, slice):
            return [self[row] for row in range(len(self))[number]]
        if not -len(self) <= number < len(self):
            raise IndexError(f"expected a number below {len(self)}, found {number}")
        return type(self)._read(self._rows, number % len(self))

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a record, with the columns of docs/table.md.

        Vectors (``location``, ``box_min`` …) hold one array (3,) a cell, world frame, metres.
        """
        return frame_of(self._rows)


class Events(_Records[Event]):
    """All candidate events of a table, accepted or not, in table order.

    ``len(events)``, ``events[0]`` and ``for event in events`` work as with a list.
    """

    _read = staticmethod(event_of)

    def __repr__(self) -> str:
        return f"<{len(self)} events: {self._counted()}>"

    def _repr_html_(self) -> str:
        shown = frame_of(self._rows.select(list(_SHOWN_COLUMNS)))
        return notebook_table(f"{len(self)} candidate events: {self._counted()}", shown)

    def _counted(self) -> str:
        """Return how many events have each outcome, the most frequent first."""
        counts = Counter(self._rows["outcome"].to_pylist())
        ordered = sorted(counts.items(), key=lambda pair: (-pair[1], pair[0]))
        return ", ".join(f"{count} {name}" for name, count in ordered) or "none"


class Recordings(_Records[Recording]):
    """All recordings that a build found, in table order.

    ``len(recordings)``, ``recordings[0]`` and ``for recording in recordings`` work as with a list.
    """

    _read = staticmethod(recording_of)

    def __repr__(self) -> str:
        statuses = self._rows["status"].to_pylist()
        return f"<{len(self)} recordings, {statuses.count('read')} of them read>"

    def _repr_html_(self) -> str:
        return notebook_table(f"{len(self)} recordings", self.to_pandas())


@dataclass(frozen=True, eq=False, repr=False)
class Story:
    """The story of one event: how far it came through curation, and the numbers that decided."""

    _story: EventStory

    @property
    def text(self) -> str:
        """The story in lines: each stage of curation with its verdict and its numbers."""
        return self._story.text()

    @property
    def outcome(self) -> str:
        """``sequence`` if the event became one, else why not."""
        return self._story.event.outcome

    @property
    def stages(self) -> Mapping[str, str]:
        """Verdict of each stage of curation by its name: ``passed``, ``stopped here`` or ``not reached``."""
        return {stage.name: stage.verdict for stage in self._story.stages}

    @cached_property
    def picture(self) -> Picture:
        """The story as a picture; the motion is drawn if the event became a sequence."""
        return Picture(self._story.title, self._draw)

    def save(self, path: PathLike) -> Path:
        """Write the picture into a PNG file; one that exists is replaced.

        Args:
            path: The file; it ends in ``.png``.

        Returns:
            The file.

        Raises:
            UsageError: for another ending.
            StorageError: if the file cannot be written.
        """
        return self.picture.save(path)

    def _draw(self, path: Path) -> None:
        from prbench.viewing.event_story import draw_event_story

        draw_event_story(self._story, path)

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"<Story of {self._story.title}: {self.outcome}>"

    def _repr_html_(self) -> str:
        png = base64.b64encode(self.picture.png).decode("ascii")
        picture = f'<img alt="{html(self._story.title)}" style="max-width:100%" src="data:image/png;base64,{png}">'
        lines = "\n".join(html(line) for line in self.text.splitlines())  # the line breaks stay
        return f"<pre>{lines}</pre>{picture}"
