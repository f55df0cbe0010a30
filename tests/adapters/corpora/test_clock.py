"""Three ways from the text's clock to the suit's."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import expit

from prbench.alignment.clock import angular_speed, best_agreement
from prbench.protocol.manifests import load_manifest
from prbench.randomness import named_generator
from prbench.recording import PoseStream
from prbench_adapters.corpora.nymeria.clock import (
    offset_by_correlation,
    offset_by_starts,
    offset_from_file,
)
from prbench_adapters.corpora.nymeria.format import Narration
from prbench_adapters.corpora.nymeria.suit import clean_suit
from tests.adapters.corpora.suits import START_US, THRESHOLDS, walking_suit

RATE = 240.0
OFFSET = 3.217
HEAD = 6


def turning(seconds: float, name: str = "head") -> np.ndarray:
    """Quaternions (n, 4), w x y z, of a head that looks here and there without rhythm."""
    rng = named_generator("test-clock", name)
    times = np.arange(int(seconds * RATE)) / RATE
    angles = np.zeros((len(times), 2))
    for begin in np.cumsum(rng.uniform(0.3, 2.0, int(seconds))):
        angles += rng.normal(0.0, 0.5, 2) * expit((times - begin) / 0.06)[:, None]
    return Rotation.from_euler("zy", angles).as_quat(scalar_first=True)


def suit_with(head: np.ndarray):
    suit = walking_suit(len(head))
    rotation = suit.rotation.copy()
    rotation[:, HEAD] = head
    return clean_suit(replace(suit, rotation=rotation), load_manifest("nymeria"), path="x")


def glasses(head: np.ndarray, *, first: int = 0, noise: float = 0.0) -> PoseStream:
    """Poses of the same head on the device clock, in another frame, with another mounting."""
    mounting = Rotation.from_euler("xyz", [0.4, -1.1, 0.2])
    turned = Rotation.from_euler("z", 2.0) * Rotation.from_quat(head, scalar_first=True) * mounting
    shaken = turned * Rotation.from_rotvec(noise * named_generator("test-clock-noise").normal(size=(len(head), 3)))
    times = START_US / 1e6 - OFFSET + np.arange(len(head)) / RATE
    return stream(times[first:], shaken.as_quat(scalar_first=True)[first:])


def stream(times: np.ndarray, rotation: np.ndarray) -> PoseStream:
    return PoseStream(times, np.zeros((len(times), 3)), rotation, np.ones(len(times), dtype=bool))


def test_the_offset_of_the_same_head_is_found_whatever_the_mounting():
    head = turning(60.0)
    offset, why = offset_by_correlation(suit_with(head), glasses(head), THRESHOLDS)
    assert offset is not None, why
    assert offset.method == "correlation"
    assert offset.seconds == pytest.approx(OFFSET, abs=1e-3)


def test_noise_and_a_late_start_of_the_glasses_move_the_offset_by_a_frame_at_most():
    head = turning(90.0)
    offset, why = offset_by_correlation(suit_with(head), glasses(head, first=4000, noise=2e-4), THRESHOLDS)
    assert offset is not None, why
    assert offset.seconds == pytest.approx(OFFSET, abs=1 / RATE)


def test_another_head_is_refused_with_numbers():
    offset, why = offset_by_correlation(suit_with(turning(60.0)), glasses(turning(60.0, "somebody else")), THRESHOLDS)
    assert offset is None
    assert "agree by" in why
    assert "needed 0.8" in why


def test_a_rhythm_has_no_single_offset():
    times = np.arange(60 * 240) / RATE
    head = Rotation.from_euler("z", 0.4 * np.sin(2 * np.pi * times / 3.0)[:, None]).as_quat(scalar_first=True)
    offset, why = offset_by_correlation(suit_with(head), glasses(head), THRESHOLDS)
    assert offset is None
    assert "second peak" in why


def test_correlation_equals_a_slow_loop_over_lags():
    rng = named_generator("test-clock-loop")
    long = rng.normal(size=400)
    one = angular_speed(stream(np.arange(401) / 100.0, np.tile([1.0, 0, 0, 0], (401, 1))))
    assert one is not None
    first = (one[0], long, np.ones(400, dtype=bool))
    valid = rng.random(250) > 0.1
    second = (7.0, long[90:340] + 0.3 * rng.normal(size=250), valid)
    lag_found, height, other = best_agreement(first, second)
    scores = {}
    for lag in range(-249, 400):
        pairs = [(long[i + lag], second[1][i]) for i in range(250) if valid[i] and 0 <= i + lag < 400]
        if len(pairs) >= 0.5 * valid.sum():
            scores[lag] = np.corrcoef(np.array(pairs).T)[0, 1]
    best = max(scores, key=lambda lag: scores[lag])
    assert best == 90
    assert height == pytest.approx(scores[best], abs=1e-9)
    assert other == pytest.approx(max(value for lag, value in scores.items() if abs(lag - best) > 100), abs=1e-9)
    assert lag_found == pytest.approx(first[0] - 7.0 + 0.90, abs=0.005)


def test_a_gap_of_the_glasses_does_not_count_as_standing_still():
    head = turning(60.0)
    worn = glasses(head)
    keep = np.ones(len(worn.times), dtype=bool)
    keep[5000:7000] = False
    offset, why = offset_by_correlation(suit_with(head), stream(worn.times[keep], worn.rotation[keep]), THRESHOLDS)
    assert offset is not None, why
    assert offset.seconds == pytest.approx(OFFSET, abs=2e-3)


def rows(*spans: tuple[float, float]) -> list[Narration]:
    return [Narration("atomic_action", start, end, (("atomic actions", "C waits."),)) for start, end in spans]


def test_starts_are_aligned_at_the_lead_of_known_sequences():
    clean = suit_with(turning(30.0))
    offset, _ = offset_by_starts(rows((905.0, 909.0), (900.0, 904.0)), clean, THRESHOLDS)
    assert offset is not None
    assert offset.method == "start_alignment"
    assert 900.0 + offset.seconds == pytest.approx(START_US / 1e6 + 0.21)


def test_starts_are_not_aligned_where_texts_would_outlast_the_suit():
    clean = suit_with(turning(30.0))
    offset, why = offset_by_starts(rows((900.0, 904.0), (928.0, 932.0)), clean, THRESHOLDS)
    assert offset is None
    assert "after the suit" in why
    offset, _ = offset_by_starts(rows((900.0, 904.0), (927.0, 930.7)), clean, THRESHOLDS)
    assert offset is not None


def test_the_users_file_names_sequences(tmp_path):
    path = tmp_path / "time_offset.json"
    path.write_text(json.dumps({"one": 12.5}))
    offset = offset_from_file(path, "one")
    assert offset is not None
    assert (offset.method, offset.seconds) == ("file", 12.5)
    assert offset_from_file(path, "three") is None
