"""Planted faults of clocks, units, axes and places are named; clean recordings, invented and real, have none."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.curation.mending import mended
from prbench.curation.stream_checks import examine_streams
from prbench.readers import reader_for
from prbench.recording import Recording
from prbench.synthetic.layouts import synthetic_recording
from prbench.synthetic.people import perform

LAYOUTS = ("adt", "hot3d", "mogaze", "gimo", "hd-epic")
change = dataclasses.replace
Fault = Callable[[Recording], Recording]


@functools.cache
def clean(preset: str, seed: int = 40_411, n_events: int = 10) -> Recording:
    return synthetic_recording(perform(preset, seed=seed, index=0, n_events=n_events))


def shift(**seconds: float) -> Fault:
    return lambda recording: mended(recording, tuple(seconds.items()), ())


def scale(**factors: float) -> Fault:
    return lambda recording: mended(recording, (), tuple(factors.items()))


def exchanged(points: np.ndarray) -> np.ndarray:
    """Z up where Y up is meant."""
    return points[..., [0, 2, 1]] * [1.0, 1.0, -1.0]


def body(points: Callable[[np.ndarray], np.ndarray]) -> Fault:
    return lambda recording: change(recording, body=change(recording.body, joints=points(recording.body.joints)))


def objects(points: Callable[[np.ndarray], np.ndarray]) -> Fault:
    return lambda recording: change(
        recording, objects=tuple(change(each, position=points(each.position)) for each in recording.objects)
    )


def hands(points: Callable[[np.ndarray], np.ndarray]) -> Fault:
    return lambda recording: change(
        recording, hands=tuple(change(each, points=points(each.points)) for each in recording.hands)
    )


def gaze(look: Callable[[np.ndarray], np.ndarray]) -> Fault:
    """Change the directions in the axes of the head."""

    def planted(recording: Recording) -> Recording:
        turn = Rotation.from_quat(recording.head.pose_at(recording.gaze.times)[1], scalar_first=True)
        local = look(turn.inv().apply(recording.gaze.direction))
        return change(recording, gaze=change(recording.gaze, direction=turn.apply(local)))

    return planted


def lying_glasses(recording: Recording) -> Recording:
    turn = Rotation.from_euler("x", 90, degrees=True) * Rotation.from_quat(recording.head.rotation, scalar_first=True)
    return change(recording, head=change(recording.head, rotation=turn.as_quat(scalar_first=True)))


def raised(points: np.ndarray) -> np.ndarray:
    return points + np.array([0.0, 1.0, 0.0])


def repeating(points: np.ndarray) -> np.ndarray:
    """The last three quarters hold one value."""
    first = len(points) // 4
    return np.concatenate([points[:first], np.repeat(points[first : first + 1], len(points) - first, axis=0)])


def gaze_as_a_whole(recording: Recording) -> Recording:
    """Rays of the world one second late, with the places where they began."""
    return change(recording, gaze=change(recording.gaze, times=recording.gaze.times + 1.0))


FAULTS: list[tuple[str, Fault, str, str, str]] = [
    ("adt", shift(gaze=5.0), "gaze", "clock", "--shift gaze=-5.0"),
    ("adt", shift(objects=0.7), "objects", "clock", "--shift objects=-0."),
    ("adt", shift(objects=-3.0), "objects", "clock", "--shift objects=3.0"),
    ("adt", shift(head=1.3), "head", "clock", "--shift head=-1."),
    ("adt", shift(body=-0.3, hands=-0.3), "body", "clock", "--shift body=0."),
    ("adt", objects(lambda points: points * 1000), "objects", "unit", "--scale objects=0.001"),
    ("adt", objects(exchanged), "objects", "place", "No option"),
    ("adt", gaze(lambda local: local * [-1.0, 1.0, 1.0]), "gaze", "axes", "No option"),
    ("hot3d", shift(gaze=-1.5), "gaze", "clock", "--shift gaze=1."),
    ("hot3d", shift(objects=2.0), "objects", "clock", "--shift objects=-"),
    ("hot3d", scale(objects=0.01), "objects", "unit", "--scale objects=100"),
    ("hot3d", body(lambda points: points * 100), "body", "unit", "--scale body=0.01"),
    ("mogaze", shift(gaze=0.3), "gaze", "clock", "--shift gaze=-0."),
    ("mogaze", gaze_as_a_whole, "gaze", "clock", "--shift gaze=-1.0"),
    ("mogaze", shift(body=4.0), "body", "clock", "--shift body=-4.0"),
    ("mogaze", scale(objects=0.001), "objects", "unit", "--scale objects=1000"),
    ("mogaze", hands(exchanged), "hands", "place", "No option"),
    ("mogaze", objects(raised), "objects", "place", "No option"),
    ("mogaze", body(repeating), "body", "stuck", "again"),
    ("gimo", shift(gaze=-0.6), "gaze", "clock", "--shift gaze=0."),
    ("gimo", shift(gaze=5.0), "gaze", "clock", "--shift gaze=-"),
    ("gimo", body(exchanged), "body", "axes", "No option"),
    ("gimo", scale(body=0.001), "body", "unit", "--scale body=1000"),
    ("hd-epic", shift(gaze=5.0), "gaze", "clock", "--shift gaze=-"),
    ("hd-epic", shift(hands=0.8), "hands", "clock", "--shift hands=-0."),
    ("hd-epic", scale(hands=1000.0), "hands", "unit", "--scale hands=0.001"),
    ("hd-epic", scale(objects=1000.0), "objects", "unit", "--scale objects=0.001"),
    ("hd-epic", body(raised), "body", "place", "No option"),
    ("hd-epic", gaze(lambda local: -local), "gaze", "axes", "No option"),
    ("hd-epic", gaze(lambda local: np.tile([0.6, 0.0, 0.8], (len(local), 1))), "gaze", "stuck", "again"),
    ("hd-epic", lying_glasses, "head", "axes", "No option"),
]


@pytest.mark.parametrize(
    ("preset", "fault", "stream", "kind", "remedy"), FAULTS, ids=[f"{row[0]} {row[2]} {row[4]}" for row in FAULTS]
)
def test_a_planted_fault_is_named_with_what_mends_it(preset, fault, stream, kind, remedy):
    first = examine_streams(fault(clean(preset)))[0]
    assert (first.evidence.split(":")[0], first.kind) == (stream, kind)
    assert remedy in first.remedy


@pytest.mark.parametrize("preset", LAYOUTS)
def test_a_clean_recording_has_no_finding(preset):
    assert examine_streams(clean(preset)) == ()


def test_where_nothing_is_carried_the_noise_of_objects_lies_anywhere():
    assert (
        examine_streams(synthetic_recording(perform("mogaze", seed=3, index=0, n_events=1, bystander_objects=1))) == ()
    )


@pytest.mark.parametrize("seconds", [-0.45, 0.3, 0.55, 5.0])
def test_what_is_measured_of_a_late_gaze_is_right_to_50_ms_and_stops_the_recording_from_half_a_second_on(seconds):
    (found,) = examine_streams(shift(gaze=seconds)(clean("adt")))
    assert float(found.remedy.rpartition("=")[2].rstrip(".")) == pytest.approx(-seconds, abs=0.05)
    assert found.certain is (abs(seconds) > 0.5)


def test_events_of_a_kitchen_are_held_against_the_wrists():
    kitchen = clean("hd-epic", n_events=40)
    assert examine_streams(kitchen) == ()
    first = examine_streams(shift(objects=3.0)(kitchen))[0]
    assert first.evidence.startswith("objects: ")
    assert "late" in first.evidence


def test_a_recording_of_a_fraction_of_a_second_says_nothing():
    recording = clean("adt")
    assert examine_streams(change(recording, span=(recording.span[0], recording.span[0] + 0.1))) == ()


@pytest.mark.parametrize("dataset", ["adt", "hot3d", "hd-epic"])
def test_the_real_samples_have_no_finding(samples: Path, dataset):
    reader = reader_for(dataset)
    found = [each for each in reader.find(samples / dataset) if each.skip_reason is None]
    assert found
    for recording in found:
        assert examine_streams(reader.read(recording)) == ()


@pytest.mark.slow
@pytest.mark.parametrize("preset", LAYOUTS)
def test_of_ten_clean_recordings_of_each_layout_few_are_suspicious_and_none_certain(preset):
    told = [examine_streams(clean(preset, 52_000 + seed)) for seed in range(10)]
    found = [each for each in told if each]
    assert not any(diagnosis.certain for each in found for diagnosis in each)
    assert len(found) <= 2, found
