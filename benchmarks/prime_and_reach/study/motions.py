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

from prbench.geometry.skeleton import Joint, head_forward
from prbench.shown import figure_text
from prbench.viewing import figures
from prbench.viewing.replay.scene import GAZE_COLOUR, GOAL_COLOUR, Scene, ShownMotion

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NOTE_CHARACTERS = 70  # that fit below a panel
_POSES = 6
_ARROW = 0.45  # metres
_MARGIN = 0.45  # metres
# Columns of Figure 5.
MOMENTS = ("first frame", "prime", "reach")


@figures.styled
def draw_examples(scenes: Sequence[Scene], path: Path, *, title: str, columns: int = 2) -> str:
    """Draw recorded sequences as in Figures 1 and 2, poses from light to dark, and return the caption.

    Args:
        scenes: Sequences whose recorded motion may be shown, one or more.
        path: PNG, SVG or PDF; replaced when it exists.
        title: What is shown.
        columns: Panels side by side.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    rows, wide = figures.grid_shape(len(scenes), columns)
    figure = figures.new_figure(3.5 * wide, 1.9 * rows + 0.4, layout="constrained")
    axes = figure.subplots(rows, wide, squeeze=False).ravel()
    chosen = [
        np.unique(np.append(np.linspace(0, scene.n_frames - 1, _POSES).round(), moments(scene)[1])).astype(int)
        for scene in scenes
    ]
    for scene, frames, place in zip(scenes, chosen, axes):
        _frame_panel(place, _drawn(scene, scene.motions[0], frames.tolist()))
        place.set_title(figure_text(f"{scene.dataset}\n{scene.title}"))
    figure.draw_without_rendering()  # settles the panels, by whose size bodies are drawn
    for scene, frames, place in zip(scenes, chosen, axes):
        motion = scene.motions[0]
        for frame in frames:
            grey = f"{round(255 * (0.78 - 0.68 * frame / max(scene.n_frames - 1, 1))):02x}"
            _draw_pose(place, scene, motion.joints[frame], colour=f"#{3 * grey}")
        # The gaze at the prime as a line, and a cross where it passes the goal.
        gaze = motion.gaze
        prime = moments(scene)[1]
        if gaze is not None and scene.goal is not None and gaze.valid[prime]:
            origin = gaze.origin[prime]
            direction = gaze.direction[prime]
            along = max(float((scene.goal.location - origin) @ direction), 0.0)
            begin, end = _flat(scene, np.stack([origin, origin + along * direction]))
            place.plot([begin[0], end[0]], [begin[1], end[1]], color=GAZE_COLOUR, linestyle="--", zorder=4)
            place.plot(*end, "+", color=GAZE_COLOUR, markersize=7, markeredgewidth=1.5, zorder=6)
        _draw_goal(place, scene)
    for place in axes[len(scenes) :]:
        place.set_axis_off()
    figure.suptitle(figure_text(title), x=0.01, ha="left")
    # A figure of a single panel is narrower than the note.
    said = _foot(scenes, "Darker: later. Orange: gaze at the prime time.")
    figure.supxlabel(figure_text(textwrap.fill(said, _NOTE_CHARACTERS * wide)), color="0.35")
    figures.write_figure(figure, path, f"{title}. {said}")
    return f"{title}. {said}"


@figures.styled
def draw_moments(scenes: Sequence[Scene], path: Path, *, title: str) -> str:
    """Draw sequences as in Figure 5, poses at the first frame, the prime and the reach, and return the caption.

    An arrow shows where each head points.

    Args:
        scenes: Sequences with their motions, a row each, one or more.
        path: PNG, SVG or PDF; replaced when it exists.
        title: What is shown.

    Raises:
        UsageError: for another kind of file.
        StorageError: if the file cannot be written.
    """
    figure = figures.new_figure(7.0, 1.7 * len(scenes) + 0.6, layout="constrained")
    axes = figure.subplots(len(scenes), len(MOMENTS), squeeze=False)
    for scene, row in zip(scenes, axes, strict=True):
        reach = [_drawn(scene, motion, [*moments(scene)]) for motion in scene.motions]
        for moment, frame, place in zip(MOMENTS, moments(scene), row, strict=True):
            _frame_panel(place, np.concatenate(reach))
            place.set_title(figure_text(f"{moment}, {frame / scene.fps:.2f} s"))
        row[0].set_ylabel(figure_text(f"{scene.dataset}\n{scene.title}"), fontsize=6)
    figure.draw_without_rendering()  # settles the panels, by whose size bodies are drawn
    for scene, row in zip(scenes, axes, strict=True):
        for frame, place in zip(moments(scene), row, strict=True):
            for motion in scene.motions:
                joints = motion.joints[min(frame, len(motion.joints) - 1)]
                _draw_pose(place, scene, joints, colour=motion.colour)
                head = joints[Joint.HEAD]
                points = np.stack([head, head + _ARROW * head_forward(joints, scene.head_tilt_deg)[0]])
                begin, end = _flat(scene, points)
                style = {"arrowstyle": "-|>", "color": motion.colour, "linewidth": 0.9, "mutation_scale": 6}
                place.annotate("", end, begin, arrowprops=style)
            _draw_goal(place, scene)
    for motion in {motion.label: motion for scene in scenes for motion in scene.motions}.values():
        axes[0, 0].plot([], [], color=motion.colour, linewidth=3, label=figure_text(motion.label))
    said = _foot(scenes, "Arrows: where the head points.")
    figures.legend_below(figure, axes[0, 0], said, columns=4)
    figure.suptitle(figure_text(title), x=0.01, ha="left")
    figures.write_figure(figure, path, f"{title}. {said}")
    return f"{title}. {said}"


def moments(scene: Scene) -> tuple[int, int, int]:
    """Return the first frame, the frame of the prime, and that of the reach, which is the last one."""
    return 0, scene.prime_frame, scene.n_frames - 1


def _drawn(scene: Scene, motion: ShownMotion, frames: Sequence[int]) -> Float[np.ndarray, "n 2"]:
    """All points of some frames and the goal in the panel's coordinates."""
    points = [_flat(scene, motion.joints[min(frame, len(motion.joints) - 1)]) for frame in frames]
    if scene.goal is not None:
        points.append(_flat(scene, scene.goal.location[None]))
    return np.concatenate(points)


def _flat(scene: Scene, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Picture coordinates: metres along the way to the goal, and height."""
    return figures.flattened(points, scene.motions[0].joints[0, Joint.PELVIS], _way(scene), 0.0)


def _way(scene: Scene) -> Float[np.ndarray, "3"]:
    """Horizontal unit vector from the first place to the goal; where the licence keeps the goal, to the last place."""
    pelvis = scene.motions[0].joints[:, Joint.PELVIS]
    end = pelvis[-1] if scene.goal is None else scene.goal.location
    return figures.horizontal_direction(end - pelvis[0])


def _draw_pose(axes: Axes, scene: Scene, joints: Float[np.ndarray, "22 3"], *, colour: str) -> None:
    def flat(points: np.ndarray) -> np.ndarray:
        return _flat(scene, points.reshape(-1, 3)).reshape(*points.shape[:-1], 2)

    towards = np.cross(_way(scene), [0.0, 1.0, 0.0])
    figures.draw_bodies(axes, joints[None], colour, flat, towards, head_tilt_deg=scene.head_tilt_deg)


def _draw_goal(axes: Axes, scene: Scene) -> None:
    if scene.goal is not None:
        place = _flat(scene, scene.goal.location[None])[0]
        axes.plot(*place, "s", color=GOAL_COLOUR, markersize=5, zorder=5)


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
    said = [marks, "Blue square: the goal. Seen at right angles to the way."]
    if any(scene.dataset.startswith("synthetic-") for scene in scenes):
        said.append("Synthetic people.")
    said += dict.fromkeys(scene.notice for scene in scenes if scene.notice)
    return " ".join(said)
