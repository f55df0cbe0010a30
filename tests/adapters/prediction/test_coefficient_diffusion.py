"""What holds for any weights: sizes, seeds, conditions, layouts, bad input."""

from __future__ import annotations

import pytest
import torch

from prbench.randomness import noise_seed
from prbench_adapters.prediction.coefficient_diffusion import CoefficientDiffusion, PreparedCondition, held, padded
from prbench_adapters.prediction.configuration import PRESETS, preset

TINY = {
    "n_joints": 4,
    "width": 16,
    "heads": 4,
    "feed_forward": 24,
    "encoder_width": 8,
    "encoder_heads": 2,
    "diffusion_steps": 40,
    "sampling_steps": 8,
}


def _tiny(name="gazemodiff", **changes):
    torch.manual_seed(3)
    model = CoefficientDiffusion(preset(name, **{**TINY, **changes})).eval()
    for layer in model.denoiser.modules():
        # Layers that start at zero would hide what the condition does.
        if isinstance(layer, torch.nn.Linear):
            torch.nn.init.normal_(layer.weight, std=0.2)
    return model


def _observed(model, windows=2):
    generator = torch.Generator().manual_seed(5)
    return torch.randn(windows, 15, model.configuration.nodes, 3, generator=generator)


def _seeds(windows, samples):
    return [[noise_seed(1, f"window {window}", sample) for sample in range(samples)] for window in range(windows)]


def _count(module):
    return sum(parameter.numel() for parameter in module.parameters())


@pytest.mark.parametrize(("joints", "encoder", "denoiser"), [(21, 930_455, 19_078_738), (23, 996_087, 19_140_232)])
def test_gazemodiff_has_the_published_number_of_parameters(joints, encoder, denoiser):
    model = CoefficientDiffusion(preset("gazemodiff", n_joints=joints))
    assert (_count(model.encoder), _count(model.denoiser)) == (encoder, denoiser)


@pytest.mark.parametrize(
    ("name", "joints", "expected"), [("humanmac", 21, 14_580_799), ("humanmac-gaze", 23, 14_636_104)]
)
def test_humanmac_has_the_published_number_of_parameters(name, joints, expected):
    assert _count(CoefficientDiffusion(preset(name, n_joints=joints))) == expected


def test_samples_depend_on_their_seeds_alone():
    # In float64: how many samples share a matrix product changes their rounding.
    model = _tiny().double()
    observed = _observed(model, 3).double()
    seeds = _seeds(3, 5)
    many = model.predict(observed, seeds)
    assert many.shape == (3, 5, 60, 5, 3)
    few = model.predict(observed[1:2], [seeds[1][:2]])
    torch.testing.assert_close(few[0], many[1, :2], rtol=0, atol=1e-9)
    assert (many[:, 0] - many[:, 1]).abs().max() > 0.1


def test_encoding_the_same_observation_twice_gives_the_same_condition():
    model = _tiny()
    known = model.transform(torch.randn(2, 75, 5, 3))
    assert torch.equal(model.condition(known), model.condition(known))


def test_gaze_changes_the_prediction_and_its_absence_removes_the_node():
    model = _tiny()
    observed = _observed(model)
    turned = observed.clone()
    turned[:, :, -1] *= -1.0
    seeds = _seeds(2, 1)
    assert (model.predict(observed, seeds) - model.predict(turned, seeds))[..., :4, :].abs().max() > 1e-3
    without = _tiny("no-gaze")
    assert without.predict(observed[:, :, :4], seeds).shape == (2, 1, 60, 4, 3)


def test_gaze_that_was_not_measured_leaves_no_trace():
    model = _tiny()
    observed = _observed(model)
    valid = torch.ones(2, 15, dtype=torch.bool)
    valid[:, [0, 7, 14]] = False
    other = observed.clone()
    other[:, [0, 7, 14], -1] = 9.0
    seeds = _seeds(2, 1)
    assert torch.equal(model.predict(held(observed, valid), seeds), model.predict(held(other, valid), seeds))
    valid[1] = False
    with pytest.raises(ValueError, match="window 1 of the batch has no valid gaze"):
        held(observed, valid)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_learns_and_predicts(name):
    model = _tiny(name)
    motion = torch.randn(2, 75, model.configuration.nodes, 3)
    noise = torch.randn(2, model.configuration.coefficients, model.configuration.values)
    kept = torch.tensor([True, False])
    loss = model.loss(motion, torch.tensor([1, 30]), noise, kept)
    loss.backward()
    without = [key for key, parameter in model.named_parameters() if parameter.grad is None]
    assert without == []
    prediction = model.predict(motion[:, :15], _seeds(2, 2))
    assert prediction.shape == (2, 2, 60, model.configuration.nodes, 3)
    assert prediction.isfinite().all()


def test_dropping_both_paths_leaves_nothing_of_the_condition():
    model = _tiny()
    noisy, step = torch.randn(2, 1, 10, 15), torch.tensor([3])
    first, second = torch.randn(2, 10, 15), torch.randn(2, 10, 15)
    none = torch.zeros(2, dtype=torch.bool)
    both = [model.denoiser(noisy, step, model._prepared(condition, none)) for condition in (first, second)]
    assert torch.equal(*both)
    vector = _tiny(dropped="vector")
    left = [vector.denoiser(noisy, step, vector._prepared(condition, none)) for condition in (first, second)]
    assert (left[0] - left[1]).abs().max() > 1e-3


def test_guidance_weighs_the_condition():
    known = _tiny().transform(torch.randn(2, 75, 5, 3))
    draws = torch.randn(9, 2, 3, 10, 15)
    states = {}
    for guidance in (0.0, 1.0, 2.0):
        model = _tiny(guidance=guidance, sampling_steps=8)
        noise = iter(draws).__next__
        states[guidance] = next(model.states(known, model.condition(known), noise))
    torch.testing.assert_close(states[2.0] - states[1.0], states[1.0] - states[0.0], rtol=0, atol=1e-4)
    assert (states[1.0] - states[0.0]).abs().max() > 1e-4


def test_each_sample_keeps_its_condition_or_not_whatever_its_batch():
    model = _tiny("humanmac", condition_kept_sampling=0.5).double()
    observed, seeds = _observed(model, 1).double(), _seeds(1, 8)
    always = _tiny("humanmac").double().predict(observed, seeds)
    sometimes = model.predict(observed, seeds)
    same = ((always - sometimes).abs().amax(dim=(2, 3, 4)) < 1e-9)[0]
    assert 0 < int(same.sum()) < 8
    torch.testing.assert_close(model.predict(observed, [seeds[0][:3]])[0], sometimes[0, :3], rtol=0, atol=1e-9)


def test_the_legacy_layout_mixes_axes_as_measured():
    model = _tiny("gazemodiff-code", n_joints=21)
    named = torch.arange(10 * 66, dtype=torch.float32).view(1, 10, 66)
    gaze = model.encoder.nodes(named)[0, :, 21]
    assert gaze[2].tolist() == [9 * 66 + value for value in range(56, 66)]
    assert gaze[0].tolist() == [3 * 66 + value for value in range(12, 22)]
    assert torch.equal(model.encoder.flat(model.encoder.nodes(named)), named)
    plain = _tiny(n_joints=21)
    assert plain.encoder.nodes(named)[0, 1, 21].tolist() == [k * 66 + 64 for k in range(10)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"layers": 3}, "'layers' must be even"),
        ({"sampling_steps": 7}, "must divide the 40 diffusion steps"),
        ({"coefficients": 76}, "at most the 75 frames"),
        ({"width": 18}, "divisible by 'heads'"),
        ({"n_joints": 0}, "'n_joints' must be at least 1"),
        ({"condition_kept": 1.5}, "'condition_kept' must be from 0 to 1"),
        ({"fusion_dropout": 1.0}, "'fusion_dropout' must be at least 0 and below 1"),
        ({"guidance": 2.0, "condition_kept_sampling": 0.5}, "both drop the condition"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        preset("gazemodiff", **{**TINY, **changes})


def test_unknown_presets_are_refused_with_those_that_exist():
    with pytest.raises(ValueError, match="'mac'; there are gazemodiff, "):
        preset("mac", n_joints=21)


def test_other_observations_and_no_samples_are_refused():
    model = _tiny()
    with pytest.raises(ValueError, match=r"expected observations of shape \(1, 15, 5, 3\), found \(1, 15, 4, 3\)"):
        model.predict(torch.zeros(1, 15, 4, 3), [[1]])
    with pytest.raises(ValueError, match="at least one sample"):
        model.predict(torch.zeros(1, 15, 5, 3), [[]])


class _Oracle(torch.nn.Module):
    """Knows the clean coefficients, and answers with the noise or the velocity that belongs to them."""

    def __init__(self, clean, levels, predicts):
        super().__init__()
        self.clean, self.levels, self.predicts = clean[:, None], torch.from_numpy(levels).float(), predicts

    def prepare(self, condition, kept):
        return PreparedCondition(condition.mean(dim=1)[:, None], ())

    def forward(self, state, step, prepared):
        level = self.levels[step]
        noise = (state - level.sqrt() * self.clean) / (1.0 - level).sqrt()
        if self.predicts == "noise":
            return noise
        return level.sqrt() * noise - (1.0 - level).sqrt() * self.clean


@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("predicts", ["noise", "velocity"])
def test_whoever_knows_the_future_predicts_it(predicts, residual):
    model = _tiny("humanmac", predicts=predicts, residual=residual, n_joints=2)
    frames = torch.arange(75)[:, None, None] / 30.0
    motion = torch.tensor([0.3, 0.1, 0.2]) * frames * torch.ones(1, 75, 2, 3)
    observed = motion[:, :15]
    clean = model.transform(motion)
    if residual:
        clean = clean - model.transform(padded(observed, 75))
    model.denoiser = _Oracle(clean, model.schedule.alphas_cumprod, predicts)
    predicted = model.predict(observed, _seeds(1, 2))
    # Ten coefficients and the noise that the last level keeps leave centimetres.
    assert float((predicted - motion[:, None, 15:]).abs().max()) < 0.08


@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("predicts", ["noise", "velocity"])
def test_whoever_knows_the_future_has_no_loss(predicts, residual):
    model = _tiny("humanmac", predicts=predicts, residual=residual, n_joints=2)
    motion = torch.randn(1, 75, 2, 3, generator=torch.Generator().manual_seed(2))
    clean = model.transform(motion)
    if residual:
        clean = clean - model.transform(padded(motion[:, :15], 75))
    model.denoiser = _Oracle(clean, model.schedule.alphas_cumprod, predicts)
    loss = model.loss(motion, torch.tensor([7]), torch.randn(clean.shape))
    assert float(loss) < 1e-8
