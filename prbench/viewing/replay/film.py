"""Sequences as an MP4: the bodies move in real time, above the curves of the sheet. Needs the extra ``view``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

from prbench.errors import MissingExtraError, StorageError
from prbench.locks import sole_file
from prbench.viewing.replay.film_stage import FilmStage
from prbench.viewing.replay.scene import Progress, Scene

FPS = 20
"""Pictures per second; a sequence of any frame rate plays in real time."""
SIZE = (1280, 720)
_HOLD = 1.0  # seconds that the last picture of a sequence stays
_QUALITY = 7  # of 10, as the encoder's wrapper counts


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
            for picture in _pictures(scenes, progress):
                writer.send(picture)
        except OSError as error:
            raise StorageError(f"{path}: the film could not be written ({str(error).splitlines()[0]}).") from error
        finally:
            writer.close()


def _pictures(scenes: Sequence[Scene], progress: Progress) -> Iterator[bytes]:
    plans = [shown_frames(scene) for scene in scenes]
    total = sum(len(plan) for plan in plans)
    done = 0
    for scene, plan in zip(scenes, plans, strict=True):
        stage = FilmStage(scene, SIZE)
        picture = b""
        shown = -1
        for frame in plan:
            if frame != shown:  # a slow sequence shows a frame in several pictures; drawing is what takes time
                picture = stage.picture(int(frame))
                shown = frame
            yield picture
            done += 1
            progress(done, total, scene.sequence_id)


def shown_frames(scene: Scene) -> Int[np.ndarray, " pictures"]:
    """Return the frame that each picture shows: the nearest one in time, and the last one for a second more."""
    # A little more than the exact product, so that rounding cannot lose the last picture.
    times = np.arange(int(scene.event_time * FPS + 1e-6) + 1) / FPS
    moving = np.minimum(np.round(times * scene.fps).astype(int), scene.n_frames - 1)
    return np.concatenate([moving, np.full(round(_HOLD * FPS), scene.n_frames - 1)])
