"""Parts of a batch that are computed together: of similar length, so that little is computed for padding."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

_MOST_PADDING = 0.25  # of the shortest sequence of a part


def parts_of_similar_length(n_frames: Int[np.ndarray, " batch"], largest: int) -> list[Int[np.ndarray, " _"]]:
    """Row numbers in parts of at most ``largest``, shortest sequences first.

    A part ends early where the next sequence would make the shortest one carry a quarter of its length as padding.
    """
    parts: list[list[int]] = []
    for row in np.argsort(n_frames, kind="stable").tolist():
        room = bool(parts) and len(parts[-1]) < largest
        if room and n_frames[row] <= (1 + _MOST_PADDING) * n_frames[parts[-1][0]]:
            parts[-1].append(row)
        else:
            parts.append([row])
    return [np.array(part) for part in parts]
