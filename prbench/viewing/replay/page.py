"""Sequences as one HTML file that opens from disk without any network. Needs the extra ``view``.

viser records the scene while every frame is set once, and wraps the recording together with its own viewer in one page.
An overlay that explains the scene is put into that page.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from prbench.errors import MissingExtraError
from prbench.files.storage import sole_writer, write_text
from prbench.shown import html
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
    with viewer() as server:
        set_up_scene(server, scenes)
        acts = [
            Act(PageStage(server, number, scene), scene.n_frames, scene.fps, scene.sequence_id)
            for number, scene in enumerate(scenes)
        ]
        page = recorded_page(server, acts, progress)
    content = with_overlay(page, scenes, hold=HOLD)
    with sole_writer(path):
        write_text(path, content)


class Stage(Protocol):
    """What stands in the viewer's scene for one act."""

    def show(self, visible: bool) -> None:
        """Let it appear or vanish."""
        ...

    def set_frame(self, frame: int) -> None:
        """Move everything to a frame."""
        ...


@dataclass(frozen=True)
class Act:
    """A part of a page's time line."""

    stage: Stage
    n_frames: int
    fps: float
    name: str

    @property
    def seconds(self) -> float:
        """How long it moves."""
        return self.n_frames / self.fps


def recorded_page(server: ViserServer, acts: Sequence[Act], progress: Progress) -> str:
    """Set every frame of every act once, each act held at its end, and return the viewer's page of it."""
    recording = server.get_scene_serializer()
    done = 0
    total = sum(act.n_frames for act in acts)
    for act in acts:
        act.stage.show(True)
        for frame in range(act.n_frames):
            act.stage.set_frame(frame)
            recording.insert_sleep(1.0 / act.fps)
            done += 1
            progress(done, total, act.name)
        recording.insert_sleep(HOLD)
        act.stage.show(False)
    return recording.as_html()


@contextmanager
def viewer() -> Iterator[ViserServer]:
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
    return with_box(page, _overlay(scenes, hold))


def with_box(page: str, box: str) -> str:
    """Put a box (:func:`overlay_box`) into a page, and give the page our title."""
    # The last one, in case the viewer's own scripts hold that text, too.
    cut = page.rindex("</body>")
    marked = page[:cut] + box + page[cut:]
    return marked.replace("<title>Viser</title>", "<title>prbench view</title>", 1)


def _overlay(scenes: Sequence[Scene], hold: float) -> str:
    parts = []
    start = 0.0
    for scene in scenes:
        end = start + scene.n_frames / scene.fps
        parts.append(_sequence(scene, start, end))
        # The time line of the viewer runs through all sequences, each held at its end.
        start = end + hold
    return overlay_box([scene.notice for scene in scenes], _key(scenes), parts)


def overlay_box(notices: Iterable[str], key: Iterable[tuple[str, str]], parts: Iterable[str]) -> str:
    """The box that explains a page.

    Args:
        notices: Sentences that licences ask for; empty ones are left out, repeated ones stand there once.
        key: What a colour means, and the colour (``#rrggbb``).
        parts: HTML of what is shown.
    """
    notice = "".join(f'<p class="notice">{html(text)}</p>' for text in dict.fromkeys(notices) if text)
    lines = "".join(f"<div>{swatch(colour)}{html(text)}</div>" for text, colour in key)
    hint = "<div>Drag turns, wheel zooms, right drag moves; play and time line are the viewer's own.</div>"
    return (
        f"<style>{_STYLE}</style>"
        f'<div id="prbench"><details open><summary>prbench view</summary>{notice}{lines}{hint}{"".join(parts)}'
        "</details></div>"
    )


def _key(scenes: Sequence[Scene]) -> list[tuple[str, str]]:
    entries = [("bodies: right limbs and trunk thick, left limbs thin; thin ray: head forward", MARK_COLOUR)]
    if any(motion.gaze is not None for scene in scenes for motion in scene.motions):
        entries.append(("gaze", GAZE_COLOUR))
    if any(scene.goal is not None for scene in scenes):
        entries.append(("goal and its box", GOAL_COLOUR))
    return entries


def _sequence(scene: Scene, start: float, end: float) -> str:
    prime = start + scene.prime_time
    motions = "".join(
        f"<div>{swatch(motion.colour)}<b>{html(motion.label)}</b>:"
        f" {html(score_sentence(scene, motion) or 'not scored')}</div>"
        for motion in scene.motions
    )
    when = f"{start:.1f} to {end:.1f} s, prime at {prime:.1f} s"
    return f'<h2>{html(scene.title)} ({when})</h2><div class="id">{html(scene.sequence_id)}</div>{motions}'


def swatch(colour: str) -> str:
    """A short line in a colour, as HTML."""
    return f'<span class="swatch" style="background:{colour}"></span>'
