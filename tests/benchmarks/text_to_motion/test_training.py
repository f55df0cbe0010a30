from __future__ import annotations

import dataclasses
from itertools import repeat

import pytest
import torch

from prbench.errors import InputFileError, TableError, UsageError
from prbench.harness.methods.installed import list_tasks, load_task
from prbench_adapters.training import collate
from prbench_adapters.training.configuration import (
    OptimisationConfiguration,
    TrainingConfiguration,
    list_configurations,
    load_configuration,
)
from prbench_adapters.training.loop import fit
from prbench_adapters.training.task import TrainingTask, split_model_table
from prbench_adapters.training.weights import read_weights
from prbench_benchmarks.text_to_motion.networks import EvaluatorConfiguration
from prbench_benchmarks.text_to_motion.training import (
    EvaluatorObjective,
    contrastive_losses,
    different_texts,
    reconstruction_losses,
    t2m_evaluator,
)
from tests.benchmarks.text_to_motion.corpora import TINY


def trained(module, batch, steps, start=0):
    """A few steps as the loop makes them."""
    parameters = [parameter for parameter in module.parameters() if parameter.requires_grad]
    optimiser = torch.optim.AdamW(parameters, lr=1e-2, weight_decay=0.0)
    module.train()
    found = []
    for step in range(start, start + steps):
        torch.manual_seed(step)  # dropout draws from the global generator
        losses = module(batch, step)
        losses["loss"].backward()
        for group in module.gradient_groups():
            torch.nn.utils.clip_grad_norm_(group, 0.5)
        optimiser.step()
        optimiser.zero_grad()
        found.append(losses)
    return found


def state(network):
    return {name: tensor.clone() for name, tensor in network.state_dict().items()}


def equal(network, before):
    return all(torch.equal(tensor, before[name]) for name, tensor in network.state_dict().items())


def test_the_autoencoder_is_trained_first_and_frozen_then(build, batch):
    module = build()
    before = {name: state(getattr(module, name)) for name in ("movement", "decoder", "motion", "text")}
    first = trained(module, batch, 2)
    assert not equal(module.movement, before["movement"])
    assert not equal(module.decoder, before["decoder"])
    assert equal(module.motion, before["motion"])
    assert equal(module.text, before["text"])
    frozen = state(module.movement)
    second = trained(module, batch, 2, start=2)
    assert equal(module.movement, frozen)
    assert not equal(module.motion, before["motion"])
    assert not equal(module.text, before["text"])
    assert [losses["reconstruction"].item() > 0 for losses in first + second] == [True, True, False, False]
    assert [losses["negative"].item() > 0 for losses in first + second] == [False, False, True, True]
    assert not module.movement.training


def test_the_losses_fall(build, batch):
    module = build(autoencoder_batches=15)
    losses = trained(module, batch, 60)
    assert losses[14]["loss"] < losses[0]["loss"]
    assert losses[-1]["positive"] + losses[-1]["negative"] < 0.8 * losses[15]["loss"]
    assert torch.stack([step["ranked"] for step in losses[-10:]]).mean() > 0.6


def test_the_wrong_motion_is_never_a_texts_own(build, batch, monkeypatch):
    module, shifts = build(), set()
    monkeypatch.setattr(
        "prbench_benchmarks.text_to_motion.training.contrastive_losses",
        lambda *_, shift, **__: shifts.add(shift) or {"loss": torch.zeros(())},
    )
    for step in range(2, 80):
        module.contrast(batch, step)
    assert shifts == set(range(1, len(batch)))


def test_a_step_draws_the_same_again_and_another_step_does_not(build, batch):
    module = build().eval()
    assert torch.equal(module(batch, 5)["loss"], module(batch, 5)["loss"])
    assert len({round(float(module(batch, step)["loss"].detach()), 6) for step in range(5, 15)}) > 1


def test_a_permuted_batch_has_the_same_embeddings(build, batch):
    """Text and motion of a row stay together: the positives do not change."""
    module = build().eval()
    order = torch.tensor([3, 1, 7, 0, 2, 6, 5, 4])
    permuted = dataclasses.replace(
        batch,
        features=batch.features[order],
        joints=batch.joints[order],
        padding=batch.padding[order],
        n_frames=batch.n_frames[order],
        text=tuple(batch.text[i] for i in order),
        sequence_id=tuple(batch.sequence_id[i] for i in order),
    )
    with torch.no_grad(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("prbench_benchmarks.text_to_motion.training._SHORTER", 0.0)
        assert torch.allclose(module.contrast(batch, 0)["positive"], module.contrast(permuted, 0)["positive"])


def test_two_stages_hand_over_the_movement_encoder(build, batch, saved):
    first = build("autoencoder")
    trained(first, batch, 3)
    path = saved(first, "autoencoder")
    assert read_weights(path).kind == "t2m-movement"
    second = build("contrastive", initial=path)
    assert equal(second.movement, state(first.movement))
    trained(second, batch, 2)
    assert equal(second.movement, state(first.movement))
    tensors, metadata = second.weights()
    assert metadata["kind"] == "t2m-evaluator"
    assert {name.partition(".")[0] for name in tensors} == {"movement", "motion", "text", "statistics"}
    assert any("autoencoder.safetensors" in line for line in second.origin)


def test_statistics_are_weighted_for_the_evaluator_and_handed_over(build, data, saved):
    module, plain = build("autoencoder"), data.train.statistics()
    assert module.std[0].item() == pytest.approx(plain.std[0] / 25)
    assert module.std[10].item() == pytest.approx(plain.std[10])
    second = build("contrastive", initial=saved(module))
    assert torch.equal(second.std, module.std)


def test_stages_and_initial_weights_have_to_fit(build, saved):
    with pytest.raises(UsageError, match="--stage contrastive needs --init"):
        build("contrastive")
    path = saved(build("autoencoder"))
    with pytest.raises(UsageError, match="--init belongs to --stage contrastive"):
        build("full", initial=path)
    with pytest.raises(InputFileError, match=r"configuration\.movement_width.*expected 16.*found 8"):
        build("contrastive", initial=path, movement_width=16)
    with pytest.raises(InputFileError, match="'t2m-movement'"):
        build("contrastive", initial=saved(build()))
    with pytest.raises(UsageError, match=r"needs model\.autoencoder_batches"):
        build("full", autoencoder_batches=0)


def test_model_tables_that_describe_no_evaluator_are_refused(build):
    for wrong in ({"movement_widht": 8}, {"text": "clip"}, {"window": 10}):
        with pytest.raises(UsageError, match=r"\[model\]"):
            split_model_table(TINY | wrong, EvaluatorConfiguration, EvaluatorObjective)
    with pytest.raises(UsageError, match=r"data\.max_frames"):
        build(max_frames=40)
    with pytest.raises(UsageError, match=r"data\.mode"):
        build(representation="reference")
    with pytest.raises(UsageError, match="folder of its word vectors"):
        build(text="glove")


def test_a_motion_that_is_too_short_is_named(build, batch):
    short = dataclasses.replace(batch, n_frames=batch.n_frames.clone().index_fill_(0, torch.tensor([2]), 3))
    for step in (0, 2):
        with pytest.raises(TableError, match=batch.sequence_id[2]):
            build()(short, step)


def test_a_single_motion_is_left_over_in_validation_only(build, data):
    module, single = build(), collate([data.train[0]])
    with pytest.raises(TableError, match="two motions or more"):
        module(single, 2)
    losses = module(single, -1)
    assert losses["loss"] == losses["positive"] > 0
    assert losses["negative"] == 0


def test_the_task_is_installed_and_its_configurations_describe_evaluators(data):
    assert "t2m-evaluator" in list_tasks()
    task = load_task("t2m-evaluator")
    assert isinstance(task, TrainingTask)
    names = list_configurations(task.configurations, task.name)
    assert names == ("paper", "small", "smoke")
    for name in names:
        for stage in t2m_evaluator().stages:
            found = load_configuration(name, package=task.configurations, task=task.name, stage=stage)
            configuration, objective = split_model_table(found.model, EvaluatorConfiguration, EvaluatorObjective)
            assert configuration.representation == found.data.mode
            assert configuration.max_frames >= found.data.max_frames
            assert found.training.ema == 0.0  # an average would go on moving a frozen encoder
            assert stage != "full" or objective.autoencoder_batches < found.training.steps


def test_a_training_that_was_stopped_between_its_phases_ends_with_the_same_weights(build, batch, tmp_path):
    def run(out, steps):
        settings = OptimisationConfiguration(steps=steps, ema=0.0, gradient_clip=0.5, save_every=1)
        configuration = TrainingConfiguration(model={}, training=settings)
        return fit(build(), lambda start: repeat(batch), configuration, tmp_path / out).module

    straight = run("straight", 4)
    for steps in (1, 3, 4):
        resumed = run("resumed", steps)
    for name, tensor in straight.weights()[0].items():
        assert torch.equal(resumed.weights()[0][name], tensor), name


def test_contrast_worked_by_hand():
    """Own motions 3 and 0 away; the other's 4 and 12 away, of a margin of 10."""
    text = torch.tensor([[0.0, 0.0], [12.0, 0.0]])
    motion = torch.tensor([[0.0, 3.0], [12.0, 0.0]])
    motion_of_other = motion.roll(1, dims=0)
    assert motion_of_other.tolist() == [[12.0, 0.0], [0.0, 3.0]]
    far = [12.0, (144 + 9) ** 0.5]
    losses = contrastive_losses(text, motion, shift=1, margin=15.0)
    assert losses["positive"].item() == pytest.approx(9 / 2, abs=1e-4)
    assert losses["negative"].item() == pytest.approx(sum((15 - d) ** 2 for d in far) / 2, abs=1e-3)
    assert losses["loss"].item() == pytest.approx(losses["positive"].item() + losses["negative"].item())
    assert losses["ranked"].item() == 1.0
    assert contrastive_losses(text, motion, shift=1, margin=10.0)["negative"].item() == 0.0


def test_rows_with_equal_texts_can_be_left_out_of_the_negatives():
    text, motion = torch.zeros(3, 2), torch.tensor([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    counted = different_texts(["a", "b", "a"], 1)  # row 0 meets the motion of row 2
    assert counted.tolist() == [False, True, True]
    negative = contrastive_losses(text, motion, shift=1, margin=10.0, counted=counted)["negative"]
    assert negative.item() == pytest.approx((9**2 + 8**2) / 2, abs=1e-3)


def test_reconstruction_counts_valid_frames_only():
    recorded, reconstructed = torch.zeros(2, 8, 259), torch.ones(2, 8, 259)
    reconstructed[1, 4:] = 100.0
    losses = reconstruction_losses(
        EvaluatorObjective(), recorded, reconstructed, torch.zeros(2, 2, 3), torch.tensor([8, 4])
    )
    assert losses["reconstruction"].item() == pytest.approx(1.0)
    assert losses["loss"].item() == pytest.approx(1.0)


def test_snippets_pay_for_their_size_and_for_changes():
    nothing, snippets = torch.zeros(1, 8, 259), torch.tensor([[[1.0, -1.0], [3.0, 1.0]]])
    loss = reconstruction_losses(EvaluatorObjective(), nothing, nothing, snippets, torch.tensor([8]))["loss"]
    assert loss.item() == pytest.approx(0.001 * (6 / 4) + 0.001 * 2.0)
