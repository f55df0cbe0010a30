"""Manifests and protocol load completely, and say what is wrong with them."""

from __future__ import annotations

import msgspec
import pytest

from prbench.errors import UsageError
from prbench.geometry.skeleton import N_JOINTS
from prbench.protocol.manifests import Manifest, dataset_names, load_manifest, load_protocol
from prbench.readers.adt.format import JOINT_NAMES


@pytest.mark.parametrize("name", dataset_names())
def test_every_manifest_is_complete(name):
    manifest = load_manifest(name)
    assert manifest.name == name
    assert len(manifest.body.joint_mapping) in (0, N_JOINTS)  # 0: the joints are native
    assert manifest.citation.strip().startswith("@") or name == "own", "nobody else can say what to cite"


def test_adt_joints_are_names_of_the_native_skeleton():
    for name in load_manifest("adt").body.joint_mapping:
        assert set(name.split("+")) <= set(JOINT_NAMES)


def test_protocol_holds_the_numbers_of_the_paper():
    protocol = load_protocol()
    assert (protocol.curation.priming_window, protocol.curation.near_miss_distance) == (10.0, 0.05)
    assert (protocol.metrics.prime_window, protocol.metrics.prime_duration) == (1.0, 0.1)
    assert (protocol.metrics.prime_distance, protocol.metrics.reach_distance) == (0.25, 0.10)
    assert protocol.metrics.location_error_distance == 0.5
    assert protocol.fps == 20.0


def test_an_unknown_key_is_refused():
    data = msgspec.to_builtins(load_manifest("adt")) | {"head_tillt": 3}
    with pytest.raises(msgspec.ValidationError, match="head_tillt"):
        msgspec.convert(data, Manifest)


def test_unknown_names_are_answered_with_the_known_ones():
    with pytest.raises(UsageError, match=r"known ones are: .*adt"):
        load_manifest("atd")
    with pytest.raises(UsageError, match="its alternatives are: wrist"):
        load_manifest("adt").in_hand_rule("elbow")


def test_known_bad_recordings_are_found_by_their_beginning():
    manifest = load_manifest("adt")
    assert manifest.why_bad("Apartment_release_clean_seq139_M1292")
    assert manifest.why_bad("Apartment_release_clean_seq1390_M1292") is None


def test_whoever_uses_estimated_bodies_is_told_to_cite_their_method() -> None:
    for name in dataset_names():
        manifest = load_manifest(name)
        for body in (manifest.body, *manifest.other_bodies.values()):
            assert ("yi2025egoallo" in body.citation) == (body.pose_source == "egoallo")
