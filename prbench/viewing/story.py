"""The story of one event: how far it came through curation, with the numbers, as text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from prbench.sequences import EventRecord
from prbench.shown import clean

Verdict = Literal["passed", "stopped here", "not reached"]
_MARKS: dict[Verdict, str] = {"passed": "+", "stopped here": "x", "not reached": " "}


@dataclass(frozen=True)
class StoryStage:
    """One stage of curation and what it made of the event."""

    name: str
    verdict: Verdict
    text: str
    """The numbers, beside what they are compared with."""


@dataclass(frozen=True)
class StoryMotion:
    """The sequence that the event became: canonical frame, metres; times in seconds on the recording's clock."""

    times: Float[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 22 3"]
    head_tilt_deg: float
    goal: Float[np.ndarray, "3"]
    box_corners: Float[np.ndarray, "8 3"]
    gaze_origin: Float[np.ndarray, "n 3"]
    gaze_direction: Float[np.ndarray, "n 3"]
    gaze_valid: Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class EventStory:
    """Everything that a built dataset knows about one event."""

    event: EventRecord
    dataset: str
    split: str
    stages: tuple[StoryStage, ...]
    neighbours: tuple[EventRecord, ...]
    """Other events of the recording, by time: those around it, and those of the same object."""
    priming_window: float
    """Seconds before the event in which a look counts."""
    lead: float
    """Seconds before the prime at which a sequence begins."""
    motion: StoryMotion | None
    """None unless it became a sequence, and where the dataset's licence keeps recorded motion out of views."""
    notice: str = ""
    """What the dataset's terms ask a picture of it to say."""

    @property
    def title(self) -> str:
        """One line: what, where, when."""
        event = self.event
        hand = f", {event.hand} hand" if event.hand else ""
        return f"{event.action} of {event.object_name} ({event.object_id}) at {event.event_time:.3f} s{hand}"

    def text(self) -> str:
        """The story in lines for a terminal."""
        event = self.event
        width = max(len(stage.name) for stage in self.stages)
        lines = [
            event.event_id,
            self.title,
            f"recording {event.recording_id} ({self.split}) of {self.dataset}; outcome: {event.outcome}",
            "",
            *(f"  {_MARKS[s.verdict]} {s.name:<{width}}  {s.text or s.verdict}" for s in self.stages),
        ]
        if self.neighbours:
            lines += ["", "other events around it, and of the same object:"]
            lines += [f"  {self._beside(other)}" for other in self.neighbours]
        return "\n".join(map(clean, lines))

    def _beside(self, other: EventRecord) -> str:
        same = " (same object)" if other.object_id == self.event.object_id else ""
        difference = other.event_time - self.event.event_time
        return f"{difference:+9.2f} s  {other.action:<4} {other.object_name}{same}: {other.outcome}  {other.event_id}"
