"""Draw the picture of the first page: ``python docs/first_picture.py TABLE``.

TABLE is made by ``prbench synthesize adt --table --count 40 --seed 0 --out TABLE``. The picture shows a sequence in
which a person finds a bowl with the eyes, walks to it and takes it. Bodies stand where they stood, seen from the
side, along the way from the first place to the bowl.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from prbench.geometry.skeleton import Joint
from prbench.viewing.explain import explain_event
from prbench.viewing.figures import draw_bodies, horizontal_direction, new_figure, styled, write_figure
from prbench.viewing.replay.scene import BOX_COLOUR, GAZE_COLOUR, GOAL_COLOUR, METHOD_COLOURS, Scene, side_view

EVENT = "7647743538855037/pick/38655986175"
PICTURE = Path(__file__).with_name("prime_and_reach.png")
GAZE_ELSEWHERE = 0.8  # metres of the gaze ray that are drawn where the goal is not in front of the eyes
UP = np.array([0.0, 1.0, 0.0])


def main() -> None:
    """Draw four moments of one sequence."""
    folder = sys.argv[1]
    story = explain_event(folder, EVENT)
    if story.motion is None:
        raise SystemExit(f"{EVENT} did not become a sequence of {folder}")
    draw(story.motion, PICTURE)


@styled
def draw(scene: Scene, path: Path) -> None:
    """Write the PNG: looking elsewhere, the prime, the walk and the reach."""
    last = scene.n_frames - 1
    # The first frame at or after the look, so that the eyes are there.
    prime = int(np.searchsorted(scene.times, scene.prime_time - 1e-6))
    moments = (
        (0, "1. Looking elsewhere"),
        (prime, "2. The eyes find the bowl: the prime"),
        ((prime + last) // 2, "3. The body follows"),
        (last, "4. The hand is there: the reach"),
    )
    motion = scene.motions[0]
    location = scene.goal_location
    assert location is not None, "a synthetic sequence knows its goal"
    start = motion.joints[0, Joint.PELVIS]
    sideways = horizontal_direction(location - start)
    goal = side_view(location, sideways, around=start)
    figure = new_figure(7.0, 4.0)
    panels = figure.subplots(2, 2, gridspec_kw={"left": 0.02, "right": 1.0, "bottom": 0.0, "top": 0.94, "wspace": 0.0})
    for axes, (frame, title) in zip(panels.flat, moments, strict=True):
        axes.set_aspect("equal")
        axes.set(xlim=(-0.9, goal[0] + 0.6), ylim=(-0.3, 2.05))
        axes.set_axis_off()
        axes.axhline(0.0, color="0.8", zorder=0)
        axes.plot(*goal, "s", color=GOAL_COLOUR, markeredgecolor=BOX_COLOUR, markersize=9)
        axes.annotate("bowl", goal, xytext=(0, -7), textcoords="offset points", ha="center", va="top", color=BOX_COLOUR)
        if motion.gaze is not None and motion.gaze.valid[frame]:
            ahead = float((location - motion.gaze.origin[frame]) @ motion.gaze.direction[frame])
            length = ahead if ahead > 0.0 else GAZE_ELSEWHERE
            ray = motion.gaze.origin[frame] + np.array([[0.0], [length]]) * motion.gaze.direction[frame]
            axes.plot(*side_view(ray, sideways, around=start).T, color=GAZE_COLOUR, linewidth=1.8, linestyle="--")
        draw_bodies(
            axes,
            motion.joints[[frame]],
            METHOD_COLOURS[0],
            lambda points: side_view(points, sideways, around=start),
            np.cross(sideways, UP),
            head_tilt_deg=scene.head_tilt_deg,
        )
        seconds = scene.times[last] - scene.times[frame]
        when = "the event" if frame == last else f"{seconds:.1f} s before"
        axes.set_title(title, fontsize=9.5, weight="bold")
        axes.text(0.5, 0.0, when, transform=axes.transAxes, ha="center", fontsize=8, color="0.3")
    write_figure(figure, path)


if __name__ == "__main__":
    main()
