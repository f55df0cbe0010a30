"""Sequences as one HTML file that opens from disk without any network. Needs the extra ``view``.

viser records the scene while every frame is set once, and wraps the recording together with its own viewer in one page.
An overlay that explains the scene is put into that page.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.errors import MissingExtraError
from prbench.locks import sole_writer
from prbench.shown import html
from prbench.storage import write_text
from prbench.viewing.replay.measures import score_sentence
from prbench.viewing.replay.page_stage import PageStage, set_up_scene
from prbench.viewing.replay.parts import GAZE_COLOUR, GOAL_COLOUR, MARK_COLOUR
from prbench.viewing.replay.scene import Progress, Scene

if TYPE_CHECKING:
    from viser import ViserServer


_STYLE = """
#prbench{position:fixed;left:10px;top:10px;width:300px;max-height:calc(100vh - 90px);overflow:auto;z-index:2000;
background:rgba(255,255,255,.92);border:1px solid #bbb;border-radius:6px;padding:6px 10px;
font:11px/1.4 system-ui,sans-serif;color:#222}
#prbench summary{cursor:pointer;font-weight:600}
#prbench h2{font-size:11px;margin:8px 0 0}
#prbench .id{color:#666;font-family:monospace;font-size:9px;overflow-wrap:anywhere}
#prbench .swatch{display:inline-block;width:14px;height:3px;margin-right:5px;vertical-align:middle}
#prbench .notice{color:#a04000;font-weight:600}
"""
HOLD = 1.0
"""Seconds that the last frame of a sequence stays."""


def write_page(scenes: Sequence[Scene], path: Path, progress: Progress) -> None:
    """Show sequences one after another on the time line of a 3-D viewer, and write the page.

    Args:
        scenes: Scenes to show.
        path: HTML to write; replaced when it exists.
        progress: Called after every frame.

    Raises:
        MissingExtraError: if viser is not installed.
        StorageError: if the file cannot be written.
    """
    with _server() as server:
        set_up_scene(server, scenes)
        stages = [PageStage(server, number, scene) for number, scene in enumerate(scenes)]
        recording = server.get_scene_serializer()
        done = 0
        total = sum(scene.n_frames for scene in scenes)
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
    """Start viser's server, which keeps the scene; it listens on this machine only, while the page is made."""
    try:
        from viser import ViserServer
    except ModuleNotFoundError as error:
        raise MissingExtraError("viser", "view", "writing HTML") from error
    with redirect_stdout(io.StringIO()):  # it prints its address in spite of `verbose`; no user needs it
        server = ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def with_overlay(page: str, scenes: Sequence[Scene], *, hold: float) -> str:
    """Put the overlay into a page: times and scores of each sequence, colours, and the notice of the licence.

    Args:
        page: A whole HTML document.
        scenes: Scenes that the page shows, in order.
        hold: Seconds that the last frame of each stays.
    """
    # The last one, in case the viewer's own scripts hold that text, too.
    cut = page.rindex("</body>")
    title = "<title>prbench view</title>"
    marked = page[:cut] + _overlay(scenes, hold) + page[cut:]
    return marked.replace("<title>Viser</title>", title, 1)


def _overlay(scenes: Sequence[Scene], hold: float) -> str:
    parts = []
    start = 0.0
    for scene in scenes:
        end = start + scene.n_frames / scene.fps
        parts.append(_sequence(scene, start, end))
        # The time line of the viewer runs through all sequences, each held at its end.
        start = end + hold
    notices = dict.fromkeys(scene.notice for scene in scenes if scene.notice)
    notice = "".join(f'<p class="notice">{html(text)}</p>' for text in notices)
    return (
        f"<style>{_STYLE}</style>"
        f'<div id="prbench"><details open><summary>prbench view</summary>{notice}{_key(scenes)}{"".join(parts)}'
        "</details></div>"
    )


def _key(scenes: Sequence[Scene]) -> str:
    entries = [("bodies: right limbs and trunk thick, left limbs thin; thin ray: head forward", MARK_COLOUR)]
    if any(motion.gaze is not None for scene in scenes for motion in scene.motions):
        entries.append(("gaze", GAZE_COLOUR))
    if any(scene.goal is not None for scene in scenes):
        entries.append(("goal and its box", GOAL_COLOUR))
    lines = "".join(f"<div>{_swatch(colour)}{html(text)}</div>" for text, colour in entries)
    return f"{lines}<div>Drag turns, wheel zooms, right drag moves; play and time line are the viewer's own.</div>"


def _sequence(scene: Scene, start: float, end: float) -> str:
    prime = start + scene.prime_time
    motions = "".join(
        f"<div>{_swatch(motion.colour)}<b>{html(motion.label)}</b>:"
        f" {html(score_sentence(scene, motion) or 'not scored')}</div>"
        for motion in scene.motions
    )
    when = f"{start:.1f} to {end:.1f} s, prime at {prime:.1f} s"
    return f'<h2>{html(scene.title)} ({when})</h2><div class="id">{html(scene.sequence_id)}</div>{motions}'


def _swatch(colour: str) -> str:
    return f'<span class="swatch" style="background:{colour}"></span>'
