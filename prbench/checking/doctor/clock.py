"""A clock that stumbles: frames that stand twice, ends and beginnings that stand still."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.patient import Finding, Patient, of_motions
from prbench.checking.doctor.remedies import AT_RATE
from prbench.checking.doctor.steps import Steps, examine_steps
from prbench.checking.doctor.types import Diagnosis

_SHORTEST_HOLD = 4  # frames that stand still at an end
_FULL_SPEED = 0.10  # m/s, mean of the joints: a body cannot stop from it within a frame
_FRESH_START = 1.7  # first step after a hold, in steps that follow it


def examine_clock(patient: Patient) -> Finding:
    """Look for frames that are repeated, left out, or held."""
    repeats = _repeats(patient)
    holds = _holds(repeats.patient)
    uneven = () if repeats.diagnoses else examine_steps(holds.patient)
    return Finding((*repeats.diagnoses, *holds.diagnoses, *uneven), holds.patient)


def _repeats(patient: Patient) -> Finding:
    """Single frames that stand twice or more in the midst of movement."""
    found: dict[int, np.ndarray] = {}
    for row, motion in enumerate(patient.motions):
        steps = Steps.of(motion)
        inside = _short_holds(steps)
        moving = (~steps.still).sum()
        if steps.usual > 0 and inside.sum() >= 3 and inside.sum() >= 0.03 * moving:
            found[row] = inside
    if len(found) * 3 < len(patient):  # a few may be recordings that lost track
        return Finding((), patient)
    counts = [int(inside.sum()) for inside in found.values()]
    gaps = np.concatenate([np.diff(np.flatnonzero(inside)) for inside in found.values()])
    period = int(np.bincount(gaps).argmax())
    regular = float((gaps == period).mean())
    rhythm = ", at no fixed distance"
    if period > 1 and regular > 0.5:
        rhythm = f", every {period} frames in {regular:.0%} of the cases"
    evidence = (
        f"{sum(counts)} frames of {of_motions(len(found), patient)} equal the frame before them in the midst of"
        f" movement{rhythm}"
    )
    cause = "another frame rate was reached by repeating the nearest frame"
    if regular > 0.5 and period > 1:
        cause += f" (as from {patient.fps * (period - 1) / period:.3g} to {patient.fps:g} frames a second)"
    undone = [_filled_in(motion, found[row]) if row in found else motion for row, motion in enumerate(patient.motions)]
    return Finding((Diagnosis("clock", True, evidence, cause, AT_RATE),), patient.with_motions(undone))


def _short_holds(steps: Steps) -> np.ndarray:
    """Still steps in runs shorter than a hold that begin and end in movement."""
    still = steps.still
    edges = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(int), [0]))))
    chosen = np.zeros_like(still)
    for start, stop in edges.reshape(-1, 2):
        if start > 0 and stop < len(still) and stop - start < _SHORTEST_HOLD * 3:
            chosen[start:stop] = True
    return chosen


def _filled_in(motion: np.ndarray, repeated: np.ndarray) -> np.ndarray:
    """Straight lines over the frames that were repeated."""
    kept = np.flatnonzero(np.concatenate(([True], ~repeated)))
    flat = motion.reshape(len(motion), -1)
    times = np.arange(len(motion))
    return np.stack([np.interp(times, kept, column[kept]) for column in flat.T], axis=1).reshape(motion.shape)


def _holds(patient: Patient) -> Finding:
    """Ends and beginnings that stand still although the body is in full speed next to them."""
    ends = _hold(
        patient,
        at_end=True,
        told="the last {frames} frames (median) of {motions} are one and the same; in {abrupt} the body stops from"
        " {speed:.2f} m/s (median) at once",
        cause="the end was padded with the last frame: the motion is shorter than was asked for",
        remedy="Generate the asked number of frames, or let the motion take the asked time by interpolation.",
    )
    starts = _hold(
        patient,
        at_end=False,
        told="the first {frames} frames (median) of {motions} are one and the same; in {abrupt} the body then starts"
        " at {speed:.2f} m/s (median)",
        cause="the motion comes too late: the first frame was repeated, or the clock starts before the motion",
        remedy="Begin with the motion's own first frame; frame 0 is 2 s before the prime.",
    )
    diagnoses = (*ends, *starts)
    held = [_without_holds(motion) for motion in patient.motions]
    return Finding(diagnoses, patient.with_motions(held) if diagnoses else patient)


def _hold(patient: Patient, *, at_end: bool, told: str, cause: str, remedy: str) -> tuple[Diagnosis, ...]:
    """One side: certain if most of the motions that are held there are in full speed next to it."""
    held = _held(patient, at_end=at_end)
    if len(held) * 3 < len(patient):
        return ()
    abrupt = sum(speed > _FULL_SPEED for _, speed in held.values())
    frames = int(np.median([count for count, _ in held.values()])) + (not at_end)
    motions = of_motions(len(held), patient)
    evidence = told.format(frames=frames, motions=motions, abrupt=abrupt, speed=_median_speed(held))
    return (Diagnosis("clock", abrupt * 2 > len(held), evidence, cause, remedy),)


def _median_speed(held: dict[int, tuple[int, float]]) -> float:
    return float(np.median([speed for _, speed in held.values()]))


def _held(patient: Patient, *, at_end: bool) -> dict[int, tuple[int, float]]:
    """For each motion that is held at one end: how many frames, and the speed next to them (m/s)."""
    held = {}
    for row, motion in enumerate(patient.motions):
        steps = Steps.of(motion[::-1] if at_end else motion)
        moving = np.flatnonzero(~steps.still)
        if steps.usual == 0 or not moving.size or moving[0] < _SHORTEST_HOLD:
            continue
        first = steps.sizes[moving[0] :][:4]
        sudden = len(first) > 1 and first[0] * _FRESH_START > np.median(first[1:])
        held[row] = int(moving[0]), float(first[0] * patient.fps) if sudden else 0.0
    return held


def _without_holds(motion: np.ndarray) -> np.ndarray:
    moving = np.flatnonzero(~Steps.of(motion).still)
    return motion[moving[0] : moving[-1] + 2] if moving.size else motion
