from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.contract import ConditionBatch
from prbench.errors import AdapterError
from prbench_adapters.diffusion import generation
from prbench_adapters.diffusion.generation import SamplingSettings, generate
from tests.adapters.diffusion import tiny

LENGTHS = [21, 10, 20, 33, 9, 5, 20, 40]  # neither sorted, nor inside the parts that are computed together
SETTINGS = {
    "ddpm": SamplingSettings(guidance=2.5),
    "ddim": SamplingSettings(guidance=2.5, sampler="ddim", steps=4),
    "one-pass": SamplingSettings(guidance=1.0),
}


@pytest.fixture(scope="module")
def model():
    return tiny.model()


def _one(batch: ConditionBatch, row: int) -> ConditionBatch:
    return batch.rows(row, row + 1)


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS.keys())
def test_a_motion_does_not_depend_on_the_batch_around_it(model, settings):
    batch = tiny.text_batch(LENGTHS)
    together = generate(model, batch, settings)
    assert together.joints.shape == (8, 40, 22, 3)
    for row, n in enumerate(LENGTHS):
        alone = generate(model, _one(batch, row), settings).joints[0]
        np.testing.assert_allclose(together.joints[row, :n], alone, rtol=0, atol=1e-4)
    assert np.abs(together.joints[0, :20] - together.joints[2, :20]).max() > 1e-2  # other seeds, other motions


def test_motions_do_not_depend_on_how_rows_are_put_together(model, monkeypatch):
    batch = tiny.text_batch(LENGTHS)
    as_planned = generate(model, batch, SETTINGS["ddpm"])
    monkeypatch.setattr(generation, "parts_of_similar_length", lambda n_frames, largest: [np.arange(len(n_frames))])
    in_one = generate(model, batch, SETTINGS["ddpm"])
    np.testing.assert_allclose(as_planned.ragged(), in_one.ragged(), rtol=0, atol=1e-4)


def test_the_same_seeds_give_the_same_bytes_and_other_seeds_do_not(model):
    first, second = (generate(model, tiny.text_batch(LENGTHS), SETTINGS["ddpm"]) for _ in range(2))
    assert np.array_equal(first.joints, second.joints)
    other = generate(model, tiny.text_batch(LENGTHS, first_seed=900), SETTINGS["ddpm"])
    assert np.abs(other.ragged() - first.ragged()).max() > 1e-2


def test_the_text_matters_only_where_it_is_heard(model):
    batch = tiny.text_batch([12, 12])
    swapped = dataclasses.replace(batch, text=tuple(reversed(tiny.TEXTS)))
    for guidance, heard in ((2.5, True), (1.0, True), (0.0, False)):
        settings = SamplingSettings(guidance=guidance, sampler="ddim")
        difference = generate(model, batch, settings).joints - generate(model, swapped, settings).joints
        assert bool(np.abs(difference).max() > 1e-3) is heard


@pytest.mark.parametrize(("name", "passes"), [("ddpm", 8 * 8 * 2), ("ddim", 8 * 4 * 2), ("one-pass", 8 * 8)])
def test_network_passes_are_declared_summed_over_the_batch(model, name, passes):
    cost = generate(model, tiny.text_batch(LENGTHS), SETTINGS[name]).cost
    assert cost is not None
    assert cost.network_passes == passes


def test_motions_start_over_the_origin_and_face_forward(model):
    joints = generate(model, tiny.text_batch([10]), SETTINGS["ddim"]).joints
    np.testing.assert_allclose(joints[0, 0, 0, [0, 2]], 0.0, atol=1e-6)
    assert joints.dtype == np.float32


def test_a_sequence_longer_than_the_model_knows_is_refused(model):
    with pytest.raises(AdapterError, match="at most 40 frames, and was asked for 41"):
        generate(model, tiny.text_batch([10, 41]), SETTINGS["ddpm"])


def test_no_gradients_are_kept(model):
    assert not any(parameter.requires_grad for parameter in model.denoiser.parameters())
