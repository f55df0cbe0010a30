"""Several motions for one goal as a fan of bodies: what they share, and where they part.

Each group of motions (those of a method, those of recorded people) fills a row: bodies from the side at three moments,
paths and looks from above, and over time how far the goal is from the head ray and how fast the wrist moves.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from prbench.geometry.skeleton import CHAINS, Joint, head_forward
from prbench.harness.diversity import MotionsToGoal, timing
from prbench.protocol.manifests import MetricConstants
from prbench.shown import figure_text
from prbench.viewing import figures
from prbench.viewing.replay.scene import GOAL_COLOUR

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LOOK = 0.5  # metres of the line that shows where a head points
_MARGIN = 0.35  # metres
_MOMENTS = ("first frame", "prime", "last frame")
_SPACING = 0.5  # metres between the bodies of two moments
_FARTHEST = 2.0  # metres; a head ray farther from the goal is off target, however far
_FASTEST = 4.0  # m/s; a wrist that jumps would flatten all other curves


@dataclass(frozen=True, eq=False)
class FanGroup:
    """Motions of one origin."""

    label: str
    colour: str
    motions: MotionsToGoal


@dataclass(frozen=True, eq=False)
class Fan:
    """One sequence with several motions for it.

    Attributes:
        shows_goal: False where the dataset's terms keep the goal.
        notice: Sentence that the dataset's terms ask for; empty where they ask for none.
    """

    sequence_id: str
    dataset: str
    synthetic: bool
    groups: tuple[FanGroup, ...]
    shows_goal: bool
    constants: MetricConstants
    notice: str


@figures.styled
def draw_fan(fan: Fan, path: Path) -> str:
    """Draw the motions of one sequence, and return the caption.

    Args:
        fan: The sequence and its motions.
        path: PNG, SVG or PDF; replaced when it exists.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    figures.require_drawable(path)
    height = 1.5 * len(fan.groups) + 0.75
    figure = figures.new_figure(7.0, height)
    # A fixed layout: that of matplotlib's solver differs in its last digits from call to call, and so do ids in an SVG.
    place = {"left": 0.005, "right": 0.995, "top": 1 - 0.4 / height, "bottom": 0.55 / height}
    grid = {**place, "wspace": 0.2, "hspace": 0.3, "width_ratios": (2.0, 1.2, 1.2, 1.2)}
    rows = figure.subplots(len(fan.groups), 4, squeeze=False, gridspec_kw=grid)
    # The same square for all groups, so that rows compare: limits of x and z, metres.
    points = [group.motions.joints[:, :, [Joint.PELVIS, Joint.HEAD]].reshape(-1, 3)[:, [0, 2]] for group in fan.groups]
    if fan.shows_goal:
        points.append(fan.groups[0].motions.goal[None, [0, 2]])
    seen_from_above = figures.square_limits(np.concatenate(points), margin=_MARGIN)
    for group, (bodies, above, looks, wrists) in zip(fan.groups, rows, strict=True):
        motions = group.motions
        primes = np.round(timing(motions, fan.constants).prime * motions.fps).astype(int)
        _draw_bodies(bodies, fan, group, primes)
        # Draw the ways of the pelvis from above, and where each head points at its prime time.
        forward, _ = head_forward(motions.joints, motions.head_tilt_deg)
        for number, colour in reversed(list(enumerate(_shades(group)))):
            pelvis = motions.joints[number, :, Joint.PELVIS]
            above.plot(pelvis[:, 0], pelvis[:, 2], color=colour, linewidth=0.9)
            above.plot(pelvis[-1, 0], pelvis[-1, 2], "s", color=colour, markersize=2.5)
            head = motions.joints[number, primes[number], Joint.HEAD]
            tip = head + _LOOK * forward[number, primes[number]]
            above.plot([head[0], tip[0]], [head[2], tip[2]], color=colour, linewidth=0.6, linestyle="--")
            above.plot(head[0], head[2], "o", color=colour, markersize=2.5)
        if fan.shows_goal:
            above.plot(motions.goal[0], motions.goal[2], "s", color=GOAL_COLOUR, markersize=4)
        above.set(title="from above (m)", xlim=seen_from_above[0], ylim=seen_from_above[1])
        above.set_aspect("equal")
        distance = motions.head_distance
        _draw_curves(looks, group, distance, "head ray (m)", _FARTHEST)
        for number, colour in reversed(list(enumerate(_shades(group)))):
            nearest = min(distance[number, primes[number]], _FARTHEST)
            looks.plot(primes[number] / motions.fps, nearest, "o", color=colour, markersize=3, zorder=4)
        looks.axhline(fan.constants.prime_distance, color=GOAL_COLOUR, linewidth=0.9, linestyle=":")
        speed = np.linalg.norm(np.diff(motions.reaching_wrist, axis=1), axis=-1) * motions.fps
        _draw_curves(wrists, group, speed, "wrist speed (m/s)", _FASTEST)
        bodies.set_title(figure_text(f"{group.label}: {len(group.motions.joints)} motions"))
    figure.suptitle(figure_text(f"{fan.dataset}: {fan.sequence_id}"), fontsize=6, x=0.01, y=0.985, ha="left")
    foot = _foot(fan)
    figure.supxlabel(figure_text(foot), fontsize=6, color="0.35", x=0.01, y=0.01, ha="left")
    caption = f"Motions of {', '.join(group.label for group in fan.groups)} for one goal. {' '.join(foot.split())}"
    figures.write_figure(figure, path, caption)
    return caption


def _foot(fan: Fan) -> str:
    said = [
        "A shade is a motion, the same in all panels of a row; a line from a head shows where it points. Dots: prime",
        "time (first look of the head that stays, else its best look).",
        f"Curves are cut at {_FARTHEST:g}\u00a0m and {_FASTEST:g}\u00a0m/s.",
    ]
    if fan.shows_goal:
        said.append("Light blue: the goal.")
    if len(fan.groups) > 1:
        said.append("Recorded people: the sequence itself and similar tasks of other recordings, laid on its start")
        said.append("and goal, stretched to its length.")
    if fan.synthetic:
        said.append("Synthetic people.")
    return "\n".join((*textwrap.wrap(" ".join(said), 140), fan.notice)).strip()


def _shades(group: FanGroup) -> list[tuple[float, float, float]]:
    """One colour a motion: the group's own, from dark to light."""
    return figures.shades(group.colour, len(group.motions.joints))


def _draw_bodies(axes: Axes, fan: Fan, group: FanGroup, primes: Int[np.ndarray, " motions"]) -> None:
    """Draw all bodies at three moments, each moment at a place of its own along the way."""
    motions = group.motions
    start = motions.joints[0, 0, Joint.PELVIS]
    sideways = figures.horizontal_direction(motions.goal - start)
    frames = (np.zeros_like(primes), primes, np.full_like(primes, motions.joints.shape[1] - 1))
    bodies = [motions.joints[np.arange(len(chosen)), chosen] for chosen in frames]
    clouds = [figures.flattened(poses.reshape(-1, 3), start, sideways, 0.0) for poses in bodies]
    goal = figures.flattened(motions.goal[None], start, sideways, 0.0)
    if fan.shows_goal:
        clouds = [clouds[0], *(np.concatenate([points, goal]) for points in clouds[1:])]
    # Bodies of two moments never overlap: each moment begins behind the one before it.
    shifts = figures.side_by_side(clouds, spacing=_SPACING)
    for moment, poses, points, shift in zip(_MOMENTS, bodies, clouds, shifts, strict=True):
        for pose, colour in reversed(list(zip(poses, _shades(group), strict=True))):
            flat = figures.flattened(pose, start, sideways, shift)
            figures.draw_chains(axes, flat, CHAINS, colour, linewidth=1.0)
            forward, _ = head_forward(pose, fan.groups[0].motions.head_tilt_deg)
            tip = figures.flattened((pose[Joint.HEAD] + _LOOK * forward)[None], start, sideways, shift)[0]
            axes.plot(*np.stack([flat[Joint.HEAD], tip]).T, color=colour, linewidth=0.6, linestyle="--")
            axes.plot(*flat[Joint.HEAD], "o", color=colour, markersize=2.5)
        if fan.shows_goal and moment != _MOMENTS[0]:
            axes.plot(goal[0, 0] + shift, goal[0, 1], "s", color=GOAL_COLOUR, markersize=4, zorder=4)
        axes.text(float(points[:, 0].mean()) + shift, -0.12, moment, fontsize=6, ha="center", va="top", color="0.35")
    figures.frame_side_view(axes, clouds, shifts, _MARGIN, 0.0)


def _draw_curves(axes: Axes, group: FanGroup, curves: np.ndarray, title: str, top: float) -> None:
    """Draw one curve a motion over its seconds, cut at ``top``; they end with the motion."""
    n_frames = group.motions.joints.shape[1]
    seconds = np.arange(n_frames - curves.shape[1], n_frames) / group.motions.fps
    for curve, colour in reversed(list(zip(curves, _shades(group), strict=True))):
        axes.plot(seconds, np.minimum(curve, top), color=colour, linewidth=0.8)
    axes.set_ylim(-top / 40, top * 41 / 40)
    axes.set_title(f"{title}, over s")
