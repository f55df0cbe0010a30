"""Figures 1, 2 and 5 of the study from one's own sequences: people on their way to a goal, seen from the side.

Every panel is a view at right angles to the way from the first frame's pelvis to the goal. Darker means later.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import CHAINS, Joint, head_forward
from prbench.shown import figure_text
from prbench.viewing import figures
from prbench.viewing.replay.scene import Scene, ShownMotion

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NOTE_CHARACTERS = 90  # that fit below a panel
_POSES = 6
_ARROW = 0.45  # metres
_MARGIN = 0.45  # metres
_GOAL = "tab:cyan"
_GAZE = "tab:green"
# Columns of Figure 5.
MOMENTS = ("first frame", "prime", "reach")


def draw_examples(scenes: Sequence[Scene], path: Path, *, title: str, columns: int = 2, dpi: int = 110) -> None:
    """Draw recorded sequences as in Figures 1 and 2: poses from light to dark, gaze at the prime, and the goal.

    Args:
        scenes: Sequences whose recorded motion may be shown, one or more.
        path: ``.png`` or ``.svg``; replaced when it exists.
        title: What is shown.
        columns: Panels side by side.
        dpi: Resolution of a PNG.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    rows, wide = figures.grid_shape(len(scenes), columns)
    figure = figures.new_figure(5.6 * wide, 3.0 * rows + 0.6, dpi=dpi, layout="constrained")
    axes = figure.subplots(rows, wide, squeeze=False).ravel()
    for scene, place in zip(scenes, axes):
        motion = scene.motions[0]
        chosen = np.unique(np.append(np.linspace(0, scene.n_frames - 1, _POSES).round(), moments(scene)[1])).astype(int)
        for frame in chosen:
            share = frame / max(scene.n_frames - 1, 1)
            _draw_pose(place, scene, motion.joints[frame], colour=str(0.78 - 0.73 * share), alpha=1.0)
        prime = moments(scene)[1]
        _draw_gaze(place, scene, prime)
        _draw_goal(place, scene)
        _frame_panel(place, _drawn(scene, motion, chosen.tolist()))
        place.set_title(figure_text(f"{scene.dataset}: {scene.title}"), fontsize=8, loc="left")
    for place in axes[len(scenes) :]:
        place.set_axis_off()
    figure.suptitle(figure_text(title), fontsize=10, x=0.01, ha="left")
    # A figure of a single panel is narrower than the note.
    foot = textwrap.fill(_foot(scenes, "Darker: later. Green: gaze at the prime time."), _NOTE_CHARACTERS * wide)
    figure.supxlabel(figure_text(foot), fontsize=7, color="0.35")
    figures.write_figure(figure, path)


def draw_moments(scenes: Sequence[Scene], path: Path, *, title: str, dpi: int = 110) -> None:
    """Draw sequences as in Figure 5: recorded and generated poses at the first frame, at the prime, and at the reach.

    An arrow shows where each head points.

    Args:
        scenes: Sequences with their motions, a row each, one or more.
        path: ``.png`` or ``.svg``; replaced when it exists.
        title: What is shown.
        dpi: Resolution of a PNG.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    figure = figures.new_figure(11.5, 2.7 * len(scenes) + 0.9, dpi=dpi, layout="constrained")
    axes = figure.subplots(len(scenes), len(MOMENTS), squeeze=False)
    for scene, row in zip(scenes, axes, strict=True):
        frames = moments(scene)
        reach = [_drawn(scene, motion, [*frames]) for motion in scene.motions]
        for moment, frame, place in zip(MOMENTS, frames, row, strict=True):
            for motion in scene.motions:
                joints = motion.joints[min(frame, len(motion.joints) - 1)]
                _draw_pose(place, scene, joints, colour=motion.colour, alpha=0.95)
                head = joints[Joint.HEAD]
                points = np.stack([head, head + _ARROW * head_forward(joints, scene.head_tilt_deg)[0]])
                begin, end = _flat(scene, points)
                style = {"arrowstyle": "-|>", "color": motion.colour, "linewidth": 1.4}
                place.annotate("", end, begin, arrowprops=style)
            _draw_goal(place, scene)
            _frame_panel(place, np.concatenate(reach))
            place.set_title(figure_text(f"{moment}, {frame / scene.fps:.2f} s"), fontsize=8, loc="left")
        row[0].set_ylabel(figure_text(f"{scene.dataset}\n{scene.title}"), fontsize=7)
    for motion in {motion.label: motion for scene in scenes for motion in scene.motions}.values():
        axes[0, 0].plot([], [], color=motion.colour, linewidth=3, label=figure_text(motion.label))
    figures.legend_below(figure, axes[0, 0], _foot(scenes, "Arrows: where the head points."), columns=4)
    figure.suptitle(figure_text(title), fontsize=10, x=0.01, ha="left")
    figures.write_figure(figure, path)


def moments(scene: Scene) -> tuple[int, int, int]:
    """Return the first frame, the frame of the prime, and that of the reach, which is the last one."""
    last = scene.n_frames - 1
    return 0, min(round(scene.prime_time * scene.fps), last), last


def _drawn(scene: Scene, motion: ShownMotion, frames: Sequence[int]) -> Float[np.ndarray, "n 2"]:
    """All points of some frames and the goal in the panel's coordinates."""
    points = [_flat(scene, motion.joints[min(frame, len(motion.joints) - 1)]) for frame in frames]
    if scene.goal is not None:
        points.append(_flat(scene, scene.goal.location[None]))
    return np.concatenate(points)


def _flat(scene: Scene, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Picture coordinates: metres along the way to the goal, and height."""
    start = scene.motions[0].joints[0, Joint.PELVIS]
    # Where the licence keeps the goal, the way is that of the motion itself.
    end = scene.motions[0].joints[-1, Joint.PELVIS]
    if scene.goal is not None:
        end = scene.goal.location
    return figures.flattened(points, start, figures.horizontal_direction(end - start), 0.0)


def _draw_pose(axes: Axes, scene: Scene, joints: Float[np.ndarray, "22 3"], *, colour: str, alpha: float) -> None:
    flat = _flat(scene, joints)
    figures.draw_chains(axes, flat, CHAINS, colour, alpha=alpha, linewidth=1.8)
    axes.plot(*flat[Joint.HEAD], "o", color=colour, alpha=alpha, markersize=5.5)


def _draw_gaze(axes: Axes, scene: Scene, frame: int) -> None:
    """Draw the gaze at the prime as a line, and a cross where it passes the goal."""
    gaze = scene.motions[0].gaze
    if gaze is None or scene.goal is None or not gaze.valid[frame]:
        return
    origin = gaze.origin[frame]
    direction = gaze.direction[frame]
    along = max(float((scene.goal.location - origin) @ direction), 0.0)
    begin, end = _flat(scene, np.stack([origin, origin + along * direction]))
    axes.plot([begin[0], end[0]], [begin[1], end[1]], color=_GAZE, linewidth=1.2, linestyle="--")
    axes.plot(*end, "+", color=_GAZE, markersize=11, markeredgewidth=2.2, zorder=5)


def _draw_goal(axes: Axes, scene: Scene) -> None:
    if scene.goal is not None:
        place = _flat(scene, scene.goal.location[None])[0]
        axes.plot(*place, "o", color=_GOAL, markersize=11, alpha=0.75, zorder=4)


def _frame_panel(axes: Axes, points: Float[np.ndarray, "n 2"]) -> None:
    low = points.min(axis=0) - _MARGIN
    high = points.max(axis=0) + _MARGIN
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(min(low[1], 0.0) - 0.05, high[1])
    axes.set_aspect("equal")
    axes.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
    figures.without_frame(axes)


def _foot(scenes: Sequence[Scene], marks: str) -> str:
    """Return what the marks mean, and the notices that the datasets' terms ask for."""
    said = [marks, "Cyan: the goal. Seen at right angles to the way."]
    if any(scene.dataset.startswith("synthetic-") for scene in scenes):
        said.append("Synthetic people.")
    said += dict.fromkeys(scene.notice for scene in scenes if scene.notice)
    return " ".join(said)
