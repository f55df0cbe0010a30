"""Events and recordings of a table, accepted or not, and the story of one event."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from prbench.api.arguments import PathLike
from prbench.api.frames import frame_of, frozen, notebook_table
from prbench.api.pictures import Picture
from prbench.errors import UsageError
from prbench.sequences.schema import OUTCOMES
from prbench.shown import html

if TYPE_CHECKING:
    import pandas as pd

    from prbench.viewing.event_story import EventStory

_SHOWN_COLUMNS = ("object_name", "action", "hand", "event_time", "prime_time", "outcome", "stage", "event_id")


@dataclass(frozen=True, eq=False, repr=False)
class Event:
    """One candidate event, an object picked or put, and what became of it; world frame, metres, seconds."""

    event_id: str
    """Dataset, recording, object, action and native time, joined by slashes."""
    recording_id: str
    """Name of the recording."""
    sequence_id: str | None
    """Id of the sequence that the event became; None if it was dropped."""
    object_id: str
    """The dataset's own id of the object."""
    object_name: str
    """The dataset's name of the object."""
    action: str
    """``pick`` or ``put``."""
    hand: str | None
    """The hand that reaches, ``left`` or ``right``; None where nothing decides."""
    hand_source: str | None
    """What told the hand (docs/table.md#which-hand-reached); None where the hand is unknown."""
    event_time: float
    """Time of the pick or put, seconds on the recording's clock."""
    prime_time: float | None
    """Time of the first look at the object's place, seconds on the recording's clock; None if there was none."""
    prime_kind: str | None
    """How gaze met the place: ``hit``, ``near_miss`` or ``published``; None if it did not."""
    location: Float[np.ndarray, "3"] | None
    """Centre of the object's box, world frame, metres; None where the object could not be placed."""
    box_min: Float[np.ndarray, "3"] | None
    """Lower end of the box along x, y and z, world frame, metres; None where the object could not be placed."""
    box_max: Float[np.ndarray, "3"] | None
    """Upper end of the box along x, y and z, world frame, metres; None where the object could not be placed."""
    outcome: str
    """``sequence`` if it became one, else why not (docs/table.md#events)."""
    stage: str
    """The stage of curation that decided."""
    value: float | None
    """The number that decided."""
    threshold: float | None
    """What the number was compared with."""
    left_wrist: Float[np.ndarray, "3"] | None
    """The left wrist at the event, world frame, metres; None where nothing measured it."""
    right_wrist: Float[np.ndarray, "3"] | None
    """The right wrist at the event, world frame, metres; None where nothing measured it."""
    published_priming: str | None
    """``primed``, ``not_primed`` or ``excluded`` where the dataset publishes priming of its own; else None."""
    published_prime_time: float | None
    """The prime time that the dataset publishes, seconds on the recording's clock; None where it publishes none."""

    def __repr__(self) -> str:
        return f"<Event {self.event_id}: {self.action} of {self.object_name}, {self.outcome}>"


class Events:
    """All candidate events of a table, accepted or not, in table order.

    ``len(events)``, ``events[0]`` and ``for event in events`` work as with a list.
    """

    def __init__(self, rows: pa.Table) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return self._rows.num_rows

    def __iter__(self) -> Iterator[Event]:
        return (self[number] for number in range(len(self)))

    @overload
    def __getitem__(self, number: int) -> Event: ...
    @overload
    def __getitem__(self, number: slice) -> list[Event]: ...
    def __getitem__(self, number: int | slice) -> Event | list[Event]:
        if isinstance(number, slice):
            return [self[row] for row in range(len(self))[number]]
        values = self._rows.slice(_place(number, len(self)), 1).to_pylist()[0]
        arrays = {name: frozen(np.array(value)) for name, value in values.items() if isinstance(value, list)}
        return Event(**{name: (values | arrays)[name] for name in Event.__dataclass_fields__})

    def to_pandas(self) -> pd.DataFrame:
        """Return one row an event, with the columns of docs/table.md#events.

        Vectors (``location``, ``box_min`` …) hold one array (3,) a cell, world frame, metres.
        """
        return frame_of(self._rows)

    def __repr__(self) -> str:
        return f"<{len(self)} events: {_counted(self._rows)}>"

    def _repr_html_(self) -> str:
        shown = frame_of(self._rows.select(list(_SHOWN_COLUMNS)))
        return notebook_table(f"{len(self)} candidate events: {_counted(self._rows)}", shown)


def _counted(rows: pa.Table) -> str:
    """Return how many events have each outcome, the most frequent first."""
    outcomes = rows["outcome"].to_pylist()
    counts = sorted(((outcomes.count(name), name) for name in set(outcomes)), key=lambda pair: (-pair[0], pair[1]))
    return ", ".join(f"{count} {name}" for count, name in counts) or "none"


@dataclass(frozen=True)
class Recording:
    """One recording that a build found."""

    recording_id: str
    """Name of the recording."""
    participant_id: str
    """Name of the person."""
    split: str
    """``train``, ``validation`` or ``test``."""
    split_group: str
    """Recordings of one group share the split."""
    duration: float
    """Length of the part with ground truth, seconds."""
    outcomes: Mapping[str, int]
    """Number of its candidate events by outcome."""
    status: str
    """``read``, ``failed`` or ``skipped``."""
    message: str
    """Why it was not read, or what was noticed when it was."""


class Recordings:
    """All recordings that a build found, in table order.

    ``len(recordings)``, ``recordings[0]`` and ``for recording in recordings`` work as with a list.
    """

    def __init__(self, rows: pa.Table) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return self._rows.num_rows

    def __iter__(self) -> Iterator[Recording]:
        return (self[number] for number in range(len(self)))

    @overload
    def __getitem__(self, number: int) -> Recording: ...
    @overload
    def __getitem__(self, number: slice) -> list[Recording]: ...
    def __getitem__(self, number: int | slice) -> Recording | list[Recording]:
        if isinstance(number, slice):
            return [self[row] for row in range(len(self))[number]]
        values = self._rows.slice(_place(number, len(self)), 1).to_pylist()[0]
        outcomes = {name: values.pop(name) for name in OUTCOMES}
        plain = {name: values[name] for name in Recording.__dataclass_fields__ if name != "outcomes"}
        return Recording(**plain, outcomes=outcomes)

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a recording, with the columns of docs/table.md#recordings."""
        return frame_of(self._rows)

    def __repr__(self) -> str:
        statuses = self._rows["status"].to_pylist()
        return f"<{len(self)} recordings, {statuses.count('read')} of them read>"

    def _repr_html_(self) -> str:
        return notebook_table(f"{len(self)} recordings", self.to_pandas())


def _place(number: int, length: int) -> int:
    """Return a list's index as one from 0.

    Raises:
        IndexError: if there is no such row.
    """
    place = number + length if number < 0 else number
    if not 0 <= place < length:
        raise IndexError(f"expected a number below {length}, found {number}")
    return place


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
        return f"<pre>{html_lines(self.text)}</pre>{picture}"


def html_lines(text: str) -> str:
    """Return lines for the body of an HTML page; the line breaks stay.

    Args:
        text: The lines.
    """
    return "\n".join(html(line) for line in text.splitlines())


def require_event(wanted: str) -> str:
    """Refuse an empty text, which every event would fit.

    Args:
        wanted: What was typed.

    Raises:
        UsageError: if it is empty.
    """
    if not wanted:
        raise UsageError("expected an event's id or a part of one, found an empty text.")
    return wanted
