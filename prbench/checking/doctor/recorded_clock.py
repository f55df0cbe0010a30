"""Finds a wrong rate, delay or slide of motions that follow recorded ones, against the table's own time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.motion_set import AT_RATE, AT_TIMES, Diagnosis, Finding, MotionSet, no_finding

_MOVES = 0.10  # metres that joints leave the first pose by, in the mean
_COPY = 0.03  # metres left after matching
_BETTER = 0.5  # share of the distance without matching
_SLIDE = 0.10  # seconds off a straight line
_DELAY = 0.10  # seconds at the beginning
_RATE = 0.04
_MATCHED = 24  # motions that are matched at most, evenly spread


@dataclass(frozen=True, eq=False)
class _Match:
    """The recorded frames that the frames of a motion show."""

    places: np.ndarray
    left: float
    """Mean distance of joints after matching, metres."""
    before: float
    """Mean distance of joints frame by frame, metres."""
    moves: np.ndarray
    """Frames at which the recorded body moves, so that time can be read off it."""


def examine_recorded_clock(motion_set: MotionSet) -> Finding:
    """Match motions with recorded ones in time, where they show the same movement on another clock."""
    rows = [row for row, expected in enumerate(motion_set.expected) if expected.recorded is not None]
    matches = []
    for row in rows[:: max(1, len(rows) // _MATCHED)]:
        recorded = motion_set.expected[row].recorded
        if recorded is None or len(recorded) < 10 or len(motion_set.motions[row]) < 10:
            continue
        if float(np.linalg.norm(recorded - recorded[0], axis=-1).mean(axis=1).max()) > _MOVES:
            matches.append(_matched(motion_set.motions[row], recorded))
    copies = [match for match in matches if match.left < _COPY and match.left < _BETTER * match.before]
    # A method of its own may come near a few recordings by chance; copies do so in nearly all.
    if len(copies) < 0.6 * len(matches) or not copies:
        return no_finding(motion_set)
    return Finding(tuple(_judged(copies, motion_set)), motion_set)


def _judged(copies: list[_Match], motion_set: MotionSet) -> list[Diagnosis]:
    lines = [_line(match) for match in copies]
    rate = float(np.median([line[0] for line in lines]))
    delay = float(np.median([line[1] for line in lines])) / motion_set.fps
    slide = float(np.median([line[2] for line in lines])) / motion_set.fps
    shared = (
        f"in {motion_set.in_words(len(copies))} frames show recorded ones at other times:"
        f" {np.median([match.before for match in copies]):.3f} m apart frame by frame,"
        f" {np.median([match.left for match in copies]):.3f} m when matched in time"
    )
    if slide > _SLIDE:
        evidence = f"{shared}; the clock leaves a straight line by up to {slide:.2f} s"
        cause = "a sliding clock: time runs faster and slower within a motion, as of frames without times of their own"
        return [Diagnosis("clock", True, evidence, cause, AT_TIMES)]
    if abs(rate - 1) > _RATE:
        evidence = f"{shared}; one frame advances {rate:.3f} recorded frames"
        made = f"{motion_set.fps / rate:.3g} frames a second shown at {motion_set.fps:g}"
        cause = f"motions look like {made}, or were stretched to the asked length"
        return [Diagnosis("frame-rate", True, evidence, cause, AT_RATE)]
    if abs(delay) > _DELAY:
        evidence = f"{shared}; frame 0 shows the recorded time {delay:+.2f} s"
        cause = "motions begin too " + ("early" if delay > 0 else "late") + ": their clock has another zero"
        return [Diagnosis("clock", True, evidence, cause, "Begin at the sequence's first frame, 2 s before the prime.")]
    return []


def _matched(motion: np.ndarray, recorded: np.ndarray) -> _Match:
    """Match poses by dynamic time warping, of every third joint only, so that long motions stay cheap."""
    apart = np.linalg.norm(motion[:, None, ::3] - recorded[None, :, ::3], axis=-1).mean(axis=-1)
    total = np.full((len(motion) + 1, len(recorded) + 1), np.inf)
    total[0, :] = 0.0  # may begin at any recorded frame
    for row in range(len(motion)):
        total[row + 1, 0] = total[row, 0] + apart[row, 0]
        reachable = np.minimum(total[row, :-1], total[row, 1:])
        # Steps along a row cost their distances: with the cumulative sum the best start is a running minimum.
        walked = np.cumsum(apart[row])
        total[row + 1, 1:] = walked + np.minimum.accumulate(reachable - walked + apart[row])
    places = _traced(total)
    same = min(len(motion), len(recorded))
    before = float(apart[np.arange(same), np.arange(same)].mean())
    left = float(apart[np.arange(len(motion)), places.round().astype(int)].mean())
    speed = np.linalg.norm(np.gradient(recorded, axis=0), axis=-1).mean(axis=-1)
    moves = speed[places.round().astype(int)] > 0.5 * np.median(speed)
    return _Match(places, left, before, moves)


def _traced(total: np.ndarray) -> np.ndarray:
    """Return the mean recorded frame of each frame along the cheapest path."""
    row = len(total) - 1
    column = int(total[-1, 1:].argmin()) + 1
    ways: list[list[int]] = [[] for _ in range(row)]
    while row > 0 and column > 0:
        ways[row - 1].append(column - 1)
        options = {
            (row - 1, column - 1): total[row - 1, column - 1],
            (row - 1, column): total[row - 1, column],
            (row, column - 1): total[row, column - 1],
        }
        row, column = min(options, key=lambda key: options[key])
    return np.array([np.mean(way) if way else 0.0 for way in ways])


def _line(match: _Match) -> tuple[float, float, float]:
    """Return slope, start and largest departure (95 %) of the straight line through the frames in movement."""
    frames = np.flatnonzero(match.moves)
    if len(frames) < 8:
        frames = np.arange(len(match.places))
    # Only frames in movement: while a body stands still, any of its frames match.
    slope, start = np.polyfit(frames, match.places[frames], 1)
    off = np.abs(match.places[frames] - slope * frames - start)
    return float(slope), float(start), float(np.percentile(off, 95))
