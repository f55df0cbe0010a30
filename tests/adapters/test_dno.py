from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.contract import Condition
from prbench.geometry.skeleton import Joint
from prbench_adapters import dno
from tests.adapters.diffusion import tiny
from tests.adapters.diffusion.goal_batches import conditions

QUICK = {"iterations": "3", "ddim-steps": "2"}
BATCH = conditions(Condition.GOAL_LOCATION, 2, frames=(9, 6))


@pytest.fixture(scope="module")
def prior(tmp_path_factory):
    return tiny.write(tmp_path_factory.mktemp("weights") / "prior.safetensors")


def test_another_goal_gives_another_motion_and_the_wrist_comes_nearer(prior):
    options = {"iterations": "40", "ddim-steps": "2", "decorrelation": "0", "learning-rate": "0.3"}
    adapter = dno.load(prior, options={**options, "optimise": "paper"}, device="cpu")
    given = conditions(Condition.GOAL_LOCATION, 1, frames=(8,))
    near, far = (
        adapter.generate(replace(given, goal_location=np.float32([goal])), seed=0)
        for goal in ((0.1, 1.0, 0.1), (0.5, 1.3, 0.4))
    )
    wrists = [motions.joints[0, -1, Joint.RIGHT_WRIST] for motions in (near, far)]
    assert np.linalg.norm(wrists[0] - [0.1, 1.0, 0.1]) < np.linalg.norm(wrists[1] - [0.1, 1.0, 0.1])
    assert np.linalg.norm(wrists[1] - [0.5, 1.3, 0.4]) < np.linalg.norm(wrists[0] - [0.5, 1.3, 0.4])


def test_the_text_is_empty_unless_asked_for(prior):
    def generated(**options):
        adapter = dno.load(prior, options={**QUICK, **options}, device="cpu")
        return [adapter.generate(replace(BATCH, text=(text,) * 2), seed=0).joints for text in ("picks", "puts")]

    without, own, fixed = generated(), generated(prompt="own"), generated(prompt="picks")
    np.testing.assert_array_equal(without[0], without[1])
    assert not np.array_equal(own[0], own[1])
    np.testing.assert_array_equal(fixed[1], own[0])


def test_the_modes_are_those_of_the_page(prior, tmp_path):
    def settings(path, **options):
        return dno.load(path, options=options, device="cpu").settings

    assert settings(prior).ddim_steps * (settings(prior).iterations + 1) <= 160
    paper = settings(prior, optimise="paper")
    assert (paper.ddim_steps, paper.iterations, paper.learning_rate) == (8, 400, 0.05)
    long = tiny.write(tmp_path / "long.safetensors", diffusion_steps=1000)
    assert settings(long, optimise="paper").ddim_steps == 10
