"""MP4: the film of ``prbench view``, one sequence a file."""

from __future__ import annotations

from pathlib import Path

from prbench.viewing.replay.film import film_scenes
from prbench.viewing.replay.scene import Scene


def write(scene: Scene, path: Path, *_: object) -> None:
    """Write a scene; the film shows the notice of its dataset."""
    film_scenes([scene], path, lambda *_: None)
