"""Convert one sequence of a release to a row of the sequence table, and to its event."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import WRISTS, Joint, invert_rigid, transform_points
from prbench.protocol.manifests import TextTemplates
from prbench.release.arrays import read_array, read_further
from prbench.release.reading import POSE_SOURCE, ReleasedDataset, ReleasedSequence, clean_gaze, parse_point
from prbench.sequences import Event, Sequence
from prbench.sequences.sequence import SEQUENCES
from prbench.sequences.table_one import body_movement, hand_movement

_UNKNOWN_ACTION = "unknown"
_ACTIONS = {"pick": "pick", "grab": "pick", "take": "pick", "put": "put", "place": "put", "drop": "put"}
_PICKS = re.compile(r"\b(pick|grab|take|taking|took|lift|fetch)", re.IGNORECASE)
_PUTS = re.compile(r"\b(put|plac|drop|set(s|ting)? down|return)", re.IGNORECASE)
_HANDS = {"left": "left", "l": "left", "right": "right", "r": "right"}


def make_row(
    found: ReleasedDataset, one: ReleasedSequence, *, head_tilt_deg: float, texts: TextTemplates
) -> tuple[Sequence, Event]:
    """Read one sequence again and convert it; times count from the first frame, unless its block tells them.

    Args:
        found: The dataset that it belongs to.
        one: The sequence, measured.
        head_tilt_deg: Rest tilt of the neck-head bone of the dataset's bodies, degrees.
        texts: The protocol's prompts, for entries without one.

    Raises:
        InputFileError: if its files changed since they were measured.
    """

    def value(canonical: str) -> Any:
        return one.fields.get(found.mapping.get(canonical, ""))

    # Motion, goal and gaze come into the canonical frame by one and the same transform.
    joints = read_array(one.motion, (22, 3))[0].astype(np.float64)
    gaze = None if one.gaze is None else read_array(one.gaze, (3,))[0]
    directions, valid = clean_gaze(gaze, len(joints))
    motion_from_canonical = np.eye(4)
    if one.block is not None:
        if one.block["motion_frame"] == "world":
            motion_from_canonical = one.block["world_from_canonical"]
    elif found.first_frame_is_previous or not one.is_canonical:
        motion_from_canonical = one.motion_from_canonical
    canonical_from_motion = invert_rigid(motion_from_canonical)
    goal = transform_points(canonical_from_motion, one.goal)
    if (motion_from_canonical != np.eye(4)).any():  # a canonical motion keeps every bit
        turn = canonical_from_motion.copy()
        turn[:3, 3] = 0.0
        joints = transform_points(canonical_from_motion, joints)
        directions = transform_points(turn, directions)
    primed = one.primed_frame
    if found.first_frame_is_previous:
        previous = joints[0]
        joints = joints[1:]
        directions = directions[1:]
        valid = valid[1:]
        primed -= 1
    else:
        previous = 2 * joints[0] - joints[1]

    # The world-aligned box around the release's box of the goal, else the goal itself.
    corners = goal[None]
    box = value("object_box")
    ends = [parse_point(end) for end in box] if isinstance(box, list) and len(box) == 2 else [None]
    if all(end is not None for end in ends):
        corners = transform_points(canonical_from_motion, np.array(list(itertools.product(*np.array(ends).T))))
    world = transform_points(motion_from_canonical, corners)

    text = value("text").strip() if isinstance(value("text"), str) else ""
    action = _action(value("action"), text)
    if not text and action != _UNKNOWN_ACTION:
        text = texts.pick if action == "pick" else texts.put
    hand = _HANDS.get(str(value("hand")).strip().lower())
    if hand is not None:
        wrist = Joint.LEFT_WRIST if hand == "left" else Joint.RIGHT_WRIST
    else:  # the nearer wrist is taken for the one that reached
        wrist = WRISTS[int(np.linalg.norm(joints[-1, WRISTS] - goal, axis=1).argmin())]
    fps = found.fps
    event_time = (len(joints) - 1) / fps
    kept = {name: one.fields[name] for name in found.unmapped if name in one.fields}
    name = value("object_name")
    sequence = Sequence(
        sequence_id=one.sequence_id,
        dataset=found.dataset,
        recording_id=one.recording_id,
        participant_id=one.participant_id,
        split=one.subset,
        split_group=one.split_group,
        action=action,
        object_id="",  # the release has none
        object_name=name.strip() if isinstance(name, str) else "",
        text=text,
        hand=hand,
        fps=fps,
        n_frames=len(joints),
        start_time=0.0,
        prime_time=primed / fps,
        event_time=event_time,
        prime_frame=primed,
        prime_gap=event_time - primed / fps,
        preroll=primed / fps,
        prime_kind="unknown",
        prime_time_uncertainty=1 / fps,  # the release counts whole frames
        goal_location=goal,
        goal_box_world_min=world.min(axis=0),
        goal_box_world_max=world.max(axis=0),
        body_movement=body_movement(joints),
        hand_movement=hand_movement(joints, wrist),
        pose_source=POSE_SOURCE,
        head_tilt_deg=head_tilt_deg,
        joints=joints,
        previous_joints=previous,
        previous_source="recorded" if found.first_frame_is_previous else "extrapolated",
        next_joints=2 * joints[-1] - joints[-2],
        next_source="extrapolated",
        head_position=None,
        head_rotation=None,
        gaze_origin=joints[:, Joint.HEAD],
        gaze_direction=directions,
        gaze_valid=valid,
        world_from_canonical=motion_from_canonical,
        extra={name: each if isinstance(each, str) else json.dumps(each) for name, each in kept.items()},
    )
    if one.block is not None and one.further is not None:
        sequence = _as_exported(sequence, one)
    return sequence, _event(sequence, one.event_id)


def _as_exported(plain: Sequence, one: ReleasedSequence) -> Sequence:
    """Restore the row that our exporter wrote."""
    assert one.block is not None
    assert one.further is not None
    values = {name: one.block[name] for name in one.block if name in SEQUENCES.names and name != "extra"}
    arrays, _ = read_further(one.further, plain.n_frames)
    values |= {name: array.astype(bool if name == "gaze_valid" else np.float64) for name, array in arrays.items()}
    return dataclasses.replace(plain, **values, extra={**plain.extra, **one.block["extra"]})


def _action(stated: Any, text: str) -> str:
    """Take the action from its field, else from the prompt, unless that says both or neither."""
    word = str(stated).strip().lower()
    for start, action in _ACTIONS.items():
        if word.startswith(start):
            return action
    picks = bool(_PICKS.search(text))
    if picks == bool(_PUTS.search(text)):  # `take the cup and put it down` names both
        return _UNKNOWN_ACTION
    return "pick" if picks else "put"


def _event(sequence: Sequence, event_id: str) -> Event:
    names = ("recording_id", "sequence_id", "object_id", "object_name", "action", "hand", "event_time", "prime_time",
             "prime_kind")  # fmt: skip
    location: Float[np.ndarray, "3"] = transform_points(sequence.world_from_canonical, sequence.goal_location)
    return Event(
        event_id=event_id,
        **{name: getattr(sequence, name) for name in names},
        location=location,
        box_min=sequence.goal_box_world_min,
        box_max=sequence.goal_box_world_max,
        outcome="sequence",
        stage="filters",
        value=None,
        threshold=None,
    )
