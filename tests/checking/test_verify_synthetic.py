"""Curation finds what was acted out (docs/specification/synthetic-recordings.md#truth-record)."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from prbench.checking.verify_synthetic import match_events
from prbench.curation import build_dataset, curate_recording
from prbench.harness.synthetic_table import Staging, build_synthetic_table
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.sequences import SequenceTable
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

RECORDINGS, SEED = 3, 301


def broken(level: SensorLevel, result: Verification) -> list[str]:
    return [f"{limit.name}: {limit.value}" for limit in limits(level, result) if not limit.holds]


@pytest.mark.parametrize("level", MOSTLY_SLOW)
def test_events_and_primes_are_found_within_the_limits(level: SensorLevel) -> None:
    result = verify_level(level, recordings=RECORDINGS, seed=SEED)
    assert result.true_events >= 20
    assert broken(level, result) == []


@pytest.mark.parametrize(
    ("tag", "outcomes"),
    [
        ("pass_by", {"not_found"}),
        ("touch", {"not_found"}),
        ("nudge", {"not_found"}),
        ("bystander", {"other_wearer"}),
        ("too_near", {"minimum_movement"}),
        ("early", {"too_short"}),
        ("two_handed", {"sequence"}),
        ("hand_over", {"sequence"}),
        ("same_place", {"sequence"}),
        ("contained", {"sequence"}),
    ],
)
def test_a_provocation_comes_to_what_it_should(tag: str, outcomes: set[str]) -> None:
    matches = staged_matches(Staging("adt", SEED, n_events=6, provocations=((tag, 0.6),)), 0)
    provoked = [m for m in matches if m.true is not None and m.true.tag == tag and not m.true.thin]
    assert provoked, "the performance holds none"
    assert [m.outcome for m in provoked] == [m.expected.replace("not_an_event", "not_found") for m in provoked]
    assert outcomes & {m.outcome for m in provoked}
    assert not [m for m in matches if m.true is None], "and nothing is found besides"


def test_lost_tracks_are_placed_or_reported() -> None:
    matches = staged_matches(Staging("adt", SEED, n_events=6, provocations=(("lost", 0.6),)), 1)
    lost = [m for m in matches if m.true is not None and m.true.tag == "lost"]
    assert lost
    assert all(m.found is not None for m in lost)


def test_native_files_give_what_the_recording_exit_gives(tmp_path: Path) -> None:
    synthesize_tree("adt", tmp_path / "tree", recordings=1, seed=SEED, size="tiny")
    from_files = verify_tree(tmp_path / "tree")
    assert broken(LEVELS[2], from_files) == []
    build_dataset("adt", tmp_path / "tree", tmp_path / "native")
    build_synthetic_table("adt", 1, SEED, tmp_path / "direct", n_events=6)
    native, direct = (SequenceTable.open(tmp_path / name) for name in ("native", "direct"))
    assert native.events().equals(direct.events())
    assert native.info.identity_digest == direct.info.identity_digest
    assert native.info.content_digest == direct.info.content_digest


def test_a_limit_is_broken_when_curation_is() -> None:
    """The check itself can fail: a rule that never holds anything finds nothing."""
    staging = Staging("adt", SEED)
    performance = staging.perform(0)
    manifest = load_manifest("adt")
    far = msgspec.structs.replace(manifest, in_hand=msgspec.structs.replace(manifest.in_hand, distance=0.001))
    curated = curate_recording(staging.sense(performance), far, load_protocol())
    result = verification(match_events(list(performance.events), list(curated.events)), recordings=1)
    assert "recall: 0.0" in broken(LEVELS[1], result)
