"""Align a device with the body segment that carries it: clocks, the transform between them, and what changed meanwhile.

Every stage, threshold and source: docs/specification/alignment.md.
"""

from __future__ import annotations

import itertools
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.alignment import hand_eye
from prbench.alignment.clock import LONGEST_GAP, Clock, find_clock
from prbench.alignment.hand_eye import Motions, Transform
from prbench.geometry.timelines import covered, interpolate, slerp
from prbench.recording import PoseStream

LEAST_OVERLAP = 60.0  # s
LEAST_SINGULAR_RATIO = 0.05
WINDOW = 120.0  # s
WINDOW_STEP = 5.0  # s
SLIPPED_BY = np.array([2.0, 0.02])  # degrees, metres: glasses that moved by more are mounted otherwise
_FRAME = 1 / 240.0  # s of drift below which a clock counts as steady
_HIGHEST_RATE = 120.0  # Hz of frames between which motions are taken
_MOST_STARTS = 60_000  # motions of a span; a longer recording is looked at less densely
_FEWEST_MOTIONS = 100
_LEAST_TURNING = 5.0  # s in which device and segment turn by enough
_LARGEST_RESIDUAL = 1.0  # degrees, median; users measured 0.09 at the 95th percentile of one file
_FEW_AGREE = 0.5  # share
_SHORTEST_SIDE = 20.0  # s on either side of a slip
_SURE = 2.5  # standard errors by which a change must stand out
_NEARLY_PLANAR = 3.0  # condition number of the translation


class Residual(msgspec.Struct, frozen=True, kw_only=True):
    """How far A X and X B are apart after one stage.

    Attributes:
        stage: Name of the stage.
        unit: ``°`` or ``mm``.
        p50: Median over the relative motions.
        p95: Their 95th percentile.
    """

    stage: str
    unit: str
    p50: float
    p95: float


class Slip(msgspec.Struct, frozen=True, kw_only=True):
    """The device moved against the segment.

    Attributes:
        time: Seconds on the device's clock.
        rotation: Degrees.
        translation: Metres.
    """

    time: float
    rotation: float
    translation: float


class Alignment(msgspec.Struct, frozen=True, kw_only=True):
    """What is known of a device on a segment.

    Attributes:
        refused: Reason why there is no X; empty where there is one.
        overlap: Seconds that both tracked, on the clocks that were found.
        clock: Offset and drift; None where too few poses could be compared.
        kept: Share of the relative motions that turn enough of which device and segment turn by the same angle.
        n_motions: Number of relative motions that decided.
        singular_ratio: Second singular value over the first; small where the head turned about one axis only.
        condition: Condition number of the translation's equations.
        weakest_direction: Direction in which the translation is known least, device coordinates.
        device_from_segment: X, 4 x 4, metres; where the device slipped, that of the longest stretch between slips.
        residuals: One row a stage.
        rolling: X of windows of 120 s every 5 s, which end where the device slipped: time of the middle (device clock,
            seconds), rotation (w x y z) and translation (metres).
        rolling_range: Largest difference between two windows, degrees and metres.
        slips: Sudden changes of X, in the order of time.
        findings: Sentences about what a user should look at.
    """

    refused: str = ""
    overlap: float = 0.0
    clock: Clock | None = None
    kept: float = 0.0
    n_motions: int = 0
    singular_ratio: float | None = None
    condition: float = 0.0
    weakest_direction: tuple[float, ...] = ()
    device_from_segment: tuple[tuple[float, float, float, float], ...] | None = None
    residuals: tuple[Residual, ...] = ()
    rolling: tuple[tuple[float, ...], ...] = ()
    rolling_range: tuple[float, float] = (0.0, 0.0)
    slips: tuple[Slip, ...] = ()
    findings: tuple[str, ...] = ()

    def x_at(self, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """Return X at device times: constant, or the rolling one (slerp between centres) where the device moved.

        Raises:
            ValueError: where alignment was refused.
        """
        if self.device_from_segment is None:
            raise ValueError(f"there is no alignment: {self.refused}")
        x = np.tile(np.array(self.device_from_segment), (len(times), 1, 1))
        if self.moved:
            rolling = np.array(self.rolling)
            turn = slerp(rolling[:, 0], rolling[:, 1:5], times)
            x[:, :3, :3] = Rotation.from_quat(turn, scalar_first=True).as_matrix()
            x[:, :3, 3] = interpolate(rolling[:, 0], rolling[:, 5:], times)
        return x

    @property
    def moved(self) -> bool:
        """Return True where X changed by more than 2° or 2 cm over time."""
        return bool((np.array(self.rolling_range) > SLIPPED_BY).any())

    def segment_in_world(self, device: PoseStream) -> PoseStream:
        """Return the segment in the device's world at the device's times: T_WD · X."""
        x = self.x_at(device.times)
        turn = Rotation.from_quat(device.rotation, scalar_first=True)
        turned = (turn * Rotation.from_matrix(x[:, :3, :3])).as_quat(scalar_first=True)
        return PoseStream(device.times, device.position + turn.apply(x[:, :3, 3]), turned, device.valid)


def align(
    device: PoseStream, segment: PoseStream, *, offset: float | None = None, least_overlap: float = LEAST_OVERLAP
) -> Alignment:
    """Find the clocks' offset and the X with T_WS(t) = T_WD(t) · X.

    Args:
        device: Poses of the device in any world, on its clock.
        segment: Poses of the segment that carries it, in any other world, on its own clock.
        offset: Segment's clock minus the device's where it is known to within half a second; 0 of one clock.
        least_overlap: Seconds that both must have tracked.

    Returns:
        The alignment, or why it is refused; nothing is raised for recordings that cannot be aligned.
    """
    clock = find_clock(device, segment, around=offset)
    if clock is None:
        return Alignment(refused="the two tracks have too few poses in common to compare how they turn")
    motions, overlap, start_rate = relative_motions(device, segment, clock)
    turning, agreeing = hand_eye.usable(motions)
    chosen = motions[agreeing if agreeing.sum() >= _FEWEST_MOTIONS else slice(None)]
    singular = hand_eye.rotation_of(chosen)[1]
    ratio = float(singular[1] / max(singular[0], 1e-12))
    known: dict[str, Any] = {"overlap": overlap, "clock": clock, "singular_ratio": ratio}
    known |= {"kept": float(agreeing.sum() / max(turning.sum(), 1)), "n_motions": int(agreeing.sum())}
    share = f"{int(turning.sum())} of {len(motions)} relative motions turn by 2° to 60°, device and segment alike in"
    named = f"{share} {int(agreeing.sum())}; σ₂/σ₁ = {ratio:.3f}"
    refused = ""
    if turning.sum() < _LEAST_TURNING * start_rate * len(hand_eye.SPANS):
        refused = f"the device hardly turns, so that how it sits cannot be observed: {named}"
    elif clock.doubt():
        refused = f"device and segment turn alike by {clock.doubt()}: are they of one recording?"
    elif overlap < least_overlap:
        refused = f"the two tracks share {overlap:.1f} s without gaps; at least {least_overlap:g} s are needed"
    elif agreeing.sum() < _FEWEST_MOTIONS:
        refused = f"device and segment turn by different angles: {named}"
    elif ratio < LEAST_SINGULAR_RATIO:
        named += f", at least {LEAST_SINGULAR_RATIO:g} is needed"
        refused = f"all turns are about one axis, so that how the device sits cannot be observed: {named}"
    if refused:
        return Alignment(refused=refused, **known)

    slips = _slips(chosen, float(chosen.times[0]), float(chosen.times[-1]), start_rate)
    borders = [-np.inf, *(slip.time for slip in slips), np.inf]
    stretches = [_between(chosen, *pair) for pair in itertools.pairwise(borders)]
    longest = max(stretches, key=len)
    by_stages, _, normal = hand_eye.in_stages(longest)
    x = hand_eye.refined(longest, by_stages)
    residuals = []
    for stages, estimate in ((("rotation", "translation"), by_stages), (("joint", "joint"), x)):
        for stage, unit, errors in zip(stages, ("°", "mm"), hand_eye.sizes_of_errors(longest, estimate), strict=True):
            p50, p95 = np.percentile(errors, [50, 95]).tolist()
            residuals.append(Residual(stage=stage, unit=unit, p50=p50, p95=p95))
    if residuals[2].p50 > _LARGEST_RESIDUAL:
        apart = f"median {residuals[2].p50:.1f}° a motion; {_LARGEST_RESIDUAL:g}° at most"
        return Alignment(refused=f"device and segment turn about different axes ({apart})", **known)
    values, vectors = np.linalg.eigh(normal)
    rolling = tuple(row for each in stretches if len(each) for row in _rolling(each, start_rate))
    rows = np.array(rolling).reshape(-1, 8)
    # The largest difference between two windows.
    nearest = min((float(np.abs(rows[:, 1:5] @ row[1:5]).min()) for row in rows), default=1.0)
    farthest = max((float(np.linalg.norm(rows[:, 5:] - row[5:], axis=1).max()) for row in rows), default=0.0)
    known |= {"condition": float(np.sqrt(values[2] / max(values[0], 1e-12))), "slips": slips, "rolling": rolling}
    known["rolling_range"] = (float(np.rad2deg(2 * np.arccos(min(nearest, 1.0)))), farthest)
    known |= {"weakest_direction": tuple(vectors[:, 0].tolist()), "residuals": tuple(residuals)}
    found = Alignment(device_from_segment=tuple(map(tuple, x.tolist())), **known)
    return msgspec.structs.replace(found, findings=_findings(found, clock))


def relative_motions(device: PoseStream, segment: PoseStream, clock: Clock) -> tuple[Motions, float, float]:
    """Return the relative motions, the seconds that both tracked, and the motions of each span that begin a second."""
    at = segment.times[segment.valid]
    native = 1.0 / float(np.median(np.diff(at)))
    rate = native / max(1.0, round(native / _HIGHEST_RATE))  # frames of the segment are used as they are
    mine = clock.to_segment(device.times[device.valid][[0, -1]])
    inside = at[(at >= mine[0]) & (at <= mine[1])]
    on_segment = np.arange(inside[0], inside[-1], 1.0 / rate) if len(inside) else np.zeros(0)
    times = clock.to_device(on_segment)
    valid = covered(device.times, device.valid, times, max_gap=LONGEST_GAP)
    valid &= covered(segment.times, segment.valid, on_segment, max_gap=LONGEST_GAP)
    # Both ends of a motion and every frame between them were tracked: no gap is bridged.
    stretch = np.cumsum(~valid)
    every = max(1, -(-len(times) // _MOST_STARTS))
    pairs = []
    for span in hand_eye.SPANS:
        step = max(1, round(span * rate))
        first = np.arange(0, max(len(times) - step, 0), every)
        whole = valid[first] & (stretch[first] == stretch[first + step])
        pairs.append(np.stack([first[whole], first[whole] + step]))
    frames = np.concatenate(pairs, axis=1)
    first, second = frames[:, np.argsort(frames[0], kind="stable")]
    poses = [stream.pose_at(moments) for stream, moments in ((device, times), (segment, on_segment))]
    tracks = [(Rotation.from_quat(rotation, scalar_first=True), position) for position, rotation in poses]
    return hand_eye.motions_between((first, second), times, *tracks), float(valid.sum() / rate), rate / every


def _between(motions: Motions, start: float, end: float) -> Motions:
    """Return the motions within a span of time, device clock; motions are sorted by time."""
    return motions[slice(*np.searchsorted(motions.times, [start, end - max(hand_eye.SPANS)]))]


def _estimate(motions: Motions, start_rate: float) -> tuple[Transform, np.ndarray] | None:
    """Return X of some motions, and its standard errors (degrees, metres); None where it is not observed."""
    if len(motions) < _FEWEST_MOTIONS:
        return None
    x, singular, normal = hand_eye.in_stages(motions)
    if singular[1] < LEAST_SINGULAR_RATIO * singular[0]:
        return None
    turning = np.eye(3) * (motions.turn_b**2).sum() - motions.turn_b.T @ motions.turn_b
    # Motions that overlap share their errors: as many as begin within the longest span count as one.
    shared = 1.48 * np.sqrt(start_rate * max(hand_eye.SPANS))
    spread = [float(np.median(np.abs(errors))) * shared for errors in hand_eye.errors_of(motions, x)]
    least = [max(float(np.linalg.eigvalsh(matrix)[0]), 1e-12) for matrix in (turning, normal)]
    return x, np.array([np.rad2deg(spread[0]), spread[1]]) / np.sqrt(least)


def _slips(motions: Motions, start: float, end: float, start_rate: float) -> tuple[Slip, ...]:
    """Find the instants at which X before and X after differ by more than 2° or 2 cm, in the order of time."""
    best: tuple[float, float, Transform, Transform] | None = None
    for instant in np.arange(start + _SHORTEST_SIDE, end - _SHORTEST_SIDE, WINDOW_STEP):
        before = _estimate(_between(motions, max(start, instant - WINDOW), instant), start_rate)
        after = _estimate(_between(motions, instant, min(end, instant + WINDOW)), start_rate)
        if before is None or after is None:
            continue
        change = _change(before[0], after[0])
        size = float(np.where(change > _SURE * np.hypot(before[1], after[1]), change / SLIPPED_BY, 0.0).max())
        if size > max(1.0, best[0] if best else 0.0):
            best = (size, float(instant), before[0], after[0])
    if best is None:
        return ()
    # The instant at which changing from the one X to the other leaves the least errors.
    around = _between(motions, max(start, best[1] - WINDOW / 2), min(end, best[1] + WINDOW / 2))
    errors = [np.stack(hand_eye.sizes_of_errors(around, x), axis=1) / SLIPPED_BY / [1, 1000] for x in best[2:]]
    costs = [np.minimum(each.sum(axis=1), 1.0) for each in errors]
    place = int(np.argmin(np.cumsum(costs[0] - costs[1])))
    time = float(np.clip(around.times[place], start + _SHORTEST_SIDE / 2, end - _SHORTEST_SIDE / 2))
    sides = [_between(motions, max(start, time - WINDOW), time), _between(motions, time, min(end, time + WINDOW))]
    rotation, translation = _change(*(hand_eye.in_stages(side)[0] for side in sides)).tolist()
    slip = Slip(time=time, rotation=rotation, translation=translation)
    return (*_slips(motions, start, time, start_rate), slip, *_slips(motions, time, end, start_rate))


def _change(before: Transform, after: Transform) -> np.ndarray:
    """Return the degrees and metres between two X."""
    turn = np.rad2deg(Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).magnitude())
    return np.array([turn, np.linalg.norm(after[:3, 3] - before[:3, 3])])


def _rolling(stretch: Motions, start_rate: float) -> list[tuple[float, ...]]:
    """Return X of windows of 120 s every 5 s and at both ends, where it is known well enough to tell a change."""
    start, end = stretch.times[[0, -1]]
    rows = []
    for time in (*np.arange(start, end, WINDOW_STEP), end):
        first = max(start, min(time - WINDOW / 2, end - WINDOW))
        estimate = _estimate(_between(stretch, first, first + WINDOW), start_rate)
        if estimate is not None and (2 * estimate[1] <= SLIPPED_BY).all():
            turn = Rotation.from_matrix(estimate[0][:3, :3]).as_quat(canonical=True, scalar_first=True)
            rows.append((float(time), *turn.tolist(), *estimate[0][:3, 3].tolist()))
    return rows


def _findings(found: Alignment, clock: Clock) -> tuple[str, ...]:
    """Return sentences about what a user should look at."""
    drift = f"{1000 * clock.drift:.1f} ms from the first third to the last ({1e6 * clock.rate:.0f} ppm)"
    along = ", ".join(f"{value:.2f}" for value in found.weakest_direction)
    creep = f"{found.rolling_range[0]:.1f}° and {100 * found.rolling_range[1]:.1f} cm"
    said = {
        f"the clocks drift: {drift}, which is taken out": abs(clock.drift) > _FRAME,
        f"the clocks drift unevenly: the middle third is off by {1000 * clock.bend:.1f} ms": abs(clock.bend) > _FRAME,
        f"the device creeps: up to {creep} between two windows": found.moved and not found.slips,
        f"turns are nearly planar: the translation along ({along}) is uncertain": found.condition > _NEARLY_PLANAR,
        f"device and segment turn by the same angle in {found.kept:.0%} of the motions only": found.kept < _FEW_AGREE,
    }
    for slip in found.slips:
        by = f"{slip.rotation:.1f}° and {100 * slip.translation:.1f} cm"
        said[f"the device moved against the segment by {by} at {slip.time:.1f} s of its clock"] = True
    return tuple(sentence for sentence, holds in said.items() if holds)
