"""How sure an event is: monotone in each of its parts, calibrated on synthetic truth, and asked for by an option."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prbench.cli.main import main
from prbench.curation import curate_recording
from prbench.curation.confidence import beyond, unbroken
from prbench.curation.events import Place
from prbench.curation.options import CurationOptions
from prbench.curation.priming import find_prime
from prbench.errors import UsageError
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.sequences import SequenceTable
from prbench.synthetic.layouts import synthetic_recording
from prbench.synthetic.people.perform import perform
from prbench.viewing.explain import explain_event
from tests.checking.matching import match_events, true_events
from tests.curation.scenes import MANIFEST, PROTOCOL, clock, finger_path, hand, scene

lengths = st.floats(-5, 5)


@given(lengths, lengths)
def test_farther_beyond_a_threshold_is_surer_and_a_longer_gap_less_sure(one: float, other: float) -> None:
    low, high = sorted((one, other))
    assert 0 <= beyond(low) <= beyond(high) <= 1
    assert 0 <= unbroken(high, usual=0.1) <= unbroken(low, usual=0.1) <= 1


def test_by_hand() -> None:
    assert beyond(0.0) == 0.5
    assert beyond(0.03) == pytest.approx(0.8413, abs=1e-4)
    assert (unbroken(0.1, usual=0.1), unbroken(1.1, usual=0.1)) == pytest.approx((1.0, np.exp(-1)))


POINT = Place(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 2.0]))


def sure(*passes: tuple[float, float], gap: tuple[float, float] = (0.0, 0.0)) -> float:
    """Confidence of a prime at 12 s or of none; each pass is a time at which gaze looks, and by how much it misses."""
    times = clock(30, 0, 15)
    direction = np.tile([0.0, 1.0, 0.0], (len(times), 1))
    for time, distance in passes:
        look = (times > time - 1e-9) & (times < time + 0.3)
        direction[look] = np.array([distance, 0.0, 2.0]) / np.hypot(distance, 2.0)
    kept = (times < gap[0]) | (times >= gap[1])
    rays = times[kept], np.zeros((kept.sum(), 3)), direction[kept]
    return find_prime(*rays, POINT, 14.0, PROTOCOL.curation).confidence


@pytest.mark.parametrize(
    ("doubtful", "clear"),
    [
        pytest.param([(12, 0.049)], [(12, 0.02)], id="a look that just meets the place"),
        pytest.param([(9, 0.051), (12, 0.0)], [(9, 0.2), (12, 0.0)], id="an earlier look that just misses it"),
        pytest.param([(12, 0.055)], [(12, 0.15)], id="no prime, by five millimetres"),
    ],
)
def test_a_look_near_the_threshold_is_doubtful(doubtful, clear) -> None:
    assert sure(*doubtful) < sure(*clear) - 0.2


@pytest.mark.parametrize("passes", [[(12, 0.0)], []])
def test_a_gap_in_the_gaze_in_which_a_first_look_may_lie_is_doubtful(passes) -> None:
    assert sure(*passes, gap=(8.0, 10.0)) == pytest.approx(sure(*passes) * np.exp(-1.5), rel=0.1)


def confidences(**changes: object) -> list[float]:
    events = curate_recording(scene(**changes), MANIFEST, PROTOCOL).events
    return [event.event_confidence for event in events]


def test_hands_that_are_equally_near_and_gaps_in_the_track_are_doubtful() -> None:
    plain = scene()
    both = (plain.hands[0], hand("right", clock(120), finger_path(clock(120)) + np.array([0.001, 0, 0])))
    wrists = (*both, *(dataclasses.replace(each, contact="wrist") for each in both))
    cup = plain.objects[0]
    lost = dataclasses.replace(cup, valid=(cup.times < 13.8) | (cup.times > 14.6))
    pick, put = confidences()
    assert confidences(hands=wrists)[0] < 0.6 * pick
    assert confidences(objects=(lost,)) == pytest.approx([pick * np.exp(-0.7), put], rel=0.1)


def test_events_below_the_asked_confidence_are_kept_with_an_outcome_of_their_own() -> None:
    plain = curate_recording(scene(), MANIFEST, PROTOCOL)
    least, most = sorted(row.event_confidence for row in plain.events)
    asked = CurationOptions(min_confidence=(least + most) / 2)
    found = curate_recording(scene(), MANIFEST, PROTOCOL, asked)
    assert len(found.sequences) == len(plain.sequences) - 1
    (low,) = (row for row in found.events if row.outcome == "low_confidence")
    assert (low.sequence_id, low.stage, low.value, low.threshold) == (None, "confidence", least, asked.min_confidence)
    assert (low.event_confidence, found.record.outcomes["low_confidence"]) == (least, 1)
    assert asked.described(MANIFEST, PROTOCOL)["min_confidence"] == f"{asked.min_confidence:g}"
    assert "min_confidence" not in CurationOptions().described(MANIFEST, PROTOCOL)


@pytest.mark.parametrize("asked", [-0.1, 1.1, float("nan")])
def test_a_confidence_outside_its_range_is_refused(asked: float) -> None:
    with pytest.raises(UsageError, match="from 0 to 1"):
        CurationOptions(min_confidence=asked)


def test_the_option_works_from_the_command_line_and_explain_tells_it(tmp_path, capsys) -> None:
    tree, out = str(tmp_path / "tree"), str(tmp_path / "table")
    assert main(["synthesize", "gimo", "--count", "1", "--events", "2", "--out", tree, "--quiet"]) == 0
    assert main(["build-dataset", "gimo", "--root", tree, "--out", out, "--min-confidence", "1", "--quiet"]) == 0
    assert "low_confidence: less sure than --min-confidence asks" in " ".join(capsys.readouterr().out.split())
    table = SequenceTable.open(out)
    low = [row for row in table.events().to_pylist() if row["outcome"] == "low_confidence"]
    low.sort(key=lambda row: row["prime_kind"] == "hit")
    assert len(low) == table.info.outcomes["low_confidence"] > 0
    text = explain_event(out, low[0]["event_id"]).text()
    assert f"outcome: low_confidence; confidence {low[0]['event_confidence']:.2f}" in text
    assert "and --min-confidence asked for 1" in text
    assert f"(near miss with {100 * low[0]['prime_margin']:.1f} cm to spare)" in text


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "recordings"), [("gimo", 10), ("hd-epic", 10), ("hot3d", 15)])
def test_less_confident_events_are_more_often_wrong_or_late(preset: str, recordings: int) -> None:
    wrong: dict[bool, list[bool]] = {True: [], False: []}
    for index in range(recordings):
        acted = perform(preset, seed=4021, index=index)
        events = curate_recording(synthetic_recording(acted), load_manifest(preset), load_protocol()).events
        for match in match_events(true_events(preset, acted), list(events)):
            true, found = match.true, match.found
            if found is None or found.event_confidence is None:
                continue
            late = False
            if true is not None and true.prime_time is not None and found.prime_time is not None:
                late = abs(found.prime_time - true.prime_time) > 0.5
            wrong[found.event_confidence < 0.7].append(late or match.outcome != match.expected)
    assert np.mean(wrong[True]) > 2.5 * np.mean(wrong[False])
