"""Sequences as an MP4: the bodies move in real time, beside the curves of the sheet. Needs the extra ``view``.

Still parts of a picture are drawn once, moving parts are drawn over them.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int

from prbench.errors import MissingExtraError, StorageError
from prbench.files.storage import sole_file
from prbench.shown import figure_text
from prbench.viewing.figures import Flatten, Vector, body_lines, draw_bodies, new_figure, styled
from prbench.viewing.replay import scene as replay
from prbench.viewing.replay.sheet import UP, draw_curves, draw_way

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes


# Pictures per second; a sequence of any frame rate plays in real time.
FPS = 20
SIZE = (1280, 720)
_HOLD = 1.0  # seconds that the last picture of a sequence stays
_DPI = 100
_LONGEST_RAY = 6.0  # metres
_FOOTPRINT = 0.5  # metres beside what must be seen
_Update = Callable[[int], object]


@styled
def film_scenes(scenes: Sequence[replay.Scene], path: Path, progress: replay.Progress) -> None:
    """Show sequences one after another, and write the film.

    Args:
        scenes: Scenes to show.
        path: MP4 (H.264) to write; replaced when it exists.
        progress: Called after every picture.

    Raises:
        MissingExtraError: if imageio-ffmpeg is not installed.
        StorageError: if the file cannot be written.
    """
    plans = [shown_frames(scene) for scene in scenes]
    with sole_file(path) as temporary:
        writer = film_writer(temporary, SIZE, FPS)
        try:
            done = 0
            for scene, plan in zip(scenes, plans, strict=True):
                # A slow sequence shows a frame in several pictures; drawing takes the time.
                picture = lru_cache(maxsize=1)(FilmStage(scene).picture)
                for frame in plan.tolist():
                    writer.send(picture(frame))
                    done += 1
                    progress(done, sum(map(len, plans)), scene.sequence_id)
        except OSError as error:
            raise StorageError(f"{path}: the film could not be written ({str(error).splitlines()[0]}).") from error
        finally:
            writer.close()


def film_writer(path: Path, size: tuple[int, int], fps: float) -> Generator[None, bytes | None, None]:
    """Open a film (H.264) that takes pictures with ``send``, as RGB bytes, until it is closed.

    Raises:
        MissingExtraError: if imageio-ffmpeg is not installed.
    """
    try:
        import imageio_ffmpeg
    except ModuleNotFoundError as error:
        raise MissingExtraError("imageio-ffmpeg", "view", "writing MP4") from error
    # Quality is of 10. The index in front, so that a browser can begin to play; bitexact, so that equal scenes are
    # equal bytes.
    how = ["-movflags", "+faststart", "-fflags", "+bitexact", "-flags:v", "+bitexact"]
    options: Any = {"fps": fps, "quality": 7, "macro_block_size": 2, "ffmpeg_log_level": "error"}
    writer = imageio_ffmpeg.write_frames(str(path), size, output_params=how, **options)
    writer.send(None)  # starts the generator
    return writer


def shown_frames(scene: replay.Scene) -> Int[np.ndarray, " pictures"]:
    """Return the frame that each picture shows: the nearest one in time, and the last one for a second more."""
    # A little more than the exact product, so that rounding cannot lose the last picture.
    times = np.arange(int(scene.event_time * FPS + 1e-6) + 1) / FPS
    moving = np.minimum(np.round(times * scene.fps).astype(int), scene.n_frames - 1)
    return np.concatenate([moving, np.full(round(_HOLD * FPS), scene.n_frames - 1)])


class FilmStage:
    """The picture of one sequence at any frame.

    Args:
        scene: The sequence.
    """

    def __init__(self, scene: replay.Scene) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self._scene = scene
        self._moving: list[tuple[Axes, Artist]] = []
        self._updates: list[_Update] = []
        self._figure = new_figure(SIZE[0] / _DPI, SIZE[1] / _DPI, dpi=_DPI)
        self._canvas = FigureCanvasAgg(self._figure)
        write = self._figure.text
        write(0.02, 0.962, figure_text(scene.title), fontsize=13, weight="bold")
        write(0.02, 0.935, figure_text(scene.sequence_id), fontsize=7.5, color="0.35", family="monospace")
        write(0.02, 0.012, figure_text(scene.notice), fontsize=8, color=replay.METHOD_COLOURS[1])
        # The bodies from the side, a panel a motion.
        flat = partial(replay.side_view, axis=scene.picture_axis)
        height = max(2.0, max(float(motion.joints[..., 1].max()) for motion in scene.motions) + 0.1)
        low, high = replay.extent(scene, flat)
        columns = 1 + (len(scene.motions) > 2) + (len(scene.motions) > 6)
        rows = -(-len(scene.motions) // columns)
        place = {"left": 0.04, "right": 0.6, "bottom": 0.07, "top": 0.88, "hspace": 0.3, "wspace": 0.1}
        grid = self._figure.add_gridspec(rows, columns, **place)
        for number, motion in enumerate(scene.motions):
            panel = self._figure.add_subplot(grid[number])
            panel.set(xlim=(low[0] - _FOOTPRINT, high[0] + _FOOTPRINT), ylim=(-0.05, height))
            panel.set_aspect("equal", adjustable="box")
            panel.axhline(0.0, color="0.8", linewidth=0.8, zorder=0)
            panel.tick_params(labelbottom=False)
            title = figure_text(f"{motion.label}\n{replay.verdict(scene, motion)}")
            panel.set_title(title, fontsize=8.5, color=motion.colour, loc="left")
            if scene.goal is not None:
                replay.draw_goal(panel, scene.goal, flat, linewidth=1.0, markersize=4.0, zorder=1)
            self._add_body(panel, motion, flat, np.cross(scene.picture_axis, UP))
        # The sheet's view from above and its curves, in which bodies and the moment move.
        place = {"left": 0.66, "right": 0.98, "bottom": 0.08, "top": 0.9, "hspace": 0.45}
        grid = self._figure.add_gridspec(3, 1, height_ratios=(3.0, 1, 1), **place)
        above, *curves = (self._figure.add_subplot(place) for place in grid)
        draw_way(above, scene)
        for motion in scene.motions:
            self._add_body(above, motion, replay.top_view, UP)
        clock = above.text(0.98, 0.962, "", fontsize=13, weight="bold", transform=self._figure.transFigure, ha="right")
        clock.set_clip_on(False)
        self._add(above, clock, lambda frame: clock.set_text(f"{replay.phase(scene, frame)}{frame / scene.fps:5.2f} s"))
        if scene.goal is not None:
            draw_curves((curves[0], curves[1]), scene, scene.goal)
        for panel in curves:
            panel.set_visible(scene.goal is not None)
            panel.set_xlabel("")
            cursor = panel.axvline(0.0, color="black", linewidth=2.4)
            self._add(panel, cursor, lambda frame, cursor=cursor: cursor.set_xdata([scene.times[frame]] * 2))
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
        return np.asarray(self._canvas.buffer_rgba())[..., :3].tobytes()

    def _add_body(self, panel: Axes, motion: replay.ShownMotion, flat: Flatten, towards: Vector) -> None:
        scene = self._scene
        goal = scene.goal_location
        head_segments = flat(replay.head_rays(motion.joints, scene.head_tilt_deg, goal, _LONGEST_RAY))
        seen = [(head_segments, {"color": motion.colour, "linewidth": 1.2, "linestyle": (0, (4, 2))})]
        if motion.gaze is not None:
            segments = flat(replay.rays(motion.gaze.origin, motion.gaze.direction, goal, _LONGEST_RAY))
            # A line to NaN is not drawn, which hides the ray where the gaze is not valid.
            segments = np.where(motion.gaze.valid[:, None, None], segments, np.nan)
            seen.append((segments, {"color": replay.GAZE_COLOUR, "linewidth": 1.6}))
        for segments, style in seen:
            (line,) = panel.plot([], [], zorder=2, **style)
            self._add(panel, line, lambda frame, line=line, ends=segments: line.set_data(*ends[frame].T))
        drawn: dict[str, Any] = {"flat": flat, "towards": towards, "head_tilt_deg": scene.head_tilt_deg}
        lines = draw_bodies(panel, motion.joints[:1], motion.colour, **drawn)

        def move(frame: int) -> None:
            lines.set(**body_lines(panel, motion.joints[[frame]], motion.colour, **drawn))

        self._add(panel, lines, move)

    def _add(self, panel: Axes, artist: Artist, update: _Update) -> None:
        # matplotlib leaves animated artists out of an ordinary drawing, so they are not part of the background.
        artist.set_animated(True)
        self._moving.append((panel, artist))
        self._updates.append(update)
