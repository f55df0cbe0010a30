"""ADT's synthetic sensors and files: ideal sensors say the truth, what is written comes back."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import Joint, bone_lengths
from prbench.readers.adt import find_recordings, read_recording
from prbench.readers.adt import format as adt
from prbench.readers.adt import synthetic as layout
from prbench.readers.adt.synthetic import LAYOUT, native_object_id, sense
from prbench.readers.aria_mps.synthetic import GAZE_BIAS
from prbench.synthetic.layouts import synthetic_recording
from prbench.synthetic.people import perform
from prbench.synthetic.performance import OtherPerson, Performance
from prbench.synthetic.sensors import Sensing, Switches, device_start_us, gaze_bias_of
from tests.synthetic.plausibility import recorded_bone_change


@pytest.fixture(scope="module")
def performance() -> Performance:
    """One pick and one put."""
    return perform("adt", seed=11, index=3, n_events=2, provocations={})


@pytest.fixture(scope="module")
def performance_for_two(performance) -> Performance:
    """The same with a second person a metre beside the first."""
    beside = (1.0, 0.0, 0.0)
    other = OtherPerson("S777", performance.joints + beside, performance.finger_bases + beside)
    return replace(performance, other_people=(other,))


@pytest.fixture(scope="module")
def readings(performance) -> adt.AdtReadings:
    return _first_seconds(sense(performance, noise=5.0))  # bad frames, blinks and losses included


def _first_seconds(readings: adt.AdtReadings, seconds: float = 4.0) -> adt.AdtReadings:
    """The beginning of a recording: quick to write."""
    end_us = int(readings.glasses.time_us[0] + seconds * 1e6)

    def cut(stream: Any, times: np.ndarray, end: int) -> Any:
        kept = times <= end
        columns = {field.name: getattr(stream, field.name) for field in fields(stream)}
        return replace(stream, **{k: v[kept] for k, v in columns.items() if np.shape(v)[:1] == kept.shape})

    return replace(
        readings,
        glasses=cut(readings.glasses, readings.glasses.time_us, end_us),
        gaze=cut(readings.gaze, readings.gaze.time_us, end_us),
        objects=tuple(
            cut(entry, entry.time_ns, end_us * 1000) if entry.dynamic else entry for entry in readings.objects
        ),
        skeletons=tuple(cut(person, person.time_ns, end_us * 1000) for person in readings.skeletons),
    )


def test_the_twin_with_the_smaller_id_names_the_split_group(readings, tmp_path) -> None:
    for twin, group in (("A_before", "A_before"), ("Z_after", readings.recording_id)):
        layout.write(replace(readings, concurrent=twin), tmp_path / twin / readings.recording_id)
        (found,) = find_recordings(tmp_path / twin)
        assert read_recording(found).split_group == group


def test_without_a_skeleton_there_is_no_body_and_nothing_is_refused(readings, tmp_path) -> None:
    layout.write(replace(readings, skeletons=()), tmp_path / "alone")
    recording = read_recording(find_recordings(tmp_path / "alone")[0])
    assert recording.body is None
    assert recording.hands == ()
    assert recording.pose_source == "none"
    assert recording.participant_id == "unknown"


def test_a_skeleton_without_glasses_is_somebody_else(readings, tmp_path) -> None:
    stranger = replace(readings.skeletons[0], serial="NONE", name="Skeleton_C")
    layout.write(replace(readings, skeletons=(stranger,)), tmp_path / "stranger")
    recording = read_recording(find_recordings(tmp_path / "stranger")[0])
    assert recording.body is None
    assert [person.person_id for person in recording.other_people] == ["Skeleton_C"]


def test_lost_gaze_rows_leave_the_others_as_they_are(performance) -> None:
    everything = sense(performance).gaze
    complete = sense(performance, switches=replace(Switches(), gaze_losses=False)).gaze
    kept = np.isin(complete.time_us, everything.time_us)
    assert 0.9 < kept.mean() < 1.0
    assert np.array_equal(complete.yaw[kept], everything.yaw, equal_nan=True)


def test_a_second_person_changes_nothing_that_the_first_one_measures(performance, performance_for_two) -> None:
    alone, together = sense(performance), sense(performance_for_two)
    assert np.array_equal(alone.skeletons[0].joints, together.skeletons[0].joints)
    assert np.array_equal(alone.gaze.yaw, together.gaze.yaw, equal_nan=True)


@pytest.mark.parametrize("ideal", [{"noise": 0.0}, {"switches": Switches.ideal()}], ids=["no noise", "all off"])
def test_ideal_sensors_say_the_truth(performance, ideal) -> None:
    recording = synthetic_recording(performance, **ideal)
    start = device_start_us(performance) / 1e6
    at = np.rint((recording.head.times - start) * performance.rate).astype(int)
    assert recording.head.position == pytest.approx(performance.eye[at], abs=2e-6)
    assert recording.gaze.valid.all()
    looks = np.rint((recording.gaze.times - start) * performance.rate).astype(int)
    assert np.einsum("nk,nk->n", recording.gaze.direction, performance.gaze[looks]) == pytest.approx(1.0, abs=1e-8)
    assert recording.gaze.origin == pytest.approx(performance.eye[looks], abs=1e-4)  # 3 us of walking, rounding
    assert recording.body is not None
    others = [joint for joint in Joint if joint != Joint.SPINE2]
    assert recording.body.joints[:, others] == pytest.approx(performance.joints[:, others], abs=1e-6)
    spine2 = np.linalg.norm(recording.body.joints[:, Joint.SPINE2] - performance.joints[:, Joint.SPINE2], axis=-1)
    assert spine2.max() < 0.015  # the dataset has no spine2: half-way between its neighbours, off when the back bends
    for side, stream in enumerate(recording.hand_streams("middle_finger_base")):
        assert stream.points[:, 0] == pytest.approx(performance.finger_bases[:, side], abs=1e-6)


def test_ideal_sensors_see_every_object_where_it_is(performance) -> None:
    recording = synthetic_recording(performance, noise=0.0)
    assert len(recording.objects) == len(performance.objects), "the room is left out"
    start = device_start_us(performance) / 1e6
    for motion in performance.objects:
        track = recording.object(str(native_object_id(motion.object_id)))
        at = np.rint((track.times - start) * performance.rate).astype(int)
        truth = motion.position[at] if len(motion.position) > 1 else motion.position
        lower, upper = track.world_box(track.position, track.rotation)
        assert (lower + upper) / 2 == pytest.approx(np.broadcast_to(truth, lower.shape), abs=3e-6)
        assert track.box_max - track.box_min == pytest.approx(2 * motion.half_extents, abs=3e-6)


def test_a_sixteen_digit_id_is_kept_and_a_word_gets_one() -> None:
    assert native_object_id("4508463855879675") == 4508463855879675
    assert len(str(native_object_id("cup"))) == 16
    assert native_object_id("cup") != native_object_id("plate")


def test_default_noise_has_the_sizes_of_the_page(performance) -> None:
    ideal, noisy = sense(performance, noise=0.0), sense(performance)
    assert (noisy.glasses.position - ideal.glasses.position).std() == pytest.approx(0.5e-3, rel=0.1)
    relative = Rotation.from_quat(ideal.glasses.rotation).inv() * Rotation.from_quat(noisy.glasses.rotation)
    assert np.rad2deg(relative.as_rotvec().std()) == pytest.approx(0.05, rel=0.1)
    only = replace(Switches.ideal(), gaze_jitter=True)
    assert np.rad2deg((sense(performance, switches=only).gaze.yaw - ideal.gaze.yaw).std()) == pytest.approx(
        0.5, rel=0.1
    )
    bias = gaze_bias_of(Sensing(performance, 1.0, Switches()), GAZE_BIAS["personalized"])
    biased = sense(performance, switches=replace(Switches.ideal(), gaze_bias=True)).gaze
    assert biased.yaw - ideal.gaze.yaw == pytest.approx(bias[0], abs=2e-6)
    assert biased.pitch - ideal.gaze.pitch == pytest.approx(bias[1], abs=2e-6)
    only = replace(Switches.ideal(), body_noise=True)
    shift = sense(performance, switches=only).skeletons[0].joints - ideal.skeletons[0].joints
    assert shift.std() == pytest.approx(0.05e-3, rel=0.15)  # a shift along a bone is that of the bone's parent
    moving = [i for i, entry in enumerate(ideal.objects) if entry.dynamic]
    shifts = [noisy.objects[i].position - ideal.objects[i].position for i in moving]
    assert np.concatenate(shifts).std() == pytest.approx(0.3e-3, rel=0.1)


def test_a_noisy_suit_keeps_the_lengths_of_all_bones_as_the_real_one_does(performance) -> None:
    only = replace(Switches.ideal(), body_noise=True, body_wobble=True)
    joints = sense(performance, switches=only).skeletons[0].joints
    truth = sense(performance, switches=Switches.ideal()).skeletons[0].joints
    for child, parent in (("LThigh", "Skeleton"), ("LFArm", "LUArm"), ("Head", "Neck"), ("RToe", "RFoot")):
        ends = [adt.JOINT_NAMES.index(name) for name in (child, parent)]
        bone = np.linalg.norm(joints[:, ends[0]] - joints[:, ends[1]], axis=1)
        assert bone == pytest.approx(np.linalg.norm(truth[:, ends[0]] - truth[:, ends[1]], axis=1), abs=4e-6)
    assert 2e-3 < (joints - truth).std() < 4e-3  # the suit still errs


def test_recorded_bodies_keep_their_bones(performance) -> None:
    body = synthetic_recording(performance, switches=replace(Switches(), body_losses=False)).body
    assert body is not None
    # Between first and third joint of the spine there is one native bone, which a bending back shortens a little.
    assert recorded_bone_change([body.joints]) < 0.01


def test_twice_the_noise_is_twice_the_error(performance) -> None:
    ideal, once, twice = (sense(performance, noise=noise).glasses.position for noise in (0.0, 1.0, 2.0))
    assert twice - ideal == pytest.approx(2 * (once - ideal), abs=2e-6)


def test_a_lost_object_has_no_rows_while_it_is_lost(performance) -> None:
    event = performance.events[0]
    span = (event.event_time - 0.3, event.event_time + 0.2)
    lost = replace(performance, events=(replace(event, tag="lost", lost_span=span), *performance.events[1:]))
    recording, start = synthetic_recording(lost), device_start_us(performance) / 1e6
    track = recording.object(str(native_object_id(event.object_id)))
    gap = int(np.argmax(np.diff(track.times)))
    assert span[0] - 1 / 30 <= track.times[gap] - start < span[0]
    assert span[1] < track.times[gap + 1] - start <= span[1] + 1 / 30
    others = [other for other in recording.objects if other.movable and other is not track]
    assert all(np.diff(other.times).max() < 0.04 for other in others)


def test_bad_frames_are_found_and_filled(performance) -> None:
    readings = sense(performance, noise=100.0, switches=replace(Switches.ideal(), body_losses=True))
    truth = sense(performance, noise=0.0).skeletons[0].joints
    bad = ~np.isclose(readings.skeletons[0].joints, truth, atol=1e-6).all(axis=(1, 2))
    body = LAYOUT.recording(readings).body
    assert body is not None
    assert 0 < bad.sum() < 0.05 * len(bad)
    at_origin = (readings.skeletons[0].joints == 0).all(axis=(1, 2))
    assert 0 < at_origin.sum() < bad.sum(), "some frames are lost, in others a joint is thrown off"
    assert not body.valid[readings.skeletons[0].joints[:, 0, 1] == 0.0].any()
    lengths = bone_lengths(body.joints)
    assert np.abs(lengths - np.median(lengths, axis=0)).max() < 0.05, "fillers are bodies too"


def test_two_wearers(performance_for_two) -> None:
    recording = synthetic_recording(performance_for_two, noise=0.0)
    assert [person.person_id for person in recording.other_people] == ["Skeleton_S777"]
    assert recording.participant_id == performance_for_two.person.participant_id
    beside = next(stream for stream in recording.other_people[0].hands if stream.contact == "wrist")
    own = next(stream for stream in recording.hands if stream.contact == "wrist")
    assert beside.points - own.points == pytest.approx(np.broadcast_to((1.0, 0.0, 0.0), own.points.shape), abs=3e-6)
