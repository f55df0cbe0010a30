"""What several diagnoses recommend."""

from __future__ import annotations

AT_RATE = (
    "Resample to the asked rate (prbench.representation.converters.at_rate), or declare native_fps in the adapter."
)
AT_TIMES = "Resample on the frames' own times: prbench.representation.converters.at_times."
