"""Synthetic bodies keep the limits of docs/specification/constants.md#plausibility, acted out and recorded."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.curation import curate_recording
from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.harness.synthetic_table import Staging
from prbench.metrics import MotionBatch, score
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.synthetic.people import PRESETS, perform
from tests.metrics.motions import targets
from tests.synthetic.true_clips import FPS, clips_of

EVENTS = 6
LARGEST_BONE_CHANGE = 0.02  # our limit: joints between recorded poses of 30 Hz cut the corner of a swinging leg


@pytest.mark.parametrize("preset", PRESETS)
def test_bodies_keep_their_bones_and_the_protocol(preset: str) -> None:
    # Without provocations, which are meant to be unusual; recorded people have them.
    some = [perform(preset, seed=5, index=index, n_events=EVENTS, rate=60.0, provocations={}) for index in range(2)]
    acted = []
    for clip in clips_of(some):
        frame = invert_rigid(canonical_frame(clip.joints))
        joints, goal = (transform_points(frame, points) for points in (clip.joints, clip.event.goal))
        acted.append((joints, goal, clip.neck_tilt_deg))
    staging = Staging(preset, 5, n_events=EVENTS)
    recordings = [staging.sense(staging.perform(index)) for index in range(2)]
    curated = [curate_recording(each, load_manifest(preset), load_protocol()) for each in recordings]
    recorded = [(each.joints, each.goal_location, each.head_tilt_deg) for one in curated for each in one.sequences]
    for people in (acted, recorded):
        joints, goals, tilts = zip(*people, strict=True)
        motions = MotionBatch.from_motions([np.asarray(motion) for motion in joints])
        found = score(motions, motions, targets(len(people), goal=goals, tilt=tilts, fps=FPS), load_protocol().metrics)
        assert (found["plausible"].flags, found["plausible_3"].flags) == ({}, {})
        assert found["bone_length_change"].value.max() <= LARGEST_BONE_CHANGE
