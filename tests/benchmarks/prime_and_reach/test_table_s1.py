"""ADT built twice, with the suit's bodies and with EgoAllo's (the study's table S1): only the bodies differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prbench.cli.main import main
from prbench.sequences import SequenceTable

SHARED = ("recording_id", "object_id", "action", "hand", "event_time", "prime_time", "prime_kind", "location")


@pytest.fixture(scope="module")
def tables(tmp_path_factory) -> dict[str, SequenceTable]:
    folder: Path = tmp_path_factory.mktemp("s1")
    tree = folder / "ADT"
    assert main(["synthesize", "adt", "--out", str(tree), "--seed", "8", "--events", "4", "--egoallo"]) == 0
    built = {}
    for poses in ("native", "egoallo"):
        arguments = ["build-dataset", "adt", "--root", str(tree), "--out", str(folder / poses)]
        arguments += ["--option", f"poses={poses}"]
        assert main(arguments) == 0
        built[poses] = SequenceTable.open(folder / poses)
    return built


def _events(table: SequenceTable) -> list[tuple]:
    return [tuple(str(row[name]) for name in SHARED) for row in table.events().to_pylist()]


def test_events_and_primes_are_the_same(tables):
    assert _events(tables["native"]) == _events(tables["egoallo"])
    assert len(_events(tables["native"])) == 8


def _bodies(table: SequenceTable) -> dict[str, tuple[str, float, np.ndarray]]:
    """Pose source, head tilt and joints of every sequence, by its event."""
    found = {}
    for chunk in table.chunks():
        joints = np.split(chunk.joints, chunk.offsets[1:-1])
        rows = zip(
            chunk.sequence_ids, chunk.strings("pose_source"), chunk.numbers("head_tilt_deg"), joints, strict=True
        )
        found |= {name.rpartition("/")[0]: (source, tilt, frames) for name, source, tilt, frames in rows}
    return found


def test_bodies_differ_by_what_an_estimate_is_off(tables):
    suit, estimated = _bodies(tables["native"]), _bodies(tables["egoallo"])
    both = suit.keys() & estimated.keys()
    assert len(both) >= max(len(suit), len(estimated)) - 1  # a wrist may cross the 20 cm of the last filter
    for event in both:
        assert [body[:2] for body in (suit[event], estimated[event])] == [("adt-optitrack", 7.4), ("egoallo", 38.3)]
        distance = np.linalg.norm(suit[event][2] - estimated[event][2], axis=-1)
        assert 0.002 < distance.mean() < 0.08


def test_the_option_stands_in_the_provenance(tables):
    assert "egoallo" in str(tables["egoallo"].info.options)
    assert "egoallo" not in str(tables["native"].info.options)
