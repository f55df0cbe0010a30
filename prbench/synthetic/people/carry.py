"""Objects that stand still, are carried in a hand, and stand still again (``methods/synthetic-recordings.md`` section 4)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.channels import minimum_jerk
from prbench.synthetic.people.geometry import matrix_of, quaternion, rotation
from prbench.synthetic.people.plan import Plan, Reach
from prbench.synthetic.people.world import Item
from prbench.synthetic.performance import ObjectMotion


def move_objects(
    plan: Plan,
    wrists: Float[np.ndarray, "n 2 3"],
    hands: Float[np.ndarray, "n 2 3 3"],
    times: Float[np.ndarray, " n"],
    object_ids: list[str],
) -> list[ObjectMotion]:
    """The tracks of all handled objects and of the room's bystanders.

    Args:
        plan: Which object is carried when.
        wrists: Left and right wrist.
        hands: World from hand.
        times: Frame times, seconds.
        object_ids: One for each of the plan's items.
    """
    tracks = []
    for index, item in enumerate(plan.items):
        reaches = [reach for reach in plan.reaches if reach.item == index and reach.action in ("pick", "put")]
        if index < plan.n_handled and plan.preset.puts and reaches:
            tracks.append(_carried(item, reaches, wrists, hands, times, object_ids[index]))
        else:
            tracks.append(_resting(item, object_ids[index]))
    return tracks


def _resting(item: Item, object_id: str) -> ObjectMotion:
    pose = quaternion(rotation(item.yaw, 0.0))[None]
    return _motion(item, object_id, item.position[None], pose, np.array([-1]))


def _motion(
    item: Item, object_id: str, position: np.ndarray, quaternions: np.ndarray, held_by: np.ndarray
) -> ObjectMotion:
    return ObjectMotion(
        object_id=object_id,
        name=item.kind.name,
        category=item.kind.category,
        half_extents=item.half_extents,
        position=position,
        rotation=quaternions,
        held_by=held_by,
        movable=True,
    )


def _carried(
    item: Item, reaches: list[Reach], wrists: np.ndarray, hands: np.ndarray, times: np.ndarray, object_id: str
) -> ObjectMotion:
    n = times.size
    position = np.tile(item.position, (n, 1))
    turned = np.tile(quaternion(rotation(item.yaw, 0.0)), (n, 1))
    held_by = np.full(n, -1)
    for pick, put in zip(reaches[0::2], [*reaches[1::2], None][: len(reaches[0::2])], strict=True):
        first = int(np.searchsorted(times, pick.event))
        last = n if put is None else int(np.searchsorted(times, put.event))
        wrist, hand = wrists[first:last, pick.hand], hands[first:last, pick.hand]
        carried_position, carried_rotation = _rigid(wrist, hand, pick, put)
        position[first:last] = carried_position
        turned[first:last] = quaternion(carried_rotation)
        held_by[first:last] = pick.hand
        if put is not None:
            position[last:] = put.centre
            turned[last:] = quaternion(rotation(put.yaw, 0.0))
    return _motion(item, object_id, position, turned, held_by)


def _rigid(wrist: np.ndarray, hand: np.ndarray, pick: Reach, put: Reach | None) -> tuple[np.ndarray, np.ndarray]:
    """Fixed in the hand; what is left at the put is spread over the carry."""
    at_rest = rotation(pick.yaw, 0.0)
    offset = hand[0].T @ (pick.centre - wrist[0])
    position = wrist + hand @ offset
    turned = hand @ (hand[0].T @ at_rest)
    if put is None:
        return position, turned
    progress = minimum_jerk(np.arange(len(wrist)) / (len(wrist) - 1))
    position += progress[:, None] * (put.centre - position[-1])
    rest = quaternion(rotation(put.yaw, 0.0) @ turned[-1].T)
    return position, _part_of_rotation(rest, progress) @ turned


def _part_of_rotation(rotation_left: np.ndarray, progress: np.ndarray) -> np.ndarray:
    """A growing part of a rotation (quaternion with w >= 0), as matrices."""
    half = np.arctan2(np.linalg.norm(rotation_left[1:]), rotation_left[0])
    axis = rotation_left[1:] / max(float(np.linalg.norm(rotation_left[1:])), 1e-12)
    return matrix_of(np.concatenate([np.cos(half * progress)[:, None], np.sin(half * progress)[:, None] * axis], axis=1))
