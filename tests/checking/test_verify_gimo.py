"""Curation of GIMO finds the annotated picks, and primes them towards the wrist."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.curation import build_dataset, curate_recording
from prbench.harness.synthetic_table import Staging, build_synthetic_table
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.sequences import SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from tests.checking.levels import MOSTLY_SLOW, limits, verify_level, verify_tree
from tests.synthetic.behaviour import TARGETS

SEED = 301


@pytest.mark.parametrize("level", MOSTLY_SLOW)
@pytest.mark.unchecked_shapes
def test_events_and_primes_are_found_within_the_limits(level) -> None:
    """All limits apply; events are annotated, so recall and precision say that no row is lost or invented."""
    result = verify_level(level, preset="gimo", recordings=4, seed=SEED)
    assert result.true_events >= 20
    assert [limit for limit in limits(level, result, preset="gimo") if not limit.holds] == []


@pytest.mark.unchecked_shapes
def test_native_files_give_what_the_recording_exit_gives(tmp_path) -> None:
    synthesize_tree("gimo", tmp_path / "tree", recordings=1, seed=SEED, n_events=3, provocations={})
    result = verify_tree(tmp_path / "tree", dataset="gimo")
    assert (result.recall, result.precision) == (1.0, 1.0)
    assert result.true_events + result.thin == 3
    assert result.timing.largest < 1 / 30
    build_dataset("gimo", tmp_path / "tree", tmp_path / "native")
    build_synthetic_table("gimo", 1, SEED, tmp_path / "direct", n_events=3, provocations={})
    native, direct = (SequenceTable.open(tmp_path / name) for name in ("native", "direct"))
    assert native.events().equals(direct.events())
    assert native.info.identity_digest == direct.info.identity_digest
    assert native.info.content_digest == direct.info.content_digest


@pytest.mark.slow
@pytest.mark.unchecked_shapes
def test_the_row_of_table_1_is_met_within_a_third_of_its_spread() -> None:
    staging = Staging("gimo", SEED, n_events=6)
    rows = [
        (sequence.prime_gap + 2.0, sequence.prime_gap, sequence.body_movement, sequence.hand_movement)
        for index in range(12)
        for sequence in curate_recording(
            staging.sense(staging.perform(index)), load_manifest("gimo"), load_protocol()
        ).sequences
    ]
    assert len(rows) >= 60
    target = TARGETS["gimo"]
    study = (target.duration, target.gap, target.body, target.hand)
    means = np.mean(rows, axis=0)
    deviations = [(mean - each.mean) / each.sd for mean, each in zip(means, study, strict=True)]
    assert np.abs(deviations).max() < 1 / 3, deviations
