"""Do the people move as people do? Limits: docs/specification/synthetic-recordings.md#plausibility."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint
from prbench.synthetic.people import PRESETS
from prbench.synthetic.performance import Performance
from tests.synthetic.plausibility import checks, measure


@pytest.mark.slow
@pytest.mark.parametrize("preset", PRESETS)
def test_every_number_of_twenty_recordings_lies_within_its_limit(
    crowds: dict[str, list[Performance]], preset: str
) -> None:
    broken = [(check.name, check.value) for check in checks(measure(crowds[preset])) if not check.holds]
    assert broken == []


def _failing(performance: Performance) -> set[str]:
    return {check.name for check in checks(measure([performance])) if not check.holds}


def test_a_foot_that_drifts_while_planted_is_noticed(adt_120: Performance) -> None:
    joints = adt_120.joints.copy()
    joints[:, Joint.LEFT_FOOT, 0] += 0.002 * adt_120.times  # 2 mm a second
    assert "planted_slide" in _failing(replace(adt_120, joints=joints))


def test_a_knee_that_bends_backwards_is_noticed(adt_120: Performance) -> None:
    joints = adt_120.joints.copy()
    hip, ankle = joints[:, Joint.LEFT_HIP], joints[:, Joint.LEFT_ANKLE]
    along = (ankle - hip) / np.linalg.norm(ankle - hip, axis=1, keepdims=True)
    offset = joints[:, Joint.LEFT_KNEE] - hip
    parallel = (offset * along).sum(axis=1, keepdims=True) * along
    joints[:, Joint.LEFT_KNEE] = hip + 2 * parallel - offset  # mirrored in the line from hip to ankle
    assert _failing(replace(adt_120, joints=joints)) == {"knees_bent_backwards"}


def test_feet_that_walk_at_half_speed_skate(adt_120: Performance) -> None:
    joints = adt_120.joints.copy()
    joints[..., [0, 2]] += 0.8 * (joints[:, :1, [0, 2]] - joints[:1, :1, [0, 2]])  # the floor slips away
    assert {"foot_skating_mean", "planted_slide"} <= _failing(replace(adt_120, joints=joints))


def test_a_growing_bone_is_noticed(adt_120: Performance) -> None:
    joints = adt_120.joints.copy()
    joints[-1, Joint.HEAD, 1] += 1e-6
    assert "bone_length_change" in _failing(replace(adt_120, joints=joints))
