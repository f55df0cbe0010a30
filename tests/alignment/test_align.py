"""Alignment of simulated glasses and suits with known clocks and X."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from prbench.alignment.align import align
from prbench.recording import PoseStream
from tests.alignment.heads import OFFSET, START, errors, mounting, tracks


def test_clean_tracks_give_x_and_clock():
    found = align(*tracks(noise=(0.0, 0.0)))
    rotation, translation = errors(found, mounting("someone"))
    assert rotation < 1e-3
    assert translation < 1e-4
    assert found.clock is not None
    assert found.clock.offset == pytest.approx(OFFSET, abs=1e-4)
    assert found.findings == ()
    assert [(row.stage, row.unit) for row in found.residuals] == [
        ("rotation", "°"),
        ("translation", "mm"),
        ("joint", "°"),
        ("joint", "mm"),
    ]


def test_noise_of_sensors_costs_hundredths_of_a_degree():
    found = align(*tracks())
    rotation, translation = errors(found, mounting("someone"))
    assert rotation < 0.02
    assert translation < 5e-4
    assert found.clock is not None
    assert found.clock.offset == pytest.approx(OFFSET, abs=2e-3)
    assert 0.05 < found.residuals[2].p50 < 0.2
    assert found.rolling_range is not None
    assert not found.moved


def test_a_drifting_clock_is_found_and_taken_out():
    found = align(*tracks(rate=2e-4))
    clock = found.clock
    assert clock is not None
    assert clock.rate == pytest.approx(2e-4, rel=0.1)
    assert clock.drift == pytest.approx(2e-4 * 60, rel=0.1)
    assert clock.offset == pytest.approx(OFFSET + 2e-4 * (clock.at - START), abs=1e-3)
    times = np.array([START + 3.0, START + 80.0])
    assert np.allclose(clock.to_device(clock.to_segment(times)), times)
    assert "drift" in found.findings[0]
    assert errors(found, mounting("someone"))[0] < 0.02


@pytest.mark.parametrize(
    ("turn", "move"), [((4.0, 0.0, 2.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (0.0, 0.03, -0.01))], ids=["turn", "move"]
)
def test_a_slip_is_found_when_it_happens_and_as_large_as_it_is(turn, move):
    device, segment = tracks(150.0, slip=(75.0, turn, move))
    found = align(device, segment)
    (slip,) = found.slips
    assert slip.time - START == pytest.approx(75.0, abs=3.0)
    assert slip.rotation == pytest.approx(np.linalg.norm(turn), rel=0.2, abs=0.2)
    assert slip.translation == pytest.approx(np.linalg.norm(move), rel=0.2, abs=2e-3)
    assert found.moved
    # X before and after, and the head in the glasses' world, are each right.
    before, after = found.x_at(START + np.array([20.0, 130.0]))
    assert np.allclose(before, mounting("someone"), atol=2e-3)
    assert np.linalg.norm(after[:3, 3] - before[:3, 3]) == pytest.approx(np.linalg.norm(move), abs=2e-3)


def test_glasses_of_another_recording_are_refused_by_the_clock():
    found = align(*tracks(glasses_of="somebody else"))
    assert found.device_from_segment is None
    assert "turn alike by" in found.refused
    with pytest.raises(ValueError, match="turn alike by"):
        found.x_at(np.zeros(1))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"about": (35.0, 0.0, 0.0)}, r"one axis.*σ₂/σ₁ = 0\.00\d, at least 0\.05"),
        ({"about": (0.4, 0.2, 0.1), "noise": (0.01, 0.01)}, r"hardly turns.*σ₂/σ₁ = 0\.\d"),
        ({"seconds": 40.0}, r"share 40\.0 s.*at least 60 s"),
    ],
    ids=["yaw alone", "seated", "short"],
)
def test_what_cannot_be_observed_is_refused_with_the_number(changes, message):
    found = align(*tracks(**changes))
    assert found.device_from_segment is None
    assert re.search(message, found.refused), found.refused


def test_a_gap_is_not_bridged_and_counts_as_no_overlap():
    device, segment = tracks(100.0)
    at = device.times - START
    lost = (at > 30) & (at < 50)
    # What stands in the gap is wrong, and must leave no trace.
    wrong = replace(device, valid=~lost, position=np.where(lost[:, None], 9.0, device.position))
    found = align(wrong, segment)
    assert errors(found, mounting("someone"))[1] < 1e-3
    assert found.overlap == pytest.approx(80.0, abs=0.1)
    # A short loss is bridged; one of more than 0.1 s is not.
    for seconds, overlap in ((0.09, 100.0), (0.2, 99.8)):
        kept = (at < 40) | (at > 40 + seconds)
        found = align(PoseStream(*(values[kept] for values in vars(device).values())), segment)
        assert found.overlap == pytest.approx(overlap, abs=0.03)


def test_a_known_offset_is_refined_and_a_wrong_one_refused():
    device, segment = tracks()
    found = align(device, segment, offset=OFFSET + 0.2)
    assert found.clock is not None
    assert found.clock.offset == pytest.approx(OFFSET, abs=2e-3)
    assert "turn alike" in align(device, segment, offset=OFFSET + 5.0).refused


def test_tracks_that_never_meet_are_refused():
    device, segment = tracks(70.0)
    assert "too few poses" in align(device, segment, offset=OFFSET + 500.0).refused
    nobody = replace(device, valid=np.zeros(len(device.times), dtype=bool))
    assert "too few poses" in align(nobody, segment).refused
