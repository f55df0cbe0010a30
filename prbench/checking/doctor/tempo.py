"""How long feet take to swing and hands to reach: what a body tells of its clock when nothing else is known.

A foot's swing lasts nearly the same whatever the speed of walking: its speed stays above a fifth of its peak for 0.27
to 0.31 s in invented people and 0.2 to 0.3 s in recorded ones. Hands take between 0.3 and 1.5 s. So this can only make
suspicious, and says nothing where nobody steps or reaches.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from prbench.checking.doctor.patient import Patient
from prbench.checking.doctor.remedies import AT_RATE
from prbench.checking.doctor.tremor import SMOOTHED_OVER, Tremor, smoothed
from prbench.checking.doctor.types import Diagnosis
from prbench.skeleton import TOES, WRISTS, Joint

_EDGE = 0.2  # of a movement's peak speed: where it begins and ends
_FAR = 0.3  # metres from its beginning to its end
_ENOUGH = 4
_SWING, _SWING_RANGE = 0.29, (0.20, 0.40)  # seconds: usual, and what is not suspicious
_REACH_RANGE = (0.25, 1.6)
_FARTHEST = 7.0  # times; 120 frames a second shown at 20 make 6, and what is farther off is no clock: feet slide, say
_ENOUGH_BENEATH_TREMOR = 12
_EQUALLY_LONG = 0.2  # interquartile range of the logarithm; walking 0.03 to 0.18, noise on other bodies 0.22 and more
_COARSEST = 1.9  # frames: narrower peaks are jitter


def tempo_of_limbs(patient: Patient) -> tuple[Diagnosis, ...]:
    """Suspicious durations of steps, or of reaches where nobody steps.

    Trembling moves the places at which a swing begins and ends, and makes swings of its own. So it is smoothed away
    first, and only steps that then last equally long count, as those of a walking person do at any rate.
    """
    if Tremor.of(patient.motions) is not None:
        return _tempo_beneath_tremor(patient)
    swings = _swings(patient.motions)
    if len(swings) >= _ENOUGH:
        return _judged(swings, patient.fps, "steps", _SWING_RANGE)
    reaches = np.concatenate(
        [_durations(motion[:, wrist] - motion[:, Joint.PELVIS]) for motion in patient.motions for wrist in WRISTS]
    )
    return _judged(reaches, patient.fps, "hands' movements", _REACH_RANGE) if len(reaches) >= _ENOUGH else ()


def _tempo_beneath_tremor(patient: Patient) -> tuple[Diagnosis, ...]:
    swings = _swings([smoothed(motion) for motion in patient.motions])
    if len(swings) < _ENOUGH_BENEATH_TREMOR:
        return ()
    spread = float(np.subtract(*np.percentile(np.log(swings), [75, 25])))
    if spread > _EQUALLY_LONG:
        return ()
    widened = 2 * np.sqrt(-2 * np.log(_EDGE)) * SMOOTHED_OVER  # width at the edge of the Gaussian that smoothed
    durations = np.sqrt(np.maximum(swings**2 - widened**2, 1.0))
    return _judged(durations, patient.fps, "steps", _SWING_RANGE)


def _swings(motions: Sequence[np.ndarray]) -> np.ndarray:
    """Frames that each swing of a foot takes."""
    return np.concatenate([_durations(motion[:, toe][:, [0, 2]]) for motion in motions for toe in TOES])


def _judged(frames: np.ndarray, fps: float, what: str, usual: tuple[float, float]) -> tuple[Diagnosis, ...]:
    middle = float(np.median(frames))
    seconds = middle / fps
    typical = float(np.sqrt(usual[0] * usual[1]))
    if usual[0] <= seconds <= usual[1] or middle < _COARSEST or seconds > _FARTHEST * typical:
        return ()
    evidence = (
        f"{len(frames)} {what} last {seconds:.2f} s (median, at {fps:g} frames a second); people's {usual[0]:g} to"
        f" {usual[1]:g} s"
    )
    cause = f"motions are played too {'slowly' if seconds > usual[1] else 'fast'}"
    if what == "steps":
        cause += f": they look like about {middle / _SWING:.0f} frames a second shown at {fps:g}"
    return (Diagnosis("frame-rate", False, evidence, cause, f"Check the rate at which motions were made. {AT_RATE}"),)


def _durations(path: np.ndarray) -> np.ndarray:
    """Frames that each movement of a joint takes, for those that begin and end within the motion and lead far."""
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1)
    if len(speed) < 8:
        return np.empty(0)
    durations, last = [], 0
    for peak in _peaks(speed):
        edge = _EDGE * speed[peak]
        before, after = np.flatnonzero(speed[:peak] < edge), np.flatnonzero(speed[peak:] < edge)
        if not before.size or not after.size or before[-1] < last:
            continue
        start, stop = int(before[-1]), int(peak + after[0])
        if speed[start:stop].max() > speed[peak]:
            continue
        last = stop
        if np.linalg.norm(path[stop] - path[start + 1]) > _FAR:
            begin = start + (edge - speed[start]) / (speed[start + 1] - speed[start])
            end = stop - (edge - speed[stop]) / (speed[stop - 1] - speed[stop])
            durations.append(end - begin)
    return np.array(durations)


def _peaks(speed: np.ndarray) -> np.ndarray:
    """Where speed is higher than before and not lower than after, if it is high at all."""
    inner = speed[1:-1]
    return 1 + np.flatnonzero((inner > speed[:-2]) & (inner >= speed[2:]) & (inner > 0.3 * speed.max()))
