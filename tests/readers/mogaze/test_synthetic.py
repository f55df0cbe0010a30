"""Synthetic MoGaze: inverse kinematics, sensors, and files that come back bit for bit."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, Joint
from prbench.protocol.manifests import load_manifest
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.format import MODEL_OFFSETS, body_joints, link_offsets, link_poses
from prbench.readers.mogaze.synthetic import GAZE_BIAS, body_names, sense, solve_body
from prbench.synthetic.layouts import synthetic_recording
from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Sensing, Switches, gaze_bias_of

DERIVED = (Joint.SPINE1, Joint.SPINE2)


@pytest.fixture(scope="module")
def performance() -> Performance:
    """Two picks and two puts, with deep bends to the low shelf."""
    return perform("mogaze", seed=1, index=0, n_events=4, provocations={})


@pytest.fixture(scope="module")
def recording(performance):
    return synthetic_recording(performance, noise=0.0)


def test_solved_joints_are_exact_below_the_chest_and_those_of_the_back_within_centimetres(performance) -> None:
    state, fixed = solve_body(performance.joints, performance.rotations)
    positions, rotations = link_poses(state, link_offsets(fixed))
    world = Y_UP_FROM_Z_UP[:3, :3]
    joints = body_joints(positions, load_manifest("mogaze").body.joint_mapping) @ world.T
    error = np.linalg.norm(joints - performance.joints, axis=-1)
    direct = [joint for joint in Joint if joint not in DERIVED]
    legs = [j for j in direct if "HIP" in j.name or "KNEE" in j.name or "ANKLE" in j.name or "FOOT" in j.name]
    assert error[:, [Joint.PELVIS, *legs]].max() < 1e-9
    chest = Rotation.from_quat(performance.rotations[:, Joint.SPINE3], scalar_first=True)
    lean = np.rad2deg(np.arccos(chest.apply((0.0, 1.0, 0.0))[:, 1].clip(-1.0, 1.0)))
    upright = lean < 12
    assert 0.3 < upright.mean() < 1.0, "both upright and bent frames are there"
    assert error[upright][:, direct].max() < 2e-3
    assert error[:, direct].max() < 0.015
    # The back of the performance is no straight line: the more it is bent, the farther are the joints derived from one.
    assert error[lean < 30][:, DERIVED].max() < 0.03
    assert error[:, DERIVED].max() < 0.045
    assert lean.max() > 60
    head = world @ rotations[:, 4] @ np.transpose([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)])
    truth = Rotation.from_quat(performance.head_rotation, scalar_first=True).as_matrix()
    assert head == pytest.approx(truth, abs=1e-9)


def test_fixed_values_are_sixty_and_only_those_that_the_model_has(performance) -> None:
    fixed = solve_body(performance.joints, performance.rotations)[1]
    assert len(fixed) == 60
    assert {key for key, value in fixed.items() if abs(value) > 1e-9} <= MODEL_OFFSETS
    assert fixed["lKneeTransZ"] < -0.3, "offsets may be negative"


def test_two_recordings_of_one_person_have_one_skeleton() -> None:
    people: dict[str, list[dict[str, float]]] = {}
    for index in range(8):
        one = perform("mogaze", seed=3, index=index, n_events=1, provocations={}, rate=30.0)
        people.setdefault(one.person.participant_id, []).append(solve_body(one.joints, one.rotations)[1])
    first, second = next(each for each in people.values() if len(each) > 1)[:2]
    bones = [key for key in MODEL_OFFSETS if not key.startswith("torso")]
    assert [first[key] for key in bones] == pytest.approx([second[key] for key in bones], abs=1e-9)


def test_ideal_sensors_say_the_truth(performance, recording) -> None:
    assert recording.head.position == pytest.approx(performance.eye, abs=1e-9)
    turned = Rotation.from_quat(recording.head.rotation, scalar_first=True).as_matrix()
    assert turned == pytest.approx(
        Rotation.from_quat(performance.head_rotation, scalar_first=True).as_matrix(), abs=1e-9
    )
    assert recording.gaze.valid.all()
    assert np.einsum("nk,nk->n", recording.gaze.direction, performance.gaze) == pytest.approx(1.0, abs=1e-9)
    for motion in performance.objects:
        track = recording.object(motion.object_id)
        lower, upper = track.world_box(track.position, track.rotation)
        assert (lower + upper) / 2 == pytest.approx(np.broadcast_to(motion.position, lower.shape), abs=1e-9)
        size = np.sort(track.box_max - track.box_min)
        assert size == pytest.approx(np.sort(2 * motion.half_extents), abs=1e-9)


def test_events_are_those_that_were_acted_out(performance, recording) -> None:
    found = recording.annotated_events
    assert [(e.action, e.object_id, e.hand) for e in found] == [
        (e.action, e.object_id, e.hand) for e in performance.events
    ]
    for event, truth in zip(found, performance.events, strict=True):
        assert abs(event.event_time - truth.event_time) <= 1 / 120
        assert event.location == pytest.approx(truth.goal, abs=2e-3)
        assert event.box_max - event.box_min == pytest.approx(truth.box_max - truth.box_min, abs=2e-3)


def test_segments_alternate_and_borders_touch_or_follow(performance) -> None:
    segments = sense(performance).segments
    assert [segment.label == "null" for segment in segments] == [index % 2 == 0 for index in range(len(segments))]
    gaps = {after.start - before.end for before, after in itertools.pairwise(segments)}
    assert gaps <= {0, 1}


def test_every_object_of_a_recording_has_a_name_of_its_own() -> None:
    acted = (perform("mogaze", seed=1, index=index, n_events=1, rate=30.0) for index in range(12))
    crowded = next(each for each in acted if len({motion.name for motion in each.objects}) < len(each.objects))
    names = body_names(crowded)
    assert len(set(names.values())) == len(names) == len(crowded.objects)
    for motion in crowded.objects:
        assert mogaze.kind_of_body(names[motion.object_id]) == mogaze.kind_of_body(motion.name)


def test_default_noise_has_the_sizes_of_the_page(performance) -> None:
    ideal = sense(performance, noise=0.0)
    only = sense(performance, switches=replace(Switches.ideal(), body_noise=True))
    assert (only.state - ideal.state)[:, :3].std() == pytest.approx(1e-3, rel=0.02)
    assert np.rad2deg((only.state - ideal.state)[:, 3:].std()) == pytest.approx(0.1, rel=0.02)
    only = sense(performance, switches=replace(Switches.ideal(), object_noise=True))
    shift = only.bodies[1].position - ideal.bodies[1].position
    assert shift.std() == pytest.approx(0.5e-3, rel=0.05)
    jitter = replace(Switches.ideal(), gaze_jitter=True)
    cosine = np.einsum(
        "nk,nk->n",
        synthetic_recording(performance, switches=jitter).gaze.direction,
        synthetic_recording(performance, noise=0.0).gaze.direction,
    )
    angle = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    assert np.sqrt((angle**2).mean() / 2) == pytest.approx(0.5, rel=0.1)


def test_the_gaze_bias_is_what_truth_says(performance) -> None:
    yaw, pitch = gaze_bias_of(Sensing(performance, 1.0, Switches()), GAZE_BIAS)
    assert gaze_bias_of(Sensing(performance, 2.0, Switches()), GAZE_BIAS) == pytest.approx((2 * yaw, 2 * pitch))
    assert 0.0 < np.rad2deg(np.hypot(yaw, pitch)) < 3.0


def test_blinks_have_low_confidence_and_some_points_lie_behind_the_camera(performance) -> None:
    readings = sense(performance)
    closed = readings.gaze_confidence < 0.6
    assert 0.0 < closed.mean() < 0.15
    assert readings.gaze_confidence[closed].max() < 0.3
    behind = readings.gaze_points[~closed, 2] < 0
    assert 0.001 < behind.mean() < 0.05
    length = np.linalg.norm(readings.gaze_points[~closed], axis=1)
    assert 399 < length.min() < length.max() < 2001


def test_every_recording_has_a_calibration_of_its_own(performance) -> None:
    other = perform("mogaze", seed=1, index=1, n_events=1, rate=30.0)
    assert not np.allclose(sense(performance).calibration, sense(other).calibration)
