"""The story of one event: how far it came through curation, with the numbers, as text and as a picture."""

from __future__ import annotations

import dataclasses
import difflib
import re
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float

from prbench.curation.priming import PUBLISHED_STAGE
from prbench.errors import TableError, UsageError
from prbench.geometry.skeleton import WRISTS, Joint, head_forward
from prbench.metrics.ray_track import ray_distance
from prbench.protocol.manifests import BenchmarkProtocol, load_protocol
from prbench.sequences import Event, SequenceChunk, SequenceTable
from prbench.sequences.dataset_info import may_pass_on, notice
from prbench.sequences.sequence import event_of
from prbench.shown import clean, figure_text
from prbench.viewing.figures import draw_box, draw_figure, flattened, horizontal_direction, new_figure, write_png
from prbench.viewing.replay.read import gaze_of, goal_of
from prbench.viewing.replay.scene import Gaze, Goal, gaze_distance

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Verdict = Literal["passed", "stopped here", "not reached"]
_MARKS: dict[Verdict, str] = {"passed": "+", "stopped here": "x", "not reached": " "}
_FIGURES = 9
_SPACING = 1.25  # metres between figures in the picture
_GAZE = "tab:orange"
_PRIME = "tab:purple"
_EVENT = "black"
_WIDTH = 13.0  # inches


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
class StoryMotion:
    """The sequence that the event became: canonical frame, metres; times in seconds on the recording's clock."""

    times: Float[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 22 3"]
    head_tilt_deg: float
    goal: Goal
    gaze: Gaze


@dataclasses.dataclass(frozen=True)
class EventStory:
    """Everything that a built dataset knows about one event.

    Attributes:
        motion: None unless it became a sequence, and where the dataset's licence keeps recorded motion out of views.
        notice: Sentence that the dataset's terms ask a picture to show.
    """

    event: Event
    dataset: str
    split: str
    stages: tuple[StoryStage, ...]
    motion: StoryMotion | None
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
        lines = [
            event.event_id,
            self.title,
            f"recording {event.recording_id} ({self.split}) of {self.dataset}; outcome: {event.outcome}{sure}",
            *([f"corrected: {event.corrected}"] if event.corrected else []),
            "",
            *(f"  {_MARKS[s.verdict]} {s.name:<{width}}  {s.text or s.verdict}" for s in self.stages),
        ]
        return "\n".join(map(clean, lines))


def draw_event_story(story: EventStory, path: Path) -> None:
    """Write the picture of one event as PNG.

    Raises:
        StorageError: if it cannot be written.
    """
    heights = [2.0] if story.motion is None else [2.0, 3.4, 2.8]
    figure = new_figure(_WIDTH, sum(heights) + 0.4, layout="constrained")
    axes = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    notice = f"\n{story.notice}" if story.notice else ""
    title = f"{clean(story.title)}: {clean(story.event.outcome)}\n{clean(story.event.event_id)}{notice}"
    figure.suptitle(figure_text(title), fontsize=10)
    # Each stage's verdict and numbers, line by line.
    axes[0].set_axis_off()
    colours = {"passed": "tab:green", "stopped here": "tab:red", "not reached": "0.6"}
    for number, stage in enumerate(story.stages):
        height = 1.0 - (number + 0.5) / len(story.stages)
        colour = colours[stage.verdict]
        place = {"transform": axes[0].transAxes, "va": "center", "fontsize": 9}
        axes[0].text(0.0, height, stage.name, weight="bold", color=colour, **place)
        axes[0].text(0.07, height, stage.verdict, color=colour, **place)
        axes[0].text(0.16, height, figure_text(stage.text), **place)
    if story.motion is not None:
        _draw_figures(axes[1], story, story.motion)
        _draw_distances(axes[2], story, story.motion)
    write_png(figure, path)


def _draw_figures(axes: Axes, story: EventStory, motion: StoryMotion) -> None:
    """Draw stick figures over time, seen from the side, each with its gaze ray and the goal."""
    frames = np.unique(np.linspace(0, len(motion.times) - 1, _FIGURES).round().astype(int))
    # Towards the goal at the end, so that the reach is seen from the side.
    sideways = horizontal_direction(motion.goal.location - motion.joints[-1, Joint.PELVIS])
    for number, frame in enumerate(frames):
        at = number * _SPACING
        joints = motion.joints[frame]
        pelvis = joints[Joint.PELVIS]
        draw_figure(axes, joints, motion.head_tilt_deg, sideways, at)
        # Farther goals would lie under the next figure; an arrow shows where they are.
        near = abs(float((motion.goal.location - pelvis) @ sideways)) < 0.75 * _SPACING
        if near:
            draw_box(axes, flattened(motion.goal.box_corners, pelvis, sideways, at), color="tab:cyan", linewidth=0.8)
        else:
            x, y = flattened(motion.goal.location[None], pelvis, sideways, at)[0]
            side = float(np.sign(x - at)) * 0.3 * _SPACING
            arrow = {"arrowstyle": "->", "color": "tab:cyan"}
            axes.annotate("", (at + 1.4 * side, y), (at + side, y), arrowprops=arrow)
        if motion.gaze.valid[frame]:
            # As long as the goal is far, so that a ray that meets the goal ends there.
            length = min(float(np.linalg.norm(motion.goal.location - motion.gaze.origin[frame])), 0.9)
            ray = motion.gaze.origin[frame] + np.array([[0.0], [length]]) * motion.gaze.direction[frame]
            axes.plot(*flattened(ray, pelvis, sideways, at).T, color=_GAZE, linewidth=0.9, linestyle="--")
        distance = np.linalg.norm((motion.goal.location - pelvis)[[0, 2]])
        since = motion.times[frame] - story.event.event_time
        axes.text(at, -0.12, f"{since:+.1f} s\ngoal {distance:.1f} m", ha="center", va="top", fontsize=7)
    axes.set_aspect("equal")
    axes.set(xlim=(-0.8, (len(frames) - 1) * _SPACING + 0.9), ylim=(-0.42, 2.05))
    axes.set_axis_off()
    axes.set_title(
        "right limbs red, left blue; green: head forward; orange: gaze; cyan: box of the goal, or where it lies",
        fontsize=8,
    )


def _draw_distances(axes: Axes, story: EventStory, motion: StoryMotion) -> None:
    """Draw the distance of the goal from the gaze ray, the head ray and the wrists."""
    times = motion.times - story.event.event_time
    forward, _ = head_forward(motion.joints, motion.head_tilt_deg)
    head = ray_distance(motion.joints[:, Joint.HEAD], forward, motion.goal.location[None])
    axes.plot(times, gaze_distance(motion.gaze, motion.goal), color=_GAZE, label="gaze ray")
    axes.plot(times, head, color="tab:green", label="head ray")
    for wrist, colour, name in zip(WRISTS, ("tab:blue", "tab:red"), ("left wrist", "right wrist"), strict=True):
        distance = np.linalg.norm(motion.joints[:, wrist] - motion.goal.location, axis=1)
        axes.plot(times, distance, color=colour, label=name)
    pelvis = motion.joints[:, Joint.PELVIS]
    axes.plot(times, np.linalg.norm(pelvis - motion.goal.location, axis=1), color="0.5", linewidth=0.8, label="pelvis")
    if story.event.prime_time is not None:
        axes.axvline(story.event.prime_time - story.event.event_time, color=_PRIME, label="prime")
    axes.axvline(0, color=_EVENT, linewidth=1.5)
    axes.set(
        xlim=(times[0], times[-1] + 0.05), ylim=(0, None), xlabel="seconds from the event", ylabel="m from the goal"
    )
    axes.legend(fontsize=7, ncols=3, frameon=False)
    axes.grid(alpha=0.3)


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
_SHOWN = 8  # candidates that an error message lists


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
    row = _find_event(events, event)
    record = event_of(events, row)
    if record.corrected and not may_pass_on(table.info, permitted):
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
    if chunk is not None and may_pass_on(table.info, permitted):
        motion = StoryMotion(
            times=float(chunk.numbers("start_time")[0])
            + np.arange(int(chunk.n_frames[0])) / float(chunk.numbers("fps")[0]),
            joints=chunk.joints.astype(np.float64),
            head_tilt_deg=float(chunk.numbers("head_tilt_deg")[0]),
            goal=goal_of(chunk),
            gaze=gaze_of(chunk),
        )
    protocol = table.described_protocol.protocol() or load_protocol()
    return EventStory(
        event=record,
        dataset=table.info.dataset,
        split=recordings["split"][index].as_py() if index >= 0 else "unknown",
        stages=_stages(record, chunk, protocol, table.info.options, shown=may_pass_on(table.info, permitted)),
        motion=motion,
        notice=notice(table.info, permitted),
    )


def _find_event(events: pa.Table, wanted: str) -> int:
    """Return the row of the one event that fits.

    Raises:
        UsageError: if none or several fit.
    """
    ids = events["event_id"].to_pylist()
    sequences = events["sequence_id"].to_pylist()
    # A whole id wins over parts: one id may be the beginning of another.
    exact = [row for row, names in enumerate(zip(ids, sequences, strict=True)) if wanted in names]
    if exact:
        return exact[0]
    # ``recording/object name/action/time``: what a person would type.
    columns = (events[name].to_pylist() for name in ("recording_id", "object_name", "action"))
    names = ["/".join((*parts, event_id.rsplit("/", 1)[-1])) for *parts, event_id in zip(*columns, ids, strict=True)]
    fitting = [row for row in range(len(ids)) if wanted in ids[row] or wanted in names[row]]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        shown = "\n".join(f"  {clean(ids[row])}  ({clean(names[row])})" for row in fitting[:_SHOWN])
        more = f"\n  … and {len(fitting) - _SHOWN} more" if len(fitting) > _SHOWN else ""
        raise UsageError(f"'{wanted}' fits {len(fitting)} events; give a longer part of one:\n{shown}{more}")
    near = difflib.get_close_matches(wanted, [*ids, *names], n=3, cutoff=0.3)
    hint = "\n".join(f"  {clean(name)}" for name in near)
    counted = f"no event '{wanted}' among the {len(ids)} of this dataset; events.parquet lists them."
    raise UsageError(f"{counted} Near it:\n{hint}" if near else counted)


def _stages(
    event: Event, chunk: SequenceChunk | None, protocol: BenchmarkProtocol, options: dict[str, str], *, shown: bool
) -> tuple[StoryStage, ...]:
    # Occlusion and the dataset's own priming are asked for by options and count as the stage of priming.
    asked = ("correction", *STAGES) if event.stage == "correction" else STAGES
    asked = (*STAGES, "confidence") if event.stage == "confidence" else asked
    decided = asked.index("priming" if event.stage in _PART_OF_PRIMING else event.stage)
    constants = protocol.curation
    texts = {
        "correction": "dropped by a person",
        "in_hand": _in_hand(event, options),
        "location": _location(event, shown=shown),
        "priming": _priming(event, protocol),
        "clipping": _clipping(event, chunk, protocol),
        "body": f"no gap of more than {constants.largest_interpolated_gap:g} s in the body",
        "filters": "",
        "confidence": "",
    }
    if event.outcome == "no_body":
        texts["body"] = "no body pose"
    elif event.stage == "body":
        longest = f"at most {constants.largest_interpolated_gap:g} s is interpolated"
        texts["body"] = f"a gap of {event.value:.2f} s in the body ({longest})"
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
        stages.append(StoryStage(name.replace("_", " "), verdict, texts[name] if number <= decided else ""))
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
    return (
        f"gaze came no nearer to the box than {_cm(event.value)} in the {constants.priming_window:g} s before"
        f" (near miss: at most {_cm(constants.near_miss_distance)})"
    )


def _clipping(event: Event, chunk: SequenceChunk | None, protocol: BenchmarkProtocol) -> str:
    interval = f"from {protocol.curation.lead:g} s before the prime"
    if event.stage == "clipping" and event.value is not None and event.threshold is not None:
        missing = event.threshold - event.value
        needed = f"the {event.threshold:.2f} s {interval} to the event"
        return f"the recording, or the body in it, lacks {missing:.2f} s of {needed}"
    if chunk is None:
        return f"the recording covers it {interval}"
    n = int(chunk.n_frames[0])
    start = float(chunk.numbers("start_time")[0])
    return f"{n} frames at {float(chunk.numbers('fps')[0]):g} Hz from {start:.3f} s"


def _cm(metres: float | None) -> str:
    return "unknown" if metres is None else f"{metres * 100:.1f} cm"
