"""Sequences as one HTML file that opens from disk and asks nothing of any network. Needs the extra ``view``.

viser records the scene while every frame is set once, and wraps the recording together with its own viewer in one page;
an overlay that says what is to be seen is put into that page.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.errors import MissingExtraError
from prbench.locks import sole_writer
from prbench.storage import write_text
from prbench.viewing.replay.page_overlay import with_overlay
from prbench.viewing.replay.page_stage import PageStage, set_up_room
from prbench.viewing.replay.scene import Scene

if TYPE_CHECKING:
    from viser import ViserServer

HOLD = 1.0
"""Seconds that the last frame of a sequence stays."""

Progress = Callable[[int, int, str], None]


def write_page(scenes: Sequence[Scene], path: Path, progress: Progress) -> None:
    """Show sequences one after another on the time line of a 3-D viewer, and write the page.

    Args:
        scenes: What to show.
        path: HTML to write; replaced when it exists.
        progress: Called after every frame.

    Raises:
        MissingExtraError: if viser is not installed.
        StorageError: if the file cannot be written.
    """
    with _server() as server:
        set_up_room(server, scenes)
        stages = [PageStage(server, number, scene) for number, scene in enumerate(scenes)]
        recording = server.get_scene_serializer()
        done, total = 0, sum(scene.n_frames for scene in scenes)
        for stage, scene in zip(stages, scenes, strict=True):
            stage.show(True)
            for frame in range(scene.n_frames):
                stage.set_frame(frame)
                recording.insert_sleep(1.0 / scene.fps)
                done += 1
                progress(done, total, scene.sequence_id)
            recording.insert_sleep(HOLD)
            stage.show(False)
        page = recording.as_html()
    content = with_overlay(page, scenes, hold=HOLD)
    with sole_writer(path):
        write_text(path, content)


@contextmanager
def _server() -> Iterator[ViserServer]:
    """Viser keeps a scene in a server; this one listens to nobody but this machine, and only while the page is made."""
    try:
        from viser import ViserServer
    except ModuleNotFoundError as error:
        raise MissingExtraError("viser", "view", "writing HTML") from error
    with redirect_stdout(io.StringIO()):  # it announces its address, whatever `verbose` says; nobody is to go there
        server = ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()
