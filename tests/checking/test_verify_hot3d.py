"""Curation finds what was acted out at HOT3D's table.

Sources: docs/specification/synthetic-recordings.md#statistics and
docs/specification/synthetic-recordings.md#truth-record.
"""

from __future__ import annotations

import importlib.util
import itertools
from pathlib import Path

import numpy as np
import pytest

from prbench.curation import build_dataset, curate_recording
from prbench.curation.options import BuildOptions, CurationOptions
from prbench.harness.synthetic_table import Staging, build_synthetic_table
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.protocol.published import QUANTITIES, load_table_one
from prbench.sequences import SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from tests.checking.levels import LEVELS, MOSTLY_SLOW, SensorLevel, limits, verify_level, verify_tree

RECORDINGS, SEED = 3, 301


@pytest.mark.parametrize("level", MOSTLY_SLOW)
def test_events_and_primes_are_found_within_the_limits(level: SensorLevel) -> None:
    result = verify_level(level, preset="hot3d", recordings=RECORDINGS, seed=SEED)
    assert result.true_events >= 15
    assert [limit for limit in limits(level, result, preset="hot3d") if not limit.holds] == []


def test_native_files_give_what_the_recording_exit_gives(tmp_path: Path) -> None:
    synthesize_tree("hot3d", tmp_path / "tree", recordings=1, seed=SEED, size="tiny")
    from_files = verify_tree(tmp_path / "tree", dataset="hot3d")
    assert [limit for limit in limits(LEVELS[2], from_files, preset="hot3d") if not limit.holds] == []
    build_dataset("hot3d", tmp_path / "tree", tmp_path / "native")
    build_synthetic_table("hot3d", 1, SEED, tmp_path / "direct", n_events=6)
    native, direct = (SequenceTable.open(tmp_path / name) for name in ("native", "direct"))
    assert native.info.dataset == "synthetic-hot3d"
    assert native.events().equals(direct.events())
    assert native.info.identity_digest == direct.info.identity_digest
    assert native.info.content_digest == direct.info.content_digest


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
def test_statistics_are_within_a_third_of_the_spread_of_table_1() -> None:
    manifest, protocol = load_manifest("hot3d"), load_protocol()
    rows = []
    # Two seeds, because how far people move along their table differs by .8 of the spread between 90 sequences of one.
    for seed, index in itertools.product((0, 1), range(20)):
        staging = Staging("hot3d", seed, n_events=6, provocations=())
        for row in curate_recording(staging.sense(staging.perform(index)), manifest, protocol).sequences:
            gap = row.event_time - row.prime_time
            rows.append((gap + protocol.curation.lead, gap, row.body_movement, row.hand_movement))
    assert len(rows) > 120
    published = load_table_one()["hot3d"]
    for name, mean in zip(QUANTITIES, np.mean(rows, axis=0), strict=True):
        spread = getattr(published, name)
        assert abs(mean - spread.mean) < spread.sd / 3, name
