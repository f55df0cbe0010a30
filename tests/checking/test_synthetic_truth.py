"""Curation finds what was acted out (docs/specification/synthetic-recordings.md#truth-record), for every dataset.

At default noise one limit is out of reach for HD-EPIC, priming recall ≥ 0.97: the dataset has general gaze only, whose
bias (1.8 degrees an axis, 3 cm at 1 m) and the points' 2 cm an axis meet a near miss of 5 cm. Of the 328 sequences of
60 recordings (docs/datasets.md) 31 are missed so; 7 with exact gaze, 5 with exact points, none with both.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from prbench.checking.hd_epic import Spread
from prbench.curation import build_dataset, curate_recording
from prbench.curation.options import BuildOptions, CurationOptions
from prbench.harness.synthetic_table import Staging, build_synthetic_table
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.sequences import Event, SequenceTable
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.sensors import Switches
from prbench.synthetic.write_tree import synthesize_tree
from tests.checking.levels import (
    LEVELS,
    MOSTLY_SLOW,
    SensorLevel,
    Verification,
    limits,
    staged_matches,
    verification,
    verify_level,
    verify_tree,
)
from tests.checking.matching import Match, match_events, true_events
from tests.synthetic.behaviour import TARGETS

SEED = 301
OF_PRIMING = ("priming recall", "false primes", "median prime time error, s")  # beyond a handful of HD-EPIC's events
ANNOTATED = ("mogaze", "hd-epic")  # their events are annotated, so none is lost or invented


def broken(level: SensorLevel, result: Verification, preset: str = "adt") -> list[str]:
    return [f"{limit.name}: {limit.value}" for limit in limits(level, result, preset=preset) if not limit.holds]


@pytest.mark.parametrize("level", MOSTLY_SLOW)
@pytest.mark.parametrize(
    ("preset", "acted", "at_least"),
    [
        ("adt", {"recordings": 3, "seed": SEED}, 20),
        ("hot3d", {"recordings": 3, "seed": SEED}, 15),
        ("gimo", {"recordings": 4, "seed": SEED}, 20),
        ("mogaze", {"recordings": 2, "n_events": 6, "seed": SEED}, 8),
        ("hd-epic", {"recordings": 3, "n_events": 6, "seed": 0}, 8),
    ],
)
def test_events_and_primes_are_found_within_the_limits(
    preset: str, acted: dict[str, int], at_least: int, level: SensorLevel
) -> None:
    result = verify_level(level, preset=preset, **acted)
    assert result.true_events >= at_least
    beyond = OF_PRIMING if preset == "hd-epic" and level.noise > 0 else ()  # no text starts with one of none
    assert [each for each in broken(level, result, preset) if not each.startswith(beyond)] == []
    if preset in ANNOTATED:
        assert result.recall == result.precision == 1.0
    if preset == "mogaze":
        assert result.timing.largest <= 1 / 120


@pytest.mark.parametrize(
    ("preset", "tree", "events"),
    [
        ("adt", {"size": "tiny"}, {"n_events": 6}),
        ("hot3d", {"size": "tiny"}, {"n_events": 6}),
        ("gimo", {"n_events": 3, "provocations": {}}, {"n_events": 3, "provocations": {}}),
        ("mogaze", {"n_events": 2}, {"n_events": 2}),
        ("hd-epic", {"n_events": 2}, {"n_events": 2}),
    ],
)
@pytest.mark.unchecked_shapes
def test_native_files_give_what_the_recording_exit_gives(
    preset: str, tree: dict[str, Any], events: dict[str, Any], tmp_path: Path
) -> None:
    seed = 0 if preset == "hd-epic" else SEED
    synthesize_tree(preset, tmp_path / "tree", recordings=1, seed=seed, **tree)
    from_files = verify_tree(tmp_path / "tree", dataset=preset)
    if preset in ("gimo", "hd-epic"):
        assert from_files.recall == from_files.precision == 1.0
    else:
        assert broken(LEVELS[2], from_files, preset) == []
    build_dataset(preset, tmp_path / "tree", tmp_path / "native")
    build_synthetic_table(preset, 1, seed, tmp_path / "direct", **events)
    native, direct = (SequenceTable.open(tmp_path / name) for name in ("native", "direct"))
    assert native.info.dataset == f"synthetic-{preset}"
    assert native.events().equals(direct.events())
    assert native.info.identity_digest == direct.info.identity_digest
    assert native.info.content_digest == direct.info.content_digest


@pytest.mark.slow
@pytest.mark.unchecked_shapes
@pytest.mark.parametrize(
    ("preset", "stagings", "recordings"),
    [
        # Two seeds: how far people move along HOT3D's table differs by 0.8 of the spread between 90 sequences of one.
        ("hot3d", [Staging("hot3d", seed, n_events=6, provocations=()) for seed in (0, 1)], 20),
        ("gimo", [Staging("gimo", SEED, n_events=6)], 12),
        ("mogaze", [Staging("mogaze", 1, n_events=6)], 12),
        ("hd-epic", [Staging("hd-epic", 0, n_events=6)], 20),
    ],
)
def test_means_are_within_a_third_of_the_spread_of_table_1(
    preset: str, stagings: list[Staging], recordings: int
) -> None:
    rows = []
    for staging in stagings:
        for index in range(recordings):
            recording = staging.sense(staging.perform(index))
            for row in curate_recording(recording, load_manifest(preset), load_protocol()).sequences:
                # The study's durations are not its gaps and 2 s (GIMO's 0.6 s more), so they are left out.
                rows.append((row.prime_gap, row.body_movement, row.hand_movement))
    assert len(rows) >= 60
    target = TARGETS[preset]
    for mean, spread in zip(np.mean(rows, axis=0), (target.gap, target.body, target.hand)):
        assert abs(mean - spread.mean) < spread.sd / 3


def provoked(preset: str, tag: str, n_events: int) -> list[Match]:
    matches = staged_matches(Staging(preset, SEED, n_events=n_events, provocations=((tag, 0.6),)), 0)
    assert not [match for match in matches if match.true is None], "something is found besides"
    return [match for match in matches if match.true is not None and match.true.tag == tag and not match.true.thin]


@pytest.mark.parametrize(
    ("tag", "outcome"),
    [
        ("pass_by", "not_found"),
        ("touch", "not_found"),
        ("nudge", "not_found"),
        ("bystander", "other_wearer"),
        ("too_near", "minimum_movement"),
        ("early", "too_short"),
        ("two_handed", "sequence"),
        ("hand_over", "sequence"),
        ("same_place", "sequence"),
        ("contained", "sequence"),
    ],
)
def test_a_provocation_comes_to_what_it_should(tag: str, outcome: str) -> None:
    matches = provoked("adt", tag, 6)
    assert [m.outcome for m in matches] == [m.expected.replace("not_an_event", "not_found") for m in matches]
    assert outcome in {match.outcome for match in matches}


@pytest.mark.parametrize("tag", ["pass_by", "touch", "nudge", "hinge", "two_handed", "contained", "too_near", "lost"])
def test_a_provocation_of_mogaze_comes_to_what_it_should(tag: str) -> None:
    matches = provoked("mogaze", tag, 3)
    assert [m.outcome for m in matches] == [m.expected.replace("not_an_event", "not_found") for m in matches]


def test_lost_tracks_are_placed_or_reported() -> None:
    matches = staged_matches(Staging("adt", SEED + 1, n_events=6, provocations=(("lost", 0.6),)), 1)
    lost = [m for m in matches if m.true is not None and m.true.tag == "lost"]
    assert lost
    assert all(m.found is not None for m in lost)


def test_a_limit_is_broken_when_curation_is() -> None:
    """The check itself can fail: a rule that never holds anything finds nothing."""
    staging = Staging("adt", SEED)
    performance = staging.perform(0)
    manifest = load_manifest("adt")
    far = msgspec.structs.replace(manifest, in_hand=msgspec.structs.replace(manifest.in_hand, distance=0.001))
    curated = curate_recording(staging.sense(performance), far, load_protocol())
    result = verification(match_events(list(performance.events), list(curated.events)), recordings=1)
    assert "recall: 0.0" in broken(LEVELS[1], result)


@pytest.mark.skipif(importlib.util.find_spec("open3d") is None, reason="needs the extra open3d")
def test_the_surface_rule_builds_where_meshes_are_read(tmp_path: Path) -> None:
    synthesize_tree("hot3d", tmp_path / "tree", recordings=1, seed=SEED, n_events=2)
    curation = CurationOptions(in_hand="surface")
    refused = build_dataset("hot3d", tmp_path / "tree", tmp_path / "without", options=BuildOptions(curation=curation))
    assert [record.status for record in refused.records] == ["failed"]
    assert "--option meshes=true" in refused.records[0].message
    options = BuildOptions(curation=curation, reader=(("meshes", "true"),))
    report = build_dataset("hot3d", tmp_path / "tree", tmp_path / "with", options=options)
    plain = build_dataset("hot3d", tmp_path / "tree", tmp_path / "plain")
    assert report.records[0].outcomes == plain.records[0].outcomes


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_primes_of_hd_epic_are_found_within_the_limits_that_apply() -> None:
    result = verify_level(LEVELS[1], preset="hd-epic", recordings=20, seed=0)
    assert [each for each in broken(LEVELS[1], result, "hd-epic") if not each.startswith("priming recall")] == []
    assert result.priming_recall >= 0.87  # 0.91 here; two standard errors below it


MASKS = ("mask_losses",)
GAZE_PLACES_TIMES = ("gaze_bias", "gaze_jitter", "gaze_losses", "blinks", "annotated_points", "annotated_times")
FEW, MANY = range(4), range(20)
# Outcomes of sequences that were acted out and missed (docs/datasets.md, "What is missed of HD-EPIC")
EXPLAINED = {"minimum_movement", "no_location", "not_primed"}


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


def _missed(index: int, *exact: str) -> list[str]:
    """What became of the sequences that were acted out and missed."""
    lines = verification(_matches(index, *exact), recordings=1).missed_sequences
    return [line.rpartition(": ")[2] for line in lines]


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_the_sequences_that_curation_misses_are_missed_by_sensors_and_annotators() -> None:
    outcomes: set[str] = set()
    for index in FEW:
        missed = _missed(index)
        outcomes.update(missed)
        kept = [outcome for outcome in missed if outcome != "no_location"]
        assert _missed(index, *MASKS) == kept, "a lost mask loses its event"
        exact = verification(_matches(index, *MASKS, *GAZE_PLACES_TIMES), recordings=1)
        assert exact.missed_sequences == ()
        assert (exact.priming_recall, exact.false_primes) == (1.0, 0.0)
        assert exact.prime_first.largest <= 1.0, "no look of seconds before is passed over"
    # A wrist that comes too near by a sensor's error is seen once in twenty recordings: the slow test has it.
    assert "no_location" in outcomes
    assert len(outcomes) >= 2
    assert outcomes <= EXPLAINED


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_every_outcome_that_the_page_explains_occurs() -> None:
    assert {outcome for index in MANY for outcome in _missed(index)} == EXPLAINED


@pytest.mark.parametrize("indices", [range(8), pytest.param(MANY, marks=pytest.mark.slow)])
@pytest.mark.unchecked_shapes
def test_hands_are_wrong_only_where_both_wrists_are_at_the_place(indices: Sequence[int]) -> None:
    """In a work pose the idle hand often is as near to the place as the one that acts: then nothing tells which it was.

    Measured on 60 recordings (docs/datasets.md): 2.2 % wrong and 5.9 % unknown.
    """
    matches = [match for index in indices for match in _matches(index)]
    hands = verification(matches, recordings=len(indices)).hands
    located = sum(hands.values())
    assert located >= 6 * len(indices)
    assert hands["wrong"] <= 0.05 * located
    assert hands["unknown"] <= 0.10 * located
    for true, found in ((match.true, match.found) for match in matches):
        if true is not None and found is not None and found.location is not None and found.hand != true.hand:
            for wrist in (found.left_wrist, found.right_wrist):
                assert wrist is not None
                assert np.linalg.norm(wrist - found.location) < 0.20


def true(
    time: float, *, action: str = "pick", name: str = "1", tag: str = "plain", expected: str = "sequence",
    prime: float | None = -3.0, thin: bool = False, hand: str = "left",
) -> TrueEvent:  # fmt: skip
    zero, time = np.zeros(3), float(time)
    prime_time = None if prime is None else time + prime
    return TrueEvent(
        "e", action, tag, name, "cup", hand, time, time, time, zero, zero, zero, prime_time, prime_time, prime_time,
        None, time - 1, time - 1, expected, thin,
    )  # fmt: skip


def found(
    time: float, *, action: str = "pick", name: str = "1", outcome: str = "sequence", prime: float | None = -3.0,
    stage: str = "filters", hand: str | None = "left", **columns,
) -> Event:  # fmt: skip
    point, time = np.array([0.0, 0.0, 0.01]), float(time)
    return Event(
        event_id=f"{name}/{action}/{time}", recording_id="r", object_id=name, object_name="cup", action=action,
        hand=hand, event_time=time, prime_time=None if prime is None else time + prime, location=point,
        box_min=point, box_max=point, outcome=outcome, stage=stage, **columns,
    )  # fmt: skip


def pairs(true_events: list[TrueEvent], found_events: list[Event]) -> set[tuple[float | None, float | None]]:
    return {
        (m.true.event_time if m.true else None, m.found.event_time if m.found else None)
        for m in match_events(true_events, found_events)
    }


def test_the_nearest_pair_is_matched_first_and_each_event_once() -> None:
    # 10.3 is nearer to 10.4 than to 10.0, so 10.0 has to take 9.8.
    assert pairs([true(10.0), true(10.4)], [found(10.3), found(9.8)]) == {(10.0, 9.8), (10.4, 10.3)}


def test_objects_actions_and_half_a_second_keep_events_apart() -> None:
    assert pairs([true(10.0)], [found(10.0, name="2")]) == {(10.0, None), (None, 10.0)}
    assert pairs([true(10.0)], [found(10.0, action="put")]) == {(10.0, None), (None, 10.0)}
    assert pairs([true(10.0)], [found(10.5)]) == {(10.0, 10.5)}
    assert pairs([true(10.0)], [found(10.51)]) == {(10.0, None), (None, 10.51)}


def test_recall_precision_and_errors_by_hand() -> None:
    matches = match_events(
        [true(10.0), true(20.0), true(30.0), true(40.0)],
        [found(10.1), found(20.0), found(30.3, prime=-3.3), found(50.0)],
    )
    result = verification(matches, recordings=1)
    assert (result.recall, result.precision) == (0.75, 0.75)
    assert result.timing.bias == pytest.approx(0.4 / 3)
    assert result.timing.median == pytest.approx(0.1)
    assert result.prime.largest == pytest.approx(0.1)


def test_priming_recall_and_false_primes_have_their_own_denominators() -> None:
    unseen = {"prime": None, "outcome": "not_primed", "stage": "priming"}
    nothing = {"prime": None, "expected": "not_primed"}
    matches = match_events(
        [true(10), true(20), true(30, **nothing), true(40, **nothing), true(50, **nothing), true(60)],
        [found(10), found(20, **unseen), found(30), found(40, **unseen), found(50, **unseen)],
    )
    result = verification(matches, recordings=1)
    assert result.priming_recall == 0.5, "of the matched events with a prime; the missing one does not count"
    assert result.false_primes == pytest.approx(1 / 3)


def test_thin_and_lost_events_and_what_was_found_of_them_count_nowhere_else() -> None:
    matches = match_events(
        [true(10, thin=True), true(20, tag="lost"), true(30, tag="lost"), true(40)],
        [found(10.2), found(20.3, outcome="tracking_lost", stage="location"), found(40)],
    )
    result = verification(matches, recordings=1)
    assert (result.true_events, result.thin, result.precision) == (1, 1, 1.0)
    assert result.timing.largest == 0.0


def test_hands_are_right_wrong_or_unknown() -> None:
    matches = match_events(
        [true(10), true(20), true(30, hand="right"), true(40)], [found(10), found(20, hand=None), found(30), found(40)]
    )
    assert verification(matches, recordings=1).hands == {"right": 2, "wrong": 1, "unknown": 1}


def test_every_sequence_that_is_missing_is_listed_with_its_outcome() -> None:
    unseen = {"prime": None, "outcome": "not_primed", "stage": "priming"}
    matches = match_events([true(10), true(20), true(30), true(40, thin=True)], [found(10), found(20, **unseen)])
    result = verification(matches, recordings=1)
    assert result.expected_sequences == 3
    assert result.missed_sequences == ("e (pick): not_primed", "e (pick): not_found")


def test_what_is_no_event_must_not_be_found() -> None:
    nudge = true(10, tag="nudge", expected="not_an_event")
    assert verification(match_events([nudge], []), recordings=1).recall == 1.0
    result = verification(match_events([nudge], [found(10)]), recordings=1)
    assert (result.recall, result.precision) == (1.0, 0.0)


def test_an_empty_sample_is_nan_not_zero() -> None:
    assert Spread.of([]).n == 0
    assert math.isnan(Spread.of([]).median)
