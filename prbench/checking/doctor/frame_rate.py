"""Finds motions whose time is wrong: another rate, uneven frames, another length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.body import SMOOTHED_OVER, Tremor, smoothed
from prbench.checking.doctor.motion_set import (
    AT_RATE,
    AT_TIMES,
    Diagnosis,
    Expected,
    Finding,
    MotionSet,
    no_finding,
    on_straight_lines,
    unit,
)
from prbench.geometry.skeleton import TOES, WRISTS, Joint

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
        # Find still steps in short runs that begin and end in movement.
        still = steps.still
        edges = np.flatnonzero(np.diff(np.concatenate(([0], still.astype(int), [0]))))
        chosen = np.zeros_like(still)
        for start, stop in edges.reshape(-1, 2):
            if start > 0 and stop < len(still) and stop - start < _SHORTEST_HOLD * 3:
                chosen[start:stop] = True
        inside = chosen
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
    # Map the row of each motion held at one end to the held frames and the speed next to them (m/s).
    held = {}
    for row, motion in enumerate(motion_set.motions):
        steps = _Steps.of(motion[::-1] if at_end else motion)
        moving = np.flatnonzero(~steps.still)
        if steps.usual == 0 or not moving.size or moving[0] < _SHORTEST_HOLD:
            continue
        first = steps.sizes[moving[0] :][:4]
        sudden = len(first) > 1 and first[0] * _FRESH_START > np.median(first[1:])
        held[row] = int(moving[0]), float(first[0] * motion_set.fps) if sudden else 0.0
    if len(held) * 3 < len(motion_set):
        return ()
    abrupt = sum(speed > _FULL_SPEED for _, speed in held.values())
    frames = int(np.median([count for count, _ in held.values()])) + (not at_end)
    speed = float(np.median([speed for _, speed in held.values()]))
    evidence = text.format(frames=frames, motions=motion_set.in_words(len(held)), abrupt=abrupt, speed=speed)
    return (Diagnosis("clock", abrupt * 2 > len(held), evidence, cause, remedy),)


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
    # How much each inner step exceeds its two neighbours (log), and where all three are fast and straight.
    logs = np.log(np.maximum(steps.sizes, 1e-9))
    out = logs[1:-1] - (logs[:-2] + logs[2:]) / 2
    slow = max(0.5 * steps.usual, _SLOW / fps)
    triples = np.lib.stride_tricks.sliding_window_view(steps.sizes, 3)
    out, fast = out, (triples.mean(axis=1) > slow) & (np.minimum(steps.straight[1:], steps.straight[:-1]) > _STRAIGHT)
    # Count the steps that are fast, in one direction or to and fro.
    if 2 * fast.sum() < int((steps.sizes > max(0.5 * steps.usual, _SLOW / fps)).sum()):
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
    return Finding(tuple(_judged_by_recording(copies, motion_set)), motion_set)


def _judged_by_recording(copies: list[_Match], motion_set: MotionSet) -> list[Diagnosis]:
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
    # The mean recorded frame of each frame along the cheapest path.
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
    places = np.array([np.mean(way) if way else 0.0 for way in ways])
    same = min(len(motion), len(recorded))
    before = float(apart[np.arange(same), np.arange(same)].mean())
    left = float(apart[np.arange(len(motion)), places.round().astype(int)].mean())
    speed = np.linalg.norm(np.gradient(recorded, axis=0), axis=-1).mean(axis=-1)
    moves = speed[places.round().astype(int)] > 0.5 * np.median(speed)
    return _Match(places, left, before, moves)


def _line(match: _Match) -> tuple[float, float, float]:
    """Return slope, start and largest departure (95 %) of the straight line through the frames in movement."""
    frames = np.flatnonzero(match.moves)
    if len(frames) < 8:
        frames = np.arange(len(match.places))
    # Only frames in movement: while a body stands still, any of its frames match.
    slope, start = np.polyfit(frames, match.places[frames], 1)
    off = np.abs(match.places[frames] - slope * frames - start)
    return float(slope), float(start), float(np.percentile(off, 95))


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
        motions = list(motion_set.motions)
        for row in known:
            n_frames = motion_set.expected[row].n_frames
            if n_frames is not None and len(motions[row]) > 1:
                frames = np.arange(len(motions[row]))
                motions[row] = on_straight_lines(motions[row], frames, np.linspace(0, frames[-1], n_frames))
        undone = motion_set.with_motions(motions)
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
    swings = _swings(motion_set.motions)
    if len(swings) >= _ENOUGH_MOVEMENTS:
        return _judged(swings, motion_set.fps, "steps", _SWING_RANGE)
    reaches = np.concatenate(
        [_durations(motion[:, wrist] - motion[:, Joint.PELVIS]) for motion in motion_set.motions for wrist in WRISTS]
    )
    return (
        _judged(reaches, motion_set.fps, "hands' movements", _REACH_RANGE) if len(reaches) >= _ENOUGH_MOVEMENTS else ()
    )


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
