"""The denoisers: no trace of padding or batch mates, every condition matters, and the published networks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench.contract import Condition, ConditionBatch
from prbench.geometry.skeleton import BONES, Joint
from prbench_adapters.diffusion.configuration import DenoiserConfiguration, EncodedCondition
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.generation import Guided, SamplingSettings, generate
from prbench_adapters.diffusion.goal_frame import PARTS
from prbench_adapters.diffusion.model import MotionModel
from prbench_adapters.diffusion.noise_optimisation import finishing
from prbench_adapters.diffusion.optimised_generation import generate_optimised
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddim
from prbench_adapters.diffusion.training import DiffusionTraining
from tests.adapters.diffusion import golden, tiny
from tests.adapters.diffusion.goal_batches import conditions
from tests.adapters.trained import build

VARIANTS = {
    "decoder": {},
    "pooled": {"text_tokens": "pooled"},
    "time-in-frames": {"time_in_frames": True},
    "encoder": {"architecture": "encoder"},
    "location": {"goal": "location"},
    "pose-by-attention": {"goal": "pose", "injection": "cross-attention"},
    "encoder-pose": {"architecture": "encoder", "goal": "pose"},
    "three-frames-a-token": {"frames_per_token": 3},
}


@pytest.fixture(params=VARIANTS.values(), ids=VARIANTS.keys())
def network(request):
    """In float64, so that a trace of what should leave none cannot hide behind rounding."""
    return tiny.denoiser(**request.param).double()


def _inputs(network: Denoiser, batch: int = 3, frames: int = 7, tokens: int = 4, seed: int = 0):
    generator, dtype = torch.Generator().manual_seed(seed), network.head.weight.dtype
    size = network.configuration.condition_size
    text = torch.randn((batch, tokens, 64), generator=generator, dtype=dtype)
    vector = torch.randn((batch, size), generator=generator, dtype=dtype) if size else None
    condition = EncodedCondition(text, torch.zeros((batch, tokens), dtype=torch.bool), vector)
    noisy = torch.randn((batch, frames, 263), generator=generator, dtype=dtype)
    return noisy, torch.arange(batch) % network.configuration.diffusion_steps, condition


def test_padding_of_frames_and_of_words_leaves_no_trace(network):
    noisy, step, condition = _inputs(network)
    n_frames = torch.tensor([7, 7, 7])
    plain = network(noisy, step, condition, n_frames)
    pad = torch.nn.functional.pad
    garbage, words = pad(condition.text, (0, 0, 0, 3), value=7.0), pad(condition.padding, (0, 3), value=True)
    for frames, told in (
        (pad(noisy, (0, 0, 0, 5), value=30.0), condition),
        (noisy, dataclasses.replace(condition, text=garbage, padding=words)),
    ):
        torch.testing.assert_close(network(frames, step, told, n_frames)[:, :7], plain, rtol=0, atol=1e-12)


def test_batch_mates_leave_no_trace(network):
    noisy, step, condition = _inputs(network)
    n_frames = torch.tensor([7, 4, 2])
    together = network(noisy, step, condition, n_frames)
    for row, n in enumerate(n_frames.tolist()):
        one = slice(row, row + 1)
        alone = network(noisy[one, :n], step[one], condition.rows(one), n_frames[one])
        torch.testing.assert_close(together[one, :n], alone, rtol=0, atol=1e-12)
    prepared = network.prepare(condition, step)  # on an accelerator full batches are masked too, as nobody looks
    masked = network.denoise(noisy, prepared, torch.ones((3, 7), dtype=torch.bool))
    torch.testing.assert_close(masked, network.denoise(noisy, prepared, None), rtol=0, atol=1e-12)


def test_frames_step_and_text_all_matter(network):
    noisy, step, condition = _inputs(network)
    n_frames = torch.tensor([7, 7, 7])
    plain = network(noisy, step, condition, n_frames)
    louder = dataclasses.replace(condition, text=2 * condition.text)
    for changed in (
        network(noisy, step + 3, condition, n_frames),
        network(noisy, step, louder, n_frames),
        network(noisy.flip(1), step, condition, n_frames).flip(1),  # positions are told apart
    ):
        assert (changed - plain).abs().max() > 1e-3


@pytest.mark.parametrize("name", ["location", "pose-by-attention", "encoder-pose"])
def test_every_part_of_the_condition_vector_matters(name):
    network = tiny.denoiser(**VARIANTS[name])
    noisy, step, condition = _inputs(network)
    n_frames = torch.tensor([7, 7, 7])
    plain = network(noisy, step, condition, n_frames)
    assert condition.vector is not None
    for part in network.configuration.condition_parts.values():
        vector = condition.vector.clone()
        vector[:, part] += 1.0
        changed = network(noisy, step, dataclasses.replace(condition, vector=vector), n_frames)
        assert (changed - plain).abs().max() > 1e-4


@pytest.mark.parametrize("injection", ["addition", "cross-attention"])
@pytest.mark.parametrize("architecture", ["decoder", "encoder"])
def test_a_new_goal_model_starts_at_the_output_of_the_model_without_goal(injection, architecture):
    before = tiny.denoiser(architecture=architecture).double()
    after = (
        Denoiser(tiny.configuration(architecture=architecture, goal="location", injection=injection)).eval().double()
    )
    missing = after.load_state_dict(before.state_dict(), strict=False).missing_keys
    assert missing
    assert all(name.startswith("condition.") for name in missing)
    noisy, step, condition = _inputs(after)
    n_frames = torch.tensor([7, 5, 7])
    without = dataclasses.replace(condition, vector=None)
    torch.testing.assert_close(
        after(noisy, step, condition, n_frames), before(noisy, step, without, n_frames), rtol=0, atol=1e-12
    )


def test_a_single_memory_token_is_a_constant_per_layer():
    """Softmax over one key is 1: the short way is the general attention."""
    network = tiny.denoiser(text_tokens="pooled").double()
    noisy, step, condition = _inputs(network)
    short = network.prepare(condition, step)
    assert all(isinstance(layer, torch.Tensor) and layer.shape == (3, 1, 16) for layer in short.layers)
    network.train()  # dropout is drawn in no place: rate 0.1 is set aside
    for module in network.modules():
        if isinstance(getattr(module, "dropout", None), float):
            module.dropout = 0.0
        if isinstance(module, torch.nn.Dropout):
            module.p = 0.0
    general = network.prepare(condition, step)
    assert all(isinstance(layer, tuple) for layer in general.layers)
    torch.testing.assert_close(
        network.denoise(noisy, short, None), network.denoise(noisy, general, None), rtol=0, atol=1e-12
    )


def test_in_training_every_parameter_gets_a_gradient():
    """Also with one memory token, where queries and keys have no say: processes that train together wait for all."""
    for name, variant in VARIANTS.items():
        network = tiny.denoiser(**variant).train().requires_grad_(True)
        noisy, step, condition = _inputs(network)
        network(noisy, step, condition, torch.tensor([7, 4, 2])).sum().backward()
        without = [key for key, parameter in network.named_parameters() if parameter.grad is None]
        assert not without, name


def test_three_condition_tokens_are_attended_to_as_equation_8_says():
    network = tiny.denoiser(goal="location", injection="cross-attention").double()
    _, step, condition = _inputs(network)
    injection = network.condition
    plain = network.text_embedding(condition.text) + network.time_embedding(network.sinusoid[step])[:, None]
    expected = torch.empty_like(plain)
    for row in range(3):
        vector = condition.vector[row]
        parts = [vector[:66], vector[66:132], vector[132:135]]
        tokens = [layer(part) for layer, part in zip(injection.embeddings.values(), parts, strict=True)]
        for word in range(plain.shape[1]):
            query = injection.query.weight @ plain[row, word]
            scores = torch.stack([query @ (injection.key.weight @ token) for token in tokens]) / 16**0.5
            weights = scores.exp() / scores.exp().sum()
            values = torch.stack([injection.value.weight @ token for token in tokens])
            expected[row, word] = plain[row, word] + weights @ values
    torch.testing.assert_close(network.memory(condition, step), expected, rtol=0, atol=1e-5)


def test_the_vector_is_asked_for_where_it_is_needed_and_refused_where_it_is_not():
    with_goal, without = tiny.denoiser(goal="pose"), tiny.denoiser()
    noisy, step, condition = _inputs(with_goal)
    n_frames = torch.tensor([7, 7, 7])
    with pytest.raises(ValueError, match="goal 'pose' needs a condition vector"):
        with_goal(noisy, step, dataclasses.replace(condition, vector=None), n_frames)
    with pytest.raises(ValueError, match="goal 'none' takes no condition vector"):
        without(noisy, step, condition, n_frames)


def test_a_row_without_any_word_is_one_with_its_first_vector_alone(network):
    noisy, step, condition = _inputs(network)
    none, first = torch.ones_like(condition.padding), torch.ones_like(condition.padding)
    first[:, 0] = False
    zeros = condition.without_text()  # what an encoder of words gives for no words
    outputs = [
        network(noisy, step, dataclasses.replace(zeros, padding=padding), torch.tensor([7, 4, 2]))
        for padding in (none, first)
    ]
    assert outputs[0].isfinite().all()
    torch.testing.assert_close(outputs[0], outputs[1], rtol=0, atol=1e-12)


def test_bfloat16_passes_stay_near_the_float32_ones(network):
    network = network.float()
    noisy, step, condition = _inputs(network)
    n_frames = torch.tensor([7, 4, 2])
    plain = network(noisy, step, condition, n_frames)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        rough = network(noisy, step, condition, n_frames)
    for row, n in enumerate(n_frames.tolist()):
        torch.testing.assert_close(
            rough[row, :n].float(), plain[row, :n], rtol=0.1, atol=0.1 * float(plain.abs().max())
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 18, "heads": 4}, "multiple of 'heads'"),
        ({"width": 15, "heads": 3}, "must be even"),
        ({"layers": 0}, "'layers' must be at least 1"),
        ({"dropout": 1.0}, "'dropout'"),
        ({"fps": 0.0}, "'fps'"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        tiny.configuration(**changes)


def test_the_paper_size_has_as_many_parameters_as_measured():
    """17.88 M and 26.3 M without text encoder, with CLIP's 512 numbers (docs/specification/mdm.md#network)."""
    for architecture, millions in (("encoder", 17.88), ("decoder", 26.3)):
        with torch.device("meta"):
            network = Denoiser(DenoiserConfiguration(architecture=architecture, text_dimension=512))
        assert sum(p.numel() for p in network.parameters()) / 1e6 == pytest.approx(millions, abs=0.05)


NAMES = ["mdm_encoder", "mdm_decoder_one_token", "mdm_decoder_word_tokens"]
TOLERANCE = 5e-6


@pytest.fixture(params=NAMES)
def arrays(request, samples):
    return golden.load(samples, request.param)


def _assert_valid_frames_equal(actual, expected, lengths):
    for row, n in enumerate(lengths):
        torch.testing.assert_close(actual[row, :n], expected[row, :n], rtol=0, atol=TOLERANCE)


def test_a_pass_and_a_guided_pass_give_the_clean_features_of_the_reference(arrays):
    """The file has another step in each row, so each row is guided by itself."""
    network, condition = golden.denoiser(arrays), golden.condition(arrays)
    noisy, expected = golden.features(arrays["x"]), golden.features(arrays["x0_guided"])
    lengths = torch.from_numpy(arrays["lengths"])
    clean = network(noisy, torch.from_numpy(arrays["t"]), condition, lengths)
    _assert_valid_frames_equal(clean, golden.features(arrays["x0"]), lengths)
    for row in range(2):
        one = slice(row, row + 1)
        denoise = Guided(network, condition.rows(one), lengths[one], 2.5)
        _assert_valid_frames_equal(denoise(noisy[one], int(arrays["t"][row])), expected[one], lengths[one])


@pytest.mark.parametrize("reuse", [False, True])
def test_ten_guided_ddim_steps_give_the_features_of_the_reference(arrays, reuse):
    lengths = torch.from_numpy(arrays["lengths"])
    denoise = Guided(golden.denoiser(arrays), golden.condition(arrays), lengths, 2.5, reuse=reuse)
    clean = sample_ddim(denoise, CosineSchedule(10), golden.features(arrays["z"]))
    _assert_valid_frames_equal(clean, golden.features(arrays["ddim10_guided"]), lengths)
    assert denoise.passes == 10 * 2 * 2


def _module(goal: str = "location") -> DiffusionTraining:
    module = build("pr-frames", goal=goal, **({} if goal == "location" else {"ray_loss_weight": 0.0}))
    torch.manual_seed(0)
    for parameter in module.parameters():  # heads start at zero, which would hide everything
        torch.nn.init.normal_(parameter, 0.0, 0.1)
    return module


def _model(module: DiffusionTraining) -> MotionModel:
    return MotionModel(module.denoiser, mean=module.mean, std=module.std, scaling=module.scaling, texts=module.texts)


def _batch(goal: Condition = Condition.GOAL_LOCATION, n_frames: tuple[int, ...] = (31, 24)) -> ConditionBatch:
    batch = conditions(goal, len(n_frames), frames=n_frames)
    assert batch.initial_joints is not None
    if goal is Condition.GOAL_POSE:
        return dataclasses.replace(batch, goal_joints=batch.initial_joints + np.float32(0.1))
    place = batch.initial_joints[:, Joint.RIGHT_WRIST] + np.float32([0.1, 0.1, 1.0])
    return dataclasses.replace(batch, goal_location=place)


SAMPLING = SamplingSettings(guidance=1.0, sampler="ddim")


def test_neither_padding_nor_batch_mates_change_a_motion():
    model = _model(_module())
    together = generate(model, _batch(), SAMPLING).joints
    alone = generate(model, _batch(n_frames=(31,)), SAMPLING).joints
    np.testing.assert_allclose(together[0, :31], alone[0], rtol=0, atol=1e-4)


@pytest.mark.parametrize("goal", [Condition.GOAL_LOCATION, Condition.GOAL_POSE])
def test_motions_start_in_the_initial_pose_and_keep_its_bones(goal):
    module = _module("location" if goal is Condition.GOAL_LOCATION else "pose")
    batch = _batch(goal)
    motions = generate(_model(module), batch, SAMPLING)
    assert batch.initial_joints is not None
    np.testing.assert_allclose(motions.joints[:, 0], batch.initial_joints, rtol=0, atol=6e-3)
    parents, children = np.transpose(BONES)
    lengths = np.linalg.norm(motions.joints[0, :, children] - motions.joints[0, :, parents], axis=-1)
    assert float(np.abs(lengths / lengths[:, :1] - 1).max()) < 0.01
    if batch.goal_joints is not None:
        np.testing.assert_allclose(motions.joints[0, 30], batch.goal_joints[0], rtol=0, atol=6e-3)


def test_the_end_is_known_from_the_start():
    """A longer motion is another one in its first frame's estimate already, because it is farther from its end."""
    module = _module()
    model = _model(module)
    condition = model.encode(_batch(n_frames=(31, 31)))
    noisy = torch.zeros(2, 31, 68)
    lengths = torch.tensor([31, 21])
    found = module.denoiser(noisy, torch.tensor([3, 3]), condition, lengths)
    assert float((found[0, 0] - found[1, 0]).abs().max()) > 1e-4


def test_more_start_noise_spreads_the_motions_of_one_sequence_and_none_leaves_one_motion():
    model = _model(_module())
    one = _batch()
    same = dataclasses.replace(one, noise_seed=(1,) * len(one))
    other = dataclasses.replace(one, noise_seed=(2,) * len(one))

    def spread(scale: float) -> float:
        settings = dataclasses.replace(SAMPLING, noise_scale=scale)
        pair = [generate(model, batch, settings).joints[0, :21] for batch in (same, other)]
        return float(np.linalg.norm(pair[0] - pair[1], axis=-1).mean())

    assert spread(0.0) == 0.0
    assert 0.0 < spread(1.0) < spread(2.0)


def test_a_wrist_can_be_led_to_the_goal_and_noise_can_be_optimised():
    model = _model(_module())
    batch = _batch(n_frames=(31,))
    assert batch.goal_location is not None

    def distance(joints: np.ndarray) -> float:
        wrists = joints[0, 30, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]]
        return float(np.linalg.norm(wrists - batch.goal_location[0], axis=-1).min())

    plain = generate(model, batch, SAMPLING).joints
    led = generate(model, batch, dataclasses.replace(SAMPLING, parts=PARTS)).joints
    assert distance(led) < min(distance(plain), 0.1)
    settings = dataclasses.replace(finishing(4), iterations=3)
    alone = generate_optimised(model, batch, dataclasses.replace(settings, reach="predicted")).joints
    finished = generate_optimised(model, batch, settings).joints
    assert distance(finished) < min(distance(alone), 0.1)
    assert np.abs(finished - alone)[:, :20].max() < 1e-5


@pytest.mark.parametrize(
    "changes",
    [
        {"features": "humanml3d"},
        {"architecture": "decoder"},
        {"goal": "none"},
        {"dropped": ("goal",)},
        {"uniform_skeleton": True},
    ],
)
def test_what_does_not_fit_together_is_refused(changes):
    fitting = {"architecture": "frames", "features": "goal-frame", "goal": "location"}
    DenoiserConfiguration(**fitting)
    with pytest.raises(ValueError, match=r"'features'|'uniform_skeleton'"):
        DenoiserConfiguration(**{**fitting, **changes})
