"""Nymeria: names and constants of its files, and what they hold (docs/specification/nymeria.md)."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import XSENS_SEGMENTS

SUIT_FILE = "xdata.npz"
SMPL_FILE = "xdata_smpl_neutral.npz"  # of NymeriaPlus
METADATA_FILE = "metadata.json"  # Written of synthetic people; nothing is read from it.
TRAJECTORY_FILE = "closed_loop_trajectory.csv"
HEAD_FOLDER = "recording_head"
DEVICE_FOLDERS = (HEAD_FOLDER, "recording_lwrist", "recording_rwrist")
# The user's own, of {sequence: TIME_CODE minus device time in seconds}; made once with the vendor's reader.
OFFSET_FILE = "time_offset.json"

# File of each kind of text.
NARRATION_FILES = {kind: f"{kind}.csv" for kind in ("atomic_action", "motion_narration", "activity_summarization")}
START_COLUMN = "start_time"
END_COLUMN = "end_time"
ANNOTATOR_COLUMN = "annotator"
ANSWER_PREFIX = "describe my"  # Beginning of the names of the answer columns, whatever their case.
NARRATION_HEADER = ("request_id", "gaia_id", START_COLUMN, END_COLUMN, ANNOTATOR_COLUMN, "creation_time")
ANSWER_COLUMNS = {
    "atomic_action": ("Describe my atomic actions",),
    "motion_narration": (
        "Describe my body posture",
        "Describe my hands/arms motion",
        "Describe my legs/feet motion",
        "Describe my focus attention",
    ),
    "activity_summarization": ("Describe my activity",),
}

SUIT_RATE = 240.0  # Frames per second of the suit.
N_SEGMENTS = len(XSENS_SEGMENTS)

# ``<date>_<session>_<name>_<act>_<uid>``; the name itself holds an underscore.
SEQUENCE_NAME = re.compile(r"\d{8}_s\d+_[^_]+(?:_[^_]+)*_act\d+_[A-Za-z0-9]+")


@dataclass(frozen=True)
class Suit:
    """One suit recording as its file has it: XSens world, Z up, metres.

    Attributes:
        time_us: TIME_CODE clock, microseconds.
        rotation: w x y z, segment to world; zero where the suit had none.
        tpose: Positions in the calibration pose.
        tpose_rotation: Rotations in the calibration pose, as ``rotation``.
    """

    time_us: Int[np.ndarray, " n"]
    position: Float[np.ndarray, "n 23 3"]
    rotation: Float[np.ndarray, "n 23 4"]
    tpose: Float[np.ndarray, "23 3"] | None
    tpose_rotation: Float[np.ndarray, "23 4"] | None = None


@dataclass(frozen=True)
class Narration:
    """One row of a narration file.

    Attributes:
        kind: Key of :data:`NARRATION_FILES`.
        start: Device time of the glasses, seconds.
        texts: Name of the answer (what follows "Describe my") and the answer; empty answers are kept.
    """

    kind: str
    start: float
    end: float
    texts: tuple[tuple[str, str], ...]
    annotator: str = ""


def participant_of(name: str) -> str:
    """Return the wearer's invented name in a sequence's name; the whole name where it does not follow the pattern.

    ``20230607_s0_james_johnson_act0_e72nhq`` is of ``james_johnson``, whatever the session.
    """
    return "_".join(name.split("_")[2:-2]) if SEQUENCE_NAME.fullmatch(name) else name
