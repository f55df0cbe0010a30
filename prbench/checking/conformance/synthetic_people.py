"""Sequences of synthetic people, made in memory: what the check asks a method about when no table is given.

Perfect curation of noise-free performances (docs/specification/synthetic-recordings.md), so that every pose is
plausible, every goal is reached by the person who was recorded, and every run of a check sees the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, islice
from typing import Any

import numpy as np

from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.protocol.manifests import load_protocol
from prbench.sequences import Sequence
from prbench.synthetic.people.perform import name_of_recording, perform
from prbench.synthetic.people.world import Source, assign
from prbench.synthetic.performance import FPS, PREROLL, Performance, TrueClip, sample_joints, true_clips

DATASET = "synthetic-conformance"
_PRESET = "adt"
_SEED = 2024  # differs from that of the embedded table, whose people a method may have learnt from
_RATE = 60.0
_CLIPS_OF_ONE = 6  # sequences a recording, so that several people are seen


def synthetic_sequences(split: str, number: int) -> list[Sequence]:
    """The first sequences of a split, by id; equal in every process.

    Args:
        split: ``train``, ``validation`` or ``test``; no person and no room is in two of them.
        number: How many.
    """
    return sorted(islice(_sequences(split), number), key=lambda sequence: sequence.sequence_id)


def _sequences(split: str) -> Iterator[Sequence]:
    source = Source(_SEED, _PRESET, "default")
    for index in count():
        if assign(source, index, "person_and_room").split != split:
            continue
        performance = perform(_PRESET, seed=_SEED, index=index, rate=_RATE, provocations={})
        for clip in true_clips(performance)[:_CLIPS_OF_ONE]:
            yield _sequence(performance, clip, split)


def _sequence(performance: Performance, clip: TrueClip, split: str) -> Sequence:
    event = clip.event
    assert event.prime_time is not None  # clips are made of primed events only
    name = name_of_recording(_PRESET, _SEED, performance.index)
    protocol = load_protocol()
    return Sequence(
        sequence_id=f"{DATASET}/{name}/{event.object_id}/{event.action}/{event.event_time:.6f}",
        dataset=DATASET,
        recording_id=name,
        participant_id=performance.person.participant_id,
        split=split,
        split_group=name,
        action=event.action,
        object_id=event.object_id,
        object_name=event.object_name,
        text=getattr(protocol.text, event.action),
        hand=event.hand,
        fps=FPS,
        n_frames=len(clip.joints),
        start_time=clip.start,
        prime_time=event.prime_time,
        event_time=event.event_time,
        prime_frame=round(PREROLL * FPS),
        prime_gap=event.event_time - event.prime_time,
        preroll=clip.prime_after,
        prime_kind=event.prime_kind or "hit",
        prime_time_uncertainty=1 / performance.rate,
        goal_box_world_min=event.box_min,
        goal_box_world_max=event.box_max,
        body_movement=clip.body_movement,
        hand_movement=clip.hand_movement,
        pose_source="invented",
        head_tilt_deg=clip.neck_tilt_deg,
        previous_source="recorded",
        next_source="recorded",
        head_position=None,
        head_rotation=None,
        gaze_valid=np.ones(len(clip.joints), dtype=bool),
        **_in_canonical_frame(performance, clip),
    )


def _in_canonical_frame(performance: Performance, clip: TrueClip) -> dict[str, Any]:
    """The columns that change with the frame, by name; gaze is that of the performance's nearest sample."""
    world_from_canonical = canonical_frame(clip.joints)
    canonical_from_world = invert_rigid(world_from_canonical)

    def pose(time: float) -> np.ndarray:
        return transform_points(canonical_from_world, sample_joints(performance, np.array([time]))[0])

    frame_times = clip.start + np.arange(len(clip.joints)) / FPS
    nearest = np.searchsorted(performance.times, frame_times - 0.5 / performance.rate)
    nearest = np.minimum(nearest, len(performance.times) - 1)
    return {
        "world_from_canonical": world_from_canonical,
        "goal_location": transform_points(canonical_from_world, clip.event.goal),
        "joints": transform_points(canonical_from_world, clip.joints).astype(np.float32),
        "previous_joints": pose(clip.start - 1 / FPS).astype(np.float32),
        "next_joints": pose(clip.event.event_time + 1 / FPS).astype(np.float32),
        "gaze_origin": transform_points(canonical_from_world, performance.eye[nearest]),
        "gaze_direction": performance.gaze[nearest] @ world_from_canonical[:3, :3],
    }
