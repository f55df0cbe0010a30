"""What is done to a method's joints after its network: bones keep their lengths, feet stand or swing.

Networks predict positions or features of them, so bones waver and feet glide. Both are mended here in the same way for
every method, each sequence by itself. The options ``bones=predicted`` and ``feet=predicted`` leave the motions as the
network and its published decoding have them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from prbench.contract import ConditionBatch, Motions
from prbench.geometry.skeleton import bone_lengths

Joints = Float[np.ndarray, "batch frames 22 3"]

FINISHING_OPTIONS = ("bones", "feet")

_MET = 0.05  # metres, mean over the joints, up to which the last frame is the goal pose
_BEGINNING = 0.5  # seconds over which the correction of the first frame fades out; choice: about a step


@dataclass(frozen=True)
class Finishing:
    """Which of both is done.

    Attributes:
        bones: Every bone has the length of the given first pose, in which the motion begins; without one, that of the
            motion's own first frame.
        feet: Feet stand or swing.
    """

    bones: bool = True
    feet: bool = True

    @classmethod
    def of(cls, options: Mapping[str, str]) -> Finishing:
        """Return what the options ``bones`` (initial or predicted) and ``feet`` (steps or predicted) ask for.

        Raises:
            ValueError: naming the option with another value.
        """
        asked = {}
        for key, value in zip(FINISHING_OPTIONS, ("initial", "steps"), strict=True):
            found = options.get(key, value)
            if found not in (value, "predicted"):
                raise ValueError(f"option '{key}': expected {value} or predicted, found '{found}'.")
            asked[key] = found == value
        return cls(**asked)

    def __call__(self, motions: Motions, batch: ConditionBatch) -> Motions:
        """Finish the motions of a batch; a goal pose that a motion ends in stays its last frame."""
        if not (self.bones or self.feet):
            return motions
        first = motions.joints[:, 0] if batch.initial_joints is None else batch.initial_joints
        lengths = bone_lengths(first.astype(np.float64)) if self.bones else None
        met = np.zeros(len(batch), dtype=bool)
        if batch.goal_joints is not None:
            last = motions.joints[np.arange(len(batch)), motions.n_frames - 1]
            met = np.linalg.norm(last - batch.goal_joints, axis=-1).mean(axis=-1) <= _MET
        joints = motions.joints
        if self.bones and batch.initial_joints is not None:
            # What a motion lacks to begin in the given pose fades out, before its last frame.
            fading = np.clip(motions.n_frames - 1, 1, _BEGINNING * batch.fps)[:, None]
            share = 0.5 + 0.5 * np.cos(np.pi * np.minimum(np.arange(joints.shape[1]) / fading, 1))
            joints = joints + share[..., None, None] * (batch.initial_joints - joints[:, 0])[:, None]
        joints = finish(joints, motions.n_frames, batch.fps, lengths=lengths, feet=self.feet, keep_last=met)
        return replace(motions, joints=joints.astype(motions.joints.dtype))


def finish(
    joints: Joints,
    n_frames: Int[np.ndarray, " batch"],
    fps: float,
    *,
    lengths: Float[np.ndarray, "batch 21"] | None,
    feet: bool,
    keep_last: bool | np.ndarray,
) -> Joints:
    """Return the motions with bones of given lengths and feet that stand or swing; the first frame is kept.

    Args:
        joints: Canonical frame, Y up, the floor at 0, metres. Padding is left alone.
        n_frames: Valid frames of each sequence.
        fps: Frames per second.
        lengths: Lengths of the bones, metres, in the order of :data:`prbench.geometry.skeleton.BONES`; None leaves the
            bones as they are.
        feet: Let the feet stand or swing.
        keep_last: Keep the last frame, too; one answer for all sequences, or one each.
    """
    import torch  # which the commands that list methods and their options do without

    from prbench_adapters.diffusion.generation import with_bone_lengths
    from prbench_adapters.footsteps import on_feet

    done = joints.copy()
    for row, (n, keep) in enumerate(zip(n_frames, np.broadcast_to(keep_last, len(joints)), strict=True)):
        motion = torch.as_tensor(joints[row, :n], dtype=torch.float64)
        if lengths is not None:
            motion = with_bone_lengths(motion[None], torch.as_tensor(lengths[row : row + 1], dtype=torch.float64))[0]
        if feet:
            motion = on_feet(motion, fps, keep_last=bool(keep))
        done[row, :n] = motion.numpy()
    return done
