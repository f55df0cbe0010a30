"""Motions at other instants of time."""

from __future__ import annotations

import numpy as np


def at_places(motion: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The motion at fractional frames, on straight lines between frames; held beyond both ends."""
    flat = motion.reshape(len(motion), -1)
    frames = np.arange(len(motion))
    return np.stack([np.interp(places, frames, column) for column in flat.T], axis=1).reshape(-1, *motion.shape[1:])


def at_length(motion: np.ndarray, n_frames: int) -> np.ndarray:
    """The motion played in another number of frames, its ends kept."""
    return at_places(motion, np.linspace(0, len(motion) - 1, n_frames))
