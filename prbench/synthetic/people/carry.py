"""Objects that stand still, are carried in a hand, and stand still again.

Sources: docs/specification/synthetic-recordings.md#reaching-and-holding,
docs/specification/synthetic-recordings.md#event-truth and docs/specification/synthetic-recordings.md#provocations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.synthetic.people.arms import HANDING_TIME, MEETING_TIME, moved_along, opened
from prbench.synthetic.people.kinematics import matrix_of, minimum_jerk, quaternion, rotation
from prbench.synthetic.people.plan import Plan, Reach
from prbench.synthetic.people.world import Item
from prbench.synthetic.performance import ObjectMotion


@dataclass
class _Track:
    """Pose of one object over time, filled in movement by movement."""

    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    held_by: Int[np.ndarray, " n"]


def move_objects(
    plan: Plan,
    wrists: Float[np.ndarray, "n 2 3"],
    hands: Float[np.ndarray, "n 2 3 3"],
    times: Float[np.ndarray, " n"],
    object_ids: list[str],
) -> list[ObjectMotion]:
    """Return the tracks of all handled objects and of the room's bystanders.

    Args:
        plan: Which object is carried when.
        wrists: Left and right wrist.
        hands: World from hand.
        times: Frame times, seconds.
        object_ids: One for each of the plan's items.

    Returns:
        One motion for each item; an object that never moves has a single pose.
    """
    tracks: list[_Track] = []
    for index, item in enumerate(plan.items):
        if item.rides_on is not None:
            tracks.append(_riding(item, plan.items[item.rides_on], tracks[item.rides_on]))
            continue
        reaches = [reach for reach in plan.reaches if reach.item == index and _moves_object(plan, reach)]
        tracks.append(_moving(item, reaches, wrists, hands, times) if reaches else _resting(item))
    return [
        ObjectMotion(
            object_id=object_id,
            name=item.kind.name,
            category=item.kind.category,
            half_extents=item.half_extents,
            position=track.position,
            rotation=track.rotation,
            held_by=track.held_by,
            movable=True,
            hinged=item.hinged,
        )
        for item, track, object_id in zip(plan.items, tracks, object_ids, strict=True)
    ]


def _moves_object(plan: Plan, reach: Reach) -> bool:
    return reach.action in ("nudge", "hinge") or (plan.preset.puts and reach.action in ("pick", "put"))


def _resting(item: Item) -> _Track:
    return _Track(item.position[None], quaternion(rotation(item.yaw, 0.0))[None], np.array([-1]))


def _moving(item: Item, reaches: list[Reach], wrists: np.ndarray, hands: np.ndarray, times: np.ndarray) -> _Track:
    n = times.size
    rest = _resting(item)
    track = _Track(np.tile(rest.position, (n, 1)), np.tile(rest.rotation, (n, 1)), np.full(n, -1))
    for reach, following in zip(reaches, (*reaches[1:], None), strict=False):
        first = int(np.searchsorted(times, reach.event))
        if reach.action == "pick":
            last = n if following is None else int(np.searchsorted(times, following.event))
            _carry(track, slice(first, last), reach, following, wrists, hands, times)
        elif reach.action == "put":
            track.position[first:] = reach.centre
            track.rotation[first:] = quaternion(rotation(reach.yaw, 0.0))
        else:
            track.position[first:] = moved_along(reach, reach.centre, times[first:])
            if reach.action == "hinge":
                track.rotation[first:] = quaternion(rotation(reach.yaw + opened(reach, times[first:]), 0.0))
                track.held_by[first : int(np.searchsorted(times, reach.event + reach.dwell))] = reach.hand
    return track


def _carry(
    track: _Track,
    span: slice,
    pick: Reach,
    put: Reach | None,
    wrists: np.ndarray,
    hands: np.ndarray,
    times: np.ndarray,
) -> None:
    """Fix the object in the hand; what is left at the put is spread over the carry."""
    position, turned = _rigid(wrists[span, pick.hand], hands[span, pick.hand], pick, at=0)
    track.held_by[span] = pick.hand
    if put is not None and put.twist.handed_over is not None:
        begin = put.twist.handed_over + MEETING_TIME
        share = minimum_jerk((times[span] - begin) / HANDING_TIME)
        position_after, turned_after = _rigid(wrists[span, put.hand], hands[span, put.hand], put, at=-1)
        position = position + share[:, None] * (position_after - position)
        turned = _between(turned, turned_after, share)
        track.held_by[span] = np.where(share < 0.5, pick.hand, put.hand)
    if put is not None:
        progress = minimum_jerk(np.arange(len(position)) / (len(position) - 1))
        position = position + progress[:, None] * (put.centre - position[-1])
        turned = _part_of_rotation(rotation(put.yaw, 0.0) @ turned[-1].T, progress) @ turned
    track.position[span] = position
    track.rotation[span] = quaternion(turned)


def _rigid(wrist: np.ndarray, hand: np.ndarray, reach: Reach, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses of an object that is fixed in a hand and lies as the reach has it in frame ``at``."""
    offset = hand[at].T @ (reach.centre - wrist[at])
    return wrist + hand @ offset, hand @ (hand[at].T @ rotation(reach.yaw, 0.0))


def _between(before: np.ndarray, after: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return the rotations a growing share of the way from one to the other."""
    left = quaternion(after @ np.swapaxes(before, -1, -2))
    return _scaled_rotation(left, share) @ before


def _part_of_rotation(whole: np.ndarray, share: np.ndarray) -> np.ndarray:
    return _scaled_rotation(np.broadcast_to(quaternion(whole), (len(share), 4)), share)


def _scaled_rotation(quaternions: Float[np.ndarray, "n 4"], share: Float[np.ndarray, " n"]) -> np.ndarray:
    """Return the matrices of rotations (w >= 0) whose angles are scaled."""
    sine = np.linalg.norm(quaternions[:, 1:], axis=1)
    half = np.arctan2(sine, quaternions[:, 0]) * share
    axis = quaternions[:, 1:] / np.maximum(sine, 1e-12)[:, None]
    return matrix_of(np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * axis], axis=1))


def _riding(item: Item, carrier: Item, track: _Track) -> _Track:
    """Return the poses of an object that stands on another one."""
    at_rest = rotation(carrier.yaw, 0.0)
    offset = at_rest.T @ (item.position - carrier.position)
    if len(track.position) == 1:
        return _resting(item)
    frames = matrix_of(track.rotation)
    turned = frames @ (at_rest.T @ rotation(item.yaw, 0.0))
    still = np.all(track.position == carrier.position, axis=1)[:, None]
    position = np.where(still, item.position, track.position + frames @ offset)
    return _Track(position, quaternion(turned), np.full(len(position), -1))
