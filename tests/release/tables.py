"""Small tables whose motions are canonical and whose people look at their goals."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import Joint, canonical_frame, invert_rigid, transform_points
from prbench.protocol.manifests import load_protocol
from prbench.randomness import named_generator
from prbench.sequences import Event, Recording, Sequence, SequenceTable
from prbench.sequences.sequence import event_batch, recording_batch, sequence_batch
from prbench.sequences.write import write_dataset
from tests.fakes import fake_info, fake_sequence

HALF_EXTENTS = np.array([0.05, 0.1, 0.07])


def looking_sequence(index: int, dataset: str, *, recordings: int = 6) -> Sequence:
    """A made-up sequence in its canonical frame, in a world of its own; some gaze samples are invalid."""
    plain = fake_sequence(index, dataset=dataset, recordings=recordings)
    joints = plain.joints.astype(np.float64)
    canonical_from_fake = invert_rigid(canonical_frame(joints))
    joints = transform_points(canonical_from_fake, joints)
    goal = transform_points(canonical_from_fake, plain.goal_location)
    towards = goal - joints[:, Joint.HEAD]
    generator = named_generator("looking", index)
    world_from_canonical = np.eye(4)
    world_from_canonical[:3, :3] = Rotation.from_rotvec([0, generator.uniform(-3, 3), 0]).as_matrix()
    world_from_canonical[:3, 3] = generator.uniform(-5, 5, size=3)
    centre = transform_points(world_from_canonical, goal)
    return dataclasses.replace(
        plain,
        participant_id=f"P{index % recordings}",
        goal_location=goal,
        goal_box_world_min=centre - HALF_EXTENTS,
        goal_box_world_max=centre + HALF_EXTENTS,
        joints=joints.astype(np.float32),
        previous_joints=(joints[0] - 0.001).astype(np.float32),
        previous_source="recorded",
        next_joints=(2 * joints[-1] - joints[-2]).astype(np.float32),
        next_source="extrapolated",
        head_position=None if plain.head_position is None else joints[:, Joint.HEAD] + [0.0, 0.05, 0.08],
        gaze_origin=joints[:, Joint.HEAD] + [0.0, 0.05, 0.08],
        gaze_direction=towards / np.linalg.norm(towards, axis=1, keepdims=True),
        gaze_valid=generator.uniform(size=plain.n_frames) > 0.1,
        world_from_canonical=world_from_canonical,
    )


def looking_table(folder: Path, n: int = 24, *, dataset: str = "synthetic-adt") -> SequenceTable:
    """A table of such sequences."""
    rows = sorted((looking_sequence(index, dataset) for index in range(n)), key=lambda row: row.sequence_id)
    events = [
        Event(
            event_id=row.sequence_id.rsplit("/", 1)[0], recording_id=row.recording_id, sequence_id=row.sequence_id,
            object_id=row.object_id, object_name=row.object_name, action=row.action, hand=row.hand,
            event_time=row.event_time, prime_time=row.prime_time, prime_kind=row.prime_kind,
            location=transform_points(row.world_from_canonical, row.goal_location), box_min=row.goal_box_world_min,
            box_max=row.goal_box_world_max, outcome="sequence", stage="filters", value=1.0, threshold=0.2,
        )
        for row in rows
    ]  # fmt: skip
    records = [
        Recording(
            recording_id=name, participant_id="P0", split=split, split_group=name, duration=60.0,
            outcomes={"sequence": 1}, status="read", message="",
        )
        for name, split in sorted({row.recording_id: row.split for row in rows}.items())
    ]  # fmt: skip
    # An import is a table of the present protocol, so only one of the same protocol can come back as it was.
    info = msgspec.structs.replace(fake_info(dataset, len(rows)), protocol_version=load_protocol().version)
    write_dataset(
        folder,
        info,
        sequences=[sequence_batch(rows)],
        events=[event_batch(events)],
        recordings=[recording_batch(records)],
    )
    return SequenceTable.open(folder)
