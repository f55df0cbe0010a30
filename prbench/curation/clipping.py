"""Cut a clip from a primed event: frames on the grid that ends at the event, in the world frame.

Source: docs/specification/curation.md#clip.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.curation.events import Decision
from prbench.geometry.skeleton import facing_yaw
from prbench.geometry.timelines import SequenceGrid, covered, interpolate, slerp
from prbench.protocol.manifests import BenchmarkProtocol
from prbench.recording import BodyStream, GazeStream, Recording
from prbench.sequences.sequence import FrameSource

_SLACK = 1e-6  # seconds; streams of one recording are written with different rounding


@dataclass(frozen=True)
class Clip:
    """One sequence in the world frame, metres; quaternions w x y z."""

    grid: SequenceGrid
    joints: Float[np.ndarray, "n 22 3"]
    previous_joints: Float[np.ndarray, "22 3"]
    previous_source: FrameSource
    next_joints: Float[np.ndarray, "22 3"]
    next_source: FrameSource
    head_position: Float[np.ndarray, "n 3"] | None
    head_rotation: Float[np.ndarray, "n 4"] | None
    gaze_origin: Float[np.ndarray, "n 3"]
    gaze_direction: Float[np.ndarray, "n 3"]
    gaze_valid: Bool[np.ndarray, " n"]


def clip(recording: Recording, *, prime_time: float, event_time: float, protocol: BenchmarkProtocol) -> Clip | Decision:
    """Cut ``[prime_time - lead, event_time]`` out of a recording and put it on the protocol's grid.

    Returns:
        The clip, or why there is none: ``no_body`` (also for a first frame without a heading), or ``too_short``
        because the recording or its body does not cover the span (stage ``clipping``; value and threshold: seconds
        available and needed) or the body has a gap in it (stage ``body``; value and threshold: longest gap and longest
        that is interpolated, seconds).
    """
    lead = protocol.curation.lead
    max_gap = protocol.curation.largest_interpolated_gap
    grid = SequenceGrid.ending_at(event_time, prime_time=prime_time, lead=lead, fps=protocol.fps)
    times = grid.times
    body = recording.body
    if body is None:
        return Decision("no_body", "body")
    if outside := _outside(recording.span, (prime_time - lead, event_time)):
        return outside
    if not covered(body.times, body.valid, times, max_gap=max_gap).all():
        span = (grid.start_time, float(times[-1]))
        usable = body.times[body.valid]
        if len(usable) == 0:
            return Decision("too_short", "clipping", 0.0, span[1] - span[0])
        # Estimated bodies begin some frames after the glasses. Nothing is extrapolated, however little is missing.
        if beyond := _outside((float(usable[0]), float(usable[-1])), span):
            return beyond
        first, stop = np.searchsorted(usable, span)
        around = usable[max(first - 1, 0) : stop + 1]  # with the nearest sample on either side
        return Decision("too_short", "body", float(np.diff(around).max()), max_gap)
    joints = joints_at(body, times)
    try:
        facing_yaw(joints[0])
    except ValueError:  # without a heading there is no canonical frame
        return Decision("no_body", "body")
    # One frame beyond either end: the initial velocity and the last feature row need them.
    step = 1 / grid.fps
    around = np.array([grid.start_time - step, event_time + step])
    recorded = covered(body.times, body.valid, around, max_gap=max_gap)
    before, after = joints_at(body, around)
    # The glasses' pose, interpolated over invalid rows; None if no valid row lies within the clip.
    head = recording.head
    head_position = head_rotation = None
    if (head.valid & (head.times >= times[0] - _SLACK) & (head.times <= times[-1] + _SLACK)).any():
        near = _around(head.times, head.valid, times)
        head_position = interpolate(head.times[near], head.position[near], times)
        head_rotation = slerp(head.times[near], head.rotation[near], times)
    ends = (*_neighbour(before, bool(recorded[0]), joints), *_neighbour(after, bool(recorded[1]), joints[::-1]))
    return Clip(grid, joints, *ends, head_position, head_rotation, *gaze_at(recording.gaze, times, max_gap=max_gap))


def _outside(span: tuple[float, float], interval: tuple[float, float]) -> Decision | None:
    """Return a decision if the interval does not lie within the recording; its value and threshold are in seconds."""
    start, end = interval
    if end > span[1] + _SLACK:
        return Decision("too_short", "clipping", span[1] - start, end - start)
    if start < span[0] - _SLACK:
        return Decision("too_short", "clipping", end - span[0], end - start)
    return None


def joints_at(body: BodyStream, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 22 3"]:
    """Return the joints between the nearest valid samples, world frame, metres.

    Args:
        body: The body, with one valid sample or more.
        times: Seconds.
    """
    near = _around(body.times, body.valid, times)
    return interpolate(body.times[near], body.joints[near], times)


def _around(
    times: Float[np.ndarray, " n"], valid: Bool[np.ndarray, " n"], query: Float[np.ndarray, " m"]
) -> Int[np.ndarray, " k"]:
    """Return indices of the valid samples around the query times, with one more on either side; at least one."""
    usable = np.flatnonzero(valid)
    first, stop = np.searchsorted(times[usable], [query[0], query[-1]])
    return usable[min(max(first - 1, 0), len(usable) - 1) : stop + 1]


def _neighbour(
    recorded: Float[np.ndarray, "22 3"], is_recorded: bool, inwards: Float[np.ndarray, "n 22 3"]
) -> tuple[Float[np.ndarray, "22 3"], FrameSource]:
    """Return the frame just outside a clip: recorded, else continued with the speed of the two frames at that end."""
    if is_recorded:
        return recorded, "recorded"
    if len(inwards) < 2:
        return inwards[0], "copied"
    return 2 * inwards[0] - inwards[1], "extrapolated"


def gaze_at(
    gaze: GazeStream, times: Float[np.ndarray, " n"], *, max_gap: float
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Rays between neighbouring valid samples; invalid where these are too far apart (blinks, losses).

    Slow trackers are allowed 1.5 of their own period (docs/specification/aria-mps.md#eye-gaze).
    """
    period = float(np.median(np.diff(gaze.times))) if len(gaze.times) > 1 else 0.0
    valid = covered(gaze.times, gaze.valid, times, max_gap=max(max_gap, 1.5 * period))
    if not gaze.valid.any():
        return np.zeros((len(times), 3)), np.tile([0.0, 0.0, 1.0], (len(times), 1)), valid
    near = _around(gaze.times, gaze.valid, times)
    origin = interpolate(gaze.times[near], gaze.origin[near], times)
    direction = interpolate(gaze.times[near], gaze.direction[near], times)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    opposite = length[:, 0] < 1e-6  # two opposite neighbours have no mean
    direction = np.where(opposite[:, None], [0.0, 0.0, 1.0], direction / np.where(length > 0, length, 1.0))
    return origin, direction, valid & ~opposite
