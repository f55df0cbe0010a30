"""Finds frames that are repeated, left out or held at an end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.anatomy import unit
from prbench.checking.doctor.motion_set import AT_RATE, AT_TIMES, Diagnosis, Finding, MotionSet, on_straight_lines

_STILL = 1e-4  # of a motion's usual step: the same frame again
_LONGEST_PERIOD = 8
_SLOW = 0.08  # m/s, mean of the joints: below, noise is larger than steps
_STRAIGHT = 0.6  # cosine between steps of one movement
_RHYTHM = 0.5  # share of the variance explained
_STAND_OUT = 0.3  # log of a step over the mean of its neighbours
_TOO_LONG = 1.6  # a step over its neighbours
_LEVEL = 1.35  # the ratio of its neighbours to each other
_SHORTEST_HOLD = 4  # frames that stand still at an end
_FULL_SPEED = 0.10  # m/s, mean of the joints: a body cannot stop from it within a frame
_FRESH_START = 1.7  # first step after a hold, in steps that follow it


@dataclass(frozen=True, eq=False)
class _Steps:
    """The steps from each frame of a motion to the next."""

    sizes: np.ndarray
    usual: float
    straight: np.ndarray
    """Cosine between each step and the next, over all joints: near 1 in movement, anything in jitter."""

    @classmethod
    def of(cls, motion: np.ndarray) -> _Steps:
        """Measure a motion."""
        steps = np.diff(motion, axis=0)
        sizes = np.linalg.norm(steps, axis=-1).mean(axis=-1)
        moving = sizes[sizes > 1e-7]
        flat = unit(steps.reshape(len(steps), -1))
        straight = (flat[1:] * flat[:-1]).sum(axis=-1)
        return cls(sizes, float(np.median(moving)) if moving.size else 0.0, straight)

    @property
    def still(self) -> np.ndarray:
        """True for steps that lead nowhere."""
        return self.sizes <= _STILL * self.usual


@dataclass(frozen=True)
class _Rhythm:
    """Steps that stand out at every so many frames."""

    period: int
    explained: float
    """Share of the variance of how much steps stand out that the place in a period explains."""
    stands_out: float
    """Mean of the place that stands out most: log of a step over its neighbours."""
    motions: int


def examine_clock(motion_set: MotionSet) -> Finding:
    """Look for frames that are repeated, left out, or held."""
    repeats = _repeats(motion_set)
    holds = _holds(repeats.motion_set)
    uneven = () if repeats.diagnoses else _examine_steps(holds.motion_set)
    return Finding((*repeats.diagnoses, *holds.diagnoses, *uneven), holds.motion_set)


def _repeats(motion_set: MotionSet) -> Finding:
    """Find single frames that are repeated in the midst of movement."""
    found: dict[int, np.ndarray] = {}
    for row, motion in enumerate(motion_set.motions):
        steps = _Steps.of(motion)
        inside = _short_holds(steps)
        moving = (~steps.still).sum()
        if steps.usual > 0 and inside.sum() >= 3 and inside.sum() >= 0.03 * moving:
            found[row] = inside
    if len(found) * 3 < len(motion_set):  # a few may be recordings that lost track
        return Finding((), motion_set)
    counts = [int(inside.sum()) for inside in found.values()]
    gaps = np.concatenate([np.diff(np.flatnonzero(inside)) for inside in found.values()])
    # The most frequent distance: frames that were lost while recording come at no fixed one.
    period = int(np.bincount(gaps).argmax())
    regular = float((gaps == period).mean())
    rhythm = ", at no fixed distance"
    if period > 1 and regular > 0.5:
        rhythm = f", every {period} frames in {regular:.0%} of the cases"
    evidence = (
        f"{sum(counts)} frames of {motion_set.in_words(len(found))} equal the frame before them in the midst of"
        f" movement{rhythm}"
    )
    cause = "another frame rate was reached by repeating the nearest frame"
    if regular > 0.5 and period > 1:
        cause += f" (as from {motion_set.fps * (period - 1) / period:.3g} to {motion_set.fps:g} frames a second)"
    undone = [
        _filled_in(motion, found[row]) if row in found else motion for row, motion in enumerate(motion_set.motions)
    ]
    return Finding((Diagnosis("clock", True, evidence, cause, AT_RATE),), motion_set.with_motions(undone))


def _short_holds(steps: _Steps) -> np.ndarray:
    """Find still steps in short runs that begin and end in movement."""
    still = steps.still
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(int), [0]))))
    chosen = np.zeros_like(still)
    for start, stop in edges.reshape(-1, 2):
        if start > 0 and stop < len(still) and stop - start < _SHORTEST_HOLD * 3:
            chosen[start:stop] = True
    return chosen


def _filled_in(motion: np.ndarray, repeated: np.ndarray) -> np.ndarray:
    """Replace repeated frames by straight lines between their neighbours."""
    kept = np.flatnonzero(np.concatenate(([True], ~repeated)))
    return on_straight_lines(motion[kept], kept, np.arange(len(motion)))


def _holds(motion_set: MotionSet) -> Finding:
    """Find ends and beginnings that stand still although the body moves at full speed next to them."""
    ends = _hold(
        motion_set,
        at_end=True,
        text="the last {frames} frames (median) of {motions} are one and the same; in {abrupt} the body stops from"
        " {speed:.2f} m/s (median) at once",
        cause="the end was padded with the last frame: the motion is shorter than was asked for",
        remedy="Generate the asked number of frames, or let the motion take the asked time by interpolation.",
    )
    starts = _hold(
        motion_set,
        at_end=False,
        text="the first {frames} frames (median) of {motions} are one and the same; in {abrupt} the body then starts"
        " at {speed:.2f} m/s (median)",
        cause="the motion comes too late: the first frame was repeated, or the clock starts before the motion",
        remedy="Begin with the motion's own first frame; frame 0 is 2 s before the prime.",
    )
    diagnoses = (*ends, *starts)
    held = [_without_holds(motion) for motion in motion_set.motions]
    return Finding(diagnoses, motion_set.with_motions(held) if diagnoses else motion_set)


def _hold(motion_set: MotionSet, *, at_end: bool, text: str, cause: str, remedy: str) -> tuple[Diagnosis, ...]:
    """Diagnose one end; certain if most of the motions that are held there move at full speed next to it."""
    held = _held(motion_set, at_end=at_end)
    if len(held) * 3 < len(motion_set):
        return ()
    abrupt = sum(speed > _FULL_SPEED for _, speed in held.values())
    frames = int(np.median([count for count, _ in held.values()])) + (not at_end)
    speed = float(np.median([speed for _, speed in held.values()]))
    evidence = text.format(frames=frames, motions=motion_set.in_words(len(held)), abrupt=abrupt, speed=speed)
    return (Diagnosis("clock", abrupt * 2 > len(held), evidence, cause, remedy),)


def _held(motion_set: MotionSet, *, at_end: bool) -> dict[int, tuple[int, float]]:
    """Map the row of each motion held at one end to the held frames and the speed next to them (m/s)."""
    held = {}
    for row, motion in enumerate(motion_set.motions):
        steps = _Steps.of(motion[::-1] if at_end else motion)
        moving = np.flatnonzero(~steps.still)
        if steps.usual == 0 or not moving.size or moving[0] < _SHORTEST_HOLD:
            continue
        first = steps.sizes[moving[0] :][:4]
        sudden = len(first) > 1 and first[0] * _FRESH_START > np.median(first[1:])
        held[row] = int(moving[0]), float(first[0] * motion_set.fps) if sudden else 0.0
    return held


def _without_holds(motion: np.ndarray) -> np.ndarray:
    moving = np.flatnonzero(~_Steps.of(motion).still)
    return motion[moving[0] : moving[-1] + 2] if moving.size else motion


def _examine_steps(motion_set: MotionSet) -> tuple[Diagnosis, ...]:
    """Find steps that are long and short in turns, or too long now and then."""
    steps = [_Steps.of(motion) for motion in motion_set.motions]
    rhythm = _common_rhythm(steps, motion_set.fps)
    if rhythm is not None:
        evidence = (
            f"every {rhythm.period} frames a step is {np.exp(rhythm.stands_out):.2f} times as long as its neighbours in"
            f" {motion_set.in_words(rhythm.motions)}; this explains {rhythm.explained:.0%} of how steps stand out"
        )
        cause = "frames were picked by rounded indices, so that time passes unevenly"
        if abs(rhythm.stands_out - np.log(2)) < 0.25:
            fps = motion_set.fps
            cause += f" (as from {fps * (rhythm.period + 1) / rhythm.period:.3g} to {fps:g} frames a second)"
    else:
        leaps = [_leaps(each, motion_set.fps) for each in steps]
        rows = [row for row, count in enumerate(leaps) if count >= 3]
        if not rows or len(rows) * 3 < len(motion_set):
            return ()
        evidence = (
            f"{sum(leaps[row] for row in rows)} steps of {motion_set.in_words(len(rows))} are about twice as long as"
            " their neighbours, which agree with each other"
        )
        cause = "frames are missing: they were dropped while the motion was recorded, cut or resampled"
    return (Diagnosis("clock", True, evidence, cause, AT_TIMES),)


def _common_rhythm(steps: Sequence[_Steps], fps: float) -> _Rhythm | None:
    """Return the rhythm of more than half of the motions that are long enough, if there is one."""
    best: _Rhythm | None = None
    for period in range(2, _LONGEST_PERIOD + 1):
        measured = [found for each in steps if (found := _rhythm(each, period, fps)) is not None]
        strong = [found for found in measured if found.explained > _RHYTHM and found.stands_out > _STAND_OUT]
        if not measured or len(strong) * 2 <= len(measured):
            continue
        explained = float(np.median([found.explained for found in strong]))
        if best is None or explained > best.explained + 0.05:
            best = _Rhythm(period, explained, float(np.median([found.stands_out for found in strong])), len(strong))
    return best


def _rhythm(steps: _Steps, period: int, fps: float) -> _Rhythm | None:
    if len(steps.sizes) < 4 * period + 2 or steps.usual == 0:
        return None
    out, fast = _standing_out(steps, fps)
    if 2 * fast.sum() < _moving(steps, fps):
        return None  # jitter, not movement
    place = (np.arange(len(out)) % period)[fast]
    counts = np.bincount(place, minlength=period)
    if (counts < 3).any():
        return None
    values = out[fast]
    means = np.bincount(place, weights=values, minlength=period) / counts
    total = float(values.var())
    explained = float((counts * (means - values.mean()) ** 2).sum() / counts.sum())
    # Adjusted for the number of places: with long periods any noise explains something.
    adjusted = 1 - (1 - explained / max(total, 1e-9)) * len(values) / max(len(values) - period, 1)
    return _Rhythm(period, adjusted, float(means.max()), 1)


def _standing_out(steps: _Steps, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return how much each inner step exceeds its two neighbours (log), and where all three are fast and straight."""
    logs = np.log(np.maximum(steps.sizes, 1e-9))
    out = logs[1:-1] - (logs[:-2] + logs[2:]) / 2
    slow = max(0.5 * steps.usual, _SLOW / fps)
    triples = np.lib.stride_tricks.sliding_window_view(steps.sizes, 3)
    return out, (triples.mean(axis=1) > slow) & (np.minimum(steps.straight[1:], steps.straight[:-1]) > _STRAIGHT)


def _moving(steps: _Steps, fps: float) -> int:
    """Count the steps that are fast, in one direction or to and fro."""
    return int((steps.sizes > max(0.5 * steps.usual, _SLOW / fps)).sum())


def _leaps(steps: _Steps, fps: float) -> int:
    """Count single steps that are about twice as long as two on each side, which agree with each other."""
    if len(steps.sizes) < 6 or steps.usual == 0:
        return 0
    # Two steps on each side have to agree, so that acceleration is not taken for a gap.
    windows = np.lib.stride_tricks.sliding_window_view(steps.sizes, 5)
    neighbours = windows[:, [0, 1, 3, 4]]
    low = neighbours.min(axis=1)
    high = neighbours.max(axis=1)
    agreeing = (high < _LEVEL * low) & (low > max(0.7 * steps.usual, _SLOW / fps))
    return int((agreeing & (windows[:, 2] > _TOO_LONG * neighbours.mean(axis=1))).sum())
