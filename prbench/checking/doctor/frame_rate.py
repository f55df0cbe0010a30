"""Finds motions of a wrong length, or that are played too fast or too slowly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.motion_set import (
    AT_RATE,
    Diagnosis,
    Expected,
    Finding,
    MotionSet,
    no_finding,
    on_straight_lines,
)
from prbench.checking.doctor.quality import SMOOTHED_OVER, Tremor, smoothed
from prbench.geometry.skeleton import TOES, WRISTS, Joint

_EDGE = 0.2  # of a movement's peak speed: where it begins and ends
_FAR = 0.3  # metres from its beginning to its end
_ENOUGH_MOVEMENTS = 4
_SWING = 0.29  # seconds, usual
_SWING_RANGE = (0.20, 0.40)  # seconds that are not suspicious
_REACH_RANGE = (0.25, 1.6)  # seconds that are not suspicious
_FARTHEST = 7.0  # times; 120 frames a second shown at 20 make 6, and what is farther off is no clock: feet slide, say
_ENOUGH_BENEATH_TREMOR = 12
_EQUALLY_LONG = 0.2  # interquartile range of the logarithm; walking 0.03 to 0.18, noise on other bodies 0.22 and more
_COARSEST = 1.9  # frames: narrower peaks are jitter
_CONTINUES = 0.8  # cosine between velocities
_BEGINS_THERE = 0.05  # metres between frame 0 and the initial pose
_SLOWEST = 0.05  # m/s of the joints' root mean square: slower starts are noise
_OFF = np.log(1.2)
_AGREEING = 0.25  # interquartile range of the logarithm of the ratio
_ENOUGH = 5
_SAME_RATIO = 0.02  # spread of the logarithm of the ratio
_NEAR = 0.025
_RATES = (5.0, 10.0, 12.0, 12.5, 15.0, 20.0, 24.0, 25.0, 29.97, 30.0, 40.0, 50.0, 59.94, 60.0, 90.0, 100.0, 120.0)


@dataclass(frozen=True)
class _Start:
    """The first step of a motion, compared with the step before it."""

    ratio: float
    """First step over the step before it."""
    cosine: float


def examine_length(motion_set: MotionSet) -> Finding:
    """Compare numbers of frames: a common ratio is another frame rate, a common number is a fixed window."""
    known = [row for row, expected in enumerate(motion_set.expected) if expected.n_frames is not None]
    found = np.array([len(motion_set.motions[row]) for row in known])
    asked = np.array([motion_set.expected[row].n_frames for row in known])
    wrong = found != asked
    if not wrong.any():
        return no_finding(motion_set)
    lines = f"another length in {motion_set.in_words(int(wrong.sum()))}, {_example(found, asked)}"
    ratios = np.log((found - 1).clip(1) / (asked - 1).clip(1))
    ratio = float(np.exp(np.median(ratios)))
    differences = found - asked
    undone = motion_set
    kind = "length"
    remedy = "Return as many frames as were asked for (n_frames)."
    if (differences[wrong] == -1).all():
        cause = "the last frame is missing: 263 features hold a step to the next frame and lose one"
        remedy += " Encode one frame more, or repeat none: extrapolate the last."
    elif (
        wrong.all()
        and (rate := _rate(motion_set.fps * ratio))
        and np.ptp(ratios) < _SAME_RATIO + 4 / float(found.min())
    ):
        kind = "frame-rate"
        cause = f"motions have {rate:g} frames a second, {motion_set.fps:g} were asked for"
        remedy = AT_RATE
        undone = _stretched(motion_set, known)
    elif len(set(found.tolist())) == 1 and len(set(asked.tolist())) > 1:
        cause = f"every motion has {found[0]} frames: a fixed window of the model, or padding that was not cut off"
    else:
        cause = "motions end where the model stopped, or were stretched by a factor that is no usual frame rate"
    diagnosis = Diagnosis(kind, True, lines, cause, remedy)
    return Finding((diagnosis,), undone)


def _example(found: np.ndarray, asked: np.ndarray) -> str:
    row = int(np.argmax(found != asked))
    ratio = np.median((found - 1).clip(1) / (asked - 1).clip(1))
    return f"such as {found[row]} frames instead of {asked[row]}; time is stretched by {ratio:.3f} (median)"


def _rate(exact: float) -> float | None:
    """Round a measured rate to the nearest common rate, or return None if none is within 2.5 %."""
    nearest = min(_RATES, key=lambda rate: abs(np.log(rate / exact)))
    return nearest if abs(np.log(nearest / exact)) < _NEAR else None


def _stretched(motion_set: MotionSet, known: list[int]) -> MotionSet:
    motions = list(motion_set.motions)
    for row in known:
        n_frames = motion_set.expected[row].n_frames
        if n_frames is not None and len(motions[row]) > 1:
            frames = np.arange(len(motions[row]))
            motions[row] = on_straight_lines(motions[row], frames, np.linspace(0, frames[-1], n_frames))
    return motion_set.with_motions(motions)


def examine_frame_rate(motion_set: MotionSet) -> Finding:
    """Compare first steps with initial velocities; without these, look at how long feet and hands take."""
    if motion_set.pinned:
        return no_finding(motion_set)
    starts = [
        start
        for motion, expected in zip(motion_set.motions, motion_set.expected, strict=True)
        if (start := _start(motion, expected, motion_set.fps)) is not None
    ]
    # A body that changes direction at the start tells nothing of its clock.
    going_on = [start.ratio for start in starts if start.cosine > _CONTINUES and start.ratio > 0]
    if len(going_on) * 2 > len(starts) and len(going_on) >= 3:
        return Finding(_by_velocity(np.log(going_on), motion_set), motion_set)
    return Finding(_tempo_of_limbs(motion_set), motion_set)


def _start(motion: np.ndarray, expected: Expected, fps: float) -> _Start | None:
    initial = expected.initial_joints
    previous = expected.previous_joints
    if initial is None or previous is None or len(motion) < 2:
        return None
    before = (initial - previous).ravel()
    after = (motion[1] - motion[0]).ravel()
    speed = float(np.sqrt((before**2).sum() / len(initial))) * fps
    if speed < _SLOWEST or float(np.abs(motion[0] - initial).max()) > _BEGINS_THERE:
        return None
    length = max(float(np.linalg.norm(before) * np.linalg.norm(after)), 1e-12)
    return _Start(float(before @ after / (before @ before)), float(before @ after / length))


def _by_velocity(logs: np.ndarray, motion_set: MotionSet) -> tuple[Diagnosis, ...]:
    middle = float(np.median(logs))
    spread = float(np.subtract(*np.percentile(logs, [75, 25])))
    if abs(middle) < _OFF or spread > _AGREEING:
        return ()
    ratio = float(np.exp(middle))
    evidence = (
        f"the step from frame 0 to 1 goes on in the direction of the initial velocity and is {ratio:.2f} times as long"
        f" (median of {len(logs)} starts in movement, middle half within {np.exp(spread / 2):.2f} times)"
    )
    fast = "fast" if ratio > 1 else "slowly"
    made = f"{motion_set.fps / ratio:.3g} frames a second shown at {motion_set.fps:g}"
    cause = f"motions are played too {fast}: they look like {made}"
    return (Diagnosis("frame-rate", len(logs) >= _ENOUGH, evidence, cause, AT_RATE),)


def _tempo_of_limbs(motion_set: MotionSet) -> tuple[Diagnosis, ...]:
    """Find suspicious durations of steps, or of reaches where nobody steps.

    A foot's swing lasts nearly the same at any walking speed: its speed stays above a fifth of its peak for 0.27 to
    0.31 s in synthetic people and 0.2 to 0.3 s in recorded ones. Hands take 0.3 to 1.5 s. So this is only a suspicion.

    Trembling moves the places at which a swing begins and ends, and makes swings of its own. So it is smoothed away
    first, and only steps that then last equally long count, as those of a walking person do at any rate.
    """
    if Tremor.of(motion_set.motions) is not None:
        return _tempo_beneath_tremor(motion_set)
    swings = _swings(motion_set.motions)
    if len(swings) >= _ENOUGH_MOVEMENTS:
        return _judged(swings, motion_set.fps, "steps", _SWING_RANGE)
    reaches = np.concatenate(
        [_durations(motion[:, wrist] - motion[:, Joint.PELVIS]) for motion in motion_set.motions for wrist in WRISTS]
    )
    return (
        _judged(reaches, motion_set.fps, "hands' movements", _REACH_RANGE) if len(reaches) >= _ENOUGH_MOVEMENTS else ()
    )


def _tempo_beneath_tremor(motion_set: MotionSet) -> tuple[Diagnosis, ...]:
    swings = _swings([smoothed(motion) for motion in motion_set.motions])
    if len(swings) < _ENOUGH_BENEATH_TREMOR:
        return ()
    spread = float(np.subtract(*np.percentile(np.log(swings), [75, 25])))
    if spread > _EQUALLY_LONG:
        return ()
    # Widths of convolved Gaussians add in squares, so the smoothing can be subtracted again.
    widened = 2 * np.sqrt(-2 * np.log(_EDGE)) * SMOOTHED_OVER  # width at the edge of the Gaussian that smoothed
    durations = np.sqrt(np.maximum(swings**2 - widened**2, 1.0))
    return _judged(durations, motion_set.fps, "steps", _SWING_RANGE)


def _swings(motions: Sequence[np.ndarray]) -> np.ndarray:
    """Return the frames that each swing of a foot takes."""
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
    """Return the frames of each movement of a joint that begins and ends within the motion and leads far."""
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1)
    if len(speed) < 8:
        return np.empty(0)
    durations = []
    last = 0
    for peak in _peaks(speed):
        edge = _EDGE * speed[peak]
        before = np.flatnonzero(speed[:peak] < edge)
        after = np.flatnonzero(speed[peak:] < edge)
        if not before.size or not after.size or before[-1] < last:
            continue
        start = int(before[-1])
        stop = int(peak + after[0])
        if speed[start:stop].max() > speed[peak]:
            continue
        last = stop
        if np.linalg.norm(path[stop] - path[start + 1]) > _FAR:
            # Between frames, by a straight line: whole frames would be too coarse for swings of six of them.
            begin = start + (edge - speed[start]) / (speed[start + 1] - speed[start])
            end = stop - (edge - speed[stop]) / (speed[stop - 1] - speed[stop])
            durations.append(end - begin)
    return np.array(durations)


def _peaks(speed: np.ndarray) -> np.ndarray:
    """Return the frames of local maxima of speed above 30 % of its maximum."""
    inner = speed[1:-1]
    return 1 + np.flatnonzero((inner > speed[:-2]) & (inner >= speed[2:]) & (inner > 0.3 * speed.max()))
