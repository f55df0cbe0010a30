"""Match what curation finds in synthetic recordings with the truth that they were made from."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from prbench.sequences import Event
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.write_tree import TIMES

_LARGEST_DIFFERENCE = 0.5  # seconds between a found and a true event that may be the same


@dataclass(frozen=True)
class Match:
    """One true event beside the found one; either may be missing.

    Attributes:
        true: Times on the recording's clock.
    """

    true: TrueEvent | None
    found: Event | None

    @property
    def expected(self) -> str:
        """The outcome that curation should have reached."""
        return "not_an_event" if self.true is None else self.true.expected

    @property
    def outcome(self) -> str:
        """The outcome that curation reached."""
        return "not_found" if self.found is None else self.found.outcome


def match_events(true: Sequence[TrueEvent], found: Sequence[Event]) -> list[Match]:
    """Pair the events of one recording one to one: same object and action, least time difference first, ≤ 0.5 s.

    Args:
        true: Times on the recording's clock.
        found: What curation says.

    Returns:
        Every true and every found event exactly once.
    """
    if not true or not found:
        return [Match(event, None) for event in true] + [Match(None, event) for event in found]
    difference = np.abs(np.subtract.outer([t.event_time for t in true], [f.event_time for f in found]))
    same = np.array([[t.object_id == f.object_id and t.action == f.action for f in found] for t in true])
    rows, columns = np.nonzero(same & (difference <= _LARGEST_DIFFERENCE))
    partner: dict[int, int] = {}
    taken: set[int] = set()
    # A stable sort, so that ties are resolved by the order of the events on every machine.
    for index in np.argsort(difference[rows, columns], kind="stable"):
        row = int(rows[index])
        column = int(columns[index])
        if row not in partner and column not in taken:
            partner[row] = column
            taken.add(column)
    matches = [Match(event, found[partner[row]] if row in partner else None) for row, event in enumerate(true)]
    return matches + [Match(None, event) for column, event in enumerate(found) if column not in taken]


def true_events(preset: str, performance: Performance) -> list[TrueEvent]:
    """Return the events of a performance as a layout names them, times on the recording's clock."""
    layout = layout_for(preset)
    # Truth counts from the performance's first frame, curation from the clock of the glasses.
    offset = layout.clock_start(performance) - float(performance.times[0])
    named = [dataclasses.replace(e, object_id=layout.object_id(e.object_id)) for e in layout.events(performance)]
    return [on_clock(event, offset) for event in named]


def on_clock(event: TrueEvent, offset: float) -> TrueEvent:
    """Return the event with all its times moved by ``offset`` seconds."""
    times = {name: getattr(event, name) for name in TIMES.values()}
    moved = {name: time + offset for name, time in times.items() if time is not None}
    if event.lost_span is not None:
        moved["lost_span"] = (event.lost_span[0] + offset, event.lost_span[1] + offset)
    return dataclasses.replace(event, **moved)
