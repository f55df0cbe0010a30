"""Objectives of optimised motions: initial state, goal and jerk, and DNO's keyframes.

Every objective reports the same three losses in the same units, so that methods can be compared, beside the sum that
it minimises. Frames behind a sequence's end are never looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int

from prbench.geometry.skeleton import Joint
from prbench_adapters.diffusion.noise_optimisation.settings import Hand, OptimisationSettings

Joints = Float[torch.Tensor, "batch frames 22 3"]
_PerSequence = Float[torch.Tensor, " batch"]

_SOFTNESS = 0.01  # m² of the soft minimum over wrists: 10 cm apart counts as a decision


@dataclass(frozen=True)
class Losses:
    """Losses of each sequence; only ``minimised`` carries gradients that matter."""

    minimised: _PerSequence
    """Weighted sum that the optimiser lowers, without decorrelation."""
    initial: _PerSequence
    """Mean over joints of the squared distance to the recorded first frame, m²."""
    goal: _PerSequence
    """The same for the goal pose, or the squared distance of the chosen wrist to the goal location, m²."""
    jerk: _PerSequence
    """Largest third difference over frames and joints, metres per frame³."""


@dataclass(frozen=True, kw_only=True)
class Targets:
    """Initial states and goals of B motions, canonical frame, metres; exactly one of the two goals is given."""

    initial_joints: Float[torch.Tensor, "batch 22 3"]
    previous_joints: Float[torch.Tensor, "batch 22 3"]
    goal_joints: Float[torch.Tensor, "batch 22 3"] | None = None
    goal_location: Float[torch.Tensor, "batch 3"] | None = None

    def __post_init__(self) -> None:
        if (self.goal_joints is None) is (self.goal_location is None):
            raise ValueError("a motion is asked for either a goal pose or a goal location")

    def rows(self, index: Int[torch.Tensor, " kept"]) -> Targets:
        """The targets of some of the sequences."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return Targets(**{name: value[index] for name, value in given.items() if value is not None})


@runtime_checkable
class Objective(Protocol):
    """Losses of motions against targets of the same batch."""

    def __call__(self, joints: Joints, n_frames: Int[torch.Tensor, " batch"], targets: Targets) -> Losses:
        """Losses of each sequence."""
        ...


@dataclass(frozen=True)
class PrimeAndReach:
    """L_init + L_goal + alpha L_jerk.

    Source: *Prime and Reach*, section 4.2; docs/specification/pr-model.md#latent-noise-optimisation.
    """

    jerk_weight: float = 0.5
    hand: Hand = "right"
    initial_velocity_weight: float = 0.0
    jerk_power: float | None = None
    """Minimise this power norm of all jerks instead of the largest one; None is the paper's maximum."""

    def __call__(self, joints: Joints, n_frames: Int[torch.Tensor, " batch"], targets: Targets) -> Losses:
        """Losses of each sequence; squared distances are averaged over joints, so that 1 joint weighs as much as 22."""
        initial = _squared_distance(joints[:, 0], targets.initial_joints)
        goal, pursued = _goal_losses(joints, n_frames, targets, self.hand)
        jerk = largest_jerk(joints, n_frames)
        smooth = jerk if self.jerk_power is None else jerk_norm(joints, n_frames, self.jerk_power)
        minimised = initial + pursued + self.jerk_weight * smooth
        if self.initial_velocity_weight:
            velocity = _squared_distance(joints[:, 1] - joints[:, 0], targets.initial_joints - targets.previous_joints)
            minimised = minimised + self.initial_velocity_weight * velocity
        return Losses(minimised, initial, goal, jerk)


@dataclass(frozen=True)
class Keyframes:
    """DNO's criterion: mean absolute error over the coordinates that are asked for.

    Source: docs/specification/dno.md#the-optimiser.

    Asked for are the first frame (with ``initial_frames=2`` also the second, continued at the initial velocity) and in
    the last frame all joints or one wrist; every coordinate weighs the same, as in the published solver.
    """

    hand: Hand = "right"
    initial_frames: int = 1

    def __call__(self, joints: Joints, n_frames: Int[torch.Tensor, " batch"], targets: Targets) -> Losses:
        """Losses of each sequence; ``minimised`` in metres."""
        last = last_frame(joints, n_frames)
        errors = [(joints[:, 0] - targets.initial_joints).abs().flatten(1)]
        if self.initial_frames == 2:
            continued = 2.0 * targets.initial_joints - targets.previous_joints
            errors.append((joints[:, 1] - continued).abs().flatten(1))
        if targets.goal_joints is not None:
            errors.append((last - targets.goal_joints).abs().flatten(1))
        else:
            wrist = chosen_wrist(last, _location(targets), self.hand)
            errors.append((wrist - _location(targets)).abs())
        return Losses(
            minimised=torch.cat(errors, dim=1).mean(dim=1),
            initial=_squared_distance(joints[:, 0], targets.initial_joints).detach(),
            goal=_goal_losses(joints, n_frames, targets, self.hand)[0].detach(),
            # Reported only, so no graph is kept for it.
            jerk=largest_jerk(joints.detach(), n_frames),
        )


ObjectiveFromSettings = Callable[[OptimisationSettings], Objective]


def prime_and_reach(settings: OptimisationSettings) -> Objective:
    """The paper's objective."""
    return PrimeAndReach(settings.jerk_weight, settings.hand, settings.initial_velocity_weight, settings.jerk_power)


def keyframes(settings: OptimisationSettings) -> Objective:
    """The DNO baseline's objective."""
    return Keyframes(settings.hand, settings.initial_frames)


def _goal_losses(
    joints: Joints, n_frames: Int[torch.Tensor, " batch"], targets: Targets, hand: Hand
) -> tuple[_PerSequence, _PerSequence]:
    """The goal loss as reported and as minimised, m²; they differ for ``hand="nearest"`` only.

    Reported is then the nearer wrist's squared distance, minimised a soft minimum that is never above it, whose
    gradient is shared between wrists that are about equally near.
    """
    last = last_frame(joints, n_frames)
    if targets.goal_joints is not None:
        loss = _squared_distance(last, targets.goal_joints)
        return loss, loss
    location = _location(targets)
    if hand != "nearest":
        loss = (chosen_wrist(last, location, hand) - location).square().sum(-1)
        return loss, loss
    both = last[:, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]]
    squared = (both - location[:, None]).square().sum(-1)
    return squared.amin(dim=1), -_SOFTNESS * torch.logsumexp(-squared / _SOFTNESS, dim=1)


def chosen_wrist(
    pose: Float[torch.Tensor, "batch 22 3"], location: Float[torch.Tensor, "batch 3"], hand: Hand
) -> Float[torch.Tensor, "batch 3"]:
    """Position of the wrist named by ``hand``, or of the one nearer to ``location``."""
    left = pose[:, Joint.LEFT_WRIST]
    right = pose[:, Joint.RIGHT_WRIST]
    if hand != "nearest":
        return left if hand == "left" else right
    left_nearer = (left - location).square().sum(-1) < (right - location).square().sum(-1)
    return torch.where(left_nearer[:, None], left, right)


def _squared_distance(
    predicted: Float[torch.Tensor, "batch 22 3"], wanted: Float[torch.Tensor, "batch 22 3"]
) -> _PerSequence:
    """Mean over joints of the squared distance, m²."""
    return (predicted - wanted).square().sum(-1).mean(-1)


def last_frame(joints: Joints, n_frames: Int[torch.Tensor, " batch"]) -> Float[torch.Tensor, "batch 22 3"]:
    """The last pose of each sequence's own frames."""
    return joints[torch.arange(len(joints), device=joints.device), n_frames - 1]


def _jerk_lengths(joints: Joints, n_frames: Int[torch.Tensor, " batch"]) -> Float[torch.Tensor, "batch windows 22"]:
    """Lengths of x(n+3) - 3 x(n+2) + 3 x(n+1) - x(n), metres per frame³; 0 where a window leaves the sequence.

    The gradient of a length 0 is 0, not NaN.
    """
    third = joints[:, 3:] - 3.0 * joints[:, 2:-1] + 3.0 * joints[:, 1:-2] - joints[:, :-3]
    inside = torch.arange(third.shape[1], device=joints.device) < (n_frames - 3)[:, None]
    squared = torch.where(inside[..., None], third.square().sum(-1), 0.0)
    # The square root has an infinite slope at 0, which would be NaN times 0 in the gradient.
    moving = squared > 0.0
    return torch.where(moving, torch.where(moving, squared, 1.0).sqrt(), 0.0)


def largest_jerk(joints: Joints, n_frames: Int[torch.Tensor, " batch"]) -> _PerSequence:
    """The largest of :func:`_jerk_lengths`, 0 for fewer than four frames.

    Source: docs/specification/pr-model.md#latent-noise-optimisation.
    """
    lengths = _jerk_lengths(joints, n_frames).flatten(1)
    return lengths.amax(dim=1) if lengths.shape[1] else joints.new_zeros(len(joints))


def jerk_norm(joints: Joints, n_frames: Int[torch.Tensor, " batch"], power: float) -> _PerSequence:
    """(sum of jerk^power)^(1/power) over frames and joints: never below the largest jerk, near it for a high power.

    Its gradient reaches every place that is about as jerky as the worst one, where the maximum reaches one place only.
    """
    lengths = _jerk_lengths(joints, n_frames).flatten(1)
    # Divided by the largest before the power, which would overflow or vanish otherwise.
    largest = largest_jerk(joints, n_frames).detach().clamp_min(1e-12)
    return largest * (lengths / largest[:, None]).pow(power).sum(dim=1).clamp_min(1e-12).pow(1.0 / power)


def _location(targets: Targets) -> Float[torch.Tensor, "batch 3"]:
    if targets.goal_location is None:
        raise ValueError("no goal location was given")
    return targets.goal_location
