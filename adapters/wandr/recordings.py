"""Training motions as WANDR learns from them: at its frame rate, in its world, with right hands that reach."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int

from prbench.geometry.skeleton import Joint
from prbench.representation.encoding import MIRRORED_JOINTS
from prbench_adapters.kinematics import WANDR as WORLD
from prbench_adapters.kinematics import rest_offsets, root_orientation
from prbench_adapters.training import MotionBatch
from prbench_adapters.wandr.state import BodyState, heading_of, yaw_rotation

_FAR = 1.5  # metres that the pelvis has to walk to a pseudo goal
_ROUNDING = 1e-4  # frames


@dataclass(frozen=True)
class Recordings:
    """B recorded motions; frame 0 is the one before the first, frames from ``n_frames[i]`` on are padding."""

    joints: Float[torch.Tensor, "batch frames 22 3"]
    """World with Z up, metres."""
    n_frames: Int[torch.Tensor, " batch"]
    has_goal: Bool[torch.Tensor, " batch"]
    """True where the last frame reaches a goal; otherwise goals are made up (:func:`goal_frames`)."""

    @classmethod
    def of(cls, batch: MotionBatch, fps: float) -> Recordings:
        """The motions of a batch, left-handed ones as a mirror shows them.

        A hand is left if the left wrist is nearer to the goal location in the last frame. Clips of a corpus, which have
        no goal location, stay as they are.
        """
        last = batch.goal_joints
        distance = (last[:, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]] - batch.goal_location[:, None]).norm(dim=-1)
        joints, n_frames = _resampled(batch, fps)
        mirrored = joints[:, :, list(MIRRORED_JOINTS)] * joints.new_tensor((-1.0, 1.0, 1.0))
        left = (distance[:, 0] < distance[:, 1])[:, None, None, None]
        has_goal = torch.isfinite(batch.goal_location).all(dim=-1)
        return cls(WORLD.from_y_up(torch.where(left, mirrored, joints)), n_frames, has_goal)

    def states(self, places: Places) -> BodyState:
        """The bodies at some places; fitted when asked for, because a step needs few of the frames."""
        return BodyState.fitted(self.joints[places.index])

    @cached_property
    def headings(self) -> Float[torch.Tensor, "batch frames 3"]:
        """Directions that the bodies face."""
        return heading_of(yaw_rotation(root_orientation(self.joints)))

    def deltas(self, places: Places) -> Float[torch.Tensor, "*places 135"]:
        """The changes from there to the frames that follow."""
        return self.states(places).delta_to(self.states(places.later(1)))

    @cached_property
    def offsets(self) -> Float[torch.Tensor, "batch 22 3"]:
        """The skeletons at rest, as the first frame has them."""
        return rest_offsets(self.joints[:, 1])


@dataclass(frozen=True)
class Places:
    """Frames of recordings: that of number ``frame[i]`` in recording ``row[i]``."""

    row: Int[torch.Tensor, "*places"]
    frame: Int[torch.Tensor, "*places"]

    @property
    def index(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Index into values of (batch, frames, …)."""
        return self.row, self.frame

    def later(self, frames: int) -> Places:
        """Move all places by the same number of frames."""
        return Places(self.row, self.frame + frames)

    def following(self, frames: int) -> Places:
        """The frames that follow each of them: (places, frames)."""
        after = torch.arange(1, frames + 1, device=self.frame.device)
        return Places(self.row[:, None].expand(-1, frames), self.frame[:, None] + after)

    def some(self, most: int, generator: torch.Generator) -> Places:
        """Draw at most so many of them without repetition; keep all if that is 0."""
        if not most or len(self.row) <= most:
            return self
        drawn = torch.randperm(len(self.row), generator=generator)[:most].to(self.row.device)
        return Places(self.row[drawn], self.frame[drawn])


def starts(recordings: Recordings, length: int) -> Places:
    """Every ``length``-th frame from which so many changes follow, the first frame of each motion among them."""
    frames = torch.arange(1, recordings.joints.shape[1], length, device=recordings.joints.device)
    row, number = torch.nonzero(frames + length < recordings.n_frames[:, None], as_tuple=True)
    return Places(row, frames[number])


def goal_frames(
    recordings: Recordings, places: Places, generator: torch.Generator, *, pseudo_share: float = 0.0
) -> Int[torch.Tensor, " places"]:
    """Choose the frame whose wrist position is the goal: the last one, or that of a pseudo goal.

    A pseudo goal is any later frame, all alike, in which the pelvis is 1.5 m or more away. Where there is none it is
    the frame itself, which means that nothing is intended, or the last frame of a motion that has a goal.

    Args:
        recordings: The recordings.
        places: The frames that are on their way.
        generator: Of the draws.
        pseudo_share: Share of the places in motions with a goal that get a pseudo goal all the same.
    """
    last = recordings.n_frames[places.row] - 1
    has_goal = recordings.has_goal[places.row]
    pretended = ~has_goal
    if pseudo_share:
        pretended = pretended | (torch.rand(len(last), generator=generator).to(last.device) < pseudo_share)
    if not bool(pretended.any()):
        return last
    pelvis = recordings.joints[:, :, Joint.PELVIS]
    frames = torch.arange(pelvis.shape[1], device=pelvis.device)
    far = (pelvis[places.row] - pelvis[places.index][:, None]).norm(dim=-1) >= _FAR
    possible = far & (frames > places.frame[:, None]) & (frames <= last[:, None])
    # The largest of uniform numbers is uniform among the possible frames; the others get -1 and are never chosen.
    drawn = torch.rand(possible.shape, generator=generator).to(pelvis.device).masked_fill(~possible, -1.0).argmax(1)
    otherwise = torch.where(has_goal, last, places.frame)
    return torch.where(pretended, torch.where(possible.any(dim=1), drawn, otherwise), last)


def _resampled(batch: MotionBatch, fps: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Joints at another rate, on a grid that ends on the last frame and begins before the first; and lengths."""
    whole = torch.cat((batch.previous_joints[:, None], batch.joints), dim=1)
    last = batch.n_frames  # the number of the last frame in ``whole``
    # The grid ends on the last frame, because that one reaches the goal; what is left over is cut off in front.
    n_frames = torch.floor(last * (fps / batch.fps) + _ROUNDING).long() + 1
    frames = torch.arange(int(n_frames.max()), device=whole.device)
    place = last[:, None] - (n_frames[:, None] - 1 - frames) * (batch.fps / fps)
    place = torch.minimum(place.clamp_min(0.0), last[:, None])
    left = torch.minimum(torch.floor(place + _ROUNDING).long(), last[:, None])
    right = torch.minimum(left + 1, last[:, None])
    weight = (place - left).clamp(0.0, 1.0)[..., None, None].to(whole.dtype)
    row = torch.arange(len(whole), device=whole.device)[:, None]
    return whole[row, left] * (1 - weight) + whole[row, right] * weight, n_frames
