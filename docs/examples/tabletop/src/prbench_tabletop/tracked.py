"""Reader of Tabletop without annotations: a hand and the cup are tracked, and curation finds the events."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.files.bounded import foreign_input
from prbench.geometry.skeleton import y_up
from prbench.readers import RecordingFiles
from prbench.readers.files import column_vectors, read_columns
from prbench.recording import HandStream, ObjectTrack, Recording
from prbench_tabletop.reader import FILES, POSITION, ROTATION, TURN, TabletopReader, read_times

CUP = np.array([0.05, 0.05, 0.05])  # metres: half edges of the cup's box


@dataclass(frozen=True)
class TrackedReader(TabletopReader):
    """See :class:`prbench.readers.Reader`."""

    dataset: str = "tabletop-tracked"
    files: ClassVar[dict[str, str]] = {
        **{role: FILES[role] for role in ("glasses", "body")},
        "hand": "hand.csv",
        "cup": "cup.csv",
    }

    @foreign_input()
    def read(self, found: RecordingFiles) -> Recording:
        """Read one recording.

        Raises:
            InputFileError: for a missing or damaged file.
        """
        hand = _read_hand(found.require("hand", self.files["hand"]))
        cup = _read_object(found.require("cup", self.files["cup"]))
        return self.recording(found, hands=(hand,), objects=(cup,))


def _read_hand(path: Path) -> HandStream:
    """One point on the right hand: the base of the middle finger."""
    table = read_columns(path, {"time_us": int, **dict.fromkeys(POSITION, float)})
    points = y_up(column_vectors(table, POSITION)) / 1000
    valid = np.ones(len(points), dtype=bool)
    return HandStream("right", "middle_finger_base", read_times(path, table), points[:, None], valid)


def _read_object(path: Path) -> ObjectTrack:
    """Pose of the cup, which is the frame of its box."""
    table = read_columns(path, {"time_us": int, **dict.fromkeys(POSITION + ROTATION, float)})
    position = y_up(column_vectors(table, POSITION)) / 1000
    rotation = TURN * Rotation.from_quat(column_vectors(table, ROTATION), scalar_first=True)
    return ObjectTrack(
        object_id="cup",
        name="cup",
        category="",
        times=read_times(path, table),
        position=position,
        rotation=rotation.as_quat(scalar_first=True),
        valid=np.ones(len(position), dtype=bool),
        box_min=-CUP,
        box_max=CUP,
        movable=True,
    )


READER = TrackedReader()
