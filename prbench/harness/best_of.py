"""Best of k: of k motions of a sequence, keep the one whose own head ray and wrist serve the given goal best.

Source: docs/specification/protocol.md#best-of-k. What is looked at are the drawn motions, what the method itself was
given, the tilt of the skeleton's neck-head bone and numbers of the protocol. Nothing of the recording but that comes
here: a method's user could make the same choice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.contract import Condition, ConditionBatch, Cost, Gaze, Motions
from prbench.errors import UsageError
from prbench.geometry.skeleton import WRISTS, Joint
from prbench.metrics.batch import MotionBatch, ranges
from prbench.metrics.prime_success import primed
from prbench.metrics.ray_track import CandidateFrames, RayTrack, candidate_frames, head_track
from prbench.protocol.manifests import BenchmarkProtocol, MetricConstants

WITH_GOAL = (Condition.GOAL_LOCATION, Condition.GOAL_POSE)
"""Conditions that say where the goal is."""
_SHOULDERS = (Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER)


@dataclass(frozen=True, eq=False)
class ChoiceRules:
    """The rules of the choice for the sequences of one batch."""

    best_of: int
    """Motions drawn for each that is kept."""
    prime_time: float
    """Seconds from the first frame to the prime time, as the protocol cuts every sequence (``curation.lead``)."""
    constants: MetricConstants
    head_tilt_deg: Float[np.ndarray, " batch"]
    """Rest tilt of the neck-head bone: a constant of the skeleton, without which a pose has no head ray."""

    @classmethod
    def of(
        cls, protocol: BenchmarkProtocol, *, best_of: int, head_tilt_deg: Float[np.ndarray, " batch"]
    ) -> ChoiceRules:
        """Take the numbers of a protocol."""
        return cls(best_of, protocol.curation.lead, protocol.metrics, head_tilt_deg)


def require_goal(condition: Condition, *, best_of: int) -> None:
    """Refuse to choose by a goal that nobody is given.

    Raises:
        UsageError: naming the conditions that give one.
    """
    if best_of > 1 and condition not in WITH_GOAL:
        known = " or ".join(item.value for item in WITH_GOAL)
        raise UsageError(
            f"--best-of {best_of}: motions are chosen by the goal that the method is given, and the condition"
            f" '{condition.value}' gives none. Choose --condition {known}, or leave --best-of out."
        )


def best_motions(
    draws: Sequence[Motions], conditions: Sequence[ConditionBatch], rules: ChoiceRules
) -> tuple[Motions, Int[np.ndarray, " batch"]]:
    """Keep one motion of each sequence.

    Args:
        draws: The k motions of every sequence, at the table's rate.
        conditions: What each draw was made from; they differ in their noise seeds only.
        rules: The rules of the choice.

    Returns:
        The chosen motions, with the cost of all; and the number of the draw that each comes from.
    """
    costs = np.stack([choice_cost(motions, conditions[0], rules) for motions in draws])
    chosen = costs.argmin(axis=0)  # the first of equal ones, so that the choice needs no further noise
    row = np.arange(len(chosen))
    joints = np.stack([motions.joints for motions in draws])[chosen, row]
    rays = [motions.gaze for motions in draws if motions.gaze is not None]
    gaze = None
    if rays:
        origin = np.stack([one.origin for one in rays])[chosen, row]
        gaze = Gaze(origin, np.stack([one.direction for one in rays])[chosen, row])
    declared = [motions.cost.network_passes for motions in draws if motions.cost is not None]
    return Motions(joints, draws[0].n_frames, Cost(sum(declared)) if declared else None, gaze), chosen


def choice_cost(motions: Motions, condition: ConditionBatch, rules: ChoiceRules) -> Float[np.ndarray, " batch"]:
    """How far each motion is from priming and reaching its given goal; 0 is best, 2.5 worst.

    ``[no prime] / 2 + [no arrival] / 2 + [no reach] + (h / (1 + h) + w / (1 + w)) / 4``, where the brackets are 1 or
    0, h is the distance of the head ray from the goal at its best stay, in units of ``prime_distance``, and w that of
    the nearer wrist in the last frame, in units of ``reach_distance``. The fractions add up to less than a half, so
    they decide only between motions that fulfil the same.

    Args:
        motions: One draw, at the table's rate, canonical frame, metres.
        condition: What they were made from.
        rules: The rules of the choice.
    """
    constants = rules.constants
    goal = goal_of(condition)
    batch = MotionBatch.from_padded(motions.joints, motions.n_frames)
    fps = np.full(len(goal), condition.fps)
    candidates = candidate_frames(motions.n_frames, np.full(len(goal), rules.prime_time), fps, constants)
    track = head_track(batch, candidates, goal, rules.head_tilt_deg, fps, constants)
    wrists = batch.values[batch.last][:, WRISTS].astype(np.float64)  # (batch, 2, 3)
    wrist = np.linalg.norm(wrists - goal[:, None], axis=-1).min(axis=-1)
    misses = (
        (1 - primed(track, candidates, constants, "equation")) / 2
        + (1 - primed(track, candidates, constants, "arrival")) / 2
        + (wrist > constants.reach_distance + constants.threshold_tolerance)
    )
    head = _best_stay(track, candidates) / constants.prime_distance
    return misses + (_saturated(head) + _saturated(wrist / constants.reach_distance)) / 4


def goal_of(condition: ConditionBatch) -> Float[np.ndarray, "batch 3"]:
    """Where the goal is, as far as a method is told; canonical frame, metres.

    Of a goal pose it is the wrist that is farther from the vertical through its own shoulder: the arm that reaches does
    not hang.

    Raises:
        UsageError: if the condition gives no goal.
    """
    require_goal(condition.condition, best_of=2)
    if condition.goal_location is not None:
        return condition.goal_location.astype(np.float64)
    assert condition.goal_joints is not None
    pose = condition.goal_joints.astype(np.float64)
    aside = (pose[:, WRISTS] - pose[:, _SHOULDERS])[..., [0, 2]]
    reaching = np.linalg.norm(aside, axis=-1).argmax(axis=1)
    return pose[:, WRISTS][np.arange(len(pose)), reaching]


def _best_stay(track: RayTrack, candidates: CandidateFrames) -> Float[np.ndarray, " batch"]:
    """Smallest distance that the ray keeps through a stay of ``hold`` frames, metres; infinite without candidates."""
    distance = np.where(track.usable, track.distance, np.inf)
    sequence = np.repeat(np.arange(len(candidates.count)), candidates.count)
    row = track.row_of_frame_0[sequence] + ranges(candidates.first, candidates.count)
    hold = candidates.hold[sequence]
    farthest = distance[row]
    for k in range(1, int(hold.max(initial=0)) + 1):
        farthest = np.maximum(farthest, distance[row + np.minimum(k, hold)])
    best = np.full(len(candidates.count), np.inf)
    np.minimum.at(best, sequence, farthest)
    return best


def _saturated(value: Float[np.ndarray, " batch"]) -> Float[np.ndarray, " batch"]:
    """``x / (1 + x)``, and 1 for infinity."""
    return 1 - 1 / (1 + value)
