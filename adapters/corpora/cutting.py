"""Cut clips out of a motion: frames of the corpus' rate in the clip's own canonical frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.sequences.sequence import FrameSource


@dataclass(frozen=True)
class CutMotion:
    """One clip: canonical frame, metres."""

    joints: Float[np.ndarray, "n 22 3"]
    previous_joints: Float[np.ndarray, "22 3"]
    previous_source: FrameSource
    next_joints: Float[np.ndarray, "22 3"]
    next_source: FrameSource
    world_from_canonical: Float[np.ndarray, "4 4"]


def cut_motion(motion: Float[np.ndarray, "frames 22 3"], first: int, stride: int, n_frames: int) -> CutMotion:
    """Every ``stride``-th frame from ``first`` on, in the canonical frame of the first of them.

    Args:
        motion: World frame, Y up, metres, without gaps.
        first: Index of the clip's first frame.
        stride: Frames of the motion for one of the clip.
        n_frames: Frames of the clip.

    Raises:
        ValueError: if the first pose faces nowhere, so that no canonical frame exists.
    """
    taken = motion[first : first + stride * (n_frames - 1) + 1 : stride].astype(np.float64)
    world_from_canonical = canonical_frame(taken)
    before, previous_source = _neighbour(motion, first - stride, taken)
    # Turned round, the last two frames come first, and their speed is continued outwards.
    after, next_source = _neighbour(motion, first + stride * n_frames, taken[::-1])
    canonical_from_world = invert_rigid(world_from_canonical)
    return CutMotion(
        joints=transform_points(canonical_from_world, taken),
        previous_joints=transform_points(canonical_from_world, before),
        previous_source=previous_source,
        next_joints=transform_points(canonical_from_world, after),
        next_source=next_source,
        world_from_canonical=world_from_canonical,
    )


def _neighbour(motion: np.ndarray, index: int, inwards: np.ndarray) -> tuple[np.ndarray, FrameSource]:
    """The frame just outside a clip: recorded, else continued with the speed of the two frames at that end."""
    if 0 <= index < len(motion):
        return motion[index].astype(np.float64), "recorded"
    if len(inwards) < 2:
        return inwards[0], "copied"
    return 2 * inwards[0] - inwards[1], "extrapolated"
