"""Golden motions of the original conversion, at the page's tolerances (docs/specification/humanml3d.md#tolerances)."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from prbench.representation import (
    BLOCKS,
    REST_OFFSETS,
    canonicalise,
    decode,
    encode,
    retarget,
    tensors,
)
from prbench.representation.features import (
    CONTACT_JOINTS,
    CONTACT_THRESHOLD,
    FRAME_RATE,
    N_FEATURES,
    REST_DIRECTIONS,
)
from tests.representation.motions import GOLDEN, decode_rotations, golden

TOLERANCES = dict.fromkeys(BLOCKS, 2e-5) | {"joint_rotations": 1e-4, "foot_contacts": 0.0}


def assert_features(features: np.ndarray, expected: np.ndarray) -> None:
    assert features.shape == expected.shape
    for name, columns in BLOCKS.items():
        assert np.abs(features[:, columns] - expected[:, columns]).max() <= TOLERANCES[name], name


@pytest.mark.parametrize("case", GOLDEN)
def test_features_of_the_original_from_its_own_input(samples, case):
    values = golden(samples, case)
    canonical = canonicalise(retarget(values["joints_in"], offsets=values["target_offsets"]))
    assert np.abs(canonical - values["canonical"]).max() < 2e-5
    assert_features(encode(canonical, mode="reference"), values["features"])


@pytest.mark.parametrize("case", GOLDEN)
def test_joints_of_the_original_from_positions_and_from_rotations(samples, case):
    values = golden(samples, case)
    features = values["features"]
    assert np.abs(decode(features) - values["recovered_ric"]).max() < 2e-5
    assert np.abs(tensors.decode(torch.from_numpy(features)).numpy() - values["recovered_ric"]).max() < 2e-5
    from_rotations = decode_rotations(features, values["target_offsets"])
    assert np.abs(from_rotations - values["recovered_rot"]).max() < 2e-5


@pytest.mark.parametrize("case", GOLDEN)
def test_only_the_passage_of_the_opposite_heading_loses_anything_and_only_in_reference_mode(samples, case):
    canonical = golden(samples, case)["canonical"]
    assert np.abs(decode(encode(canonical)) - canonical[:-1]).max() < 1e-6
    lost = np.abs(decode(encode(canonical, mode="reference")) - canonical[:-1]).max()
    assert lost > 0.1 if case == "antipode" else lost < 1e-6


def test_the_modes_differ_in_one_number_a_passage(samples):
    canonical = golden(samples, "antipode")["canonical"]
    continuous, reference = encode(canonical), encode(canonical, mode="reference")
    rows = np.flatnonzero(np.abs(continuous[:, 0] - reference[:, 0]) > 1e-5)
    assert len(rows) == 1
    assert continuous[rows[0], 0] == pytest.approx(-reference[rows[0], 0], abs=1e-5)
    assert np.abs(continuous[:, 1:] - reference[:, 1:]).max() < 1e-4


def test_constants_are_those_of_the_skeleton_file(samples):
    skeleton = json.loads((samples / "humanml3d" / "skeleton.json").read_text())
    assert np.allclose(skeleton["target_offsets"], REST_OFFSETS, atol=1e-9)
    assert np.array_equal(skeleton["raw_offsets"], REST_DIRECTIONS)
    assert [*CONTACT_JOINTS] == [*skeleton["left_foot"], *skeleton["right_foot"]]
    assert (skeleton["foot_threshold_sq_m2"], skeleton["fps"]) == (CONTACT_THRESHOLD, FRAME_RATE)
    bounds = [tuple(pair) for pair in skeleton["feature_slices"].values()]
    assert [(block.start, block.stop) for block in BLOCKS.values()] == bounds
    assert bounds[-1][1] == N_FEATURES
