"""Steps from frame to frame: uneven ones tell of frames that were left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.anatomy import unit
from prbench.checking.doctor.patient import Patient, of_motions
from prbench.checking.doctor.remedies import AT_TIMES
from prbench.checking.doctor.types import Diagnosis

_STILL = 1e-4  # of a motion's usual step: the same frame again
_LONGEST_PERIOD = 8
_SLOW = 0.08  # m/s, mean of the joints: below, noise is larger than steps
_STRAIGHT = 0.6  # cosine between steps of one movement
_RHYTHM, _STAND_OUT = 0.5, 0.3  # share of the variance explained; log of a step over the mean of its neighbours
_TOO_LONG, _LEVEL = 1.6, 1.35  # a step over its neighbours; their own ratio


@dataclass(frozen=True, eq=False)
class Steps:
    """From each frame of a motion to the next: mean distance that joints move, metres."""

    sizes: np.ndarray
    usual: float
    straight: np.ndarray
    """Cosine between each step and the next, over all joints: near 1 in movement, anything in jitter."""

    @classmethod
    def of(cls, motion: np.ndarray) -> Steps:
        """Measure a motion."""
        steps = np.diff(motion, axis=0)
        sizes = np.linalg.norm(steps, axis=-1).mean(axis=-1)
        moving = sizes[sizes > 1e-7]
        flat = unit(steps.reshape(len(steps), -1))
        straight = (flat[1:] * flat[:-1]).sum(axis=-1)
        return cls(sizes, float(np.median(moving)) if moving.size else 0.0, straight)

    @property
    def still(self) -> np.ndarray:
        """Steps that lead nowhere."""
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


def examine_steps(patient: Patient) -> tuple[Diagnosis, ...]:
    """Steps that are long and short in turns, or too long now and then."""
    steps = [Steps.of(motion) for motion in patient.motions]
    rhythm = _common_rhythm(steps, patient.fps)
    if rhythm is not None:
        evidence = (
            f"every {rhythm.period} frames a step is {np.exp(rhythm.stands_out):.2f} times as long as its neighbours in"
            f" {of_motions(rhythm.motions, patient)}; this explains {rhythm.explained:.0%} of how steps stand out"
        )
        cause = "frames were picked by rounded indices, so that time passes unevenly"
        if abs(rhythm.stands_out - np.log(2)) < 0.25:
            cause += (
                f" (as from {patient.fps * (rhythm.period + 1) / rhythm.period:.3g} to {patient.fps:g} frames a second)"
            )
    else:
        leaps = [_leaps(each, patient.fps) for each in steps]
        rows = [row for row, count in enumerate(leaps) if count >= 3]
        if not rows or len(rows) * 3 < len(patient):
            return ()
        evidence = (
            f"{sum(leaps[row] for row in rows)} steps of {of_motions(len(rows), patient)} are about twice as long as"
            " their neighbours, which agree with each other"
        )
        cause = "frames are missing: they were dropped while the motion was recorded, cut or resampled"
    return (Diagnosis("clock", True, evidence, cause, AT_TIMES),)


def _common_rhythm(steps: Sequence[Steps], fps: float) -> _Rhythm | None:
    """The rhythm of more than half of the motions that are long enough, if there is one."""
    best: _Rhythm | None = None
    for period in range(2, _LONGEST_PERIOD + 1):
        measured = [found for found in (_rhythm(each, period, fps) for each in steps) if found is not None]
        strong = [found for found in measured if found.explained > _RHYTHM and found.stands_out > _STAND_OUT]
        if not measured or len(strong) * 2 <= len(measured):
            continue
        explained = float(np.median([found.explained for found in strong]))
        if best is None or explained > best.explained + 0.05:
            best = _Rhythm(period, explained, float(np.median([found.stands_out for found in strong])), len(strong))
    return best


def _standing_out(steps: Steps, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """How much each inner step stands out from its two neighbours (log), and where all three are fast and straight."""
    logs = np.log(np.maximum(steps.sizes, 1e-9))
    out = logs[1:-1] - (logs[:-2] + logs[2:]) / 2
    slow = max(0.5 * steps.usual, _SLOW / fps)
    triples = np.lib.stride_tricks.sliding_window_view(steps.sizes, 3)
    return out, (triples.mean(axis=1) > slow) & (np.minimum(steps.straight[1:], steps.straight[:-1]) > _STRAIGHT)


def _moving(steps: Steps, fps: float) -> int:
    """How many steps are fast, in one direction or to and fro."""
    return int((steps.sizes > max(0.5 * steps.usual, _SLOW / fps)).sum())


def _rhythm(steps: Steps, period: int, fps: float) -> _Rhythm | None:
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
    adjusted = 1 - (1 - explained / max(total, 1e-9)) * len(values) / max(len(values) - period, 1)
    return _Rhythm(period, adjusted, float(means.max()), 1)


def _leaps(steps: Steps, fps: float) -> int:
    """How many single steps are about twice as long as two on each side, which agree with each other."""
    if len(steps.sizes) < 6 or steps.usual == 0:
        return 0
    windows = np.lib.stride_tricks.sliding_window_view(steps.sizes, 5)
    neighbours = windows[:, [0, 1, 3, 4]]
    low, high = neighbours.min(axis=1), neighbours.max(axis=1)
    agreeing = (high < _LEVEL * low) & (low > max(0.7 * steps.usual, _SLOW / fps))
    return int((agreeing & (windows[:, 2] > _TOO_LONG * neighbours.mean(axis=1))).sum())
