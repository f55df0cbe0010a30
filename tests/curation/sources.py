"""Recordings for build tests: the hand-made scene under several names, some of them broken."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.curation import build_from_sources
from prbench.engine import engine_for
from prbench.errors import InputFileError
from prbench.files.storage import text_digest
from prbench.recording import Recording, UnreadableEntry
from tests.curation.scenes import PICK, PUT, clock, cup_centre, finger_path, hand, scene, track


def trembling(recording: Recording) -> Recording:
    """Return a recording in which head, hands and eyes tremble, as nobody holds still, and the head faces the gaze."""
    rng = np.random.default_rng(5)

    def shaken(points: np.ndarray) -> np.ndarray:
        return points + rng.normal(size=points.shape) * 1e-8

    gaze = recording.gaze
    direction = shaken(gaze.direction)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return replace(
        recording,
        head=replace(
            recording.head,
            position=shaken(recording.head.position),
            rotation=np.tile([np.cos(1.1), 0.0, -np.sin(1.1), 0.0], (len(recording.head.times), 1)),
        ),
        gaze=replace(gaze, direction=direction),
        hands=tuple(replace(each, points=shaken(each.points)) for each in recording.hands),
    )


@dataclass(frozen=True)
class SceneSource:
    """See :class:`prbench.curation.job.RecordingSource`."""

    recording_id: str
    version: int = 0
    """Another version holds another movement."""
    problem: str = ""
    """``file`` or ``defect``: reading fails."""
    skip_reason: str | None = None
    dataset: str = "adt"
    split: str | None = None
    seconds: float = 0.0
    """How long reading takes."""
    unreadable: tuple[UnreadableEntry, ...] = ()
    short: Path | None = None
    """Folder that holds a file for each time for which the memory will not suffice."""

    def input_digest(self) -> str:
        return text_digest(self.recording_id, str(self.version), self.problem)

    def read(self) -> Recording:
        time.sleep(self.seconds)
        if self.short is not None and any(self.short.iterdir()):
            next(self.short.iterdir()).unlink()
            raise pa.lib.ArrowMemoryError("malloc of size 4398046511104 failed")
        if self.problem == "file":
            raise InputFileError("/home/someone/adt/a.csv", "row 3", expected="a number", found="text")
        if self.problem == "defect":
            raise KeyError("left")
        pick, put = PICK + 0.1 * self.version, PUT
        slow, fast = clock(30), clock(120)
        moved = track(slow, cup_centre(slow, pick, put))
        reaching = hand("left", fast, finger_path(fast, pick, put))
        recording = trembling(scene(objects=(moved,), hands=(reaching,)))
        return replace(recording, recording_id=self.recording_id, split_group="", unreadable=self.unreadable)

    def without_places(self, message: str) -> str:
        return message.replace("/home/someone/adt/", "")


def some_sources(n: int = 5, seconds: float = 0.0) -> list[SceneSource]:
    return [SceneSource(f"room_{index}", version=index, seconds=seconds) for index in range(n)]


def short_of_memory(folder: Path, times: int) -> list[SceneSource]:
    """Two recordings; for one the memory will not suffice so many times."""
    folder.mkdir()
    for index in range(times):
        (folder / str(index)).touch()
    return [some_sources(1)[0], replace(some_sources(2)[1], short=folder)]


def folder_bytes(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


if __name__ == "__main__":  # run by the resume test, to be killed
    build_from_sources(some_sources(8, seconds=0.05), Path(sys.argv[1]), engine=engine_for(int(sys.argv[2])))
