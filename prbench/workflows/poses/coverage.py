"""Check that outputs are whole: readable, of this recording, and over all of its time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.bodies import check_output
from prbench.recording import PoseStream
from prbench.timelines import nearest_index

_STEP = 0.033  # seconds between the instants that are asked about
_MISSING_ALLOWED = 0.5  # seconds, share of a short recording: first frame, last part of a window
_MISSING_SHARE = 0.1


@dataclass(frozen=True)
class Coverage:
    """The part of a recording that some outputs cover."""

    seconds: float
    """Length of the recording."""
    missing: float
    """Time without a body within 0.1 s, seconds."""
    first_missing: float | None
    """The first instant without a body, seconds from the start; None if there is none."""

    @property
    def complete(self) -> bool:
        """Return True if nothing but the ends of windows is missing."""
        return self.missing <= min(_MISSING_ALLOWED, _MISSING_SHARE * self.seconds) + 1e-9

    def __str__(self) -> str:
        if self.first_missing is None:
            return f"all {self.seconds:.1f} s"
        return (
            f"{self.seconds - self.missing:.1f} of {self.seconds:.1f} s,"
            f" missing first at {self.first_missing:.1f} s from the start"
        )


def coverage(outputs: Sequence[Path], cpf: PoseStream) -> Coverage:
    """Check some outputs and say how much of the recording they cover.

    Args:
        outputs: Files of one recording.
        cpf: The recording's central pupil frame in the world of the outputs, device seconds.

    Raises:
        InputFileError: for the first output that is damaged or belongs to another recording.
    """
    times = np.unique(np.concatenate([check_output(path, cpf) for path in outputs])) if outputs else np.zeros(0)
    seconds = float(cpf.times[-1] - cpf.times[0])
    regular = cpf.times[0] + np.arange(int(seconds / _STEP) + 1) * _STEP
    posed = np.abs(cpf.times[nearest_index(cpf.times, regular)] - regular) <= ego.LONGEST_STEP / 2
    asked = regular[posed]
    if len(times) == 0:
        return Coverage(seconds, seconds, 0.0)
    found = times / 1e9
    missing = asked[np.abs(found[nearest_index(found, asked)] - asked) > ego.LONGEST_STEP]
    first = float(missing[0] - cpf.times[0]) if len(missing) else None
    return Coverage(seconds, len(missing) * _STEP, first)
