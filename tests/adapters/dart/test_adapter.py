from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.contract import Condition
from prbench.errors import AdapterError
from prbench_adapters import dart
from prbench_adapters.dart.adapter import parts_of_similar_cost
from prbench_adapters.dart.model import DartConfiguration
from tests.adapters.dart import tiny
from tests.adapters.diffusion.goal_batches import conditions

QUICK = {"iterations": "2"}
BATCH = conditions(Condition.GOAL_LOCATION, 2, frames=(11, 9))
"""Two sequences of one part; the first takes two primitives, the second one."""


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return tiny.write(tmp_path_factory.mktemp("weights") / "dart.safetensors", diffusion_steps=2)


def _generated(weights, batch, **options):
    return dart.load(weights, options={**QUICK, **options}, device="cpu").generate(batch, seed=0)


@pytest.mark.parametrize(("n_frames", "primitives"), [(1, 1), (2, 1), (10, 1), (11, 2), (18, 2), (242, 30)])
def test_a_motion_takes_as_many_primitives_as_cover_it(n_frames, primitives):
    assert DartConfiguration().primitives_for(n_frames) == primitives


@pytest.mark.parametrize("largest", [1, 7, 20, 1000])
def test_parts_hold_all_rows_once_the_longest_first_and_about_as_much(largest):
    primitives = np.array([3, 1, 5, 5, 2, 4])
    parts = parts_of_similar_cost(primitives, largest)
    assert sorted(np.concatenate(parts).tolist()) == list(range(6))
    assert (np.diff(primitives[np.concatenate(parts)]) <= 0).all()
    assert max(primitives[part].sum() for part in parts) < largest + 5
    assert len(parts) == min(6, -(-20 // largest))


@pytest.mark.parametrize("name", ["initial_joints", "previous_joints"])
@pytest.mark.parametrize(("value", "found"), [(np.nan, "not finite"), (0.0, "one vertical line")])
def test_an_initial_state_without_heading_is_refused(weights, name, value, found):
    poses = getattr(BATCH, name).copy()
    poses[1, 1:3] = value
    with pytest.raises(AdapterError, match=rf"(?s)row 1 .*{found}" if name == "previous_joints" else "row 1"):
        _generated(weights, replace(BATCH, **{name: poses}))


@pytest.mark.parametrize("change", [{"vae_layers": 4}, {"future_frames": 1}, {"width": 15}, {"layers": 0}])
def test_sizes_that_do_not_fit_together_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        DartConfiguration(**change)
