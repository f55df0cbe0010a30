"""Finds motions whose time is wrong: another rate, uneven frames, another length."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, on_straight_lines, unit

_AT_RATE = (
    "Resample to the asked rate (prbench.representation.converters.at_rate), or let the method declare native_fps: an"
    " attribute of an adapter, a key in the hello of a program."
)
_AT_TIMES = "Resample on the frames' own times: prbench.representation.converters.at_times."
_STILL = 1e-4  # of a motion's usual step: the same frame again
_LONGEST_PERIOD = 8
_SLOW = 0.08  # m/s, mean of the joints: below, noise is larger than steps
_STRAIGHT = 0.6  # cosine between steps of one movement
_RHYTHM = 0.5  # share of the variance explained
_STAND_OUT = 0.3  # log of a step over the mean of its neighbours
_SHORTEST_HOLD = 4  # frames that stand still at an end
_FULL_SPEED = 0.10  # m/s, mean of the joints: a body cannot stop from it within a frame
_FRESH_START = 1.7  # first step after a hold, in steps that follow it
_CONTINUES = 0.7  # cosine between velocities
_BEGINS_THERE = 0.05  # metres between frame 0 and the initial pose
_SLOWEST = 0.10  # m/s of the joints' root mean square: slower starts are noise
_OFF = np.log(1.2)
_ERRORS = 2.5  # standard errors by which the median ratio must be farther off
_ENOUGH = 5
_SAME_RATIO = 0.02  # spread of the logarithm of the ratio
_NEAR = 0.025  # of a usual rate
_RATES = (5.0, 10.0, 12.0, 12.5, 15.0, 20.0, 24.0, 25.0, 29.97, 30.0, 40.0, 50.0, 59.94, 60.0, 90.0, 100.0, 120.0)


def examine_length(motion_set: MotionSet) -> Finding | None:
    """Compare numbers of frames: a common ratio is another frame rate, a common number is a fixed window."""
    known = [row for row, expected in enumerate(motion_set.expected) if expected.n_frames is not None]
    found = np.array([len(motion_set.motions[row]) for row in known])
    asked = np.array([motion_set.expected[row].n_frames for row in known])
    wrong = found != asked
    if not wrong.any():
        return None
    ratios = np.log((found - 1).clip(1) / (asked - 1).clip(1))
    ratio = float(np.exp(np.median(ratios)))
    row = int(np.argmax(wrong))
    evidence = f"another length in {motion_set.in_words(int(wrong.sum()))}, such as {found[row]} frames instead of"
    evidence += f" {asked[row]}; time is stretched by {ratio:.3f} (median)"
    remedy = "Return as many frames as were asked for (n_frames)."
    rate = min(_RATES, key=lambda usual: abs(np.log(usual / (motion_set.fps * ratio))))
    is_usual = abs(np.log(rate / (motion_set.fps * ratio))) < _NEAR
    if ((found - asked)[wrong] == -1).all():
        cause = "the last frame is missing: 263 features hold a step to the next frame and lose one"
        remedy += " Encode one frame more, or repeat none: extrapolate the last."
    elif wrong.all() and is_usual and np.ptp(ratios) < _SAME_RATIO + 4 / float(found.min()):
        cause = f"motions have {rate:g} frames a second, {motion_set.fps:g} were asked for"
        motions = list(motion_set.motions)
        for row, n_frames in zip(known, asked, strict=True):
            frames = np.arange(len(motions[row]))
            motions[row] = on_straight_lines(motions[row], frames, np.linspace(0, frames[-1], n_frames))
        remedy = f"Score a file with --native-fps {rate:g}. {_AT_RATE}"
        return Finding((Diagnosis("frame-rate", True, evidence, cause, remedy),), motion_set.with_motions(motions))
    elif len(set(found.tolist())) == 1 and len(set(asked.tolist())) > 1:
        cause = f"every motion has {found[0]} frames: a fixed window of the model, or padding that was not cut off"
    else:
        cause = "motions end where the model stopped, or were stretched by a factor that is no usual frame rate"
    return Finding((Diagnosis("length", True, evidence, cause, remedy),), motion_set)


def examine_repeats(motion_set: MotionSet) -> Finding | None:
    """Find single frames that are repeated in the midst of movement."""
    found: dict[int, np.ndarray] = {}
    for row, motion in enumerate(motion_set.motions):
        sizes, usual = _step_sizes(motion)
        still = sizes <= _STILL * usual
        # Find still steps in short runs that begin and end in movement.
        inside = np.zeros_like(still)
        edges = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(int), [0]))))
        for start, stop in edges.reshape(-1, 2):
            if start > 0 and stop < len(still) and stop - start < _SHORTEST_HOLD * 3:
                inside[start:stop] = True
        if usual > 0 and inside.sum() >= max(3, 0.03 * (~still).sum()):
            found[row] = inside
    if not found or len(found) * 3 < len(motion_set):  # a few may be recordings that lost track
        return None
    gaps = np.concatenate([np.diff(np.flatnonzero(inside)) for inside in found.values()])
    # The most frequent distance: frames that were lost while recording come at no fixed one.
    period = int(np.bincount(gaps).argmax())
    regular = float((gaps == period).mean())
    rhythm = ", at no fixed distance"
    cause = "another frame rate was reached by repeating the nearest frame"
    if period > 1 and regular > 0.5:
        rhythm = f", every {period} frames in {regular:.0%} of the cases"
        cause += f" (as from {motion_set.fps * (period - 1) / period:.3g} to {motion_set.fps:g} frames a second)"
    evidence = f"{sum(int(inside.sum()) for inside in found.values())} frames of {motion_set.in_words(len(found))}"
    evidence += f" equal the frame before them in the midst of movement{rhythm}"
    undone = list(motion_set.motions)
    for row, inside in found.items():
        kept = np.flatnonzero(np.concatenate(([True], ~inside)))
        undone[row] = on_straight_lines(undone[row][kept], kept, np.arange(len(undone[row])))
    return Finding((Diagnosis("clock", True, evidence, cause, _AT_RATE),), motion_set.with_motions(undone))


def _step_sizes(motion: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the mean way of the joints from each frame to the next, and that of a usual frame; metres."""
    sizes = np.linalg.norm(np.diff(motion, axis=0), axis=-1).mean(axis=-1)
    moving = sizes[sizes > 1e-7]
    return sizes, float(np.median(moving)) if moving.size else 0.0


def examine_holds(motion_set: MotionSet) -> Finding | None:
    """Find ends and beginnings that stand still although the body moves at full speed next to them.

    It is certain if most of the motions that are held there move at full speed next to it.
    """
    diagnoses = []
    for at_end, where, does, cause, remedy in (
        (
            True, "last", "stops from",
            "the end was padded with the last frame: the motion is shorter than was asked for",
            "Generate the asked number of frames, or let the motion take the asked time by interpolation.",
        ),
        (
            False, "first", "then starts at",
            "the motion comes too late: the first frame was repeated, or the clock starts before the motion",
            "Begin with the motion's own first frame; frame 0 is 2 s before the prime.",
        ),
    ):  # fmt: skip
        frames = []
        speeds = []
        for motion in motion_set.motions:
            sizes, usual = _step_sizes(motion[::-1] if at_end else motion)
            moving = np.flatnonzero(sizes > _STILL * usual)
            if usual > 0 and moving.size and moving[0] >= _SHORTEST_HOLD:
                next_to_it = sizes[moving[0] :][:4]
                sudden = len(next_to_it) > 1 and next_to_it[0] * _FRESH_START > np.median(next_to_it[1:])
                frames.append(moving[0] + (not at_end))
                speeds.append(float(next_to_it[0] * motion_set.fps) if sudden else 0.0)
        if not frames or len(frames) * 3 < len(motion_set):
            continue
        abrupt = sum(speed > _FULL_SPEED for speed in speeds)
        evidence = f"the {where} {np.median(frames):.0f} frames (median) of {motion_set.in_words(len(frames))} are one"
        evidence += f" and the same; in {abrupt} the body {does} {np.median(speeds):.2f} m/s (median) at once"
        diagnoses.append(Diagnosis("clock", abrupt * 2 > len(frames), evidence, cause, remedy))
    if not diagnoses:
        return None

    def without_holds(motion: np.ndarray) -> np.ndarray:
        sizes, usual = _step_sizes(motion)
        moving = np.flatnonzero(sizes > _STILL * usual)
        return motion[moving[0] : moving[-1] + 2] if moving.size else motion

    return Finding(tuple(diagnoses), motion_set.changed(without_holds))


def examine_rhythm(motion_set: MotionSet) -> Finding | None:
    """Find steps that are long and short in turns, in more than half of the motions that are long enough."""
    best = None
    for period in range(2, _LONGEST_PERIOD + 1):
        measured = [found for motion in motion_set.motions if (found := _rhythm(motion, period, motion_set.fps))]
        strong = [found for found in measured if found[0] > _RHYTHM and found[1] > _STAND_OUT]
        if measured and len(strong) * 2 > len(measured):
            explained, stands_out = np.median(strong, axis=0)
            if best is None or explained > best[1] + 0.05:
                best = period, explained, stands_out, len(strong)
    if best is None:
        return None
    period, explained, stands_out, count = best
    evidence = f"every {period} frames a step is {np.exp(stands_out):.2f} times as long as its neighbours in"
    evidence += f" {motion_set.in_words(count)}; this explains {explained:.0%} of how steps stand out"
    cause = "frames were picked by rounded indices, so that time passes unevenly"
    if abs(stands_out - np.log(2)) < 0.25:
        fps = motion_set.fps
        cause += f" (as from {fps * (period + 1) / period:.3g} to {fps:g} frames a second)"
    return Finding((Diagnosis("clock", True, evidence, cause, _AT_TIMES),), motion_set)


def _rhythm(motion: np.ndarray, period: int, fps: float) -> tuple[float, float] | None:
    """Return how much of how steps stand out the place in a period explains, and by how much one place stands out."""
    sizes, usual = _step_sizes(motion)
    if len(sizes) < 4 * period + 2 or usual == 0:
        return None
    flat = unit(np.diff(motion, axis=0).reshape(len(sizes), -1))
    straight = (flat[1:] * flat[:-1]).sum(axis=-1)
    # How much each inner step exceeds its two neighbours (log), where all three are fast and go in one direction.
    logs = np.log(np.maximum(sizes, 1e-9))
    out = logs[1:-1] - (logs[:-2] + logs[2:]) / 2
    slow = max(0.5 * usual, _SLOW / fps)
    mean_of_three = (sizes[:-2] + sizes[1:-1] + sizes[2:]) / 3
    fast = (mean_of_three > slow) & (np.minimum(straight[1:], straight[:-1]) > _STRAIGHT)
    if 2 * fast.sum() < int((sizes > slow).sum()):
        return None  # jitter, not movement
    place = (np.arange(len(out)) % period)[fast]
    counts = np.bincount(place, minlength=period)
    if (counts < 3).any():
        return None
    values = out[fast]
    means = np.bincount(place, weights=values, minlength=period) / counts
    explained = float((counts * (means - values.mean()) ** 2).sum() / counts.sum())
    # Adjusted for the number of places: with long periods any noise explains something.
    freedom = len(values) / max(len(values) - period, 1)
    return 1 - (1 - explained / max(float(values.var()), 1e-9)) * freedom, float(means.max())


def examine_frame_rate(motion_set: MotionSet) -> Finding | None:
    """Compare the first steps with the initial velocities."""
    ratios = []
    n_starts = 0
    for motion, expected in zip(motion_set.motions, motion_set.expected, strict=True):
        initial = expected.initial_joints
        if initial is None or expected.previous_joints is None or len(motion) < 2:
            continue
        before = (initial - expected.previous_joints).ravel()
        after = (motion[1] - motion[0]).ravel()
        speed = float(np.sqrt((before**2).sum() / len(initial))) * motion_set.fps
        if speed < _SLOWEST or float(np.abs(motion[0] - initial).max()) > _BEGINS_THERE:
            continue
        n_starts += 1
        # A body that changes direction at the start tells nothing of its clock.
        if before @ after > _CONTINUES * np.linalg.norm(before) * np.linalg.norm(after):
            ratios.append(float(before @ after / (before @ before)))
    if motion_set.pinned or len(ratios) < 3 or len(ratios) * 3 < n_starts:
        return None
    logs = np.log(ratios)
    spread = float(np.subtract(*np.percentile(logs, [75, 25])))
    ratio = float(np.exp(np.median(logs)))
    # The standard error of a median, from the middle half of values that are spread as normal ones are.
    error = 0.93 * spread / np.sqrt(len(logs))
    if abs(np.log(ratio)) - _ERRORS * error < _OFF:
        return None
    evidence = f"the step from frame 0 to 1 goes on in the direction of the initial velocity and is {ratio:.2f} times"
    evidence += f" as long (median of {len(logs)} starts in movement, middle half within"
    evidence += f" {np.exp(spread / 2):.2f} times)"
    made = f"{motion_set.fps / ratio:.3g} frames a second shown at {motion_set.fps:g}"
    cause = f"motions are played too {'fast' if ratio > 1 else 'slowly'}: they look like {made}"
    return Finding((Diagnosis("frame-rate", len(logs) >= _ENOUGH, evidence, cause, _AT_RATE),), motion_set)
