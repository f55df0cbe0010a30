"""The story of one event: how far it came through curation, with the numbers, as text and as a picture."""

from __future__ import annotations

import dataclasses
import re
import textwrap
from collections.abc import Collection
from pathlib import Path
from typing import Literal

import pyarrow.compute as pc

from prbench.curation.priming import PUBLISHED_STAGE
from prbench.errors import TableError
from prbench.protocol.manifests import BenchmarkProtocol, load_protocol
from prbench.sequences import Event, SequenceChunk, SequenceTable
from prbench.sequences.dataset_info import may_pass_on, notice
from prbench.sequences.sequence import event_of
from prbench.sequences.table import find_sequence_id
from prbench.shown import clean, figure_text
from prbench.viewing.figures import new_figure, styled, write_figure
from prbench.viewing.replay.read import scene_of
from prbench.viewing.replay.scene import Scene
from prbench.viewing.replay.sheet import COLUMN, KEY, Block, block_height, caption_of, draw_key, draw_scene

Verdict = Literal["passed", "stopped here", "not reached"]
_MARKS: dict[Verdict, str] = {"passed": "+", "stopped here": "x", "not reached": " "}
_LINE_HEIGHT = 0.115  # inches of a line of text in the picture
_CHARACTERS = 62  # of such a line


@dataclasses.dataclass(frozen=True)
class StoryStage:
    """One stage of curation and its verdict on the event.

    Attributes:
        name: Name of the stage, such as ``priming``.
        verdict: What it said.
        text: The numbers, beside what they are compared with.
    """

    name: str
    verdict: Verdict
    text: str


@dataclasses.dataclass(frozen=True)
class EventStory:
    """Everything that a built dataset knows about one event.

    Attributes:
        motion: The sequence that it became; None where it became none, and where the dataset's licence keeps recorded
            motion out of views.
        notice: Sentence that the dataset's terms ask a picture to show.
    """

    event: Event
    dataset: str
    split: str
    stages: tuple[StoryStage, ...]
    motion: Scene | None
    notice: str = ""

    @property
    def title(self) -> str:
        """Action, object, time and hand in one line."""
        event = self.event
        if event.outcome == "unreadable_entry":
            return f"entry {event.object_id} of {event.object_name}"
        hand = f", {event.hand} hand" if event.hand else ""
        return f"{event.action} of {event.object_name} ({event.object_id}) at {event.event_time:.3f} s{hand}"

    def text(self) -> str:
        """Return the story in lines for a terminal."""
        event = self.event
        width = max(len(stage.name) for stage in self.stages)
        sure = "" if event.event_confidence is None else f"; confidence {event.event_confidence:.2f}"
        at = event.video or {}
        moments = [name for name in ("prime", "event") if f"{name}_time" in at]
        shown = [f"{name} at {at[f'{name}_time']} s (frame {at[f'{name}_frame']})" for name in moments]
        lines = [
            event.event_id,
            self.title,
            f"recording {event.recording_id} ({self.split}) of {self.dataset}; outcome: {event.outcome}{sure}",
            *([f"corrected: {event.corrected}"] if event.corrected else []),
            *([f"in the video: {', '.join(shown)}"] if shown else []),
            "",
            *(f"  {_MARKS[s.verdict]} {s.name:<{width}}  {s.text or s.verdict}" for s in self.stages),
        ]
        return "\n".join(map(clean, lines))


@styled
def draw_event_story(story: EventStory, path: Path) -> None:
    """Write the picture of one event, as wide as a text column: its story, and the motion below.

    Args:
        story: Result of :func:`explain_event`.
        path: PNG, SVG or PDF to write; replaced when it exists.

    Raises:
        UsageError: for another kind of file.
        StorageError: if it cannot be written.
    """
    lines = []
    for line in [*story.text().splitlines(), *([clean(story.notice)] if story.notice else [])]:
        # What goes on stands under the text of its line.
        lines += textwrap.wrap(line, _CHARACTERS, subsequent_indent="    ") or [""]
    below = 0.0 if story.motion is None else block_height(1) + KEY
    height = below + 0.2 + _LINE_HEIGHT * len(lines)
    figure = new_figure(COLUMN, height)
    text = figure_text("\n".join(lines))
    figure.text(0.06 / COLUMN, 1 - 0.08 / height, text, fontsize=6.2, family="monospace", va="top")
    if story.motion is not None:
        draw_scene(Block(figure, 0.0, below), story.motion)
        draw_key(Block(figure, 0.0, KEY), [story.motion])
    write_figure(figure, path, "" if story.motion is None else caption_of([story.motion]))


# The stages in the order in which curation asks.
STAGES = ("in_hand", "location", "priming", "clipping", "body", "filters")
_PART_OF_PRIMING = ("occlusion", PUBLISHED_STAGE)  # the first in tables of prbench 0.10 alone
_TOLD_BY = {
    "annotated": " (annotated)",
    "contact": " (by its contact points)",
    "tracked": " (by the tracked wrist)",
    "body": " (by the body's wrist)",
    "movement": " (it moved more before)",
}


def explain_event(folder: Path | str, event: str, *, permitted: Collection[str] = ()) -> EventStory:
    """Tell the story of one event.

    Args:
        folder: A built dataset.
        event: Its id, its sequence's id, or any part of ``event_id`` or ``recording/object name/action/time`` that
            fits one event only.
        permitted: Datasets for which the user has permission to pass recorded motion on; without it the story of one
            whose licence keeps it has no motion to draw.

    Raises:
        TableError: if the folder holds no dataset.
        UsageError: if no event fits (with the nearest known ids), or more than one does.
    """
    table = SequenceTable.open(folder)
    events = table.events()
    ids = events["event_id"].to_pylist()
    # A whole id wins over parts: one id may be the beginning of another.
    exact = [
        row for row, names in enumerate(zip(ids, events["sequence_id"].to_pylist(), strict=True)) if event in names
    ]
    # Else ``recording/object name/action/time``: what a person would type.
    columns = (events[name].to_pylist() for name in ("recording_id", "object_name", "action"))
    names = ("/".join((*parts, event_id.rsplit("/", 1)[-1])) for *parts, event_id in zip(*columns, ids, strict=True))
    known = [clean(f"{event_id}  ({name})") for event_id, name in zip(ids, names, strict=True)]
    among = f"{table.info.dataset}; events.parquet lists them"
    row = exact[0] if exact else known.index(find_sequence_id(event, known, among=among, what="event"))
    record = event_of(events, row)
    shown = may_pass_on(table.info, permitted)
    if record.corrected and not shown:
        told = re.sub(r"\bgoal [-+.0-9e ]+", "goal (left out: the licence keeps goals)", record.corrected)
        record = dataclasses.replace(record, corrected=told)
    recordings = table.recordings()
    index = pc.index(recordings["recording_id"], record.recording_id).as_py()
    chunk = None
    if record.sequence_id is not None:
        chunk = next(iter(table.chunks(ids=frozenset({record.sequence_id}))), None)
        if chunk is None:
            named = f"the events name a sequence {record.sequence_id} that the sequences do not hold."
            raise TableError(f"{table.folder}: {named}")
    motion = None
    if chunk is not None and shown:
        motion = scene_of(chunk, table.info, permitted=permitted)
    protocol = table.described_protocol.protocol() or load_protocol()
    split = recordings["split"][index].as_py() if index >= 0 else "unknown"
    stages = _stages(record, chunk, protocol, table.info.options, shown=shown)
    return EventStory(record, table.info.dataset, split, stages, motion, notice(table.info, permitted))


def _stages(
    event: Event, chunk: SequenceChunk | None, protocol: BenchmarkProtocol, options: dict[str, str], *, shown: bool
) -> tuple[StoryStage, ...]:
    # Occlusion and the dataset's own priming are asked for by options and count as the stage of priming.
    asked = ("correction", *STAGES) if event.stage == "correction" else STAGES
    asked = (*STAGES, "confidence") if event.stage == "confidence" else asked
    decided = asked.index("priming" if event.stage in _PART_OF_PRIMING else event.stage)
    constants = protocol.curation
    texts = {"correction": "dropped by a person", "in_hand": _in_hand(event, options)}
    texts |= {"location": _location(event, shown=shown), "priming": _priming(event, protocol)}
    texts["clipping"] = _clipping(event, chunk, protocol)
    texts["body"] = f"no gap of more than {constants.largest_interpolated_gap:g} s in the body"
    if event.outcome == "no_body":
        texts["body"] = "no body pose"
    elif event.stage == "body":
        limit = constants.largest_interpolated_gap
        texts["body"] = f"a gap of {event.value:.2f} s in the body (at most {limit:g} s is interpolated)"
    if event.stage == "confidence":
        texts["confidence"] = f"{event.value:.2f}, and --min-confidence asked for {event.threshold:g}"
    elif event.value is not None and event.threshold is not None:
        measure = options.get("minimum_movement", "wrist_to_goal").replace("_", " ")
        texts["filters"] = f"{measure}: {event.value:.3f} m (at least {event.threshold:.2f} m)"
    stages = []
    for number, name in enumerate(asked):
        verdict: Verdict = "passed" if number < decided else "not reached"
        if number == decided:
            verdict = "passed" if event.outcome == "sequence" else "stopped here"
        stages.append(StoryStage(name.replace("_", " "), verdict, texts.get(name, "") if number <= decided else ""))
    return tuple(stages)


def _in_hand(event: Event, options: dict[str, str]) -> str:
    if event.outcome == "unreadable_entry":
        return f"this entry of the annotations cannot be read: {event.unreadable}"
    if event.outcome == "other_wearer":
        nearest = "not seen" if event.value is None else f"{_cm(event.value)} away"
        return f"somebody else's hand was nearer: {_cm(event.threshold)} away, the wearer's {nearest}"
    if event.outcome == "excluded_category":
        return "a door, drawer or the like: turned or slid in its place, not picked up"
    hand = "neither hand is surely the one that reached"
    if event.hand_source == "person":
        hand = f"the {event.hand} hand, by a person's correction"
    elif event.hand is not None:
        hand = f"nearest at the event: the {event.hand} hand{_TOLD_BY.get(event.hand_source or '', '')}"
    return f"{hand} (rule: {options.get('in_hand_rule', 'default')})"


def _location(event: Event, *, shown: bool) -> str:
    """Return the object's place in words; empty where the licence keeps goals private."""
    if event.outcome == "annotation_only":
        return "listed from the annotations alone (--events-only): no stream was read"
    if event.outcome == "no_location":
        return "the object never came to rest, or the dataset gives no place"
    if event.location is None or event.box_min is None or event.box_max is None:
        return ""
    place = "rested" if event.action == "pick" else "will rest"
    sides = " × ".join(f"{side * 100:.0f}" for side in event.box_max - event.box_min)
    where = f"{place} at ({', '.join(f'{axis:.2f}' for axis in event.location)}) m, box {sides} cm (x, y, z)"
    # Locations of goals are derived data that some licences keep private, also in words.
    if not shown:
        where = f"{place} (where is left out: the licence keeps goals)"
    if event.outcome == "tracking_lost":
        return f"{where}; not tracked for {event.value:.2f} s around the event, and no hand tells when in it"
    return where


def _priming(event: Event, protocol: BenchmarkProtocol) -> str:
    constants = protocol.curation
    if event.prime_time is not None:
        gap = event.event_time - event.prime_time
        kind = (event.prime_kind or "").replace("_", " ")
        window = f"window {constants.priming_window:g} s"
        if event.prime_kind == "near_miss" and event.prime_margin is not None:
            kind = f"near miss with {_cm(event.prime_margin)} to spare"
        return f"first look at {event.prime_time:.3f} s ({kind}), {gap:.2f} s before ({window})"
    if event.stage == PUBLISHED_STAGE:
        return f"by what the dataset itself publishes: {event.outcome.replace('_', ' ')}"
    if event.value is None:
        return f"no valid gaze in the {constants.priming_window:g} s before"
    near = f"(near miss: at most {_cm(constants.near_miss_distance)})"
    return f"gaze came no nearer to the box than {_cm(event.value)} in the {constants.priming_window:g} s before {near}"


def _clipping(event: Event, chunk: SequenceChunk | None, protocol: BenchmarkProtocol) -> str:
    interval = f"from {protocol.curation.lead:g} s before the prime"
    if event.stage == "clipping" and event.value is not None and event.threshold is not None:
        missing = event.threshold - event.value
        needed = f"the {event.threshold:.2f} s {interval} to the event"
        return f"the recording, or the body in it, lacks {missing:.2f} s of {needed}"
    if chunk is None:
        return f"the recording covers it {interval}"
    fps, start = (float(chunk.numbers(name)[0]) for name in ("fps", "start_time"))
    return f"{int(chunk.n_frames[0])} frames at {fps:g} Hz from {start:.3f} s"


def _cm(metres: float | None) -> str:
    return "unknown" if metres is None else f"{metres * 100:.1f} cm"
