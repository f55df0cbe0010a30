"""The constructed sample through the reader, against values worked out by hand (reference-values, ids ``hdepic-*``)."""

from __future__ import annotations

import pytest

from prbench.curation import curate_recording
from prbench.curation.options import CurationOptions
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.readers import reader_for
from prbench.readers.hd_epic import read_readings

VIDEO = "P99-20240101-120000"
START = 150.0  # device time of the first frame, seconds


def _read(samples, **options):
    reader = reader_for("hd-epic", options)
    (found,) = reader.find(samples / "hd-epic")
    return reader.read(found)


@pytest.fixture(scope="module")
def recording(samples):
    return _read(samples)


@pytest.fixture(scope="module")
def readings(samples):
    (found,) = reader_for("hd-epic").find(samples / "hd-epic")
    return read_readings(found)


def _curated(recording, **options):
    curated = curate_recording(recording, load_manifest("hd-epic"), load_protocol(), CurationOptions(**options))
    return {(event.object_name, event.action, round(event.event_time - START, 2)): event for event in curated.events}


def test_video_frames(readings, reference_values) -> None:
    expected = reference_values["hdepic-frames"]["expect"]
    clock = readings.clock
    assert len(clock.device_ns) == expected["frames"]
    assert (clock.device_ns[0], clock.device_ns[135]) == (expected["frame_0_ns"], expected["frame_135_ns"])
    assert clock.repeats == expected["repeats"]


def test_events_with_their_places(recording, reference_values) -> None:
    expected = reference_values["hdepic-events"]["expect"]
    found = [(e.object_name, e.action, e.event_time - START, e.location) for e in recording.annotated_events]
    assert [(name, action) for name, action, _, _ in found] == [(name, action) for name, action, _, _ in expected]
    for (_, _, time, place), (_, _, seconds, native) in zip(found, expected, strict=True):
        assert time == pytest.approx(seconds, abs=2e-6)  # image time stamps jitter by 0.4 us
        assert (place is None) == (native is None)
        if native is not None:
            x, y, z = native
            assert place == pytest.approx([x, z, -y], abs=1e-6), "Z up becomes Y up"


def test_the_mug_is_primed_by_the_rule(recording, reference_values) -> None:
    expected = reference_values["hdepic-prime-mug-pick"]
    mug = _curated(recording)["mug", "pick", 7.0]
    assert mug.prime_time == pytest.approx(expected["expect"]["prime_device_s"], abs=1e-6)
    assert mug.event_time - mug.prime_time == pytest.approx(expected["expect"]["prime_gap_s"], abs=1e-5)
    assert mug.prime_kind == "near_miss", "a point is never hit"


def test_the_mug_is_primed_by_the_priming_file(recording) -> None:
    events = _curated(recording, priming="published")
    pick, put = events["mug", "pick", 7.0], events["mug", "put", 9.4]
    assert (pick.prime_time, put.prime_time) == pytest.approx((START + 135 / 30, START + 246 / 30), abs=1e-6)
    assert pick.prime_kind == put.prime_kind == "published"


def test_the_plate_is_not_primed(recording, reference_values) -> None:
    expected = reference_values["hdepic-not-primed"]["expect"]
    by_rule, published = _curated(recording), _curated(recording, priming="published")
    for action, time in (("pick", 5.5), ("put", 6.5)):
        assert (by_rule["plate", action, time].prime_time is not None) is expected[action]
    assert published["plate", "pick", 5.5].outcome == "not_primed"
    assert published["plate", "put", 6.5].outcome == "excluded_by_dataset"


def test_what_the_priming_file_does_not_mention_is_counted(recording) -> None:
    events = _curated(recording, priming="published")
    unmentioned = {key[:2] for key, event in events.items() if event.outcome == "not_published"}
    assert unmentioned == {("cloth", "pick"), ("cloth", "put")}
    assert "published priming: nothing about 3 of 7 located events" in recording.messages


def test_events_without_a_place_and_without_a_body_stay_and_say_so(recording) -> None:
    events = _curated(recording)
    outcomes = {key: event.outcome for key, event in events.items()}
    assert outcomes["lid", "pick", 2.0] == outcomes["lid", "put", 2.1] == outcomes["cloth", "put", 3.4] == "no_location"
    assert outcomes["mug", "pick", 7.0] == "no_body"
    assert "3 of 10 events have no place: 3 have no mask" in recording.messages


def test_the_folder_hd_epic_alone_finds_the_annotations_beside_it(samples) -> None:
    (found,) = reader_for("hd-epic").find(samples / "hd-epic" / "HD-EPIC")
    assert found.recording_id == VIDEO
    assert len(reader_for("hd-epic").read(found).annotated_events) == 10
