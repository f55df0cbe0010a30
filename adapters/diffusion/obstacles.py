"""Lead motions around the boxes of a scene: a smooth correction of all joints, made after a motion is generated.

The correction is found by gradient descent: it is zero in the first frame (and in the last, where that pose is given),
and costs what it leaves inside boxes, what it changes of bones, planted feet and the motion itself, and what the wrist
that is nearer to the goal at the end loses of its reach.
Motions that come into no box stay as they are, to the bit. No network knows of the boxes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from prbench.contract import ConditionBatch, Motions
from prbench.errors import AdapterError
from prbench.geometry.boxes import Boxes, deepest
from prbench.geometry.skeleton import PARENTS, WRISTS, Joint
from prbench.metrics.scene_penetration import without_goal
from prbench_adapters.diffusion.batches import bone_lengths, with_bone_lengths

_TOES = (Joint.LEFT_FOOT, Joint.RIGHT_FOOT)
_MARGIN = 0.02
"""Metres that joints are led beyond a side, for what the other costs take back."""
_ITERATIONS = 300
_STEP = 0.004
"""Metres that a joint moves in one iteration, about (Adam's learning rate)."""
_LOW = 0.05
_SLOW = 0.2
"""Metres and metres a second below which a toe stands (``foot_height`` and ``slide_speed`` of the protocol)."""


@dataclass(frozen=True)
class _Weights:
    """What the correction costs, each a mean of squares over frames in metres, but for ``smooth`` in m/s²."""

    inside: float = 2000.0
    bones: float = 400.0
    standing: float = 400.0
    reach: float = 100.0
    floor: float = 400.0
    smooth: float = 0.2
    stay: float = 1.0


def led_around(motions: Motions, batch: ConditionBatch) -> Motions:
    """Correct the motions that come into boxes.

    Args:
        motions: As generated, at the rate of ``batch``.
        batch: What they were made from, with ``obstacles``.

    Returns:
        Motions of the same lengths; every bone keeps the length that it had in its frame.

    Raises:
        AdapterError: if the batch holds no boxes.
    """
    if batch.obstacles is None:
        raise AdapterError(
            "option 'obstacles': expected the boxes of the scene, and was given none. Behind --isolate and in programs"
            " no boxes are handed over; run the method without --isolate."
        )
    joints = np.array(motions.joints, dtype=np.float32)
    for row in range(len(batch)):
        n = int(motions.n_frames[row])
        boxes = _solid_for(batch, row)
        if deepest(joints[row, :n].astype(np.float64), boxes).any():
            goal = None if batch.goal_location is None else batch.goal_location[row]
            joints[row, :n] = _corrected(joints[row, :n], boxes, fps=batch.fps, goal=goal)
    return replace(motions, joints=joints)


def _solid_for(batch: ConditionBatch, row: int) -> Boxes:
    """The boxes of one row that are in the way: none that holds its goal, or a wrist of its goal pose."""
    assert batch.obstacles is not None
    boxes = batch.obstacles.part(row, row + 1)
    goals: list[np.ndarray] = []
    if batch.goal_location is not None:
        goals = [batch.goal_location[row]]
    if batch.goal_joints is not None:
        goals = list(batch.goal_joints[row, WRISTS])
    for goal in goals:
        boxes = without_goal(boxes, goal.astype(np.float64))
    return boxes


def _corrected(
    motion: Float[np.ndarray, "frames 22 3"], boxes: Boxes, *, fps: float, goal: Float[np.ndarray, "3"] | None
) -> Float[np.ndarray, "frames 22 3"]:
    near = boxes.chosen(boxes.reached(motion.reshape(-1, 3).astype(np.float64)))
    before = torch.as_tensor(motion, dtype=torch.float32)
    free = torch.ones(len(before), 1, 1)
    free[0] = 0.0  # the first pose is given
    if goal is None:  # then the last pose is given
        free[-1] = 0.0
    terms = _Terms(before, near, fps, goal)
    move = torch.zeros_like(before, requires_grad=True)
    descent = torch.optim.Adam([move], lr=_STEP)
    with torch.enable_grad():
        for _ in range(_ITERATIONS):
            descent.zero_grad()
            terms.cost(move * free).backward()
            descent.step()
    after = before + move.detach() * free
    # Soft bones have come near their lengths; this makes every frame's those that it had, from the pelvis outwards.
    return with_bone_lengths(after[:, None], bone_lengths(before))[:, 0].numpy()


class _Terms:
    """The costs of one motion's correction."""

    def __init__(
        self,
        motion: Float[Tensor, "frames 22 3"],
        boxes: Boxes,
        fps: float,
        goal: Float[np.ndarray, "3"] | None,
    ) -> None:
        self.motion = motion
        self.fps = fps
        self.weights = _Weights()
        self.centre = torch.as_tensor(boxes.centre, dtype=torch.float32)
        self.rotation = torch.as_tensor(boxes.rotation, dtype=torch.float32)
        self.half = torch.as_tensor(boxes.half_extents, dtype=torch.float32)
        self.bones = _bones(motion)
        self.standing = _standing(motion, fps)
        self.lowest = motion[..., 1].clamp(max=0.0)
        self.goal = None if goal is None else torch.as_tensor(goal, dtype=torch.float32)
        self.reach = self._reach(motion)

    def cost(self, move: Float[Tensor, "frames 22 3"]) -> Float[Tensor, ""]:
        """The weighted sum."""
        weights = self.weights
        joints = self.motion + move
        toes = move[:, _TOES]
        slides = (toes[1:] - toes[:-1]).square().sum(-1) * self.standing
        acceleration = (move[2:] - 2 * move[1:-1] + move[:-2]) * self.fps**2
        lost_reach = (self._reach(joints) - self.reach).clamp(min=0.0).square()
        return (
            weights.inside * self._inside(joints).square().sum(-1).mean()
            + weights.bones * (_bones(joints) - self.bones).square().sum(-1).mean()
            + weights.standing * slides.sum(-1).mean()
            + weights.reach * lost_reach
            + weights.floor * (self.lowest - joints[..., 1]).clamp(min=0.0).square().sum(-1).mean()
            + weights.smooth * acceleration.square().sum(-1).mean() / self.fps
            + weights.stay * move.square().sum(-1).mean()
        )

    def _reach(self, joints: Float[Tensor, "frames 22 3"]) -> Float[Tensor, ""]:
        """Distance of the nearer wrist from the goal in the last frame; 0 without a goal location."""
        if self.goal is None:
            return joints.new_zeros(())
        return (joints[-1, WRISTS] - self.goal).norm(dim=-1).amin()

    def _inside(self, joints: Float[Tensor, "frames 22 3"]) -> Float[Tensor, "frames 22"]:
        """Depth of each joint in the box in which it is deepest, with the margin; 0 outside."""
        away = joints[:, :, None] - self.centre
        local = torch.einsum("fjbi,bik->fjbk", away, self.rotation)
        depth = (self.half - local.abs()).amin(-1)  # (frames, 22, boxes)
        return (depth + _MARGIN).clamp(min=0.0).amax(-1)


def _bones(joints: Float[Tensor, "frames 22 3"]) -> Float[Tensor, "frames 21"]:
    return (joints[:, 1:] - joints[:, PARENTS[1:]]).norm(dim=-1)


def _standing(motion: Float[Tensor, "frames 22 3"], fps: float) -> Bool[Tensor, "steps 2"]:
    """Steps in which a toe is low and slow, so that a correction must not move it."""
    toes = motion[:, _TOES]
    speed = (toes[1:] - toes[:-1]).norm(dim=-1) * fps
    low = toes[..., 1] < _LOW
    return (speed < _SLOW) & low[1:] & low[:-1]
