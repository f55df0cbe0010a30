"""Curation of synthetic HD-EPIC finds what was acted out, and its table resembles the published row.

At default noise one limit of docs/specification/synthetic-recordings.md#truth-record is out of reach, priming recall ≥
0.97: the dataset has general gaze only, whose bias (1.8 degrees an axis, 3 cm at 1 m) and the points' 2 cm an axis meet
a near miss of 5 cm. Of the 328 sequences of 60 recordings (docs/datasets.md) 31 are missed so; 7 with exact gaze, 5
with exact points, none with both.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from prbench.checking.verify_synthetic import Match, match_events, true_events
from prbench.curation import build_dataset, curate_recording
from prbench.harness.synthetic_table import Staging, build_synthetic_table
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.sequences import SequenceTable
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Switches
from prbench.synthetic.write_tree import synthesize_tree
from tests.checking.levels import (
    LEVELS,
    MOSTLY_SLOW,
    SensorLevel,
    Verification,
    limits,
    verification,
    verify_level,
    verify_tree,
)
from tests.synthetic.behaviour import TARGETS

RECORDINGS, EVENTS, SEED = 3, 6, 0
OF_PRIMING = ("priming recall", "false primes", "median prime time error, s")
"""Limits that a handful of events with noise cannot show."""


@pytest.mark.parametrize("level", MOSTLY_SLOW)
def test_events_are_found_within_the_limits(level: SensorLevel) -> None:
    result = verify_level(level, preset="hd-epic", recordings=RECORDINGS, n_events=EVENTS, seed=SEED)
    assert result.true_events >= 8
    applying = [
        each for each in limits(level, result, preset="hd-epic") if level.noise == 0 or each.name not in OF_PRIMING
    ]
    assert [f"{limit.name}: {limit.value}" for limit in applying if not limit.holds] == []
    assert result.recall == result.precision == 1.0, "the dataset annotates its events"


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_primes_are_found_within_the_limits_that_apply() -> None:
    level = LEVELS[1]
    result = verify_level(level, preset="hd-epic", recordings=20, seed=SEED)
    broken = [limit.name for limit in limits(level, result, preset="hd-epic") if not limit.holds]
    assert set(broken) <= {"priming recall"}
    assert result.priming_recall >= 0.87  # 0.91 here; two standard errors below it


MASKS = ("mask_losses",)
GAZE = ("gaze_bias", "gaze_jitter", "gaze_losses", "blinks")
PLACES = ("annotated_points",)
TIMES = ("annotated_times",)


def _found(index: int, *exact: str) -> Verification:
    """Curation against truth where some sensor errors are switched off."""
    return verification(_matches(index, *exact), recordings=1)


@cache
def _acted(index: int) -> Performance:
    """Recording ``index``, which several tests look at."""
    return Staging("hd-epic", 1).perform(index)


@cache
def _matches(index: int, *exact: str) -> list[Match]:
    """Events of a recording beside what curation finds, with some sensor errors switched off."""
    acted = _acted(index)
    layout = layout_for("hd-epic")
    switches = dataclasses.replace(Switches(), **dict.fromkeys(exact, False))
    recording = layout.recording(layout.sense(acted, switches=switches))
    events = curate_recording(recording, load_manifest("hd-epic"), load_protocol()).events
    return match_events(true_events("hd-epic", acted), events)


def _outcomes(found: Verification) -> list[str]:
    """What became of the sequences that were acted out and missed."""
    return [line.rpartition(": ")[2] for line in found.missed_sequences]


FEW, MANY = range(4), range(20)
EXPLAINED = {"minimum_movement", "no_location", "not_primed"}
"""Outcomes of sequences that were acted out and missed (docs/datasets.md, "What is missed of HD-EPIC")."""


@pytest.mark.unchecked_shapes
def test_the_sequences_that_curation_misses_are_missed_by_sensors_and_annotators() -> None:
    outcomes: set[str] = set()
    for index in FEW:
        missed = _outcomes(_found(index))
        outcomes.update(missed)
        without_losses = _outcomes(_found(index, *MASKS))
        kept = [outcome for outcome in missed if outcome != "no_location"]
        assert without_losses == kept, "a lost mask loses its event"
        exact = _found(index, *MASKS, *GAZE, *PLACES, *TIMES)
        assert exact.missed_sequences == ()
        assert (exact.priming_recall, exact.false_primes) == (1.0, 0.0)
        assert exact.prime_first.largest <= 1.0, "no look of seconds before is passed over"
    # A wrist that comes too near by a sensor's error is seen once in twenty recordings: the slow test has it.
    assert {"no_location", "not_primed"} <= outcomes <= EXPLAINED


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_every_outcome_that_the_page_explains_occurs() -> None:
    assert {outcome for index in MANY for outcome in _outcomes(_found(index))} == EXPLAINED


@pytest.mark.parametrize("indices", [range(8), pytest.param(MANY, marks=pytest.mark.slow)])
@pytest.mark.unchecked_shapes
def test_hands_are_wrong_only_where_both_wrists_are_at_the_place(indices: range) -> None:
    """In a work pose the idle hand often is as near to the place as the one that acts: then nothing tells which it was.

    Measured on 60 recordings (docs/datasets.md): 2.2 % wrong and 5.9 % unknown.
    """
    matches = [match for index in indices for match in _matches(index)]
    hands = verification(matches, recordings=len(indices)).hands
    located = sum(hands.values())
    assert located >= 6 * len(indices)
    assert hands["wrong"] <= 0.04 * located
    assert hands["unknown"] <= 0.10 * located
    assert max(distance for match in matches for distance in _wrists_of_a_missed_hand(match)) < 0.20


def _wrists_of_a_missed_hand(match: Match) -> list[float]:
    """Return how far both wrists are from the place of an event whose hand is wrong or unknown, metres."""
    true, found = match.true, match.found
    if true is None or found is None or found.location is None or found.hand == true.hand:
        return []
    wrists = [np.inf if wrist is None else wrist - found.location for wrist in (found.left_wrist, found.right_wrist)]
    return [float(np.linalg.norm(wrist)) for wrist in wrists]


def test_native_files_give_what_the_recording_exit_gives(tmp_path: Path) -> None:
    synthesize_tree("hd-epic", tmp_path / "tree", recordings=1, seed=SEED, n_events=2)
    from_files = verify_tree(tmp_path / "tree", dataset="hd-epic")
    assert from_files.recall == from_files.precision == 1.0
    build_dataset("hd-epic", tmp_path / "tree", tmp_path / "native")
    build_synthetic_table("hd-epic", 1, SEED, tmp_path / "direct", n_events=2)
    native, direct = (SequenceTable.open(tmp_path / name) for name in ("native", "direct"))
    assert native.info.dataset == "synthetic-hd-epic"
    assert native.events().equals(direct.events())
    assert native.info.identity_digest == direct.info.identity_digest
    assert native.info.content_digest == direct.info.content_digest


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_a_table_of_twenty_recordings_resembles_table_1(tmp_path: Path) -> None:
    report = build_synthetic_table("hd-epic", 20, SEED, tmp_path / "table", n_events=6)
    rows, target = SequenceTable.open(report.folder).scalars(), TARGETS["hd-epic"]
    columns = {
        "duration": np.asarray(rows["event_time"]) - np.asarray(rows["prime_time"]) + 2.0,
        "gap": np.asarray(rows["prime_gap"]),
        "body": np.asarray(rows["body_movement"]),
        "hand": np.asarray(rows["hand_movement"]),
    }
    for name, values in columns.items():
        spread = getattr(target, name)
        assert abs(values.mean() - spread.mean) <= spread.sd / 3, name
