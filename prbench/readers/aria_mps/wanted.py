"""Choose the rows of a trajectory: those around some times, or those that curation needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int

from prbench.readers.aria_mps.format import POSE_RATE, grid_times_us, rows_around, wanted_times_us


@runtime_checkable
class Wanted(Protocol):
    """Times around which rows are wanted, known bit by bit as a file is read from its start."""

    def between(self, first_us: int, after_us: int | None, until_us: int) -> Int[np.ndarray, " n"]:
        """Sorted wanted times after one time (None: from the beginning) until another one.

        Args:
            first_us: Time of the first row.
            after_us: Later than this.
            until_us: Not later than this.
        """
        ...

    def beyond(self, last_us: int) -> bool:
        """True where a time after that of the last row is wanted: the last row then counts."""
        ...

    def rows(self, time_us: Int[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
        """The same choice among rows whose times are all known."""
        ...

    def key(self) -> bytes:
        """Equal for equal wishes."""
        ...


@dataclass(frozen=True)
class NearTimes:
    """Rows around some times."""

    time_us: Int[np.ndarray, " n"]

    def between(self, first_us: int, after_us: int | None, until_us: int) -> Int[np.ndarray, " n"]:  # noqa: ARG002
        """See :class:`Wanted`."""
        times = np.unique(self.time_us)
        first = 0 if after_us is None else np.searchsorted(times, after_us, side="right")
        return times[first : np.searchsorted(times, until_us, side="right")]

    def beyond(self, last_us: int) -> bool:
        """See :class:`Wanted`."""
        return bool((self.time_us > last_us).any())

    def rows(self, time_us: Int[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
        """See :class:`Wanted`."""
        return rows_around(time_us, self.time_us)

    def key(self) -> bytes:
        """See :class:`Wanted`."""
        return b"times" + self.time_us.tobytes()


@dataclass(frozen=True)
class NearGaze:
    """Rows around gaze times and a regular grid, first and last row included (``wanted_times_us``)."""

    gaze_us: Int[np.ndarray, " n"]
    """Increasing."""
    rate: float = POSE_RATE

    def between(self, first_us: int, after_us: int | None, until_us: int) -> Int[np.ndarray, " n"]:
        """See :class:`Wanted`."""
        after = first_us - 1 if after_us is None else after_us
        gaze = self.gaze_us[slice(*np.searchsorted(self.gaze_us, (after, until_us), side="right"))]
        times = np.union1d(gaze, grid_times_us(first_us, max(after, first_us), until_us, self.rate))
        return times[(times > after) & (times <= until_us)]

    def beyond(self, last_us: int) -> bool:  # noqa: ARG002
        """See :class:`Wanted`."""
        return True

    def rows(self, time_us: Int[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
        """See :class:`Wanted`."""
        return rows_around(time_us, wanted_times_us(self.gaze_us, int(time_us[0]), int(time_us[-1]), self.rate))

    def key(self) -> bytes:
        """See :class:`Wanted`."""
        return f"gaze {self.rate} ".encode() + self.gaze_us.tobytes()
