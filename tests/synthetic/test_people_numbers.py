"""Synthetic bodies keep the limits of docs/specification/constants.md#plausibility, acted out and recorded."""

from __future__ import annotations

import os

import numpy as np
import pytest

from prbench.curation import curate_recording
from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.harness.synthetic_table import Staging
from prbench.metrics import MetricValues, MotionBatch, score
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.synthetic.people import PRESETS, perform
from prbench.synthetic.performance import World
from tests.metrics.motions import targets
from tests.synthetic.true_clips import FPS, clips_of

EVENTS = 6
LARGEST_BONE_CHANGE = 0.02  # our limit: joints between recorded poses of 30 Hz cut the corner of a swinging leg

# Joints of a sequence, its goal, and the rest tilt of its head.
Person = tuple[np.ndarray, np.ndarray, float]


def recorded(staging: Staging, recordings: int) -> list[Person]:
    people: list[Person] = []
    for index in range(recordings):
        recording = staging.sense(staging.perform(index))
        curated = curate_recording(recording, load_manifest(staging.preset), load_protocol())
        people += [(np.asarray(each.joints), each.goal_location, each.head_tilt_deg) for each in curated.sequences]
    return people


def measured(people: list[Person]) -> dict[str, MetricValues]:
    joints, goals, tilts = zip(*people, strict=True)
    motions = MotionBatch.from_motions(joints)
    return score(motions, motions, targets(len(people), goal=goals, tilt=tilts, fps=FPS), load_protocol().metrics)


@pytest.mark.parametrize("preset", PRESETS)
def test_bodies_keep_their_bones_and_the_protocol(preset: str) -> None:
    # Without provocations, which are meant to be unusual; recorded people have them.
    some = [perform(preset, seed=5, index=index, n_events=EVENTS, rate=60.0, provocations={}) for index in range(2)]
    acted = []
    for clip in clips_of(some):
        frame = invert_rigid(canonical_frame(clip.joints))
        joints, goal = (transform_points(frame, points) for points in (clip.joints, clip.event.goal))
        acted.append((joints, goal, clip.neck_tilt_deg))
    for people in (acted, recorded(Staging(preset, 5, n_events=EVENTS), 2)):
        found = measured(people)
        assert (found["plausible"].flags, found["plausible_3"].flags) == ({}, {})
        assert found["bone_length_change"].value.max() <= LARGEST_BONE_CHANGE


@pytest.mark.slow
@pytest.mark.parametrize(("world", "recordings"), [("default", 6), ("second", 2)])
def test_of_recorded_people_of_fresh_seeds_99_percent_are_plausible(world: World, recordings: int) -> None:
    kept: dict[str, list[float]] = {}
    flags = []
    for seed in map(int, os.environ.get("PRBENCH_PEOPLE_SEEDS", "909").split()):
        for preset in PRESETS:
            found = measured(recorded(Staging(preset, seed, world), recordings))["plausible"]
            kept.setdefault(preset, []).extend(found.value)
            flags += [f"{preset} {seed}: {flag}" for flag in found.flag if flag]
    assert np.mean(np.concatenate(list(kept.values()))) >= 0.99, flags
    assert min(map(np.mean, kept.values())) >= 0.97, flags
