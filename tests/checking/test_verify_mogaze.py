"""Curation of synthetic MoGaze finds what was acted out, and its table resembles the published row."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.curation import build_dataset
from prbench.harness.synthetic_table import Staging, build_synthetic_table
from prbench.protocol.published import Spread
from prbench.sequences import SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from tests.checking.levels import LEVELS, MOSTLY_SLOW, SensorLevel, limits, staged_matches, verify_level, verify_tree
from tests.synthetic.behaviour import TARGETS, SequenceStatistics

RECORDINGS, EVENTS, SEED = 2, 6, 301
TABLE_SEED = 1


@pytest.mark.parametrize("level", MOSTLY_SLOW)
def test_events_and_primes_are_found_within_the_limits(level: SensorLevel) -> None:
    result = verify_level(level, preset="mogaze", recordings=RECORDINGS, n_events=EVENTS, seed=SEED)
    assert result.true_events >= 8
    assert [f"{limit.name}: {limit.value}" for limit in limits(level, result) if not limit.holds] == []
    assert result.recall == result.precision == 1.0, "the dataset annotates its events"
    assert result.timing.largest <= 1 / 120


@pytest.mark.parametrize("tag", ["pass_by", "touch", "nudge", "hinge", "two_handed", "contained", "too_near", "lost"])
def test_a_provocation_comes_to_what_it_should(tag: str) -> None:
    matches = staged_matches(Staging("mogaze", SEED, n_events=3, provocations=((tag, 0.6),)), 0)
    assert not [match for match in matches if match.true is None], "nothing is found besides"
    provoked = [match for match in matches if match.true is not None and match.true.tag == tag and not match.true.thin]
    assert [m.outcome for m in provoked] == [m.expected.replace("not_an_event", "not_found") for m in provoked]


def test_native_files_give_what_the_recording_exit_gives(tmp_path: Path) -> None:
    synthesize_tree("mogaze", tmp_path / "tree", recordings=1, seed=SEED, n_events=2)
    from_files = verify_tree(tmp_path / "tree", dataset="mogaze")
    assert [limit.name for limit in limits(LEVELS[2], from_files) if not limit.holds] == []
    build_dataset("mogaze", tmp_path / "tree", tmp_path / "native")
    build_synthetic_table("mogaze", 1, SEED, tmp_path / "direct", n_events=2)
    native, direct = (SequenceTable.open(tmp_path / name) for name in ("native", "direct"))
    assert native.info.dataset == "synthetic-mogaze"
    assert native.events().equals(direct.events())
    assert native.info.identity_digest == direct.info.identity_digest
    assert native.info.content_digest == direct.info.content_digest


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_a_table_of_twelve_recordings_resembles_table_1(tmp_path: Path) -> None:
    build_synthetic_table("mogaze", 12, TABLE_SEED, tmp_path / "table", n_events=6)
    rows = SequenceTable.open(tmp_path / "table").scalars()
    gap, body, hand = (rows[name].to_numpy() for name in ("prime_gap", "body_movement", "hand_movement"))
    spreads = [Spread(float(values.mean()), float(values.std())) for values in (gap + 2.0, gap, body, hand)]
    deviations = SequenceStatistics(*spreads).deviations(TARGETS["mogaze"])
    assert {name: value for name, value in deviations.items() if abs(value) > 1 / 3} == {}
