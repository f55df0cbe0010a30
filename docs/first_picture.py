"""Draw the picture of the first page: ``python docs/first_picture.py TABLE``.

TABLE is made by ``prbench synthesize adt --table --count 40 --seed 0 --out TABLE``. The picture shows a sequence in
which a person finds a bottle with the eyes, walks to it and takes it. Bodies stand where they stood, seen from the
side, along the way from the first place to the bottle.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from prbench.geometry.skeleton import Joint
from prbench.viewing.explain import StoryMotion, explain_event
from prbench.viewing.figures import draw_figure, horizontal_direction, new_figure, write_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EVENT = "5326650905410485/pick/27180990645"
PICTURE = Path(__file__).with_name("prime_and_reach.png")
GAZE = "tab:orange"
GOAL = "tab:cyan"
GAZE_ELSEWHERE = 0.8  # metres of the gaze ray that are drawn where the goal is not in front of the eyes
LINE_WIDTH = 2.4


def main() -> None:
    """Draw four moments of one sequence."""
    folder = sys.argv[1]
    story = explain_event(folder, EVENT)
    if story.motion is None or story.event.prime_time is None:
        raise SystemExit(f"{EVENT} did not become a sequence of {folder}")
    draw(story.motion, story.event.prime_time, PICTURE)


def draw(motion: StoryMotion, prime_time: float, path: Path) -> None:
    """Write the PNG: looking elsewhere, the prime, the walk and the reach."""
    last = len(motion.times) - 1
    prime = int(
        np.searchsorted(motion.times, prime_time)
    )  # first frame at or after the look, so that the eyes are there
    moments = (
        (0, "1. Looking elsewhere"),
        (prime, "2. The eyes find the bottle: the prime"),
        ((prime + last) // 2, "3. The body follows"),
        (last, "4. The hand is there: the reach"),
    )
    figure = new_figure(11.0, 6.0, layout="constrained", dpi=110)
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, (frame, title) in zip(panels.flat, moments, strict=True):
        _draw_moment(axes, motion, frame)
        seconds = motion.times[last] - motion.times[frame]
        when = "the event" if frame == last else f"{seconds:.1f} s before"
        axes.set_title(title, fontsize=15, weight="bold", loc="left")
        axes.text(0.5, 0.0, when, transform=axes.transAxes, ha="center", fontsize=13, color="0.3")
    write_png(figure, path)


def _draw_moment(axes: Axes, motion: StoryMotion, frame: int) -> None:
    """Draw body, gaze and goal of one frame at their places; metres from the first place of the pelvis."""
    start = motion.joints[0, Joint.PELVIS]
    sideways = horizontal_direction(motion.goal.location - start)
    at = float((motion.joints[frame, Joint.PELVIS] - start) @ sideways)
    draw_figure(axes, motion.joints[frame], motion.head_tilt_deg, sideways, at)
    axes.lines[-2].remove()  # the head-forward line: one line of sight is enough here
    for line in axes.lines:
        line.set_linewidth(LINE_WIDTH)
    axes.lines[-1].set_markersize(11)
    goal = (float((motion.goal.location - start) @ sideways), float(motion.goal.location[1]))
    axes.plot(*goal, "s", color=GOAL, markersize=10)
    axes.annotate("bottle", goal, xytext=(0, 11), textcoords="offset points", ha="center", fontsize=13, color=GOAL)
    if motion.gaze.valid[frame]:
        ahead = float((motion.goal.location - motion.gaze.origin[frame]) @ motion.gaze.direction[frame])
        length = ahead if ahead > 0.0 else GAZE_ELSEWHERE
        ray = motion.gaze.origin[frame] + np.array([[0.0], [length]]) * motion.gaze.direction[frame]
        axes.plot((ray - start) @ sideways, ray[:, 1], color=GAZE, linewidth=LINE_WIDTH, linestyle="--")
    axes.axhline(0.0, color="0.7", linewidth=1.2)
    axes.set_aspect("equal")
    axes.set(xlim=(-0.9, goal[0] + 0.5), ylim=(-0.35, 1.95))
    axes.set_axis_off()


if __name__ == "__main__":
    main()
