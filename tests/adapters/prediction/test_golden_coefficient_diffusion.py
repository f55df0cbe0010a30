"""GazeMoDiff and HumanMAC give the values of the published programs."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench_adapters.prediction.coefficient_diffusion import CoefficientDiffusion, padded
from prbench_adapters.prediction.configuration import preset
from tests.adapters.prediction.golden import (
    largest_difference,
    load,
    load_denoiser,
    load_encoder,
    tensor,
    weights,
)

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
    observed = tensor(arrays["observed"])
    coefficients = model.transform(padded(observed, model.configuration.frames))
    assert largest_difference(coefficients, arrays["coefficients"]) < 2e-5
    given = tensor(arrays["coefficients"])
    nodes = model.encoder.nodes(given)
    joints = model.configuration.n_joints
    assert largest_difference(nodes, arrays[f"encoder_input_{layout}"]) == 0.0
    pose = model.encoder.pose(nodes[:, :, :joints])
    gaze = model.encoder.gaze(nodes[:, :, joints])
    assert largest_difference(pose, arrays[f"pose_features_{layout}"]) < 2e-6
    assert largest_difference(gaze, arrays[f"gaze_features_{layout}"]) < 2e-6
    start = model.encoder.fusion.start(torch.cat([pose, gaze[:, :, None]], dim=2))
    assert largest_difference(start, arrays[f"fusion_start_{layout}"]) < 2e-6
    block = model.encoder.fusion.blocks[0](torch.cat([start, start], dim=-1))
    assert largest_difference(block, arrays[f"fusion_block0_{layout}"]) < 2e-6
    condition = model.condition(given)
    assert largest_difference(model.encoder.nodes(condition), arrays[f"encoder_output_{layout}"]) < 2e-6
    assert largest_difference(condition, arrays[f"condition_{layout}"]) < 2e-6


@pytest.mark.parametrize("layout", LAYOUTS)
def test_denoiser_and_loss(samples, layout):
    arrays = load(samples, "gazemodiff_denoiser")
    model = _gazemodiff(arrays, layout, diffusion_steps=int(arrays["noise_steps"]))
    load_denoiser(model.denoiser, arrays)
    step, noise = tensor(arrays["t"]), tensor(arrays["training_noise"])
    levels = model.schedule.alphas_cumprod[arrays["t"]]
    np.testing.assert_allclose(levels, arrays["alpha_bar_t"], rtol=0, atol=1e-6)
    assert largest_difference(model.denoiser.sinusoid[step], arrays["sinusoid"]) < 2e-5
    level = torch.from_numpy(levels).float()[:, None, None]
    noisy = level.sqrt() * tensor(arrays["coefficients"]) + (1 - level).sqrt() * noise
    assert largest_difference(noisy, arrays["x_t"]) < 5e-5
    condition = tensor(arrays[f"condition_{layout}"])
    noisy = tensor(arrays["x_t"])[:, None]
    predicted = model.denoiser(noisy, step, model.denoiser.prepare(condition))[:, 0]
    assert largest_difference(predicted, arrays[f"epsilon_{layout}"]) < 5e-6
    loss = (predicted - noise).square().mean()
    assert largest_difference(loss, arrays[f"loss_{layout}"]) < 5e-6
    none = torch.zeros(len(step), 1, dtype=torch.bool)
    predicted = model.denoiser(noisy, step, model.denoiser.prepare(condition, none))[:, 0]
    assert largest_difference(predicted, arrays[f"epsilon_vector_zeroed_{layout}"]) < 5e-6


@pytest.mark.parametrize("layout", LAYOUTS)
def test_sampling(samples, layout):
    arrays = load(samples, "gazemodiff_sampling")
    model = _gazemodiff(
        arrays,
        layout,
        "encoder/",
        "denoiser/",
        diffusion_steps=int(arrays["noise_steps"]),
        sampling_steps=len(arrays["sampling_steps"]),
    )
    load_encoder(model.encoder, arrays, "encoder/")
    load_denoiser(model.denoiser, arrays, "denoiser/")
    assert largest_difference(model.transform.rows, arrays["dct_rows"]) < 1e-12
    np.testing.assert_allclose(model.schedule.alphas_cumprod, arrays["alpha_bar"], rtol=0, atol=1e-6)
    steps = [(step, previous) for step, previous in zip(arrays["sampling_steps"], arrays["sampling_steps_previous"])]
    levels = model.schedule.alphas_cumprod
    assert list(model.moves()) == [(s, levels[s], levels[p]) for s, p in reversed(steps)]
    motion = tensor(arrays["motion"])
    full = model.transform(motion)
    assert largest_difference(full, arrays["coefficients_full"]) < 2e-5
    truncated = model.transform.inverse(tensor(arrays["coefficients_full"]))
    assert largest_difference(truncated, arrays["motion_truncated"]) < 2e-6
    known = model.transform(padded(motion[:, : model.configuration.observed], motion.shape[1]))
    assert largest_difference(known, arrays["coefficients_observed"]) < 2e-5
    condition = model.condition(known)
    assert largest_difference(condition, arrays[f"condition_{layout}"]) < 2e-5
    # Samples in front of windows there, behind them here.
    draws = [arrays["start_noise"], *arrays["completion_noise"].swapaxes(0, 1)]
    noise = iter([tensor(draw).transpose(0, 1) for draw in draws])
    states = list(model.states(known, condition, lambda: next(noise)))
    found = torch.stack(states).permute(2, 0, 1, 3, 4)
    assert largest_difference(found, arrays[f"x_{layout}"]) < 1e-4
    prediction = model.transform.inverse(states[-1]).transpose(0, 1)
    assert largest_difference(prediction, arrays[f"prediction_{layout}"]) < 1e-4


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
    assert largest_difference(filled, arrays["padded"]) == 0.0
    assert largest_difference(model.transform.rows, arrays["dct_rows"]) < 1e-12
    assert largest_difference(model.transform(motion), arrays["coefficients"]) < 3e-5
    assert largest_difference(model.condition(model.transform(filled)), arrays["condition"]) < 3e-5
    for key, value in (("coefficients", "motion_truncated"), ("condition", "condition_motion")):
        assert largest_difference(model.transform.inverse(tensor(arrays[key])), arrays[value]) < 5e-6
    np.testing.assert_allclose(model.schedule.alphas_cumprod, arrays["alpha_bar"], rtol=0, atol=1e-6)
    table = model.denoiser.sinusoid[tensor(arrays["t"])]
    assert largest_difference(table, arrays["sinusoid"]) < 3e-5
    assert largest_difference(model.denoiser.time(table), arrays["time_embedding"]) < 3e-5
    level = torch.from_numpy(model.schedule.alphas_cumprod[arrays["t"]]).float()[:, None, None]
    noisy = level.sqrt() * tensor(arrays["coefficients"]) + (1 - level).sqrt() * tensor(arrays["training_noise"])
    assert largest_difference(noisy, arrays["x_t"]) < 3e-5


def test_humanmac_denoiser_loss_and_gradient(samples):
    arrays = load(samples, "humanmac")
    model = _humanmac(arrays)
    step, noise, condition = (tensor(arrays[name]) for name in ("t", "training_noise", "condition"))
    noisy = tensor(arrays["x_t"])[:, None]
    predicted = model.denoiser(noisy, step, model.denoiser.prepare(condition))[:, 0]
    assert largest_difference(predicted, arrays["epsilon"]) < 2e-5
    loss = (predicted - noise).square().mean()
    assert loss.item() == pytest.approx(float(arrays["loss"]), abs=1e-5)
    loss.backward()
    norm = torch.stack([parameter.grad.norm() for parameter in model.parameters()]).norm()
    assert norm.item() == pytest.approx(float(arrays["grad_norm"]), rel=1e-4)
    none = torch.zeros(len(step), 1, dtype=torch.bool)
    without = model.denoiser(noisy, step, model.denoiser.prepare(condition, none))[:, 0]
    assert largest_difference(without, arrays["epsilon_unconditioned"]) < 2e-5
    loss = (without - noise).square().mean()
    assert loss.item() == pytest.approx(float(arrays["loss_unconditioned"]), abs=1e-5)
    whole = model.loss(tensor(arrays["motion"]), step, noise)
    assert whole.item() == pytest.approx(float(arrays["loss"]), abs=1e-5)


@pytest.mark.parametrize("suffix", ["", "_unconditioned"])
def test_humanmac_sampling(samples, suffix):
    arrays = load(samples, "humanmac")
    model = _humanmac(arrays)
    known = tensor(arrays["condition"])
    noise = iter([tensor(draw)[:, None] for draw in (arrays["start_noise"], *arrays["completion_noise"])])
    kept = torch.zeros(len(known), 1, dtype=torch.bool) if suffix else None
    states = list(model.states(known, model.condition(known), lambda: next(noise), kept))
    assert largest_difference(torch.stack(states)[:, :, 0], arrays[f"x{suffix}"]) < 5e-4
    prediction = model.transform.inverse(states[-1])[:, 0]
    assert largest_difference(prediction, arrays[f"prediction{suffix}"]) < 2e-4
