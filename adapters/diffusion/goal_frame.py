"""Motions seen from their goal: where body, hands and feet are in a frame that faces the goal.

A representation of ours for small networks, beside HumanML3D's 263 features (docs/methods/pr.md). The frame stands
under the goal (of a goal pose, under the middle between its wrists); +Z is the way from the first pelvis to a goal
location, or where a goal pose faces. Each frame of a motion is 68 numbers:

* the pelvis (3);
* unit directions of the 11 bones of the trunk, of thighs and upper arms, and of the feet (51);
* the ankles and the wrists (12): a planted foot and a hand at its goal are numbers that do not change;
* whether each foot is planted (2).

Decoding constructs what the network need not learn (:data:`PARTS`), each of which can be left out:

* ``bones``: knees and elbows follow from the lengths of the bones of the initial pose, so that all bones keep them;
  without, the lower bone of a limb stretches where a wrist or an ankle is predicted out of its reach;
* ``first``: the first frame is the initial pose, the second one goes on with the initial velocity, and the last one is
  a goal pose if there is one: what a network predicts for them is corrected, and the correction fades out within
  :data:`FADE` seconds;
* ``smooth``: neighbouring frames are averaged with weights -1, 4, 10, 4, -1, which leave movement up to 3 Hz as it is,
  and a third of the jerk of independent errors;
* ``reach``: the wrist that ends nearer to the goal is led up to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional

from prbench.geometry.skeleton import BONES, N_JOINTS, PARENTS, TOES, WRISTS, Joint

Joints = Float[Tensor, "batch frames 22 3"]  # metres
Flat = Float[Tensor, "batch frames 66"]  # joints in one row
Features = Float[Tensor, "batch frames 68"]
Counts = Int[Tensor, " batch"]

# Seconds over which corrections of the first and last frame fade out; choice: about a step.
FADE = 0.5
# Metres a second over the floor below which a toe counts as planted: the protocol's ``slide_speed``. Noise of body
# trackers moves planted toes by half of it.
STILL = 0.2
# Metres above the floor below which it must be, too: the protocol's ``foot_height``.
LOW = 0.05
# Numbers that :func:`sight` returns for each frame.
N_SIGHT = 17

# Joints whose bones are chained from the pelvis: hips, spine, neck, head, collars, shoulders.
_TRUNK = (1, 2, 3, 6, 9, 12, 13, 14, 15, 16, 17)
_ROOTS = (Joint.LEFT_HIP, Joint.RIGHT_HIP, Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER)
_MIDDLES = (Joint.LEFT_KNEE, Joint.RIGHT_KNEE, Joint.LEFT_ELBOW, Joint.RIGHT_ELBOW)
_ENDS = (Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE, *WRISTS)
# Joints whose bones have directions among the features.
_DIRECTED = (*_TRUNK, *_MIDDLES, *TOES)
_DIRECTIONS = slice(3, 3 + 3 * len(_DIRECTED))
# Directions of the upper arms, which bend that way.
_ELBOWS = slice(3 + 3 * _DIRECTED.index(Joint.LEFT_ELBOW), 6 + 3 * _DIRECTED.index(Joint.RIGHT_ELBOW))
_PLACES = slice(_DIRECTIONS.stop, _DIRECTIONS.stop + 3 * len(_ENDS))
N_POSE_FEATURES = _PLACES.stop
N_GOAL_FRAME_FEATURES = N_POSE_FEATURES + len(TOES)

_PARENTS, _CHILDREN = (list(ends) for ends in zip(*BONES, strict=True))
# What decoding constructs, and what of it a network is trained with.
PARTS = frozenset({"bones", "first", "smooth", "reach"})
TRAINED_WITH = PARTS - {"reach"}
_SHORTEST = 1e-6  # metres; keeps the direction of a vanished bone, and its gradient, finite
_TOUCH = 0.05  # metres between wrist and goal: a hand holds an object, the wrist is not inside it
_BEND = 5e-3  # metres that a knee or elbow stands out at least; a straight limb has no gradient
_SOON = 0.05  # seconds over which the initial velocity is taken to hold: one frame of the protocol
_POSE = 3 * N_JOINTS


@dataclass(frozen=True)
class GoalFrame:
    """The frame of each sequence's goal, with the poses that are given in it.

    Attributes:
        origin: Under the goal, on the floor; canonical frame, metres.
        forward: Unit vector (x, z) of the frame's +Z axis, canonical frame.
        height: Height of the goal above the floor, metres; a goal pose is measured in the middle between its wrists.
        lengths: Lengths of the bones of the initial pose, metres.
        first: Features of the initial pose, contacts left out.
        rates: Their changes in a second, as the initial velocity has it.
        last: Features of the goal pose, if that is the goal.
    """

    origin: Float[Tensor, "batch 3"]
    forward: Float[Tensor, "batch 2"]
    height: Float[Tensor, " batch"]
    lengths: Float[Tensor, "batch 21"]
    first: Float[Tensor, "batch 66"]
    rates: Float[Tensor, "batch 66"]
    last: Float[Tensor, "batch 66"] | None

    @classmethod
    def of(cls, raw: Float[Tensor, "batch size"]) -> GoalFrame:
        """Return the frame of a condition vector.

        Args:
            raw: Initial pose, initial velocity and goal (:func:`~.configuration.raw_condition`).
        """
        initial = raw[:, :_POSE].unflatten(1, (N_JOINTS, 3))
        goal = raw[:, 2 * _POSE :]
        pose = goal.unflatten(1, (N_JOINTS, 3)) if goal.shape[1] == _POSE else None
        if pose is None:
            place = goal
            forward = (goal - initial[:, Joint.PELVIS])[:, ::2]
        else:
            place = pose[:, WRISTS].mean(dim=1)
            left = pose[:, Joint.LEFT_HIP] - pose[:, Joint.RIGHT_HIP]
            left = left + pose[:, Joint.LEFT_SHOULDER] - pose[:, Joint.RIGHT_SHOULDER]
            forward = torch.stack((-left[:, 2], left[:, 0]), dim=1)  # left × up, on the floor
        # A goal right above or below the pelvis has no direction; then the frame faces as the canonical one.
        ahead = forward.new_tensor((0.0, 1.0)).expand_as(forward)
        forward = torch.where(forward.norm(dim=1, keepdim=True) > _SHORTEST, forward, ahead)
        forward = forward / forward.norm(dim=1, keepdim=True)
        origin = place * place.new_tensor((1.0, 0.0, 1.0))
        lengths = bones(initial).norm(dim=-1)
        frame = cls(origin, forward, place[:, 1], lengths, initial.flatten(1), initial.flatten(1), None)
        velocity = raw[:, _POSE : 2 * _POSE].unflatten(1, (N_JOINTS, 3))
        first, soon = frame._pose_features(torch.stack((initial, initial + _SOON * velocity), dim=1)).unbind(1)
        last = None if pose is None else frame._pose_features(pose[:, None])[:, 0]
        return replace(frame, first=first, rates=(soon - first) / _SOON, last=last)

    def encode(self, joints: Joints, fps: float) -> Features:
        """Features of canonical joints; lengths of bones are lost."""
        pose = self._pose_features(joints)
        return torch.cat((pose, planted(joints, fps).to(pose.dtype)), dim=2)

    def _pose_features(self, joints: Tensor) -> Flat:
        directions = unit(bones(joints))[:, :, [joint - 1 for joint in _DIRECTED]]
        places = joints[:, :, (Joint.PELVIS, *_ENDS)] - self.origin[:, None, None]
        pelvis, ends = self._turned(places).split((1, len(_ENDS)), dim=2)
        return torch.cat([part.flatten(2) for part in (pelvis, self._turned(directions), ends)], dim=2)

    def decode(
        self, features: Features, n_frames: Counts, fps: float, *, parts: frozenset[str] = TRAINED_WITH
    ) -> Joints:
        """Canonical joints, metres.

        Args:
            features: Not standardised.
            n_frames: Valid frames of each row.
            fps: Frames per second.
            parts: What is constructed, of :data:`PARTS`.
        """
        pose = features[..., :N_POSE_FEATURES]
        if "smooth" in parts:
            pose = smoothed(2 * pose - smoothed(pose, n_frames), n_frames)
        before, directions, after = pose.tensor_split((_DIRECTIONS.start, _DIRECTIONS.stop), dim=-1)
        pose = torch.cat((before, unit(directions.unflatten(-1, (-1, 3))).flatten(-2), after), dim=-1)
        if "first" in parts:
            pose = self._kept(pose, n_frames, fps)
        if "reach" in parts:
            pose = self._reaching(pose, n_frames, fps)
        return self._canonical(pose, parts)

    def led_to_goal(self, joints: Joints, n_frames: Counts, fps: float, *, parts: frozenset[str]) -> Joints:
        """Finished canonical joints with the nearer wrist led up to the goal.

        Args:
            joints: Metres.
            n_frames: Valid frames of each row.
            fps: Frames per second.
            parts: What was constructed; of it the bones are looked at.
        """
        return self._canonical(self._reaching(self._pose_features(joints), n_frames, fps), parts)

    def _canonical(self, pose: Flat, parts: frozenset[str]) -> Joints:
        joints = self._joints(pose, stretched="bones" not in parts)
        return self._turned(joints, back=True) + self.origin[:, None, None]

    def _joints(self, features: Flat, *, stretched: bool = False) -> Joints:
        """Chain the bones of the trunk from the pelvis, and let arms and legs reach from there to their ends.

        Args:
            features: Numbers of the pose.
            stretched: Put the ends where they are predicted, even where the bones are too short for that.
        """
        pelvis = features[:, :, None, :3]
        directions = unit(features[..., _DIRECTIONS].unflatten(2, (-1, 3)))
        targets = features[..., _PLACES].unflatten(2, (-1, 3))
        trunk, poles, feet = directions.split((len(_TRUNK), len(_MIDDLES), len(TOES)), dim=2)
        # Positions are sums of bones along the way from the pelvis, which one product with the ancestry gives for all.
        leads = torch.eye(len(_TRUNK))  # 1 where a bone of the trunk leads from the pelvis to a joint, else 0
        for row, joint in enumerate(_TRUNK):  # parents come before their children
            if PARENTS[joint] != Joint.PELVIS:
                leads[row] += leads[_TRUNK.index(PARENTS[joint])]
        trunk = pelvis + leads.to(features) @ (trunk * self._lengths_to(_TRUNK))
        roots = trunk[:, :, [_TRUNK.index(joint) for joint in _ROOTS]]
        upper = self._lengths_to(_MIDDLES)
        lower = self._lengths_to(_ENDS)
        middles, ends = bent(roots, targets, upper, lower, poles)
        ends = targets if stretched else ends
        toes = ends[:, :, : len(TOES)] + feet * self._lengths_to(TOES)
        order = (Joint.PELVIS, *_TRUNK, *_MIDDLES, *_ENDS, *TOES)
        together = torch.cat((pelvis, trunk, middles, ends, toes), dim=2)
        return together[:, :, [order.index(joint) for joint in range(N_JOINTS)]]

    def _reaching(self, pose: Flat, n_frames: Tensor, fps: float) -> Flat:
        """Lead the wrist that ends nearer to the goal up to it, within the last :data:`FADE` seconds.

        It stops :data:`_TOUCH` before the goal. Where the arm is too short, the pelvis makes up for the rest.
        """
        last = n_frames.to(pose.device) - 1
        fade = _fade((last[:, None] - torch.arange(pose.shape[1], device=pose.device)).clamp_min(0) / fps)[..., None]
        moves = fade[..., None] * self._missing(pose, last)[:, None]
        # Elbows turn along: an arm that swings past the direction in which it is said to bend would bend the other way.
        shoulders = self._joints(pose)[:, :, _ROOTS[-2:]]
        before, elbows, between, wrists = pose.tensor_split((_ELBOWS.start, _ELBOWS.stop, N_POSE_FEATURES - 6), dim=-1)
        places = wrists.unflatten(2, (-1, 3))
        bends = elbows.unflatten(2, (-1, 3))
        turned = turned_along(bends, unit(places - shoulders), unit(places + moves - shoulders))
        pose = torch.cat((before, turned.flatten(2), between, (places + moves).flatten(2)), dim=2)
        return pose + functional.pad(fade * self._missing(pose, last).sum(dim=1)[:, None], (0, N_POSE_FEATURES - 3))

    def _missing(self, pose: Tensor, last: Counts) -> Float[Tensor, "batch 2 3"]:
        """Return what each wrist lacks to touch the goal in the last frame; zeros for the one that is farther away."""
        wrists = self._joints(pose)[torch.arange(len(pose), device=pose.device), last][:, WRISTS]
        missing = functional.pad(self.height[:, None, None], (1, 1)) - wrists
        distance = _length(missing)
        nearer = distance == distance.amin(dim=1, keepdim=True)
        return missing * ((1 - _TOUCH / distance).clamp_min(0.0) * nearer)[..., None]

    def _lengths_to(self, joints: tuple[int, ...]) -> Float[Tensor, "batch 1 joints 1"]:
        return self.lengths[:, None, [joint - 1 for joint in joints], None]

    def _kept(self, features: Tensor, n_frames: Tensor, fps: float) -> Tensor:
        """Move the first frame, and with a goal pose the last one, to where it is known to be.

        The second frame goes on with the initial velocity.
        """
        frame = torch.arange(features.shape[1], device=features.device)
        fade = _fade(frame / fps)[None, :, None]
        kept = features + fade * (self.first - features[:, 0])[:, None]
        if kept.shape[1] > 1:
            late = self.rates - (kept[:, 1] - kept[:, 0]) * fps
            # The correction grows by what each frame's speed lacks, and both fade out.
            share = (1 - (frame - 1).clamp_min(0) / (FADE * fps)).clamp_min(0) ** 2
            kept = kept + (frame / fps * share)[None, :, None] * late[:, None]
        if self.last is None:
            return kept
        last = n_frames.to(features.device) - 1
        fade = _fade((last[:, None] - frame).abs() / fps)[..., None]
        return kept + fade * (self.last - kept[torch.arange(len(features), device=features.device), last])[:, None]

    def _turned(self, vectors: Float[Tensor, "batch n m 3"], *, back: bool = False) -> Float[Tensor, "batch n m 3"]:
        """Vectors turned into the frame of the goal, or back."""
        x, y, z = vectors.unbind(-1)
        sin, cos = self.forward[:, :, None, None].unbind(1)
        if back:
            sin = -sin
        return torch.stack((cos * x - sin * z, y, sin * x + cos * z), dim=-1)

    def seen(self, joints: Joints) -> Joints:
        """Canonical joints as they are seen from the goal."""
        return self._turned(joints - self.origin[:, None, None])

    def velocity(self, raw: Float[Tensor, "batch size"]) -> Float[Tensor, "batch 66"]:
        """Return initial velocities of a condition vector, seen from the goal, m/s."""
        return self._turned(raw[:, None, _POSE : 2 * _POSE].unflatten(2, (N_JOINTS, 3))).flatten(1)


def seen_condition(raw: Float[Tensor, "batch size"]) -> Float[Tensor, "batch seen"]:
    """Return a condition vector as a network of goal-frame features is told it, not standardised.

    Args:
        raw: Initial pose, initial velocity and goal (:func:`prbench_adapters.diffusion.configuration.raw_condition`).

    Returns:
        Features of the initial pose, velocities of the joints (m/s), bone lengths (m), distance of the first pelvis on
        the floor (m), and what :func:`sight` says of the initial pose; at last the features of a goal pose.
    """
    frame = GoalFrame.of(raw)
    away = frame.first[:, (0, 2)].norm(dim=1, keepdim=True)
    joints = frame.seen(raw[:, None, :_POSE].unflatten(2, (N_JOINTS, 3)))
    parts = (frame.first, frame.velocity(raw), frame.lengths, away, sight(joints, frame.height)[:, 0])
    return torch.cat(parts if frame.last is None else (*parts, frame.last), dim=1)


def seen_size(goal: str) -> int:
    """Numbers in :func:`seen_condition` for a kind of goal, ``location`` or ``pose``."""
    return 2 * _POSE + (N_JOINTS - 1) + 1 + N_SIGHT + (_POSE if goal == "pose" else 0)


def sight(joints: Joints, height: Float[Tensor, " batch"]) -> Float[Tensor, "batch frames sight"]:
    """Measure where the goal is, seen from head, wrists and feet.

    Args:
        joints: Joints in the frame of the goal, metres.
        height: Height of the goal, metres.

    Returns:
        Goal direction minus head-forward vector of a head without tilt (3), neck-head direction (3), distance of the
        goal from the head (1), wrists relative to the goal (6), heights of the toes (2) and their way since the frame
        before (2); metres.
    """
    goal = functional.pad(height[:, None, None], (1, 1))
    to_goal = goal - joints[:, :, Joint.HEAD]
    distance = to_goal.norm(dim=-1, keepdim=True)
    forward, up = head_axes(joints)
    wrists = joints[:, :, WRISTS] - goal[:, :, None]
    toes = joints[:, :, TOES]
    way = functional.pad(_length(toes.diff(dim=1)), (0, 0, 1, 0))
    parts = (to_goal / distance.clamp_min(_SHORTEST) - forward, up, distance, wrists.flatten(2), toes[..., 1], way)
    return torch.cat(parts, dim=-1)


def head_axes(joints: Float[Tensor, "*batch 22 3"]) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """Return the unit vectors that ``skeleton.head_forward`` mixes: forward without tilt, and neck to head."""
    up = unit(joints[..., Joint.HEAD, :] - joints[..., Joint.NECK, :])
    left = joints[..., Joint.LEFT_SHOULDER, :] - joints[..., Joint.RIGHT_SHOULDER, :]
    left = unit(left - (left * up).sum(dim=-1, keepdim=True) * up)
    return torch.linalg.cross(left, up), up


def _length(vectors: Float[Tensor, "*batch axes"]) -> Float[Tensor, "*batch"]:
    """Lengths whose gradient at 0 is finite."""
    return (vectors.square().sum(dim=-1) + _SHORTEST**2).sqrt()


def bones(joints: Float[Tensor, "*batch 22 3"]) -> Float[Tensor, "*batch 21 3"]:
    """Return the vectors of the bones, in the order of :data:`prbench.geometry.skeleton.BONES`."""
    return joints[..., _CHILDREN, :] - joints[..., _PARENTS, :]


def unit(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Return unit vectors; a vanished one stays zero."""
    return vectors / vectors.norm(dim=-1, keepdim=True).clamp_min(_SHORTEST)


def smoothed(features: Tensor, n_frames: Counts) -> Tensor:
    """Average neighbouring frames with weights 1, 2, 1; the first and the last frame stay."""
    bend = functional.pad(features.diff(n=2, dim=1), (0, 0, 1, 1))
    frame = torch.arange(features.shape[1], device=features.device)
    between = (frame < n_frames.to(features.device)[:, None] - 1)[..., None]
    return features + torch.where(between, bend, 0.0) / 4


def bent(
    roots: Tensor, targets: Tensor, upper: Tensor, lower: Tensor, poles: Tensor
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """Return middles and ends of limbs of two bones whose ends are at their targets, or as near as their bones reach.

    Args:
        roots: Hips or shoulders, metres.
        targets: Places for ankles or wrists.
        upper: Lengths of the upper bones, with an axis for the coordinates.
        lower: Lengths of the lower bones, with the same axis.
        poles: Directions to the side of which the limbs bend.
    """
    way = targets - roots
    distance = _length(way)[..., None]
    along = way / distance
    distance = distance.clamp_max(upper + lower).clamp_min((upper - lower).abs())
    # Law of cosines: the foot of the middle joint on the line from root to end, and its distance from that line.
    foot = (upper.square() - lower.square() + distance.square()) / (2 * distance).clamp_min(_SHORTEST)
    height = (upper.square() - foot.square()).clamp_min(_BEND**2).sqrt()
    aside = unit(poles - (poles * along).sum(dim=-1, keepdim=True) * along)
    return roots + along * foot + aside * height, roots + along * distance


def turned_along(vectors: Tensor, source: Tensor, target: Tensor) -> Float[Tensor, "*batch 3"]:
    """Vectors, turned by the smallest rotation that turns one unit vector into another (Rodrigues)."""
    axis = torch.linalg.cross(source, target)
    once = torch.linalg.cross(axis, vectors)
    cos = (source * target).sum(dim=-1, keepdim=True)
    return vectors + once + torch.linalg.cross(axis, once) / (1 + cos).clamp_min(_SHORTEST)


def _fade(seconds: Tensor) -> Tensor:
    """1 at 0, falling smoothly to 0 at :data:`FADE`."""
    return 0.5 + 0.5 * torch.cos(torch.pi * (seconds / FADE).clamp(max=1.0))


def planted(joints: Joints, fps: float) -> Bool[Tensor, "batch frames 2"]:
    """Return True where a toe is low and still, coming into a frame or going out of it."""
    steps = still_steps(joints, fps)
    return functional.pad(steps, (0, 0, 1, 0)) | functional.pad(steps, (0, 0, 0, 1))


def still_steps(joints: Joints, fps: float) -> Bool[Tensor, "batch steps 2"]:
    """Return True where a toe stays low and in its place from one frame to the next."""
    toes = joints[:, :, TOES]
    low = toes[..., 1] < LOW
    return (_length(toes[..., ::2].diff(dim=1)) * fps < STILL) & low[:, 1:] & low[:, :-1]
