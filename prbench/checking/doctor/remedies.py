"""What several diagnoses recommend."""

from __future__ import annotations

AT_RATE = (
    "Resample to the asked rate (prbench.representation.converters.at_rate), or let the method declare native_fps: an"
    " attribute of an adapter, a key in the hello of a program."
)
AT_TIMES = "Resample on the frames' own times: prbench.representation.converters.at_times."
