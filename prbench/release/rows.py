"""Convert one sequence of a release to a row of the sequence table, and to its event."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.bounded import read_whole
from prbench.geometry.skeleton import WRISTS, Joint, invert_rigid, transform_points
from prbench.protocol.manifests import TextTemplates
from prbench.release.block import Block, fits, parse_array, unpack_arrays
from prbench.release.candidates import Candidate
from prbench.release.judge import UNKNOWN, Conclusions, is_canonical_already
from prbench.release.rates import PrimedFrames
from prbench.release.survey import Measured, clean_gaze, goal_transform
from prbench.release.values import action_of_text, parse_action, parse_goal, parse_hand, parse_name, parse_text
from prbench.sequences.sequence import EventRecord, Sequence
from prbench.sequences.table_one import body_movement, hand_movement

POSE_SOURCE = "release"
_UNKNOWN_ACTION = "unknown"


@dataclass(frozen=True)
class RowNames:
    """Names of a sequence and its recording."""

    sequence_id: str
    event_id: str
    recording_id: str
    participant_id: str
    split_group: str
    recording_is_known: bool


@dataclass(frozen=True)
class Reading:
    """Everything that was inferred about one dataset of a release, as far as rows depend on it."""

    dataset: str
    head_tilt_deg: float
    texts: TextTemplates
    """The protocol's prompts, for entries without one."""
    mapping: Mapping[str, str]
    """Field of the release by canonical name."""
    unmapped: tuple[str, ...]
    """Fields that stand for no canonical one; they go to ``extra``."""
    fps: float
    primed: PrimedFrames
    conclusions: Conclusions
    first_frame_is_previous: bool = False
    """Frame 0 of a motion is the frame before the sequence, kept for the initial velocity."""

    def primed_frame(self, candidate: Candidate) -> float:
        """Return the frame of the prime from 0, with a fraction where the release gives seconds."""
        return candidate.primed * self.fps if self.primed.in_seconds else candidate.primed - self.primed.base

    def field(self, candidate: Candidate, canonical: str) -> object:
        """Return the value of a canonical field, or None."""
        return candidate.entry.fields.get(self.mapping.get(canonical, ""))

    def block(self, candidate: Candidate) -> Block | None:
        """Return the prbench block of an entry, if it has one that still fits its sequence."""
        value = self.field(candidate, "prbench")
        if value is None or candidate.further is None or self.first_frame_is_previous:
            return None
        try:
            block = msgspec.convert(value, Block)
        except (ValueError, msgspec.ValidationError):  # of another form, or its numbers are impossible
            return None
        span = block.event_time - block.start_time
        # A block that no longer fits belongs to an entry that somebody changed; its fields then count, not the block.
        same_prime = abs(block.preroll * self.fps - self.primed_frame(candidate)) <= 0.5 + 1e-6
        same_length = block.n_frames == candidate.n_frames and abs(span * self.fps - candidate.n_frames + 1) < 1e-3
        return block if same_prime and same_length else None

    def names(self, candidate: Candidate) -> RowNames:
        """Name a sequence by dataset and number, and its recording by the source field, unless a block names both."""
        block = self.block(candidate)
        if block is not None:
            return RowNames(
                block.sequence_id, block.event_id, block.recording_id, block.participant_id, block.split_group, True
            )
        event = f"{self.dataset}/{candidate.index:010d}"
        source = parse_name(self.field(candidate, "source"))
        recording = source or f"unknown-{candidate.subset}"
        return RowNames(f"{event}/{POSE_SOURCE}", event, recording, "unknown", recording, source is not None)


@dataclass(frozen=True)
class _Motion:
    """Arrays of one sequence in its canonical frame, metres."""

    joints: Float[np.ndarray, "n 22 3"]
    previous_joints: Float[np.ndarray, "22 3"] | None
    """Recorded pose before the first frame; None where the release has none."""
    goal: Float[np.ndarray, "3"]
    gaze_direction: Float[np.ndarray, "n 3"]
    gaze_valid: np.ndarray
    world_from_canonical: Float[np.ndarray, "4 4"]
    canonical_from_goal: Float[np.ndarray, "4 4"]
    """Transform from the frame of the release's goals, scaled to metres."""


def make_row(reading: Reading, measured: Measured) -> tuple[Sequence, EventRecord]:
    """Read one sequence again and convert it.

    Raises:
        InputFileError: if its files changed since they were measured.
    """
    candidate = measured.candidate
    block = reading.block(candidate)
    motion = _motion(reading, measured, block)
    sequence = _plain_sequence(reading, candidate, motion)
    if block is not None:
        sequence = _with_block(sequence, block, candidate)
    return sequence, _event(sequence, reading.names(candidate).event_id)


def _motion(reading: Reading, measured: Measured, block: Block | None) -> _Motion:
    candidate = measured.candidate
    metres = reading.conclusions.metres
    joints = parse_array(candidate.motion, read_whole(candidate.motion)).astype(np.float64) * metres
    gaze = None if candidate.gaze is None else parse_array(candidate.gaze, read_whole(candidate.gaze))
    directions, valid = clean_gaze(gaze, len(joints))
    previous = None
    if reading.first_frame_is_previous:
        previous = joints[0]
        joints = joints[1:]
        directions = directions[1:]
        valid = valid[1:]
    motion_from_canonical = _motion_from_canonical(reading, measured, block)
    canonical_from_motion = invert_rigid(motion_from_canonical)
    # Goals may be given in another frame than the motions; both come into the canonical frame in one product.
    motion_from_goal = goal_transform(_known_goal_frame(reading), _scaled(measured.world_from_canonical, metres))
    canonical_from_goal = canonical_from_motion @ motion_from_goal
    goal = transform_points(canonical_from_goal, candidate.goal.location * metres)
    world_from_canonical = motion_from_canonical
    if block is not None:
        world_from_canonical = np.array(block.world_from_canonical).reshape(4, 4)
    if (motion_from_canonical != np.eye(4)).any():  # a canonical motion keeps every bit
        turn = canonical_from_motion.copy()
        turn[:3, 3] = 0.0
        joints = transform_points(canonical_from_motion, joints)
        directions = transform_points(turn, directions)
        previous = None if previous is None else transform_points(canonical_from_motion, previous)
    return _Motion(joints, previous, goal, directions, valid, world_from_canonical, canonical_from_goal)


def _motion_from_canonical(reading: Reading, measured: Measured, block: Block | None) -> Float[np.ndarray, "4 4"]:
    """Return the one transform by which joints, goal and gaze of a sequence are turned."""
    if block is not None:
        is_world = block.motion_frame == "world"
        return np.array(block.world_from_canonical).reshape(4, 4) if is_world else np.eye(4)
    metres = reading.conclusions.metres
    if is_canonical_already(measured, metres) and not reading.first_frame_is_previous:
        return np.eye(4)
    return _scaled(measured.world_from_canonical, metres)


def _known_goal_frame(reading: Reading) -> str:
    return "as the motions" if reading.conclusions.goal_frame == UNKNOWN else reading.conclusions.goal_frame


def _scaled(transform: Float[np.ndarray, "4 4"], metres: float) -> Float[np.ndarray, "4 4"]:
    scaled = transform.copy()
    scaled[:3, 3] *= metres
    return scaled


def _plain_sequence(reading: Reading, candidate: Candidate, motion: _Motion) -> Sequence:
    """Make the row from the layout's own fields; times count from the first frame."""
    joints = motion.joints
    fps = reading.fps
    primed = reading.primed_frame(candidate) - reading.first_frame_is_previous
    event_time = (len(joints) - 1) / fps
    hand = parse_hand(reading.field(candidate, "hand"))
    low, high = _world_box(reading, candidate, motion)
    previous = motion.previous_joints
    return Sequence(
        **_labels(reading, candidate),
        hand=hand,
        fps=fps,
        n_frames=len(joints),
        start_time=0.0,
        prime_time=primed / fps,
        event_time=event_time,
        prime_frame=round(primed),
        prime_gap=event_time - primed / fps,
        preroll=primed / fps,
        prime_kind="unknown",
        # The release counts whole frames, so the prime is known to one frame.
        prime_time_uncertainty=1 / fps,
        goal_location=motion.goal,
        goal_box_world_min=low,
        goal_box_world_max=high,
        body_movement=body_movement(joints),
        hand_movement=hand_movement(joints, _reaching_wrist(joints, motion.goal, hand)),
        pose_source=POSE_SOURCE,
        head_tilt_deg=reading.head_tilt_deg,
        joints=joints,
        previous_joints=2 * joints[0] - joints[1] if previous is None else previous,
        previous_source="extrapolated" if previous is None else "recorded",
        next_joints=2 * joints[-1] - joints[-2],
        next_source="extrapolated",
        head_position=None,
        head_rotation=None,
        gaze_origin=joints[:, Joint.HEAD],
        gaze_direction=motion.gaze_direction,
        gaze_valid=motion.gaze_valid,
        world_from_canonical=motion.world_from_canonical,
        extra=_extra(reading, candidate),
    )


def _labels(reading: Reading, candidate: Candidate) -> dict[str, str]:
    """Return the columns of a row that are text from the entry; the release has no ids of objects."""
    names = reading.names(candidate)
    action, text = _action_and_text(reading, candidate)
    return {
        "sequence_id": names.sequence_id,
        "dataset": reading.dataset,
        "recording_id": names.recording_id,
        "participant_id": names.participant_id,
        "split": candidate.subset,
        "split_group": names.split_group,
        "action": action,
        "object_id": "",
        "object_name": parse_name(reading.field(candidate, "object_name")) or "",
        "text": text,
    }


def _with_block(plain: Sequence, block: Block, candidate: Candidate) -> Sequence:
    """Restore the row that our exporter wrote."""
    assert candidate.further is not None
    arrays = unpack_arrays(candidate.further, read_whole(candidate.further))
    if not fits(arrays, plain.n_frames):
        raise InputFileError(
            candidate.further, "", expected="the arrays of this sequence", found="others", remedy="Export it again."
        )
    values = msgspec.structs.asdict(block)
    for name in ("event_id", "motion_frame", "goal_frame", "world_from_canonical", "n_frames"):
        del values[name]
    if block.prime_time_uncertainty is None:
        values["prime_time_uncertainty"] = float("nan")
    for name in ("goal_box_world_min", "goal_box_world_max"):
        values[name] = np.array(values[name])
    values["extra"] = {**plain.extra, **block.extra}
    return dataclasses.replace(plain, **values, **_as_columns(arrays))


def _as_columns(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray | None]:
    columns: dict[str, np.ndarray | None] = {name: values.astype(np.float64) for name, values in arrays.items()}
    columns["gaze_valid"] = arrays["gaze_valid"].astype(bool)
    return columns | {name: columns.get(name) for name in ("head_position", "head_rotation")}


def _action_and_text(reading: Reading, candidate: Candidate) -> tuple[str, str]:
    """Take the action from its field, else from the prompt; a missing prompt is the protocol's for the action."""
    text = parse_text(reading.field(candidate, "text")) or ""
    action = parse_action(reading.field(candidate, "action"), reading.mapping.get("action", ""))
    action = action or action_of_text(text) or _UNKNOWN_ACTION
    if not text and action != _UNKNOWN_ACTION:
        text = reading.texts.pick if action == "pick" else reading.texts.put
    return action, text


def _world_box(
    reading: Reading, candidate: Candidate, motion: _Motion
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the world-aligned box around the release's box of the goal, else around the goal's location."""
    box = candidate.goal.box
    if box is None:
        given = parse_goal(reading.field(candidate, "object_box"))
        box = None if given is None else given.box
    if box is None:
        corners = motion.goal[None]
    else:
        given_corners = np.array(list(itertools.product(*box.T))) * reading.conclusions.metres
        corners = transform_points(motion.canonical_from_goal, given_corners)
    world = transform_points(motion.world_from_canonical, corners)
    return world.min(axis=0), world.max(axis=0)


def _reaching_wrist(joints: Float[np.ndarray, "n 22 3"], goal: Float[np.ndarray, "3"], hand: str | None) -> int:
    if hand is not None:
        return Joint.LEFT_WRIST if hand == "left" else Joint.RIGHT_WRIST
    # Without a stated hand the nearer wrist is taken for the one that reached.
    return WRISTS[int(np.linalg.norm(joints[-1, WRISTS] - goal, axis=1).argmin())]


def _extra(reading: Reading, candidate: Candidate) -> dict[str, str]:
    """Return the fields that stand for no canonical one, as text."""
    values = {name: candidate.entry.fields[name] for name in reading.unmapped if name in candidate.entry.fields}
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in values.items()}


def _event(sequence: Sequence, event_id: str) -> EventRecord:
    return EventRecord(
        event_id=event_id,
        recording_id=sequence.recording_id,
        sequence_id=sequence.sequence_id,
        object_id=sequence.object_id,
        object_name=sequence.object_name,
        action=sequence.action,
        hand=sequence.hand,
        event_time=sequence.event_time,
        prime_time=sequence.prime_time,
        prime_kind=sequence.prime_kind,
        location=transform_points(sequence.world_from_canonical, sequence.goal_location),
        box_min=sequence.goal_box_world_min,
        box_max=sequence.goal_box_world_max,
        outcome="sequence",
        stage="filters",
        value=None,
        threshold=None,
    )
