"""A second person who moves an object while the wearer does something else.

Source: docs/specification/synthetic-recordings.md#provocations, ``bystander``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from prbench.synthetic.people.base import sample_base
from prbench.synthetic.people.carry import move_objects
from prbench.synthetic.people.motion import Generators, Motion, synthesise
from prbench.synthetic.people.person import draw_person
from prbench.synthetic.people.plan import Plan
from prbench.synthetic.people.planner import plan_recording
from prbench.synthetic.people.population import Source
from prbench.synthetic.people.world import Item
from prbench.synthetic.performance import ObjectMotion, OtherPerson

_EVENTS = 2
_ATTEMPTS = 8
_POLITE_DISTANCE = 0.9  # metres between two people


@dataclass(frozen=True)
class Bystander:
    """The other person, what they planned, and the objects that they moved."""

    person: OtherPerson
    plan: Plan
    objects: list[ObjectMotion]


def bystander_acts(
    source: Source, index: int, wearer: Plan, motion: Motion, times: np.ndarray, object_ids: list[str]
) -> Bystander | None:
    """Let somebody else pick and put one object in the same room at the same time.

    Args:
        source: Names the generators.
        index: Of the recording.
        wearer: Whose objects must not be in the way.
        motion: Of the wearer, to keep away from.
        times: Frame times of the recording, seconds.
        object_ids: Ids for the objects of the other person.

    Returns:
        None if the recording is too short for it.
    """
    preset, participant = wearer.preset, f"B{index:04d}"
    person = draw_person(preset, participant, source.generator("recording", index, "bystander-body"))
    taken = [_stand_in(wearer, reach.item, reach.centre) for reach in wearer.reaches]
    room = replace(wearer.room, bystanders=(*wearer.room.bystanders, *taken))
    best: tuple[float, Plan] | None = None
    for attempt in range(_ATTEMPTS):
        plan = plan_recording(
            preset, person, room, _EVENTS, source.generator("recording", index, f"bystander-plan{attempt}")
        )
        if len(plan.reaches) < _EVENTS or plan.reaches[-1].event > times[-1] - 1.5:
            continue
        path = sample_base(plan.start, plan.segments, times)
        distance = float(np.hypot(path.x - motion.base.x, path.z - motion.base.z).min())
        if best is None or distance > best[0]:
            best = distance, plan
        if distance > _POLITE_DISTANCE:
            break
    return None if best is None else _acted(source, index, best[1], times, object_ids)


def _stand_in(wearer: Plan, item: int, centre: np.ndarray) -> Item:
    """Something that stands where the wearer's object was or will be."""
    return replace(wearer.items[item], position=centre, rides_on=None)


def _acted(source: Source, index: int, plan: Plan, times: np.ndarray, object_ids: list[str]) -> Bystander:
    purposes = (source.generator("recording", index, f"bystander-{name}") for name in ("sway", "gaze", "head"))
    motion = synthesise(plan, times, Generators(*purposes))
    handled = 1 + max(reach.item for reach in plan.reaches)
    plan = replace(plan, items=plan.items[:handled])
    objects = move_objects(plan, motion.joints[:, 20:22], motion.hands, times, object_ids[:handled])
    held = [replace(item, held_by=np.where(item.held_by >= 0, 2, -1)) for item in objects]
    person = OtherPerson(plan.person.participant_id, motion.joints, motion.finger_bases)
    return Bystander(person, plan, held)
