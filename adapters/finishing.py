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
from prbench.geometry.skeleton import N_JOINTS, PARENTS, TOES, Joint, bone_lengths
from prbench_adapters.diffusion.footsteps import stepped

Joints = Float[np.ndarray, "batch frames 22 3"]
Motion = Float[np.ndarray, "frames 22 3"]
Points = Float[np.ndarray, "frames 2 3"]  # of the left and the right limb
Lengths = Float[np.ndarray, "frames 2"]

FINISHING_OPTIONS = ("bones", "feet")

_STILL = 0.2  # m/s below which a toe counts as planted: the protocol's ``slide_speed``
_LOW = 0.05  # metres above the floor below which it must be, too: ``foot_height``
_MET = 0.05  # metres, mean over the joints, up to which the last frame is the goal pose
_SHORTEST = 1e-9  # metres; keeps the direction of a vanished bone finite
_STRETCHED = 0.999  # share of thigh and shank that a leg reaches, so that its knee keeps a side to bend to
_BEGINNING = 0.5  # seconds over which the correction of the first frame fades out; choice: about a step
_EASE = 0.3  # seconds over which the body comes down before a leg would be too short; choice
_HIPS = (Joint.LEFT_HIP, Joint.RIGHT_HIP)
_KNEES = (Joint.LEFT_KNEE, Joint.RIGHT_KNEE)
_ANKLES = (Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE)


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
            met = _length(last - batch.goal_joints).mean(axis=-1) <= _MET
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
    done = joints.copy()
    for row, (n, keep) in enumerate(zip(n_frames, np.broadcast_to(keep_last, len(joints)), strict=True)):
        motion = joints[row, :n].astype(np.float64)
        if lengths is not None:
            motion = _with_lengths(motion, lengths[row])
        if feet:
            motion = _on_feet(motion, fps, keep_last=bool(keep))
        done[row, :n] = motion
    return done


def _with_lengths(motion: Motion, lengths: Float[np.ndarray, "21"]) -> Motion:
    """Keep the directions of all bones, the pelvis' place over the floor, and the height of the lowest joint."""
    moved = motion.copy()
    for joint in range(1, N_JOINTS):  # parents come before their children
        bone = motion[:, joint] - motion[:, PARENTS[joint]]
        direction = bone / np.maximum(_length(bone), _SHORTEST)[:, None]
        moved[:, joint] = moved[:, PARENTS[joint]] + direction * lengths[joint - 1]
    moved[..., 1] += (motion[..., 1].min(axis=1) - moved[..., 1].min(axis=1))[:, None]
    return moved


def _on_feet(motion: Motion, fps: float, *, keep_last: bool) -> Motion:
    """Let the toes stand or swing, and the legs reach from the hips to them."""
    toes = motion[:, TOES]
    still = _length(np.diff(toes[..., ::2], axis=0)) * fps < _STILL
    low = toes[..., 1] < _LOW
    stands = np.zeros(toes.shape[:2], dtype=bool)
    stands[1:] |= still & low[1:] & low[:-1]
    stands[:-1] |= still & low[1:] & low[:-1]
    moves = stepped(toes, stands, fps, keeps_last=keep_last) - toes
    targets = motion[:, _ANKLES] + moves
    upper = _length(motion[:, _KNEES] - motion[:, _HIPS])
    lower = _length(motion[:, _ANKLES] - motion[:, _KNEES])
    # The body comes down as far as a leg is too short, smoothly, and not in frames that are kept.
    away = _length((targets - motion[:, _HIPS])[..., ::2])
    longest = np.maximum(_STRETCHED * (upper + lower), _length(motion[:, _ANKLES] - motion[:, _HIPS]))
    reach = np.sqrt(np.maximum(longest**2 - away**2, 0))
    short = np.maximum(motion[:, _HIPS, 1] - targets[..., 1] - reach, 0).max(axis=1)
    done = motion.copy()
    done[..., 1] -= _eased_down(short, fps, keep_last=keep_last)[:, None]
    ways = targets - done[:, _HIPS]
    done[:, _ANKLES] = done[:, _HIPS] + ways * np.minimum(longest / np.maximum(_length(ways), _SHORTEST), 1)[..., None]
    done[:, TOES] = done[:, _ANKLES] + motion[:, TOES] - motion[:, _ANKLES]
    # Knees are turned along with their legs: one that swings past its knee's side would bend the other way.
    bends = motion[:, _KNEES] - motion[:, _HIPS]
    bends = _turned_along(bends, motion[:, _ANKLES] - motion[:, _HIPS], done[:, _ANKLES] - done[:, _HIPS])
    done[:, _KNEES] = _middle(done[:, _HIPS], done[:, _ANKLES], upper, lower, bends)
    return done


def _eased_down(short: Float[np.ndarray, " frames"], fps: float, *, keep_last: bool) -> Float[np.ndarray, " frames"]:
    """Return how far the body comes down: as far as it is too high, and partly shortly before and after."""
    frames = np.arange(len(short))
    near = np.clip(np.abs(frames[:, None] - frames) / (_EASE * fps), 0, 1)
    down = (short * (0.5 + 0.5 * np.cos(np.pi * near))).max(axis=1)
    ends = frames if not keep_last else np.minimum(frames, frames[::-1])
    return down * np.clip(ends / (_EASE * fps), 0, 1)


def _middle(root: Points, end: Points, upper: Lengths, lower: Lengths, bend: Points) -> Points:
    """Return where knees or elbows are.

    Args:
        root: Hips or shoulders, metres.
        end: Ankles or wrists, within reach.
        upper: Lengths of the upper bones.
        lower: Lengths of the lower bones.
        bend: Directions to the side of which the limbs bend.
    """
    way = end - root
    distance = np.maximum(_length(way), _SHORTEST)
    along = way / distance[..., None]
    # Law of cosines: the foot of the middle joint on the line from root to end, and its distance from that line.
    foot = (upper**2 - lower**2 + distance**2) / (2 * distance)
    height = np.sqrt(np.maximum(upper**2 - foot**2, 0))
    aside = bend - (bend * along).sum(axis=-1, keepdims=True) * along
    aside = aside / np.maximum(_length(aside), _SHORTEST)[..., None]
    return root + along * foot[..., None] + aside * height[..., None]


def _turned_along(vectors: Points, source: Points, target: Points) -> Points:
    """Vectors, turned by the smallest rotation that turns one direction into another (Rodrigues)."""
    source = source / np.maximum(_length(source), _SHORTEST)[..., None]
    target = target / np.maximum(_length(target), _SHORTEST)[..., None]
    axis = np.cross(source, target)
    once = np.cross(axis, vectors)
    cosine = (source * target).sum(axis=-1, keepdims=True)
    return vectors + once + np.cross(axis, once) / np.maximum(1 + cosine, _SHORTEST)


def _length(vectors: Float[np.ndarray, "*batch axes"]) -> Float[np.ndarray, "*batch"]:
    return np.linalg.norm(vectors, axis=-1)
