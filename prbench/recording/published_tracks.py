"""Pieces of a recording as a study of motion prediction used them, in the joints of the dataset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class PublishedTrack:
    """One segment at 30 frames a second, every frame of it, measured or not. World, metres, Y up."""

    name: str
    """Unique within the recording."""
    published_split: str
    """``train``, ``test`` or ``unused`` where the files themselves tell it, else empty."""
    times: Float[np.ndarray, " n"]
    joints: Float[np.ndarray, "n joints 3"]
    valid: Bool[np.ndarray, " n"]
    """Frames whose pose was measured or filled in; elsewhere a neighbour's stands."""
    filled: Bool[np.ndarray, " n"]
    """Frames whose pose was filled in from frames on both sides."""
    body: Float[np.ndarray, "n 22 3"]
    """The 22 joints of the same frames, from which the head's direction is computed."""
    gaze: Float[np.ndarray, "n 3"]
    gaze_measured: Bool[np.ndarray, " n"]
    """Frames with a measurement of their own, neither held nor interpolated."""
