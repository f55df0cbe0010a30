"""Possible futures of windows in the HTML player: what was observed moves, then all futures fan out from it.

Needs the extra ``view``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

from prbench.files.storage import sole_writer, write_text
from prbench.shown import html
from prbench.viewing.figures import shades
from prbench.viewing.replay.page import (
    HOLD,
    Act,
    overlay_box,
    place_camera,
    recorded_page,
    set_up_floor,
    swatch,
    viewer,
    with_box,
)
from prbench.viewing.replay.scene import Progress, rgb
from prbench_benchmarks.motion_prediction.futures import (
    GAZE_COLOUR,
    GOAL_COLOUR,
    OBSERVED_COLOUR,
    RECORDED_COLOUR,
    Fan,
    ShownWindow,
)

if TYPE_CHECKING:
    from viser import ViserServer

_LOOK = 1.5  # metres of the line that shows where gaze points
_HEAD_RADIUS = 0.06
_BETWEEN = 1.2  # metres between the lanes of two predictors


def write_future_page(windows: Sequence[ShownWindow], path: Path, progress: Progress) -> None:
    """Show windows one after another on the time line of a 3-D viewer, and write the page.

    Args:
        windows: What is shown.
        path: HTML to write; replaced when it exists.
        progress: Called after every frame.

    Raises:
        MissingExtraError: if viser is not installed.
        StorageError: if the file cannot be written.
    """
    with viewer() as server:
        set_up_floor(server)
        place_camera(server, *_camera_of(windows[0]))
        acts = [
            Act(FutureStage(server, number, window), n_frames_of(window), window.fps, window.window_id)
            for number, window in enumerate(windows)
        ]
        page = recorded_page(server, acts, progress)
    with sole_writer(path):
        write_text(path, with_box(page, _box(windows)))


def n_frames_of(window: ShownWindow) -> int:
    """Frames of a window: the observed ones, and the longest future."""
    return len(window.observed) + max(fan.joints.shape[1] for fan in window.fans)


def lanes_of(window: ShownWindow) -> Float[np.ndarray, "fans 3"]:
    """Offset of each predictor's lane, metres: side by side across the way, so that fans do not cover one another."""
    across = np.cross([0.0, 1.0, 0.0], window.sideways)
    pelvis = window.joint_set.index(window.joint_set.pelvis)[0]
    spans = [np.ptp(fan.joints[:, :, pelvis] @ across) for fan in window.fans]
    places = np.arange(len(window.fans)) - (len(window.fans) - 1) / 2
    return places[:, None] * (_BETWEEN + float(max(spans))) * across


def _camera_of(window: ShownWindow) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Place a camera at the side of the first window, far enough to see all lanes."""
    pelvis = window.joint_set.index(window.joint_set.pelvis)[0]
    ways = [
        fan.joints[:, :, pelvis].reshape(-1, 3) + lane for fan, lane in zip(window.fans, lanes_of(window), strict=True)
    ]
    points = np.concatenate([window.observed[:, pelvis], *ways])
    low = points.min(axis=0)
    high = points.max(axis=0)
    look_at = np.array([(low[0] + high[0]) / 2, 0.9, (low[2] + high[2]) / 2])
    across = np.cross([0.0, 1.0, 0.0], window.sideways)
    away = 0.55 * window.sideways - 0.85 * across
    distance = 1.7 + 0.55 * float(np.linalg.norm((high - low)[[0, 2]]))
    look_at = look_at + np.cross(away, [0.0, 1.0, 0.0]) * 0.15 * distance  # of the picture: the overlay stands there
    return look_at + away * distance + [0.0, 0.25 * distance, 0.0], look_at


class FutureStage:
    """The bodies of one window, hidden until its turn.

    Args:
        server: Server that keeps the scene.
        number: Number of the window on the page.
        window: What is shown.
    """

    def __init__(self, server: ViserServer, number: int, window: ShownWindow) -> None:
        self._root = server.scene.add_frame(f"/window_{number}", show_axes=False, visible=False)
        # Heights count from the floor of the page.
        down = np.array([0.0, -window.floor, 0.0])
        self._lanes = [
            _Lane(server, f"/window_{number}/fan_{lane}", window, fan, offset + down)
            for lane, (fan, offset) in enumerate(zip(window.fans, lanes_of(window), strict=True))
        ]

    def show(self, visible: bool) -> None:
        """See :class:`prbench.viewing.replay.page.Stage`."""
        self._root.visible = visible

    def set_frame(self, frame: int) -> None:
        """See :class:`prbench.viewing.replay.page.Stage`."""
        for lane in self._lanes:
            lane.set_frame(frame)


class _Lane:
    """What one predictor sees in a window: the observed body, its futures, and what happened."""

    def __init__(
        self, server: ViserServer, name: str, window: ShownWindow, fan: Fan, offset: Float[np.ndarray, "3"]
    ) -> None:
        n_observed = len(window.observed)
        n_future = fan.joints.shape[1]
        held = np.repeat(window.last_pose[None], n_future, axis=0)
        observed = np.concatenate([window.observed, held]) + offset
        # Before the border everything lies on the observed body, and is as good as not there.
        before = np.broadcast_to(window.observed, (len(fan.joints), *window.observed.shape))
        futures = np.concatenate([before, fan.joints], axis=1) + offset
        recorded = np.concatenate([window.observed, _held_to(window.recorded, n_future)]) + offset
        bones = np.array(window.joint_set.bones)
        head = window.joint_set.index(window.joint_set.head)[0]
        # One node for all futures: (bodies * bones, 2 ends, 3).
        each = np.repeat(_vertex_colours(shades(fan.colour, len(fan.joints))), len(bones), axis=0)
        colours = np.repeat(each[:, None], 2, axis=1)
        self._moving = []
        for what, bodies, colour, width in (
            ("observed", observed[None], rgb(OBSERVED_COLOUR), 0.03),
            ("futures", futures, colours, 0.014),
            ("recorded", recorded[None], rgb(RECORDED_COLOUR), 0.012),
        ):
            positions = np.moveaxis(bodies[:, :, bones], 0, 1).reshape(n_observed + n_future, -1, 2, 3)
            handle = server.scene.add_line_segments(
                f"{name}/{what}", positions[0].astype(np.float32), colors=colour, thickness=width
            )
            self._moving.append((positions.astype(np.float32), handle))
        self._heads = observed[:, head]
        self._head = server.scene.add_icosphere(
            f"{name}/head", radius=_HEAD_RADIUS, color=rgb(OBSERVED_COLOUR), subdivisions=2
        )
        self._add_gaze(server, name, window, observed, head, n_future)
        server.scene.add_label(f"{name}/label", fan.label, position=tuple(observed[0, head] + [0.0, 0.3, 0.0]))
        if window.goal is not None:
            server.scene.add_icosphere(
                f"{name}/goal",
                radius=0.05,
                color=rgb(GOAL_COLOUR),
                subdivisions=2,
                position=tuple(window.goal + offset),
            )

    def _add_gaze(
        self, server: ViserServer, name: str, window: ShownWindow, observed: np.ndarray, head: int, n_future: int
    ) -> None:
        if not window.gaze_valid.any():
            return
        length = np.where(window.gaze_valid, _LOOK, 0.0)[:, None]  # no length where gaze was not measured
        tips = observed[: len(length), head] + length * window.gaze
        # The last look stays while the futures fan out.
        tips = np.concatenate([tips, np.repeat(tips[-1:], n_future, axis=0)])
        positions = np.stack([observed[:, head], tips], axis=1)[:, None]
        handle = server.scene.add_line_segments(
            f"{name}/gaze", positions[0].astype(np.float32), colors=rgb(GAZE_COLOUR), thickness=0.014
        )
        self._moving.append((positions.astype(np.float32), handle))

    def set_frame(self, frame: int) -> None:
        """Move everything to a frame."""
        self._head.position = self._heads[frame]
        for positions, handle in self._moving:
            handle.points = positions[frame]


def _vertex_colours(shade: Sequence[tuple[float, float, float]]) -> UInt8[np.ndarray, "n 3"]:
    """Colours of single vertices, which the viewer takes as linear light (those of a whole node it does not)."""
    return np.rint(255 * np.array(shade) ** 2.2).astype(np.uint8)


def _held_to(recorded: Float[np.ndarray, "scored joints 3"], n: int) -> Float[np.ndarray, "n joints 3"]:
    """What happened, its last pose held where the window ends with an event."""
    return recorded[np.minimum(np.arange(n), len(recorded) - 1)]


def _box(windows: Sequence[ShownWindow]) -> str:
    key = [("observed, and its last pose", OBSERVED_COLOUR), ("what happened", RECORDED_COLOUR)]
    if any(window.gaze_valid.any() for window in windows):
        key.append(("recorded gaze, held after the last observed frame", GAZE_COLOUR))
    if any(window.goal is not None for window in windows):
        key.append(("goal at the event", GOAL_COLOUR))
    parts = []
    start = 0.0
    for window in windows:
        end = start + n_frames_of(window) / window.fps
        border = start + len(window.observed) / window.fps
        fans = "".join(
            f"<div>{swatch(fan.colour)}<b>{html(fan.label)}</b>: {len(fan.joints)} futures"
            f"{html(f', {fan.score}') if fan.score else ''}</div>"
            for fan in window.fans
        )
        synthetic = " (synthetic people)" if window.synthetic else ""
        when = f"{start:.1f} to {end:.1f} s, futures from {border:.1f} s"
        parts.append(
            f'<h2>{html(window.dataset)}{synthetic} ({when})</h2><div class="id">{html(window.window_id)}</div>{fans}'
        )
        start = end + HOLD
    return overlay_box([window.notice for window in windows], key, parts)
