"""Sequences as an MP4: the bodies move in real time, beside the curves of the sheet. Needs the extra ``view``.

Still parts of a picture are drawn once, moving parts are drawn over them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import MissingExtraError, StorageError
from prbench.files.storage import sole_file
from prbench.geometry.skeleton import Joint
from prbench.shown import figure_text
from prbench.viewing.figures import new_figure
from prbench.viewing.replay.scene import (
    GAZE_COLOUR,
    MARK_COLOUR,
    METHOD_COLOURS,
    Goal,
    Progress,
    Scene,
    ShownMotion,
    bone_segments,
    draw_bodies,
    draw_goal,
    extent,
    gaze_distance,
    gaze_style,
    head_rays,
    limit_top_view,
    mark_times,
    measure,
    phase,
    rays,
    side_view,
    top_view,
    verdict,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Pictures per second; a sequence of any frame rate plays in real time.
FPS = 20
SIZE = (1280, 720)
_HOLD = 1.0  # seconds that the last picture of a sequence stays
_QUALITY = 7  # of 10, as the encoder's wrapper counts
_LEFT = 0.04
_WIDTH = 0.56
_BOTTOM = 0.09
_TOP = 0.895
_DPI = 100
_LONGEST_RAY = 6.0  # metres
_FOOTPRINT = 0.5  # metres around what must be seen
_Flatten = Callable[[np.ndarray], np.ndarray]
_Update = Callable[[int], None]


def film_scenes(scenes: Sequence[Scene], path: Path, progress: Progress) -> None:
    """Show sequences one after another, and write the film.

    Args:
        scenes: Scenes to show.
        path: MP4 (H.264) to write; replaced when it exists.
        progress: Called after every picture.

    Raises:
        MissingExtraError: if imageio-ffmpeg is not installed.
        StorageError: if the file cannot be written.
    """
    try:
        import imageio_ffmpeg
    except ModuleNotFoundError as error:
        raise MissingExtraError("imageio-ffmpeg", "view", "writing MP4") from error
    plans = [shown_frames(scene) for scene in scenes]
    with sole_file(path) as temporary:
        writer = imageio_ffmpeg.write_frames(
            str(temporary),
            SIZE,
            fps=FPS,
            quality=_QUALITY,
            macro_block_size=2,
            ffmpeg_log_level="error",
            # The index in front, so that a browser can begin to play; bitexact, so that equal scenes are equal bytes.
            output_params=["-movflags", "+faststart", "-fflags", "+bitexact", "-flags:v", "+bitexact"],
        )
        try:
            # Starts the generator, as imageio-ffmpeg asks for.
            writer.send(None)
            done = 0
            for scene, plan in zip(scenes, plans, strict=True):
                stage = FilmStage(scene, SIZE)
                picture = b""
                shown = -1
                for frame in plan:
                    if frame != shown:  # a slow sequence shows a frame in several pictures; drawing takes the time
                        picture = stage.picture(int(frame))
                        shown = frame
                    writer.send(picture)
                    done += 1
                    progress(done, sum(map(len, plans)), scene.sequence_id)
        except OSError as error:
            raise StorageError(f"{path}: the film could not be written ({str(error).splitlines()[0]}).") from error
        finally:
            writer.close()


def shown_frames(scene: Scene) -> Int[np.ndarray, " pictures"]:
    """Return the frame that each picture shows: the nearest one in time, and the last one for a second more."""
    # A little more than the exact product, so that rounding cannot lose the last picture.
    times = np.arange(int(scene.event_time * FPS + 1e-6) + 1) / FPS
    moving = np.minimum(np.round(times * scene.fps).astype(int), scene.n_frames - 1)
    return np.concatenate([moving, np.full(round(_HOLD * FPS), scene.n_frames - 1)])


class FilmStage:
    """The picture of one sequence at any frame.

    Args:
        scene: The sequence.
        size: Width and height of the picture, pixels.
    """

    def __init__(self, scene: Scene, size: tuple[int, int]) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self._scene = scene
        self._moving: list[tuple[Axes, Artist]] = []
        self._updates: list[_Update] = []
        self._figure = new_figure(size[0] / _DPI, size[1] / _DPI, dpi=_DPI)
        self._canvas = FigureCanvasAgg(self._figure)
        self._write_texts()
        self._build_side_views()
        self._build_top_view()
        if scene.goal is not None:
            self._build_curves(scene.goal)
        self._canvas.draw()
        # Everything still is drawn once and kept as pixels; a picture restores these and draws what moves on top.
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)

    def picture(self, frame: int) -> bytes:
        """Return the RGB bytes of one frame, row by row from the top."""
        self._canvas.restore_region(self._background)
        for update in self._updates:
            update(frame)
        for axes, artist in self._moving:
            axes.draw_artist(artist)
        pixels = np.asarray(self._canvas.buffer_rgba())
        return np.ascontiguousarray(pixels[..., :3]).tobytes()

    def _write_texts(self) -> None:
        scene = self._scene
        write = self._figure.text
        write(0.02, 0.962, figure_text(scene.title), fontsize=13, weight="bold")
        write(0.02, 0.935, figure_text(scene.sequence_id), fontsize=7.5, color="0.35", family="monospace")
        if scene.notice:
            write(0.02, 0.012, figure_text(scene.notice), fontsize=8, color=METHOD_COLOURS[1])

    def _build_side_views(self) -> None:
        scene = self._scene
        axis = scene.picture_axis
        height = max(2.0, max(float(motion.joints[..., 1].max()) for motion in scene.motions) + 0.1)
        low, high = extent(scene, lambda points: side_view(points, axis))
        for panel, motion in zip(_side_panels(self._figure, len(scene.motions)), scene.motions, strict=True):
            _fit_limits(panel, (low[0] - _FOOTPRINT, high[0] + _FOOTPRINT), (-0.05, height))
            panel.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
            panel.tick_params(labelsize=7, length=2)
            panel.set_ylabel("m", fontsize=7.5)
            for side in ("top", "right"):
                panel.spines[side].set_visible(False)
            panel.set_title(
                figure_text(motion.label), fontsize=9.5, color=motion.colour, weight="bold", loc="left", pad=2
            )
            panel.set_title(verdict(scene, motion), fontsize=7.5, color="0.35", loc="right", pad=3)
            self._add_goal(panel, lambda points: side_view(points, axis))
            self._add_body(panel, motion, lambda points: side_view(points, axis))

    def _build_top_view(self) -> None:
        scene = self._scene
        panel = self._figure.add_axes((0.66, 0.47, 0.25, 0.445))
        self._add_goal(panel, top_view)
        for motion in scene.motions:
            path = top_view(motion.joints[:, Joint.PELVIS])
            panel.plot(*path.T, color=motion.colour, linewidth=0.9, alpha=0.5)
            self._add_body(panel, motion, top_view)
        limit_top_view(panel, scene, least=1.4, margin=_FOOTPRINT)
        panel.set_title("seen from above (m)", fontsize=8, loc="left", pad=3)
        place = {"transform": self._figure.transFigure, "clip_on": False, "ha": "right"}
        clock = panel.text(0.98, 0.962, "", fontsize=13, weight="bold", **place)
        self._add(panel, clock, lambda frame: clock.set_text(f"{phase(scene, frame)}{frame / scene.fps:5.2f} s"))
        panel.tick_params(labelsize=7)
        panel.grid(alpha=0.25, linewidth=0.6)

    def _build_curves(self, goal: Goal) -> None:
        scene = self._scene
        ray = self._figure.add_axes((0.65, 0.27, 0.33, 0.12))
        wrist = self._figure.add_axes((0.65, 0.09, 0.33, 0.12))
        for motion in scene.motions:
            values = measure(motion, goal, scene.head_tilt_deg)
            ray.plot(scene.times, values.head_distance, color=motion.colour, linewidth=1.3)
            wrist.plot(scene.times, values.wrist_distance, color=motion.colour, linewidth=1.3)
            if motion.gaze is not None:
                style = {"linewidth": 0.9, "zorder": 1.5, **gaze_style(motion)}
                ray.plot(scene.times, gaze_distance(motion.gaze, goal), **style)
        limits = scene.thresholds.prime_distance, scene.thresholds.reach_distance
        titles = "goal to head ray (m)", "goal to nearer wrist (m)"
        for panel, limit, title, what in zip((ray, wrist), limits, titles, ("primed", "reached"), strict=True):
            panel.axhline(limit, color=MARK_COLOUR, linewidth=0.8, linestyle=":")
            panel.set(xlim=(0, scene.event_time * 1.01), ylim=(0, min(panel.get_ylim()[1], 2.5)))
            panel.set_title(f"{title}; {what} below {limit * 100:.0f} cm", fontsize=8, loc="left", pad=3)
            panel.tick_params(labelsize=7)
            mark_times(panel, scene)
            self._add_cursor(panel)
        wrist.set_xlabel(f"time (s); grey: prime time ± {scene.thresholds.prime_window:g} s", fontsize=7.5)

    def _add_goal(self, panel: Axes, flat: _Flatten) -> None:
        if self._scene.goal is not None:
            corners = flat(self._scene.goal.box_corners)
            draw_goal(panel, corners, flat(self._scene.goal.location), linewidth=1.0, markersize=4.0, zorder=1)

    def _add_body(self, panel: Axes, motion: ShownMotion, flat: _Flatten) -> None:
        scene = self._scene
        goal = scene.goal_location
        points = flat(motion.joints)
        head_segments = flat(head_rays(motion.joints, scene.head_tilt_deg, goal, _LONGEST_RAY))
        self._add_ray(panel, head_segments, {"color": motion.colour, "linewidth": 1.2, "linestyle": (0, (4, 2))})
        if motion.gaze is not None:
            segments = flat(rays(motion.gaze.origin, motion.gaze.direction, goal, _LONGEST_RAY))
            # A line to NaN is not drawn, which hides the ray where the gaze is not valid.
            segments = np.where(motion.gaze.valid[:, None, None], segments, np.nan)
            self._add_ray(panel, segments, {"color": GAZE_COLOUR, "linewidth": 1.6})
        lines, head = draw_bodies(panel, points[:1], motion.colour)
        bones = bone_segments(points)
        self._add(panel, lines, lambda frame: lines.set_segments(list(bones[frame])))
        self._add(panel, head, lambda frame: head.set_data(*points[frame, Joint.HEAD, :, None]))

    def _add_ray(self, panel: Axes, segments: Float[np.ndarray, "n 2 2"], style: dict[str, Any]) -> None:
        (line,) = panel.plot([], [], zorder=2, **style)
        self._add(panel, line, lambda frame: line.set_data(*segments[frame].T))

    def _add_cursor(self, panel: Axes) -> None:
        times = self._scene.times
        cursor = panel.axvline(0.0, color="black", linewidth=2.4)
        self._add(panel, cursor, lambda frame: cursor.set_xdata([times[frame], times[frame]]))

    def _add(self, panel: Axes, artist: Artist, update: _Update) -> None:
        # matplotlib leaves animated artists out of an ordinary drawing, so they are not part of the background.
        artist.set_animated(True)
        self._moving.append((panel, artist))
        self._updates.append(update)


def _side_panels(figure: Figure, n_motions: int) -> list[Axes]:
    """Add one panel a motion, in one column for up to two motions, two for up to six, else three."""
    columns = 1 + (n_motions > 2) + (n_motions > 6)
    rows = -(-n_motions // columns)
    width = _WIDTH / columns
    height = (_TOP - _BOTTOM) / rows
    panels = []
    for number in range(n_motions):
        row, column = divmod(number, columns)
        left = _LEFT + column * width
        bottom = _TOP - (row + 1) * height + 0.035
        panels.append(figure.add_axes((left, bottom, width - 0.025, height - 0.065)))
    return panels


def _fit_limits(axes: Axes, across: tuple[float, float], up: tuple[float, float]) -> None:
    """Show at least this range with equal scales; the rest of the panel goes to both sides, or to the top."""
    figure = axes.get_figure(root=True)
    assert figure is not None, "the axes stand in a figure"
    place = axes.get_position()
    # Places are shares of the figure; metres need the same scale on both axes.
    ratio = (place.width * figure.get_figwidth()) / (place.height * figure.get_figheight())
    width = across[1] - across[0]
    height = up[1] - up[0]
    more_across = max(height * ratio - width, 0.0)
    more_up = max(width / ratio - height, 0.0)
    axes.set_xlim(across[0] - more_across / 2, across[1] + more_across / 2)
    axes.set_ylim(up[0], up[1] + more_up)
