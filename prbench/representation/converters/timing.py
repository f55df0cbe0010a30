"""Frames of any rate as the frames that the benchmark asks for: by time, never by index."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Num

from prbench.errors import InputFileError
from prbench.representation.checks import IN_MEMORY
from prbench.representation.features import FRAME_RATE
from prbench.timelines import interpolate

_ROUNDING = 1e-6  # seconds


def frames_needed(n_frames: int, fps: float, *, wanted_fps: float = FRAME_RATE) -> int:
    """Frames at ``fps`` that cover ``n_frames`` at ``wanted_fps``: what to ask a model of another rate for.

    >>> frames_needed(101, 30.0)  # five seconds
    151
    """
    return int(np.ceil((n_frames - 1) * fps / wanted_fps - 1e-9)) + 1


def at_rate(
    values: Num[np.ndarray, "frames *shape"],
    fps: float,
    *,
    n_frames: int | None = None,
    wanted_fps: float = FRAME_RATE,
    source: Path | str = IN_MEMORY,
) -> Float[np.ndarray, "wanted *shape"]:
    """The same motion at another rate, linearly interpolated; both begin on the first frame.

    The first frame of a generated motion is the initial pose, so the grid begins there
    (:func:`prbench.representation.at_20_fps` ends its grid on the last frame, which is the event of a recording).

    Args:
        values: Uniformly sampled positions or other vectors.
        fps: Their rate.
        n_frames: Frames to give back; None for as many as the motion covers.
        wanted_fps: Rate to come to.
        source: File or name that messages begin with.

    Raises:
        InputFileError: if a rate is no positive number, or the motion ends before the last frame that is asked for.
    """
    for rate in (fps, wanted_fps):
        if not (np.isfinite(rate) and rate > 0):
            raise InputFileError(source, "", expected="a frame rate above 0", found=f"{rate:g}")
    return at_times(np.arange(len(values)) / fps, values, n_frames=n_frames, wanted_fps=wanted_fps, source=source)


def at_times(
    times: Float[np.ndarray, " frames"],
    values: Num[np.ndarray, "frames *shape"],
    *,
    n_frames: int | None = None,
    wanted_fps: float = FRAME_RATE,
    source: Path | str = IN_MEMORY,
) -> Float[np.ndarray, "wanted *shape"]:
    """:func:`at_rate` for a motion with a time stamp a frame, however they are spaced.

    Args:
        times: Seconds, strictly increasing; the first one is the start.
        values: One a time.
        n_frames: Frames to give back; None for as many as the motion covers.
        wanted_fps: Rate to come to.
        source: File or name that messages begin with.

    Raises:
        InputFileError: if there is no frame, time does not increase, or the motion is too short.
    """
    if not len(times) or (np.diff(times) <= 0).any():
        raise InputFileError(source, "times", expected="increasing times, at least one", found=_fault(times))
    covered = float(times[-1] - times[0])
    most = int(np.floor((covered + _ROUNDING) * wanted_fps)) + 1
    wanted = most if n_frames is None else n_frames
    if wanted > most:
        raise InputFileError(
            source,
            "",
            expected=f"{(wanted - 1) / wanted_fps:.3f} s of motion, for {wanted} frames at {wanted_fps:g} fps",
            found=f"{covered:.3f} s ({len(times)} frames)",
            remedy="Ask the model for frames_needed(n_frames, fps) frames; a motion is never stretched.",
        )
    query = times[0] + np.arange(wanted) / wanted_fps
    return interpolate(times.astype(np.float64), values, query).astype(np.result_type(values.dtype, np.float32))


def _fault(times: np.ndarray) -> str:
    if not len(times):
        return "none"
    frame = int(np.flatnonzero(np.diff(times) <= 0)[0]) + 1
    return f"{times[frame]:g} s after {times[frame - 1]:g} s on frame {frame}"
