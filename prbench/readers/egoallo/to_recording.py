"""Converts EgoAllo's outputs to a body stream.

Sources: docs/specification/egoallo.md#time and docs/specification/egoallo.md#joints.

Readers call this with what the files hold, synthetic recordings with what their sensors say; so both mean the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import N_JOINTS, transform_points
from prbench.geometry.timelines import covered
from prbench.readers.egoallo import format as ego
from prbench.recording import BodyStream, PoseStream, hold_neighbours, plausible_body_frames
from prbench.representation.converters import RestJoints
from prbench.representation.converters.smpl import pose_body

# Message about a recording without outputs.
NO_OUTPUTS = "no EgoAllo outputs: no body (`prbench poses egoallo` says how to make them)"


def body_from_outputs(outputs: Sequence[ego.EgoAlloOutput], rest: RestJoints) -> ego.EgoAlloBody | None:
    """Return one body from the windows of one recording: in the order of their first times, frames that two hold once.

    Of each window the first guess counts, with its shape averaged over time; float32, as the files are. Where windows
    overlap the one that begins earlier is kept. Gaps between windows stay gaps.

    Args:
        outputs: Windows of one recording, in any order.
        rest: The body model that they were made with.

    Returns:
        None without windows.
    """
    ordered = sorted(outputs, key=lambda window: (int(window.time_ns[0]), window.name))
    settled = []
    time_ns = np.zeros(0, dtype=np.int64)
    joints = np.zeros((0, N_JOINTS, 3), dtype=np.float32)
    for window in ordered:
        before = int(np.searchsorted(time_ns, window.time_ns[0] - ego.SAME_FRAME_NS))
        settled.append((time_ns[:before], joints[:before]))  # no later window reaches back there
        time_ns = time_ns[before:]
        new = np.ones(len(window.time_ns), dtype=bool)
        if len(time_ns):
            # In integers: a float does not hold nanoseconds of a device clock exactly.
            right = np.clip(np.searchsorted(time_ns, window.time_ns), 0, len(time_ns) - 1)
            left = np.clip(right - 1, 0, None)
            nearest = np.minimum(np.abs(time_ns[left] - window.time_ns), np.abs(time_ns[right] - window.time_ns))
            new = nearest > ego.SAME_FRAME_NS
        time_ns = np.concatenate([time_ns, window.time_ns[new]])
        order = np.argsort(time_ns, kind="stable")
        time_ns = time_ns[order]
        root = window.world_from_root[0].astype(np.float64)
        rotations = np.concatenate([root[:, None, :4], window.body_quats[0].astype(np.float64)], axis=1)
        rotations /= np.linalg.norm(rotations, axis=-1, keepdims=True)
        shaped = rest.of(window.betas[0].astype(np.float64).mean(axis=0))
        posed = pose_body(shaped, root[:, 4:], rotations)[0].astype(np.float32)
        joints = np.concatenate([joints[before:], posed[new]])[order]
    if not ordered:
        return None
    time_ns, joints = (np.concatenate(parts) for parts in zip(*settled, (time_ns, joints), strict=True))
    # Tell the user what is unusual.
    remarks = []
    if several := sum(len(window.world_from_root) > 1 for window in ordered):
        remarks.append(f"{several} of {len(ordered)} EgoAllo outputs hold several samples; the first is taken")
    if gaps := int((np.diff(time_ns) > ego.LONGEST_STEP * 1e9).sum()):
        remarks.append(f"{gaps} gaps of more than {ego.LONGEST_STEP * 1e3:.0f} ms in the EgoAllo body")
    return ego.EgoAlloBody(time_ns, joints, tuple(remarks))


def body_stream(
    body: ego.EgoAlloBody, *, world_from_source: Float[np.ndarray, "4 4"], head: PoseStream | None = None
) -> BodyStream:
    """Return the 22 joints in the recording's world, device seconds; implausible frames are masked and filled.

    Args:
        body: Joints in the source world, on the device clock.
        world_from_source: Source world (Z up) to the recording's (Y up).
        head: Poses of the glasses, device seconds; where they have a gap of more than 0.1 s, EgoAllo had
            nothing to go by, and the body is invalid.
    """
    times = body.time_ns / 1e9
    joints = transform_points(world_from_source, body.joints.astype(np.float64))
    valid = plausible_body_frames(times, joints)
    if head is not None:
        valid &= covered(head.times, head.valid, times, max_gap=ego.LONGEST_STEP)
    return BodyStream(times, hold_neighbours(joints, valid), valid)
