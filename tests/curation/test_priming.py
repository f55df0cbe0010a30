"""When gaze first meets a place, by the rule or as the dataset publishes it (``--priming published``)."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np
import pytest

from prbench.curation import build_dataset, curate_recording, plan_build
from prbench.curation.corrections import Correction, Corrections
from prbench.curation.events import Decision, Place
from prbench.curation.options import BuildOptions, CurationOptions
from prbench.curation.priming import Prime, find_prime, gaze_rays
from prbench.errors import RecordingUnusable, UsageError
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.recording import AnnotatedEvent, PublishedPriming, Recording
from tests.curation.scenes import LOOK_A, PICK, PLACE_A, PLACE_B, PROTOCOL, PUT, clock, finger_path, gaze, hand, scene

CONSTANTS = PROTOCOL.curation
BOX = Place(np.array([0.0, 0.0, 2.0]), np.array([-0.1, -0.1, 1.9]), np.array([0.1, 0.1, 2.1]))
TIMES = clock(30, 0, 20)


def prime(looks: list[tuple[float, float, tuple[float, float, float]]], event_time: float = 15.0) -> Prime | Decision:
    """From the origin, looking up except for the given looks."""
    direction = np.tile([0.0, 1.0, 0.0], (len(TIMES), 1))
    for start, end, point in looks:
        direction[(start - 1e-9 <= TIMES) & (end > TIMES)] = np.array(point) / np.linalg.norm(point)
    return find_prime(TIMES, np.zeros((len(TIMES), 3)), direction, BOX, event_time, CONSTANTS)


AT_IT, AWAY = (0, 0, 1), (0, 0, -1)


@pytest.mark.parametrize(
    ("looks", "found"),
    [
        pytest.param([(9.0, 9.2, AT_IT), (12.0, 13.0, AT_IT)], ("hit", 9.0, 0.0), id="the first of two looks"),
        pytest.param([(9.0, 9.01, AT_IT), (12.0, 13.0, AT_IT)], ("hit", 9.0, 0.0), id="a single sample"),
        pytest.param([(5.0, 5.01, AT_IT)], ("hit", 5.0, 0.0), id="at the beginning of the window"),
        pytest.param([(15.0, 15.01, AT_IT)], ("hit", 15.0, 0.0), id="at the event"),
        pytest.param([(4.0, 4.9, AT_IT), (15.1, 16.0, AT_IT)], "not_primed", id="before the window, after the event"),
        pytest.param([(9.0, 9.2, AWAY)], "not_primed", id="away from the place"),
        # Closest to the centre near z = 2; the box ends at 0.1 m, so the ray passes about 0.04 m outside it.
        pytest.param([(9.0, 9.2, (0.14, 0, 2.0))], ("near_miss", 9.0, 0.0393), id="four centimetres beside it"),
    ],
)
def test_looks_that_prime(looks, found) -> None:
    prime_found = prime(looks)
    if isinstance(found, str):
        assert prime_found.outcome == found
        return
    kind, time, distance = found
    assert (prime_found.kind, prime_found.time) == (kind, pytest.approx(time))
    assert prime_found.distance == pytest.approx(distance, abs=0.002)
    assert prime_found.uncertainty == pytest.approx(1 / 30)


def test_a_ray_that_passes_eight_centimetres_beside_the_box_tells_its_distance() -> None:
    found = prime([(9.0, 9.2, (0.18, 0, 2.0))])
    assert found.value == pytest.approx(0.08, abs=0.003)
    assert found.threshold == 0.05


def test_a_lost_sample_before_the_look_widens_the_uncertainty() -> None:
    stream = gaze(TIMES, [(9.0, 9.5, np.array([0.0, 1.6, 3.0]))])
    lost = np.abs(TIMES - 8.9) < 0.08
    recording = scene(gaze=dataclasses.replace(stream, valid=~lost))
    place = Place(np.array([0.0, 1.6, 3.0]), np.array([-0.1, 1.5, 2.9]), np.array([0.1, 1.7, 3.1]))
    found = find_prime(*gaze_rays(recording, "eye"), place, 15.0, CONSTANTS)
    assert found.time == pytest.approx(9.0)
    assert found.uncertainty == pytest.approx(6 / 30)


@pytest.mark.parametrize(("look", "uncertainty"), [(0, 0.2), (1, 0.2), (2, 0.5), (3, 0.1)])
def test_the_uncertainty_is_the_time_since_the_sample_before_and_for_the_first_until_the_one_after(
    look: int, uncertainty: float
) -> None:
    times = np.array([10.0, 10.2, 10.7, 10.8])
    directions = np.tile([0.0, 1.0, 0.0], (4, 1))
    directions[look] = [0.0, 0.0, 1.0]
    found = find_prime(times, np.zeros((4, 3)), directions, BOX, 15.0, CONSTANTS)
    assert (found.time, found.uncertainty) == (times[look], pytest.approx(uncertainty))


def test_no_gaze_at_all_is_said_so() -> None:
    empty = np.empty((0, 3))
    found = find_prime(np.empty(0), empty, empty, BOX, 15.0, CONSTANTS)
    assert (found.outcome, found.value, found.threshold) == ("not_primed", None, 0.05)
    assert found.confidence < 0.001


def test_the_ray_may_start_at_the_camera() -> None:
    recording = scene()
    camera = dataclasses.replace(recording.camera, position=recording.camera.position + np.array([0.05, 0, 0]))
    moved = dataclasses.replace(recording, camera=camera)
    np.testing.assert_allclose(gaze_rays(moved, "camera")[1] - gaze_rays(moved, "eye")[1], [[0.05, 0, 0]] * 901)


def lasting(looks: list[tuple[float, float]], shortest: float, *, gap_at: float | None = None) -> Prime | Decision:
    """Looks at the box, of which only those that last prime; gaze is lost for 0.2 s where ``gap_at`` says."""
    direction = np.tile([0.0, 1.0, 0.0], (len(TIMES), 1))
    for start, end in looks:
        direction[(start - 1e-9 <= TIMES) & (end > TIMES)] = (0.0, 0.0, 1.0)
    keep = np.ones(len(TIMES), dtype=bool) if gap_at is None else np.abs(TIMES - gap_at) > 0.1
    constants = msgspec.structs.replace(CONSTANTS, minimum_prime=shortest)
    return find_prime(TIMES[keep], np.zeros((keep.sum(), 3)), direction[keep], BOX, 15.0, constants)


def test_a_look_that_is_too_short_does_not_prime_and_the_next_one_does() -> None:
    found = lasting([(9.0, 9.05), (12.0, 13.0)], 0.1)
    assert found.time == pytest.approx(12.0)
    # From the first sample to the last: three periods of 30 Hz are 0.1 s.
    found = lasting([(9.0, 9.0 + 3.5 / 30), (12.0, 13.0)], 0.1)
    assert found.time == pytest.approx(9.0)
    found = lasting([(9.0, 9.05)], 0.1)
    assert found.outcome == "not_primed"


def test_a_look_ends_where_gaze_is_lost() -> None:
    found = lasting([(9.0, 9.5)], 0.3, gap_at=9.25)
    assert isinstance(found, Decision), "0.1 s before the gap and 0.1 s behind it"
    found = lasting([(9.0, 9.5)], 0.3)
    assert isinstance(found, Prime)


def test_the_minimum_of_the_protocol_is_written_down_where_there_is_one() -> None:
    manifest = load_manifest("adt")
    assert "minimum_prime" not in CurationOptions().described(manifest, PROTOCOL)
    lasting = msgspec.structs.replace(PROTOCOL, curation=msgspec.structs.replace(CONSTANTS, minimum_prime=0.1))
    assert CurationOptions().described(manifest, lasting)["minimum_prime"] == "0.1"


PUBLISHED = CurationOptions(priming="published")
MANIFEST, PROTOCOL = load_manifest("hd-epic"), load_protocol()


def _event(action: str, time: float, place: np.ndarray | None, published: PublishedPriming | None) -> AnnotatedEvent:
    key = f"cup/{action}/{time}"
    return AnnotatedEvent(key, action, "cup", "cup", time, place, None, None, None, published)  # type: ignore[arg-type]


def _recording(pick: PublishedPriming | None, put: PublishedPriming | None, **changes) -> Recording:
    events = (_event("pick", PICK, PLACE_A, pick), _event("put", PUT, PLACE_B, put))
    recording = scene(dataset="hd-epic", objects=(), annotated_events=events)
    return dataclasses.replace(recording, **{"has_published_priming": True, **changes})


def _curated(recording: Recording, options: CurationOptions = PUBLISHED, corrections: Corrections | None = None):
    curated = curate_recording(recording, MANIFEST, PROTOCOL, options, corrections=corrections)
    return curated, {event.action: event for event in curated.events}


PRIMED_AT_12 = PublishedPriming("primed", 12.0, 1 / 30)


def test_the_published_prime_begins_the_sequence() -> None:
    curated, events = _curated(_recording(PRIMED_AT_12, None))
    (sequence,) = curated.sequences
    assert (sequence.action, sequence.prime_kind) == ("pick", "published")
    assert sequence.prime_time == 12.0
    assert sequence.prime_gap == pytest.approx(PICK - 12.0)
    assert sequence.n_frames == round((PICK - 12.0 + 2.0) * PROTOCOL.fps) + 1
    assert sequence.prime_time_uncertainty == pytest.approx(1 / 30)
    assert events["pick"].prime_time == 12.0


@pytest.mark.parametrize(
    ("published", "outcome"),
    [
        (PublishedPriming("not_primed", None), "not_primed"),
        (PublishedPriming("excluded", None), "excluded_by_dataset"),
        (None, "not_published"),
    ],
)
def test_what_the_dataset_did_not_prime_says_so(published, outcome) -> None:
    _, events = _curated(_recording(PRIMED_AT_12, published))
    assert (events["put"].outcome, events["put"].stage) == (outcome, "published priming")
    assert events["put"].prime_time is None


def test_the_rule_does_not_look_at_what_is_published_but_tells_it() -> None:
    _, events = _curated(_recording(PRIMED_AT_12, PublishedPriming("excluded", None)), CurationOptions())
    assert events["pick"].prime_time == pytest.approx(LOOK_A)
    assert (events["pick"].published_priming, events["pick"].published_prime_time) == ("primed", 12.0)
    assert (events["put"].published_priming, events["put"].published_prime_time) == ("excluded", None)


@pytest.mark.parametrize(("change", "value"), [("move", "0.10"), ("goal", "0.5 0.92 1.5"), ("rename", "mug")])
def test_an_event_at_another_time_or_place_is_primed_by_the_rule_whatever_is_published(change, value) -> None:
    name = f"hd-epic/kitchen_1/cup/pick/{round(PICK * 1e6)}"
    rows = (Correction(name, change, value, "seen", "MM", "line 2"),)
    _, events = _curated(_recording(PRIMED_AT_12, None), corrections=Corrections("c.csv", "", rows))
    at, by_the_dataset = (12.0, True) if change == "rename" else (LOOK_A, False)
    assert events["pick"].prime_time == pytest.approx(at)
    assert (events["pick"].prime_kind == "published") == by_the_dataset


def test_a_recording_of_which_nothing_is_published_is_refused() -> None:
    with pytest.raises(RecordingUnusable, match="--priming published needs the dataset's own priming results"):
        _curated(_recording(None, None, has_published_priming=False))


def test_a_dataset_without_published_priming_is_a_usage_error(tmp_path) -> None:
    options = BuildOptions(curation=PUBLISHED)
    with pytest.raises(UsageError, match="adt publishes no priming of its own"):
        build_dataset("adt", tmp_path, tmp_path / "table", options=options)
    with pytest.raises(UsageError, match="adt publishes no priming of its own"):
        plan_build("adt", tmp_path, options)


def test_the_choice_stands_in_the_options_of_the_build() -> None:
    assert PUBLISHED.described(MANIFEST, PROTOCOL)["priming"] == "published"
    assert CurationOptions().described(MANIFEST, PROTOCOL)["priming"] == "rule"


def test_wrists_are_those_of_the_hands_else_of_the_body_else_null() -> None:
    slow = clock(10)
    left = hand("left", slow, finger_path(slow), contact="wrist")
    recording = _recording(PRIMED_AT_12, None, hands=(left,))
    _, events = _curated(recording)
    at_pick = pytest.approx(finger_path(np.array([PICK]))[0])
    assert events["pick"].left_wrist == at_pick
    body = recording.body
    of_body = body.joints[np.searchsorted(body.times, PICK - 1e-9), 21]
    assert events["pick"].right_wrist == pytest.approx(of_body, abs=1e-6)

    curated, events = _curated(dataclasses.replace(recording, body=None))
    assert curated.sequences == ()
    assert (events["pick"].outcome, events["pick"].prime_time) == ("no_body", 12.0)
    assert events["pick"].left_wrist == at_pick
    assert events["pick"].right_wrist is None

    unseen = dataclasses.replace(left, valid=np.abs(slow - PICK) > 0.3)
    _, events = _curated(dataclasses.replace(recording, hands=(unseen,), body=None))
    assert events["pick"].left_wrist is None
    assert events["put"].left_wrist is not None
