"""GazeMoDiff and HumanMAC: the values of the published programs, check values, and what holds for any weights."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch.nn import functional

from prbench.randomness import noise_seed
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.prediction.coefficient_diffusion import (
    CoefficientDiffusion,
    ConditionEncoder,
    GraphAttention,
    PreparedCondition,
    Whitening,
    WindowDCT,
    dct_rows,
    held,
    padded,
)
from prbench_adapters.prediction.configuration import PRESETS, preset
from tests.adapters.prediction.golden import (
    agree,
    agree_in_gradient,
    load,
    load_denoiser,
    load_encoder,
    tensor,
    weights,
)


def test_rows_of_constant_and_rising_values():
    rows = dct_rows(4, 75)
    assert (rows @ torch.ones(75).double()).tolist() == pytest.approx([8.660254, 0, 0, 0], abs=1e-6)
    rising = rows @ torch.arange(75).double()
    assert rising.tolist() == pytest.approx([320.429399, -186.125290, 0, -20.668473], abs=1e-6)


@pytest.mark.parametrize(("hertz", "share"), [(0.5, 0.9995), (1.0, 0.9934), (2.0, 0.7442), (2.5, 0.2233)])
def test_ten_coefficients_keep_slow_movements_only(hertz, share):
    wave = torch.sin(2 * math.pi * hertz * torch.arange(75).double() / 30)
    assert float((dct_rows(10, 75) @ wave).norm() / wave.norm()) == pytest.approx(share, abs=1e-4)


def test_a_walking_body_is_off_by_centimetres_after_truncation():
    transform = WindowDCT(10, 15, 75)
    walk = torch.zeros(1, 75, 1, 3).double()
    walk[0, :, 0, 0] = 1.4 / 30 * torch.arange(75)
    error = (transform.inverse(transform(walk)) - walk).norm(dim=-1)[0, :, 0]
    assert float(error[15:].mean()) == pytest.approx(0.0074, abs=1e-4)
    assert float(error[-1]) == pytest.approx(0.0494, abs=1e-4)
    frozen = padded(walk[:, :15], 75)
    assert float((transform.inverse(transform(frozen)) - frozen)[0, 14, 0, 0].abs()) == pytest.approx(0.031, abs=1e-3)


def test_completion_equals_the_exchange_of_frames():
    transform = WindowDCT(10, 15, 75)
    own, known = torch.randn(3, 2, 10, 6).double(), torch.randn(3, 1, 10, 6).double()
    frames = transform.inverse(own).clone()
    frames[:, :, :15] = transform.inverse(known)[:, :, :15]
    torch.testing.assert_close(transform.completed(own, known), transform(frames))


def test_padding_repeats_the_last_frame_and_the_last_measured_gaze():
    observed = torch.arange(4.0).view(1, 4, 1, 1).expand(1, 4, 2, 3)
    filled = padded(held(observed, torch.tensor([[False, True, False, False]])), 6)
    assert filled[0, :, 0, 0].tolist() == [0, 1, 2, 3, 3, 3]
    assert filled[0, :, 1, 0].tolist() == [1] * 6
    with pytest.raises(ValueError, match="4 frames does not fit into a window of 3"):
        padded(observed, 3)


def test_schedule_of_1500_steps():
    schedule = CosineSchedule(1500)
    for index, value in ((0, 2.698328e-5), (750, 2.103810e-3), (1499, 0.999)):
        assert schedule.betas[index] == pytest.approx(value, rel=1e-6)
    for index, value in ((0, 0.9999730167), (1, 0.9999438753), (16, 0.9992478880), (751, 0.4917657159)):
        assert schedule.alphas_cumprod[index] == pytest.approx(value, abs=1e-10)
    assert schedule.alphas_cumprod[1486] == pytest.approx(1.824164e-4, rel=1e-6)


@pytest.fixture
def layer():
    found = GraphAttention(1, 1, 2, 2, 1)
    with torch.no_grad():
        for parameter in found.parameters():
            parameter.zero_()
        found.channels.fill_(1.0)
    return found.requires_grad_(False)


GRAPH = torch.tensor([[[[1.0, 3.0], [5.0, 9.0]]]])


def test_without_scores_every_entry_is_the_mean(layer):
    assert torch.equal(layer(GRAPH), torch.full((1, 1, 2, 2), 4.5))


def test_what_is_aggregated_passes_two_leaky_rectifiers_in_the_paper_s_layer():
    leaky = GraphAttention(1, 1, 2, 2, 1, leaky=True).requires_grad_(False)
    for parameter in leaky.parameters():
        parameter.zero_()
    leaky.channels.fill_(1.0)
    torch.testing.assert_close(leaky(-GRAPH), torch.full((1, 1, 2, 2), -4.5 * 0.2 * 0.2))
    torch.testing.assert_close(leaky(GRAPH), torch.full((1, 1, 2, 2), 4.5))


def test_the_paper_s_encoder_ends_within_one_and_without_its_input():
    tiny = {"n_joints": 3, "encoder_width": 4}
    nodes = 50 * torch.randn(2, 3, 3, 10)
    ends = {}
    for name in ("gazemodiff", "gazemodiff-paper"):
        encoder = ConditionEncoder(preset(name, **tiny, encoder_heads=2)).eval().pose
        ends[name] = encoder(nodes).abs().max()
    assert ends["gazemodiff-paper"] <= 1.0 < ends["gazemodiff"]


def test_the_paper_s_cross_attention_is_its_equation_5(monkeypatch):
    shape = preset("gazemodiff-paper", n_joints=2, width=8, heads=2, encoder_width=4)
    model = CoefficientDiffusion(shape).eval()
    cross = model.denoiser.blocks[0].cross
    assert cross is not None
    monkeypatch.setattr(cross.style, "forward", lambda weighed, _: weighed)  # what comes before the stylisation
    stream, condition = torch.randn(2, 3, 10, 8), torch.randn(2, 10, shape.values)
    found = cross(stream, torch.zeros(1), cross.memory(condition))
    queries, values = (condition @ part.T for part in cross.key_value.weight.split(8))
    values = functional.layer_norm(values, (8,))
    keys = functional.layer_norm(stream, (8,)) @ cross.query.weight.T
    for head in (slice(0, 4), slice(4, 8)):
        for sample in range(3):
            memory = keys[1, sample, :, head].softmax(dim=0).T @ values[1, :, head]
            expected = queries[1, :, head].softmax(dim=1) @ memory
            torch.testing.assert_close(found[1, sample, :, head], expected)


def test_scores_of_the_token_that_is_looked_at(layer):
    layer.over_steps[0, 1, 0] = 1.0
    layer.over_nodes[0, 1, 0] = 1.0
    torch.testing.assert_close(layer(GRAPH), torch.full((1, 1, 2, 2), 8.5051), rtol=0, atol=1e-4)


def test_sums_of_two_dot_products_equal_scores_of_pairs():
    torch.manual_seed(1)
    layer = GraphAttention(3, 4, 5, 6, 2)
    stream = torch.randn(2, 3, 5, 6)

    def of_pairs(tokens, weights):
        n = tokens.shape[1]
        pairs = torch.cat([tokens[:, :, None].expand(-1, -1, n, -1), tokens[:, None].expand(-1, n, -1, -1)], dim=-1)
        scores = functional.leaky_relu(torch.einsum("bijf,hf->bhij", pairs, weights.flatten(1)), 0.2)
        return scores.softmax(dim=-1).mean(dim=1)

    steps = stream.permute(0, 3, 2, 1)
    mixed = torch.einsum("bij,bjnc->binc", of_pairs(steps.flatten(2), layer.over_steps), steps) @ layer.channels
    nodes = mixed.transpose(1, 2)
    expected = torch.einsum("bij,bjsc->bisc", of_pairs(nodes.flatten(2), layer.over_nodes), nodes).permute(0, 3, 1, 2)
    torch.testing.assert_close(layer(stream), expected + layer.bias)


@pytest.fixture
def coefficients() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    mixed = torch.randn((500, 4, 9), generator=generator) @ torch.randn((9, 9), generator=generator)
    return mixed * torch.tensor([4.0, 2.0, 1.0, 0.5])[:, None]


def test_whitened_numbers_have_unit_spread_and_go_back_to_metres(coefficients):
    whitening = Whitening(4, 9)
    whitening.take(coefficients)
    whitened = whitening(coefficients)
    torch.testing.assert_close(whitened.square().mean(dim=0), torch.ones(4, 9))
    assert (whitened.flatten(0, 1).T @ whitened.flatten(0, 1) / 2000 - torch.eye(9)).abs().max() < 0.1  # by chance 0.07
    torch.testing.assert_close(whitening.inverse(whitened), coefficients, atol=1e-4, rtol=1e-4)


def test_directions_in_half_precision_are_still_undone_exactly(coefficients):
    whitening = Whitening(4, 9)
    whitening.take(coefficients)
    whitening.directions.copy_(whitening.directions.half())
    whitening.spread.copy_(whitening.spread.half())
    torch.testing.assert_close(whitening.inverse(whitening(coefficients)), coefficients, atol=1e-4, rtol=1e-4)


def test_a_direction_without_spread_is_not_divided_by_zero():
    whitening = Whitening(2, 3)
    whitening.take(torch.zeros(5, 2, 3))
    assert whitening(torch.zeros(1, 2, 3)).isfinite().all()


def test_observed_frames_are_put_back_in_metres(coefficients):
    """Whatever the network answers, the observed frames end up where they were."""
    shape = preset(
        "humanmac", n_joints=3, observed=6, predicted=4, coefficients=10, width=8, heads=2, layers=2, feed_forward=8,
        diffusion_steps=20, sampling_steps=10, predicts="velocity", residual=True, whitened=True,
    )  # fmt: skip
    model = CoefficientDiffusion(shape).eval()
    assert model.whitening is not None
    generator = torch.Generator().manual_seed(1)
    model.whitening.take(torch.randn((50, 10, 9), generator=generator) @ torch.randn((9, 9), generator=generator))
    known = torch.zeros(1, 10, 9)
    noise = torch.randn((1, 2, 10, 9), generator=generator)
    *_, state = model.states(known, torch.zeros(1, 10, 9), lambda: noise)
    residual = model.transform.inverse(model.whitening.inverse(state))[:, :, :6]
    level = float(model.schedule.alphas_cumprod[0])
    expected = model.transform.inverse(model.whitening.inverse((1.0 - level) ** 0.5 * noise))[:, :, :6]
    torch.testing.assert_close(residual, expected, atol=1e-4, rtol=1e-4)


def test_whitening_needs_residuals():
    with pytest.raises(ValueError, match="'whitened' needs 'residual' true"):
        preset("humanmac", n_joints=3, whitened=True)


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


LAYOUTS = ("corrected", "legacy")


def _gazemodiff(arrays, layout, encoder="", denoiser="", **changes):
    """A model of the sizes that a file tells; parts that are not in the file stay tiny."""
    torch.manual_seed(0)
    sizes = {"width": 16, "feed_forward": 24, "encoder_width": 8, "heads": int(arrays.get("heads", 8))}
    found = weights(arrays, encoder)
    if "start_gcn.bias" in found:
        sizes["encoder_width"] = found["start_gcn.feature_weights"].shape[1]
        sizes["encoder_heads"] = len(found["start_gcn.attention_weights"])
        sizes["fusion_blocks"] = len({name.split(".")[1] for name in found if name.startswith("residual_gcns")})
    found = weights(arrays, denoiser)
    if "joint_embed.weight" in found:
        sizes["width"] = len(found["joint_embed.weight"])
        sizes["feed_forward"] = len(found["temporal_decoder_blocks.0.ffn.linear1.weight"])
        sizes["layers"] = len({name.split(".")[1] for name in found if name.startswith("temporal")})
    return CoefficientDiffusion(
        preset(
            "gazemodiff",
            n_joints=int(arrays["n_joints"]),
            observed=int(arrays["n_observed"]),
            predicted=int(arrays["n_predicted"]),
            coefficients=int(arrays["n_coefficients"]),
            legacy_layout=layout == "legacy",
            dropped="vector",
            **{**sizes, **changes},
        )
    ).eval()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_encoder(samples, layout):
    arrays = load(samples, "gazemodiff_encoder")
    model = _gazemodiff(arrays, layout)
    load_encoder(model.encoder, arrays)
    agree(arrays, 2e-5, coefficients=model.transform(padded(tensor(arrays["observed"]), model.configuration.frames)))
    given = tensor(arrays["coefficients"])
    nodes = model.encoder.nodes(given)
    agree(arrays, 0.0, f"_{layout}", encoder_input=nodes)
    joints = model.configuration.n_joints
    pose = model.encoder.pose(nodes[:, :, :joints])
    gaze = model.encoder.gaze(nodes[:, :, joints])
    start = model.encoder.fusion.start(torch.cat([pose, gaze[:, :, None]], dim=2))
    block = model.encoder.fusion.blocks[0](torch.cat([start, start], dim=-1))
    agree(arrays, 2e-6, f"_{layout}", pose_features=pose, gaze_features=gaze, fusion_start=start, fusion_block0=block)
    condition = model.condition(given)
    agree(arrays, 2e-6, f"_{layout}", encoder_output=model.encoder.nodes(condition), condition=condition)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_denoiser_and_loss(samples, layout):
    arrays = load(samples, "gazemodiff_denoiser")
    model = _gazemodiff(arrays, layout, diffusion_steps=int(arrays["noise_steps"]))
    load_denoiser(model.denoiser, arrays)
    step, noise = tensor(arrays["t"]), tensor(arrays["training_noise"])
    levels = model.schedule.alphas_cumprod[arrays["t"]]
    np.testing.assert_allclose(levels, arrays["alpha_bar_t"], rtol=0, atol=1e-6)
    level = torch.from_numpy(levels).float()[:, None, None]
    agree(arrays, 2e-5, sinusoid=model.denoiser.sinusoid[step])
    agree(arrays, 5e-5, x_t=level.sqrt() * tensor(arrays["coefficients"]) + (1 - level).sqrt() * noise)
    condition = tensor(arrays[f"condition_{layout}"])
    noisy = tensor(arrays["x_t"])[:, None]
    none = torch.zeros(len(step), 1, dtype=torch.bool)
    predicted, without = (
        model.denoiser(noisy, step, model.denoiser.prepare(condition, kept))[:, 0] for kept in (None, none)
    )
    loss = (predicted - noise).square().mean()
    agree(arrays, 5e-6, f"_{layout}", epsilon=predicted, loss=loss, epsilon_vector_zeroed=without)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_sampling(samples, layout):
    arrays = load(samples, "gazemodiff_sampling")
    steps = {"diffusion_steps": int(arrays["noise_steps"]), "sampling_steps": len(arrays["sampling_steps"])}
    model = _gazemodiff(arrays, layout, "encoder/", "denoiser/", **steps)
    load_encoder(model.encoder, arrays, "encoder/")
    load_denoiser(model.denoiser, arrays, "denoiser/")
    levels = model.schedule.alphas_cumprod
    np.testing.assert_allclose(levels, arrays["alpha_bar"], rtol=0, atol=1e-6)
    moves = [(s, levels[s], levels[p]) for s, p in zip(arrays["sampling_steps"], arrays["sampling_steps_previous"])]
    assert list(model.moves()) == moves[::-1]
    motion = tensor(arrays["motion"])
    known = model.transform(padded(motion[:, : model.configuration.observed], motion.shape[1]))
    agree(arrays, 1e-12, dct_rows=model.transform.rows)
    agree(arrays, 2e-5, coefficients_full=model.transform(motion), coefficients_observed=known)
    agree(arrays, 2e-6, motion_truncated=model.transform.inverse(tensor(arrays["coefficients_full"])))
    condition = model.condition(known)
    agree(arrays, 2e-5, f"_{layout}", condition=condition)
    # Samples in front of windows there, behind them here.
    draws = [arrays["start_noise"], *arrays["completion_noise"].swapaxes(0, 1)]
    noise = iter([tensor(draw).transpose(0, 1) for draw in draws])
    states = list(model.states(known, condition, lambda: next(noise)))
    prediction = model.transform.inverse(states[-1]).transpose(0, 1)
    agree(arrays, 1e-4, f"_{layout}", x=torch.stack(states).permute(2, 0, 1, 3, 4), prediction=prediction)


def _humanmac(arrays):
    sizes = ("n_joints", "heads", "layers", "width")
    torch.manual_seed(0)
    model = CoefficientDiffusion(
        preset(
            "humanmac",
            **{name: int(arrays[name]) for name in sizes},
            observed=int(arrays["n_observed"]),
            predicted=int(arrays["n_predicted"]),
            coefficients=int(arrays["n_coefficients"]),
            feed_forward=int(arrays["width_feed_forward"]),
            diffusion_steps=int(arrays["noise_steps"]),
            sampling_steps=len(arrays["sampling_steps"]),
        )
    ).eval()
    load_denoiser(model.denoiser, arrays)
    return model


def test_humanmac_transform_and_schedule(samples):
    arrays = load(samples, "humanmac")
    model = _humanmac(arrays)
    motion = tensor(arrays["motion"])
    filled = padded(motion[:, : model.configuration.observed], motion.shape[1])
    agree(arrays, 0.0, padded=filled)
    agree(arrays, 1e-12, dct_rows=model.transform.rows)
    condition = model.condition(model.transform(filled))
    agree(arrays, 3e-5, coefficients=model.transform(motion), condition=condition)
    back = {name: model.transform.inverse(tensor(arrays[name])) for name in ("coefficients", "condition")}
    agree(arrays, 5e-6, motion_truncated=back["coefficients"], condition_motion=back["condition"])
    np.testing.assert_allclose(model.schedule.alphas_cumprod, arrays["alpha_bar"], rtol=0, atol=1e-6)
    table = model.denoiser.sinusoid[tensor(arrays["t"])]
    level = torch.from_numpy(model.schedule.alphas_cumprod[arrays["t"]]).float()[:, None, None]
    noisy = level.sqrt() * tensor(arrays["coefficients"]) + (1 - level).sqrt() * tensor(arrays["training_noise"])
    agree(arrays, 3e-5, sinusoid=table, time_embedding=model.denoiser.time(table), x_t=noisy)


def test_humanmac_denoiser_loss_and_gradient(samples):
    arrays = load(samples, "humanmac")
    model = _humanmac(arrays)
    step, noise, condition = (tensor(arrays[name]) for name in ("t", "training_noise", "condition"))
    noisy = tensor(arrays["x_t"])[:, None]
    none = torch.zeros(len(step), 1, dtype=torch.bool)
    predicted, without = (
        model.denoiser(noisy, step, model.denoiser.prepare(condition, kept))[:, 0] for kept in (None, none)
    )
    loss = (predicted - noise).square().mean()
    agree(arrays, 2e-5, epsilon=predicted, epsilon_unconditioned=without)
    agree(arrays, 1e-5, loss=loss, loss_unconditioned=(without - noise).square().mean())
    agree(arrays, 1e-5, loss=model.loss(tensor(arrays["motion"]), step, noise))
    loss.backward()
    agree_in_gradient(arrays, model)


@pytest.mark.parametrize("suffix", ["", "_unconditioned"])
def test_humanmac_sampling(samples, suffix):
    arrays = load(samples, "humanmac")
    model = _humanmac(arrays)
    known = tensor(arrays["condition"])
    noise = iter([tensor(draw)[:, None] for draw in (arrays["start_noise"], *arrays["completion_noise"])])
    kept = torch.zeros(len(known), 1, dtype=torch.bool) if suffix else None
    states = list(model.states(known, model.condition(known), lambda: next(noise), kept))
    agree(arrays, 5e-4, suffix, x=torch.stack(states)[:, :, 0])
    agree(arrays, 2e-4, suffix, prediction=model.transform.inverse(states[-1])[:, 0])
