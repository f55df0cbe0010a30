"""How sure an event is: the chance that no number behind it lies on the wrong side of its threshold.

Source: docs/specification/curation.md#confidence.
"""

from __future__ import annotations

import math

from scipy.special import ndtr

# Metres; one standard deviation of every distance: gaze that is off by 1.8 degrees misses by this at a metre.
DISTANCE_ERROR = 0.03
# Seconds in which an unmeasured stretch costs a factor of e.
_FADES_IN = 1.0
# Seconds that trackers are usually without a measurement: of an object, and of the eyes, which blink.
TRACK_PAUSE = 0.1
GAZE_PAUSE = 0.5


def beyond(distance: float) -> float:
    """Return the chance that a distance, measured with a normal error, is truly on its side of the threshold.

    Args:
        distance: Metres beyond the threshold; negative on its wrong side.
    """
    return float(ndtr(distance / DISTANCE_ERROR))


def unbroken(gap: float, *, usual: float) -> float:
    """Return the trust in a stream without a measurement for ``gap`` seconds; 1 up to the ``usual`` pause."""
    return math.exp(-max(gap - usual, 0.0) / _FADES_IN)
