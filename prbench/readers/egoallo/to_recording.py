"""Converts EgoAllo's outputs to a body stream.

Sources: docs/specification/egoallo.md#time and docs/specification/egoallo.md#joints.

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import transform_points
from prbench.geometry.timelines import covered
from prbench.readers.egoallo import format as ego
from prbench.recording.streams import BodyStream, PoseStream, hold_neighbours, plausible_body_frames

NO_OUTPUTS = "no EgoAllo outputs: no body (`prbench poses egoallo` says how to make them)"
"""Message about a recording without outputs."""


def body_from_outputs(outputs: Sequence[ego.EgoAlloOutput], rest: ego.SmplhRest) -> ego.EgoAlloBody | None:
    """One body from the windows of one recording; None without windows.

    Args:
        outputs: In any order.
        rest: The body model that they were made with.
    """
    return joined_windows([window_joints(output, rest) for output in outputs])


def window_joints(output: ego.EgoAlloOutput, rest: ego.SmplhRest) -> ego.BodyWindow:
    """Joints of the first guess of one window, with its shape averaged over time; float32, as the files are."""
    root, quats = (_unit_quaternions(array[0]) for array in (output.world_from_root[..., :4], output.body_quats))
    joints = ego.forward_kinematics(
        rest.rest_joints(output.betas[0].astype(np.float64).mean(axis=0)),
        output.world_from_root[0, :, 4:].astype(np.float64),
        root,
        quats,
    )
    return ego.BodyWindow(output.name, output.time_ns, joints.astype(np.float32), len(output.world_from_root))


def joined_windows(windows: Sequence[ego.BodyWindow]) -> ego.EgoAlloBody | None:
    """One body from several windows: in the order of their first times, frames that two of them hold once.

    Where windows overlap the one that begins earlier is kept. Gaps between windows stay gaps.
    """
    if not windows:
        return None
    ordered = sorted(windows, key=lambda window: (int(window.time_ns[0]), window.name))
    settled = []
    latest = (ordered[0].time_ns, ordered[0].joints)
    for window in ordered[1:]:
        before = int(np.searchsorted(latest[0], window.time_ns[0] - ego.SAME_FRAME_NS))
        settled.append(tuple(part[:before] for part in latest))  # no later window reaches back there
        latest = _merged(latest[0][before:], latest[1][before:], window)
    time_ns, joints = (np.concatenate(parts) for parts in zip(*settled, latest, strict=True))
    return ego.EgoAlloBody(time_ns, joints, _remarks(ordered, time_ns))


def _merged(time_ns: np.ndarray, joints: np.ndarray, window: ego.BodyWindow) -> tuple[np.ndarray, np.ndarray]:
    """Kept frames, and those of a window that are none of them."""
    new = _distance_to(time_ns, window.time_ns) > ego.SAME_FRAME_NS
    times = np.concatenate([time_ns, window.time_ns[new]])
    order = np.argsort(times, kind="stable")
    return times[order], np.concatenate([joints, window.joints[new]])[order]


def body_stream(
    body: ego.EgoAlloBody,
    *,
    world_from_source: Float[np.ndarray, "4 4"],
    seconds_before_device: float = 0.0,
    head: PoseStream | None = None,
) -> BodyStream:
    """The 22 joints in the recording's world and on its clock; implausible frames are masked and filled.

    Args:
        body: In the source world, on the device clock.
        world_from_source: Source world (Z up) to the recording's (Y up).
        seconds_before_device: Recording time = device seconds - this.
        head: Poses of the glasses on the recording's clock; where they have a gap of more than 0.1 s, EgoAllo had
            nothing to go by, and the body is invalid.
    """
    times = body.time_ns / 1e9 - seconds_before_device
    joints = transform_points(world_from_source, body.joints.astype(np.float64))
    valid = plausible_body_frames(times, joints)
    if head is not None:
        valid &= covered(head.times, head.valid, times, max_gap=ego.LONGEST_STEP)
    return BodyStream(times, hold_neighbours(joints, valid), valid)


def _unit_quaternions(quaternions: np.ndarray) -> np.ndarray:
    wide = quaternions.astype(np.float64)
    return wide / np.linalg.norm(wide, axis=-1, keepdims=True)


def _distance_to(kept: np.ndarray, query: np.ndarray) -> np.ndarray:
    """Nanoseconds from each query time to the nearest kept one, in integers; for ever where none is kept."""
    if len(kept) == 0:
        return np.full(len(query), np.iinfo(np.int64).max)
    # In integers: a float does not hold nanoseconds of a device clock exactly.
    right = np.clip(np.searchsorted(kept, query), 0, len(kept) - 1)
    left = np.clip(right - 1, 0, None)
    return np.minimum(np.abs(kept[left] - query), np.abs(kept[right] - query))


def _remarks(windows: Sequence[ego.BodyWindow], time_ns: np.ndarray) -> tuple[str, ...]:
    remarks = []
    several = sum(window.samples > 1 for window in windows)
    if several:
        remarks.append(f"{several} of {len(windows)} EgoAllo outputs hold several samples; the first is taken")
    followed = sorted({window.guidance for window in windows if window.guidance})
    if followed:
        remarks.append(f"EgoAllo was guided by: {', '.join(followed)}")
    gaps = int((np.diff(time_ns) > ego.LONGEST_STEP * 1e9).sum())
    if gaps:
        remarks.append(f"{gaps} gaps of more than {ego.LONGEST_STEP * 1e3:.0f} ms in the EgoAllo body")
    return tuple(remarks)
