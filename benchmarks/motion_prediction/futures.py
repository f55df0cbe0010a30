"""Possible futures of a window as a fan of bodies over the observed half second.

Each predictor fills a row: bodies from the side at some moments after the last observed frame, ways from above, and how
far each future is from what happened. What was observed is grey, what happened is black.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from prbench.errors import UsageError
from prbench.shown import figure_text
from prbench.viewing.figures import (
    draw_chains,
    flattened,
    horizontal_direction,
    new_figure,
    require_drawable,
    shades,
    side_by_side,
    square_limits,
    without_frame,
    write_figure,
)
from prbench_benchmarks.motion_prediction.joint_sets import JointSet
from prbench_benchmarks.motion_prediction.metrics import joint_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RECORDED_COLOUR = "#000000"
OBSERVED_COLOUR = "#8c8c8c"
GAZE_COLOUR = "#e69f00"
GOAL_COLOUR = "#56b4e9"
_MOMENTS = (0.5, 1.0, 1.5, 2.0)  # seconds after the last observed frame
_OBSERVED_POSES = 3  # of the observed frames, evenly spread
_SPACING = 0.45  # metres between the bodies of two moments
_MARGIN = 0.3  # metres
_LOOK = 0.6  # metres of the line that shows where gaze points
_LINE = 190  # characters of the note below the panels
MOST_ROWS = 12


@dataclass(frozen=True, eq=False)
class Fan:
    """The futures of one predictor."""

    label: str
    colour: str
    """``#rrggbb``."""
    joints: Float[np.ndarray, "samples future joints 3"]
    """Room, metres."""
    score: str
    """What it scored, in words."""


@dataclass(frozen=True, eq=False)
class ShownWindow:
    """One window with the futures that predictors see in it. Room, metres."""

    window_id: str
    dataset: str
    synthetic: bool
    joint_set: JointSet
    fps: float
    observed: Float[np.ndarray, "observed joints 3"]
    recorded: Float[np.ndarray, "scored joints 3"]
    """What happened, up to the last scored frame."""
    gaze: Float[np.ndarray, "observed 3"]
    gaze_valid: Bool[np.ndarray, " observed"]
    goal: Float[np.ndarray, "3"] | None
    """Where the hand is at the event; None where the window does not reach it."""
    fans: tuple[Fan, ...]
    notice: str
    """Sentence that the dataset's terms ask for; empty where they ask for none."""

    @property
    def last_pose(self) -> Float[np.ndarray, "joints 3"]:
        """The last observed pose."""
        return self.observed[-1]

    @property
    def floor(self) -> float:
        """Height of the lowest joint that was seen, metres."""
        return float(self.observed[..., 1].min())

    @property
    def sideways(self) -> Float[np.ndarray, "3"]:
        """Horizontal unit vector that points to the right in side views: where the body goes, or else faces."""
        pelvis = self.joint_set.index(self.joint_set.pelvis)[0]
        way = self.recorded[-1, pelvis] - self.observed[0, pelvis]
        if np.hypot(way[0], way[2]) < 0.1:
            way = self.joint_set.last_pose_frame(self.last_pose[None])[0, :3, 2]
        return horizontal_direction(way)


def draw_futures(windows: Sequence[ShownWindow], path: Path, *, dpi: int = 110) -> None:
    """Draw windows below one another, a row for each predictor.

    Args:
        windows: What is shown.
        path: ``.png`` or ``.svg``; replaced when it exists.
        dpi: Resolution of a PNG.

    Raises:
        UsageError: for another kind of file, or too many rows for one picture.
        StorageError: if the file cannot be written.
    """
    require_drawable(path)
    rows = [(window, fan) for window in windows for fan in window.fans]
    if not 0 < len(rows) <= MOST_ROWS:
        raise UsageError(f"{path}: expected 1 to {MOST_ROWS} rows (windows times predictors), found {len(rows)}.")
    height = 2.9 * len(rows) + 1.1
    figure = new_figure(14.0, height, dpi=dpi)
    grid = {"left": 0.005, "right": 0.992, "top": 1 - 0.55 / height, "bottom": 0.8 / height, "wspace": 0.13}
    panels = figure.subplots(
        len(rows), 3, squeeze=False, width_ratios=(3.4, 1.2, 1.2), gridspec_kw={**grid, "hspace": 0.26}
    )
    for (window, fan), (bodies, above, errors) in zip(rows, panels, strict=True):
        _draw_bodies(bodies, window, fan)
        # Draw ways of the pelvis and the wrists from above.
        pelvis = window.joint_set.index(window.joint_set.pelvis)[0]
        wrists = window.joint_set.index(*window.joint_set.wrists)
        for joints, colour in reversed(list(zip(fan.joints, _shades(fan), strict=True))):
            above.plot(joints[:, pelvis, 0], joints[:, pelvis, 2], color=colour, linewidth=1.4)
            above.plot(joints[-1, pelvis, 0], joints[-1, pelvis, 2], "s", color=colour, markersize=4)
            above.plot(joints[-1, wrists, 0], joints[-1, wrists, 2], ".", color=colour, markersize=4)
        for joints, colour, width in ((window.observed, OBSERVED_COLOUR, 3.0), (window.recorded, RECORDED_COLOUR, 1.1)):
            above.plot(joints[:, pelvis, 0], joints[:, pelvis, 2], color=colour, linewidth=width)
        end = window.recorded[-1]
        above.plot(end[pelvis, 0], end[pelvis, 2], "s", color=RECORDED_COLOUR, markersize=4)
        above.plot(end[wrists, 0], end[wrists, 2], ".", color=RECORDED_COLOUR, markersize=4)
        shown = [window.observed[:, pelvis], window.recorded[:, pelvis], end[wrists]]
        shown += [each.joints[:, :, pelvis].reshape(-1, 3) for each in window.fans]
        if window.gaze_valid[-1]:
            look = _look(window)
            above.plot(look[:, 0], look[:, 2], color=GAZE_COLOUR, linewidth=1.4)
            shown.append(look)
        if window.goal is not None:
            above.plot(window.goal[0], window.goal[2], "o", color=GOAL_COLOUR, markersize=8, alpha=0.8)
            shown.append(window.goal[None])
        x, z = square_limits(np.concatenate(shown)[:, [0, 2]], margin=_MARGIN)
        # x grows to the left, as for somebody who looks down on a body that faces away from them.
        above.set_xlim(*reversed(x))
        above.set_ylim(*z)
        above.set_aspect("equal")
        above.set_title("from above, m; squares: pelvis, dots: wrists at the end", fontsize=7.5, loc="left")
        above.tick_params(labelsize=6)
        _draw_errors(errors, window, fan)
        title = f"{window.window_id}\n{fan.label}: {len(fan.joints)} futures{f', {fan.score}' if fan.score else ''}"
        bodies.set_title(figure_text(title), fontsize=8.5, loc="left")
    figure.supxlabel(figure_text(_foot(windows)), fontsize=7.5, color="0.35", x=0.01, y=0.01, ha="left")
    write_figure(figure, path)


def _foot(windows: Sequence[ShownWindow]) -> str:
    said = [
        "Grey: the observed half second, the last pose darkest; black: what happened; a shade is a future, the same in",
        "all panels of a row.",
    ]
    if any(window.gaze_valid.any() for window in windows):
        said.append("Orange: recorded gaze at the last observed frame.")
    if any(window.goal is not None for window in windows):
        said.append("Cyan: the goal at the event.")
    if any(window.synthetic for window in windows):
        said.append("Synthetic people.")
    notices = dict.fromkeys(window.notice for window in windows if window.notice)
    return "\n".join((*textwrap.wrap(" ".join(said), _LINE), *notices)).strip()


def moments_of(window: ShownWindow) -> list[tuple[str, int]]:
    """Moments that are drawn, and the frame of each after the last observed one, from 0 on."""
    frames = [(seconds, round(seconds * window.fps) - 1) for seconds in _MOMENTS]
    n_future = min((fan.joints.shape[1] for fan in window.fans), default=0)
    return [(f"+{seconds:g} s", frame) for seconds, frame in frames if frame < n_future]


def _draw_bodies(axes: Axes, window: ShownWindow, fan: Fan) -> None:
    """Draw the observed half second, then all futures at some moments, each moment at a place of its own."""
    pelvis = window.last_pose[window.joint_set.index(window.joint_set.pelvis)[0]]
    places = np.linspace(0, len(window.observed) - 1, _OBSERVED_POSES).round().astype(int)
    observed = window.observed[places]
    moments = moments_of(window)
    groups = [observed, *(_poses_at(window, fan, frame) for _, frame in moments)]
    clouds = [flattened(poses.reshape(-1, 3), pelvis, window.sideways, 0.0) for poses in groups]
    shifts = side_by_side(clouds, spacing=_SPACING)
    for colour, pose in zip(reversed(shades(OBSERVED_COLOUR, len(observed))), observed, strict=True):
        _draw_pose(axes, window, pose, pelvis, shifts[0], colour)
    _draw_look(axes, window, pelvis, shifts[0])
    for (_, frame), shift in zip(moments, shifts[1:], strict=True):
        for pose, colour in reversed(list(zip(fan.joints[:, frame], _shades(fan), strict=True))):
            _draw_pose(axes, window, pose, pelvis, shift, colour)
        if frame < len(window.recorded):
            _draw_pose(axes, window, window.recorded[frame], pelvis, shift, RECORDED_COLOUR, linewidth=1.1)
        goal = _goal_at(window, frame)
        if goal is not None:
            place = flattened(goal[None], pelvis, window.sideways, shift)[0]
            axes.plot(*place, "o", color=GOAL_COLOUR, markersize=8, alpha=0.8, zorder=4)
    names = ["observed", *(name for name, _ in moments)]
    for name, points, shift in zip(names, clouds, shifts, strict=True):
        centre = float(points[:, 0].mean()) + shift
        axes.text(centre, window.floor - 0.1, name, fontsize=7, ha="center", va="top", color="0.35")
    everything = np.concatenate([points + np.array([shift, 0.0]) for points, shift in zip(clouds, shifts, strict=True)])
    axes.set_xlim(everything[:, 0].min() - _MARGIN, everything[:, 0].max() + _MARGIN)
    axes.set_ylim(min(window.floor, float(everything[:, 1].min())) - 0.3, everything[:, 1].max() + 0.15)
    axes.axhline(window.floor, color="0.8", linewidth=0.8, zorder=0)
    axes.set_aspect("equal")
    without_frame(axes)


def _poses_at(window: ShownWindow, fan: Fan, frame: int) -> Float[np.ndarray, "poses joints 3"]:
    """All that is drawn at one moment; the goal is put where a joint is, so that there is room for it."""
    poses = [fan.joints[:, frame]]
    if frame < len(window.recorded):
        poses.append(window.recorded[None, frame])
    goal = _goal_at(window, frame)
    if goal is not None:
        poses.append(np.broadcast_to(goal, (1, *fan.joints.shape[2:])))
    return np.concatenate(poses)


def _goal_at(window: ShownWindow, frame: int) -> Float[np.ndarray, "3"] | None:
    """The goal, up to the event: what futures show after it nobody has recorded."""
    return window.goal if frame < len(window.recorded) else None


def _shades(fan: Fan) -> list[tuple[float, float, float]]:
    return shades(fan.colour, len(fan.joints))


def _draw_pose(
    axes: Axes,
    window: ShownWindow,
    pose: Float[np.ndarray, "joints 3"],
    pelvis: Float[np.ndarray, "3"],
    shift: float,
    colour: object,
    *,
    linewidth: float = 1.5,
) -> None:
    flat = flattened(pose, pelvis, window.sideways, shift)
    draw_chains(axes, flat, window.joint_set.chains, colour, linewidth=linewidth)
    axes.plot(*flat[window.joint_set.index(window.joint_set.head)[0]], "o", color=colour, markersize=4.0)


def _draw_look(axes: Axes, window: ShownWindow, pelvis: Float[np.ndarray, "3"], shift: float) -> None:
    """Draw where gaze points in the last observed frame, where it was measured."""
    if window.gaze_valid[-1]:
        axes.plot(*flattened(_look(window), pelvis, window.sideways, shift).T, color=GAZE_COLOUR, linewidth=1.4)


def _look(window: ShownWindow) -> Float[np.ndarray, "2 3"]:
    head = window.last_pose[window.joint_set.index(window.joint_set.head)[0]]
    return np.stack([head, head + _LOOK * window.gaze[-1]])


def _draw_errors(axes: Axes, window: ShownWindow, fan: Fan) -> None:
    """Draw the mean distance of the joints from what happened over the seconds."""
    errors = _errors(window, fan)
    seconds = np.arange(1, errors.shape[1] + 1) / window.fps
    for track, colour in reversed(list(zip(errors, _shades(fan), strict=True))):
        axes.plot(seconds, track, color=colour, linewidth=1.1)
    # The same for all rows of a window, so that rows compare.
    axes.set_ylim(0.0, 1.05 * max(float(_errors(window, each).max()) for each in window.fans) + 1e-3)
    axes.set_title("joints from what happened, mean, m, over seconds", fontsize=7.5, loc="left")
    axes.tick_params(labelsize=6)


def _errors(window: ShownWindow, fan: Fan) -> Float[np.ndarray, "samples scored"]:
    """Mean distance of the joints from what happened, metres."""
    n = min(len(window.recorded), fan.joints.shape[1])
    return joint_errors(fan.joints[None, :, :n], window.recorded[None, :n])[0].mean(axis=-1)
