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

from prbench.geometry.skeleton import CHAINS, Joint
from prbench.viewing.explain import explain_event
from prbench.viewing.figures import horizontal_direction, new_figure, write_png
from prbench.viewing.replay.scene import Scene, side_view

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EVENT = "5326650905410485/pick/27180990645"
PICTURE = Path(__file__).with_name("prime_and_reach.png")
GAZE = "tab:orange"
GOAL = "tab:cyan"
GAZE_ELSEWHERE = 0.8  # metres of the gaze ray that are drawn where the goal is not in front of the eyes
LINE_WIDTH = 2.4
# In the order of the chains: right leg, left leg, trunk, right arm, left arm.
COLOURS = ("tab:red", "tab:blue", "0.25", "tab:red", "tab:blue")


def main() -> None:
    """Draw four moments of one sequence."""
    folder = sys.argv[1]
    story = explain_event(folder, EVENT)
    if story.motion is None:
        raise SystemExit(f"{EVENT} did not become a sequence of {folder}")
    draw(story.motion, PICTURE)


def draw(scene: Scene, path: Path) -> None:
    """Write the PNG: looking elsewhere, the prime, the walk and the reach."""
    last = scene.n_frames - 1
    # The first frame at or after the look, so that the eyes are there.
    prime = int(np.searchsorted(scene.times, scene.prime_time - 1e-6))
    moments = (
        (0, "1. Looking elsewhere"),
        (prime, "2. The eyes find the bottle: the prime"),
        ((prime + last) // 2, "3. The body follows"),
        (last, "4. The hand is there: the reach"),
    )
    figure = new_figure(11.0, 6.0, layout="constrained", dpi=110)
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, (frame, title) in zip(panels.flat, moments, strict=True):
        _draw_moment(axes, scene, frame)
        seconds = scene.times[last] - scene.times[frame]
        when = "the event" if frame == last else f"{seconds:.1f} s before"
        axes.set_title(title, fontsize=15, weight="bold", loc="left")
        axes.text(0.5, 0.0, when, transform=axes.transAxes, ha="center", fontsize=13, color="0.3")
    write_png(figure, path)


def _draw_moment(axes: Axes, scene: Scene, frame: int) -> None:
    """Draw body, gaze and goal of one frame at their places; metres from the first place of the pelvis."""
    motion = scene.motions[0]
    location = scene.goal_location
    assert location is not None, "a synthetic sequence knows its goal"
    start = motion.joints[0, Joint.PELVIS]
    sideways = horizontal_direction(location - start)
    flat = side_view(motion.joints[frame], sideways, around=start)
    for chain, colour in zip(CHAINS, COLOURS, strict=True):
        # Round ends, so that neighbouring bones join without a notch.
        axes.plot(*flat[list(chain)].T, color=colour, linewidth=LINE_WIDTH, solid_capstyle="round")
    axes.plot(*flat[Joint.HEAD], "o", color="0.25", markersize=11)
    goal = (float((location - start) @ sideways), float(location[1]))
    axes.plot(*goal, "s", color=GOAL, markersize=10)
    axes.annotate("bottle", goal, xytext=(0, 11), textcoords="offset points", ha="center", fontsize=13, color=GOAL)
    if motion.gaze is not None and motion.gaze.valid[frame]:
        ahead = float((location - motion.gaze.origin[frame]) @ motion.gaze.direction[frame])
        length = ahead if ahead > 0.0 else GAZE_ELSEWHERE
        ray = motion.gaze.origin[frame] + np.array([[0.0], [length]]) * motion.gaze.direction[frame]
        axes.plot((ray - start) @ sideways, ray[:, 1], color=GAZE, linewidth=LINE_WIDTH, linestyle="--")
    axes.axhline(0.0, color="0.7", linewidth=1.2)
    axes.set_aspect("equal")
    axes.set(xlim=(-0.9, goal[0] + 0.5), ylim=(-0.35, 1.95))
    axes.set_axis_off()


if __name__ == "__main__":
    main()
