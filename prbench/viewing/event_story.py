"""The story of one event: how far it came through curation, with the numbers, as text and as a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import WRISTS, Joint, head_forward
from prbench.metrics.ray_track import ray_distance
from prbench.sequences import Event
from prbench.shown import clean, figure_text
from prbench.viewing.figures import draw_box, draw_figure, flattened, horizontal_direction, new_figure, write_png
from prbench.viewing.replay.measures import gaze_distance
from prbench.viewing.replay.scene import Gaze, Goal

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


@dataclass(frozen=True)
class StoryStage:
    """One stage of curation and its verdict on the event."""

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
    goal: Goal
    gaze: Gaze


@dataclass(frozen=True)
class EventStory:
    """Everything that a built dataset knows about one event."""

    event: Event
    dataset: str
    split: str
    stages: tuple[StoryStage, ...]
    neighbours: tuple[Event, ...]
    """Other events of the recording, by time: those around it, and those of the same object."""
    priming_window: float
    """Seconds before the event in which a look counts."""
    lead: float
    """Seconds before the prime at which a sequence begins."""
    motion: StoryMotion | None
    """None unless it became a sequence, and where the dataset's licence keeps recorded motion out of views."""
    notice: str = ""
    """Sentence that the dataset's terms ask a picture to show."""

    @property
    def title(self) -> str:
        """Action, object, time and hand in one line."""
        event = self.event
        hand = f", {event.hand} hand" if event.hand else ""
        return f"{event.action} of {event.object_name} ({event.object_id}) at {event.event_time:.3f} s{hand}"

    def text(self) -> str:
        """Return the story in lines for a terminal."""
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

    def _beside(self, other: Event) -> str:
        same = " (same object)" if other.object_id == self.event.object_id else ""
        difference = other.event_time - self.event.event_time
        return f"{difference:+9.2f} s  {other.action:<4} {other.object_name}{same}: {other.outcome}  {other.event_id}"


def draw_event_story(story: EventStory, path: Path) -> None:
    """Write the picture of one event as PNG.

    Raises:
        StorageError: if it cannot be written.
    """
    heights = [2.0, 1.9] if story.motion is None else [2.0, 1.9, 3.4, 2.8]
    figure = new_figure(_WIDTH, sum(heights) + 0.4, layout="constrained")
    axes = figure.subplots(len(heights), 1, height_ratios=heights)
    notice = f"\n{story.notice}" if story.notice else ""
    title = f"{clean(story.title)}: {clean(story.event.outcome)}\n{clean(story.event.event_id)}{notice}"
    figure.suptitle(figure_text(title), fontsize=10)
    _write_stages(axes[0], story)
    _draw_timeline(axes[1], story)
    if story.motion is not None:
        _draw_figures(axes[2], story, story.motion)
        _draw_distances(axes[3], story, story.motion)
    write_png(figure, path)


def _write_stages(axes: Axes, story: EventStory) -> None:
    """Write each stage's verdict and numbers, line by line."""
    axes.set_axis_off()
    colours = {"passed": "tab:green", "stopped here": "tab:red", "not reached": "0.6"}
    for number, stage in enumerate(story.stages):
        height = 1.0 - (number + 0.5) / len(story.stages)
        colour = colours[stage.verdict]
        place = {"transform": axes.transAxes, "va": "center", "fontsize": 9}
        axes.text(0.0, height, stage.name, weight="bold", color=colour, **place)
        axes.text(0.07, height, stage.verdict, color=colour, **place)
        axes.text(0.16, height, figure_text(stage.text), **place)


def _draw_timeline(axes: Axes, story: EventStory) -> None:
    """Draw window, sequence, prime and event, with the neighbouring events; seconds from the event."""
    event = story.event
    axes.axvspan(-story.priming_window, 0, color="0.93", label=f"a look counts ({story.priming_window:g} s)")
    if event.prime_time is not None:
        prime = event.prime_time - event.event_time
        axes.axvspan(
            prime - story.lead, 0, ymin=0.05, ymax=0.25, color="tab:green", alpha=0.25, label="from lead to event"
        )
        axes.axvline(prime, color=_PRIME, label=figure_text(f"prime ({(event.prime_kind or '').replace('_', ' ')})"))
    axes.axvline(0, color=_EVENT, linewidth=1.5, label=figure_text(event.action))
    # A prime at the very beginning of the window still has its lead in the picture.
    first = -story.priming_window - story.lead - 1
    last = 5.0
    shown = [other for other in story.neighbours if first <= other.event_time - event.event_time <= last]
    for number, other in enumerate(shown):
        time = other.event_time - event.event_time
        height = (0.37, 0.52, 0.67)[number % 3]  # neighbours in time would cover one another's labels
        colour = "tab:green" if other.outcome == "sequence" else "tab:gray"
        axes.plot(time, height, "v" if other.action == "put" else "^", color=colour)
        name = other.object_name + (" (same)" if other.object_id == event.object_id else "")
        # Labels near the right edge are written to the left of their mark, or they would leave the picture.
        side = {"ha": "right", "xytext": (-6, 0)} if time > last - 3 else {"ha": "left", "xytext": (6, 0)}
        label = figure_text(f"{other.action} {name}: {other.outcome}")
        axes.annotate(label, (time, height), fontsize=7, va="center", color=colour, textcoords="offset points", **side)
    axes.set(xlim=(first, last), ylim=(0, 1), yticks=[], xlabel="seconds from the event")
    axes.legend(loc="upper left", fontsize=7, ncols=4, frameon=False)


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
    axes.plot(times, gaze_distance(motion.gaze, motion.goal), color=_GAZE, label="gaze ray")
    axes.plot(
        times,
        ray_distance(motion.joints[:, Joint.HEAD], forward, motion.goal.location[None]),
        color="tab:green",
        label="head ray",
    )
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
