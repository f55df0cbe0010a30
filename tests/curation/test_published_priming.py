"""``--priming published``: prime times taken over from the dataset; wrists and published priming in ``events``."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.curation import build_dataset, curate_recording, plan_build
from prbench.curation.options import BuildOptions, CurationOptions
from prbench.errors import RecordingUnusable, UsageError
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.recording import AnnotatedEvent, PublishedPriming, Recording
from tests.curation.scenes import LOOK_A, PICK, PLACE_A, PLACE_B, PUT, clock, finger_path, hand, scene

PUBLISHED = CurationOptions(priming="published")
MANIFEST, PROTOCOL = load_manifest("hd-epic"), load_protocol()


def _event(action: str, time: float, place: np.ndarray | None, published: PublishedPriming | None) -> AnnotatedEvent:
    key = f"cup/{action}/{time}"
    return AnnotatedEvent(key, action, "cup", "cup", time, place, None, None, None, published)  # type: ignore[arg-type]


def _recording(pick: PublishedPriming | None, put: PublishedPriming | None, **changes) -> Recording:
    events = (_event("pick", PICK, PLACE_A, pick), _event("put", PUT, PLACE_B, put))
    return dataclasses.replace(scene(dataset="hd-epic", objects=(), annotated_events=events), **changes)


def _curated(recording: Recording, options: CurationOptions = PUBLISHED):
    curated = curate_recording(recording, MANIFEST, PROTOCOL, options)
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


def test_a_recording_of_which_nothing_is_published_is_refused() -> None:
    with pytest.raises(RecordingUnusable, match="--priming published needs the dataset's own priming results"):
        _curated(_recording(None, None))


def test_a_dataset_without_published_priming_is_a_usage_error(tmp_path) -> None:
    options = BuildOptions(curation=PUBLISHED)
    with pytest.raises(UsageError, match="adt publishes no priming of its own"):
        build_dataset("adt", tmp_path, tmp_path / "table", options=options)
    with pytest.raises(UsageError, match="adt publishes no priming of its own"):
        plan_build("adt", tmp_path, options)


def test_the_choice_stands_in_the_options_of_the_build() -> None:
    assert PUBLISHED.described(MANIFEST, PROTOCOL)["priming"] == "published"
    assert CurationOptions().described(MANIFEST, PROTOCOL)["priming"] == "rule"


def test_wrists_are_those_of_the_hands_and_else_of_the_body() -> None:
    slow = clock(10)
    left = hand("left", slow, finger_path(slow), contact="wrist")
    recording = _recording(PRIMED_AT_12, None, hands=(left,))
    _, events = _curated(recording)
    assert events["pick"].left_wrist == pytest.approx(finger_path(np.array([PICK]))[0])
    body = recording.body
    assert body is not None
    at_pick = body.joints[np.searchsorted(body.times, PICK - 1e-9), 21]
    assert events["pick"].right_wrist == pytest.approx(at_pick, abs=1e-6)


def test_without_a_body_primed_events_stay_with_their_wrists() -> None:
    slow = clock(10)
    left = hand("left", slow, finger_path(slow), contact="wrist")
    curated, events = _curated(_recording(PRIMED_AT_12, None, hands=(left,), body=None))
    assert curated.sequences == ()
    assert events["pick"].outcome == "no_body"
    assert events["pick"].prime_time == 12.0
    assert events["pick"].left_wrist == pytest.approx(finger_path(np.array([PICK]))[0])
    assert events["pick"].right_wrist is None


def test_a_wrist_that_was_not_seen_around_the_event_is_null() -> None:
    slow = clock(10)
    left = hand("left", slow, finger_path(slow), contact="wrist")
    unseen = dataclasses.replace(left, valid=np.abs(slow - PICK) > 0.3)
    _, events = _curated(_recording(PRIMED_AT_12, None, hands=(unseen,), body=None))
    assert events["pick"].left_wrist is None
    assert events["put"].left_wrist is not None
