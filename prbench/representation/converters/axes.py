"""Positions of any common world and rate as the benchmark asks for them: Y up, right-handed, metres, 20 fps.

Frames are resampled by time, never by index.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Num

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.geometry.timelines import interpolate
from prbench.representation.clips import IN_MEMORY, check_rate
from prbench.representation.features import FRAME_RATE

_TURNS: Mapping[str, tuple[tuple[int, int], ...]] = MappingProxyType(
    {
        "y": ((0, 1), (1, 1), (2, 1)),
        "-y": ((0, 1), (1, -1), (2, -1)),
        "z": ((0, 1), (2, 1), (1, -1)),
        "-z": ((0, 1), (2, -1), (1, 1)),
        "x": ((1, -1), (0, 1), (2, 1)),
        "-x": ((1, 1), (0, -1), (2, 1)),
    }
)
"""Maps each axis that may point up to source column and sign of x, y and z: rotations by a quarter or half turn."""

UNITS: Mapping[str, float] = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048})
"""Metres a unit."""
_ROUNDING = 1e-6  # seconds


def to_y_up(
    points: Num[np.ndarray, "*batch 3"], *, up: str = "y", left_handed: bool = False, unit: str | float = "m"
) -> Float[np.ndarray, "*batch 3"]:
    """Positions with Y up, right-handed, in metres.

    The heading that comes out is arbitrary; :func:`prbench.representation.converters.placed_on` or
    :func:`prbench.representation.canonicalise` gives it a meaning.

    Args:
        points: In the world of the source.
        up: Axis that points up there: ``y``, ``z``, ``x``, or one of them with a minus sign. ``-y`` is that of camera
            coordinates (x right, y down, z forward).
        left_handed: The source's axes are left-handed (Unity: Y up, Unreal: Z up). One horizontal axis is negated;
            names of joints stay, because the body is the same.
        unit: ``m``, ``cm``, ``mm``, ``inch``, ``foot``, or metres a unit.

    Raises:
        UsageError: if axis or unit is unknown.
    """
    if up not in _TURNS:
        raise UsageError(f"unknown up axis '{up}'.{did_you_mean(up, _TURNS)} Choose one of: {', '.join(_TURNS)}.")
    columns, signs = np.transpose(_TURNS[up])
    exact = np.result_type(points.dtype, np.float32)  # millimetres may come as integers
    turned = points[..., columns].astype(exact) * (signs * _metres_of(unit)).astype(exact)
    if left_handed:
        turned[..., 0] = -turned[..., 0]
    return turned


def _metres_of(unit: str | float) -> float:
    """Metres a unit.

    Raises:
        UsageError: if the name is unknown, or the number is none above 0.
    """
    if isinstance(unit, str):
        if unit not in UNITS:
            raise UsageError(f"unknown unit '{unit}'.{did_you_mean(unit, UNITS)} Choose one of: {', '.join(UNITS)}.")
        return UNITS[unit]
    if not (np.isfinite(unit) and unit > 0):
        raise UsageError(f"unit: expected metres a unit, a number above 0, found {unit:g}.")
    return float(unit)


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
    """Resample a motion to another rate, linearly interpolated; both begin on the first frame.

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
        check_rate(rate, source)
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
