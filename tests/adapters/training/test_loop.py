"""The loop: an interrupted training ends with the weights of an uninterrupted one, bit for bit."""

from __future__ import annotations

import itertools
import shutil
import signal
import time
from pathlib import Path

import msgspec
import pytest
import torch
from safetensors.torch import load_file, save_file

from prbench.errors import TrainingError, TrainingStopped, UsageError
from prbench.files.storage import read_json, write_json
from prbench_adapters.training.configuration import (
    OptimisationConfiguration,
    TrainingConfiguration,
    ValidationConfiguration,
)
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.loop import Progress, faster_precision, fit, make_fabric
from prbench_adapters.training.task import TrainingModule
from prbench_adapters.training.weights import read_weights
from tests.adapters.training.toy import Toy, random_batch, random_batches, rows_of, toy

SETTINGS = OptimisationConfiguration(
    steps=7, learning_rate=1e-2, schedule="cosine", warmup_steps=2, weight_decay=0.01, gradient_clip=0.5,
    ema=0.9, save_every=3, log_every=4,
)  # fmt: skip


def configuration(**changes):
    return TrainingConfiguration(model={}, training=msgspec.structs.replace(SETTINGS, **changes))


def validated(**settings):
    return msgspec.structs.replace(configuration(), validation=ValidationConfiguration(**settings))


def signalled_in(step: int, number: signal.Signals):
    """Batches that send a signal when the first one of a step (from 1 on) is asked for."""

    def batches(start: int):
        for place, batch in enumerate(random_batches(start), start=start):
            if place == step - 1:
                signal.raise_signal(number)
            yield batch

    return batches


def final_files(out):
    """Everything that a training is about; times stand in files of their own."""
    checkpoint = sorted((out / "checkpoints").iterdir())[-1]
    rows = read_json(checkpoint / "state.json")["rows"]
    return (out / "weights.safetensors").read_bytes(), (checkpoint / "tensors.safetensors").read_bytes(), rows


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    out = tmp_path_factory.mktemp("uninterrupted")
    fit(toy(), random_batches, configuration(), out)
    return final_files(out)


@pytest.mark.parametrize("step", [1, 5])
def test_a_training_stopped_at_any_step_and_resumed_ends_with_the_same_bits(step, uninterrupted, tmp_path):
    with pytest.raises(TrainingStopped, match=f"after step {step} of 7") as stopped:
        fit(toy(), signalled_in(step, signal.SIGTERM), configuration(), tmp_path)
    assert stopped.value.exit_code == 143
    assert (tmp_path / "checkpoints" / f"step-{step:09d}").is_dir(), "the step that was just done is saved"
    seen = []
    fit(toy(), random_batches, configuration(), tmp_path, report=lambda progress: seen.append(progress.step))
    assert seen == list(range(step + 1, 8)), "nothing is done twice"
    assert final_files(tmp_path) == uninterrupted


def _with_matrices():
    module = toy()
    module.hidden_matrices = lambda: (module.network[3].weight,)
    return module


def test_a_training_with_muon_resumes_to_the_same_bits(tmp_path):
    muon = configuration(optimiser="muon")
    fit(_with_matrices(), random_batches, muon, tmp_path / "whole")
    with pytest.raises(TrainingStopped):
        fit(_with_matrices(), signalled_in(4, signal.SIGTERM), muon, tmp_path / "parts")
    fit(_with_matrices(), random_batches, muon, tmp_path / "parts")
    assert final_files(tmp_path / "parts") == final_files(tmp_path / "whole")


def test_muon_is_refused_where_no_matrices_are_named(tmp_path):
    with pytest.raises(UsageError, match=r"training\.optimiser: this task names no matrices"):
        fit(toy(), random_batches, configuration(optimiser="muon"), tmp_path)


def test_a_checkpoint_that_a_kill_kept_from_being_deleted_goes_with_the_next_call(tmp_path):
    fit(toy(), random_batches, configuration(), tmp_path)
    folder = tmp_path / "checkpoints"
    kept = sorted(path.name for path in folder.iterdir())
    shutil.copytree(folder / kept[0], folder / "step-000000000")
    fit(toy(), random_batches, configuration(), tmp_path)
    assert sorted(path.name for path in folder.iterdir()) == kept


def test_a_training_that_died_loses_no_more_than_the_steps_since_it_last_saved(uninterrupted, tmp_path):
    def die(progress: Progress) -> None:
        if progress.step == 5:
            raise MemoryError

    with pytest.raises(MemoryError):
        fit(toy(), random_batches, configuration(), tmp_path, report=die)
    (tmp_path / "checkpoints" / ".step-000000006-abcdefgh.partial").mkdir()  # what a kill in mid-writing leaves
    seen = []
    fit(toy(), random_batches, configuration(), tmp_path, report=lambda progress: seen.append(progress.step))
    assert seen == [4, 5, 6, 7]
    assert final_files(tmp_path) == uninterrupted
    assert [path.name for path in sorted((tmp_path / "checkpoints").iterdir())] == ["step-000000006", "step-000000007"]


def test_ctrl_c_saves_and_has_its_own_exit_code(tmp_path):
    before = signal.getsignal(signal.SIGINT)  # a shell's background jobs ignore it
    with pytest.raises(TrainingStopped) as stopped:
        fit(toy(), signalled_in(2, signal.SIGINT), configuration(), tmp_path)
    assert stopped.value.exit_code == 130
    assert signal.getsignal(signal.SIGINT) is before, "the handlers of before are back"


def test_one_plain_step_is_what_adamw_does_by_hand(tmp_path):
    settings = configuration(
        steps=1, schedule="constant", warmup_steps=0, weight_decay=0.0, gradient_clip=None, ema=0.0
    )
    by_hand, trained = toy(dropout=0.0), toy(dropout=0.0)
    by_hand(random_batch(0), 0)["loss"].backward()
    fit(trained, random_batches, settings, tmp_path)
    for name, parameter in by_hand.network.named_parameters():
        assert parameter.grad is not None
        # After one step both moments are the gradient, so AdamW moves every weight by the learning rate.
        expected = parameter - 1e-2 * parameter.grad / (parameter.grad.abs() + 1e-8)
        torch.testing.assert_close(trained.network.get_parameter(name), expected, rtol=0, atol=1e-6)


def test_frozen_parameters_are_neither_trained_nor_in_the_checkpoint(tmp_path):
    module = toy()
    before = module.frozen.weight.clone()
    fit(module, random_batches, configuration(), tmp_path)
    assert torch.equal(module.frozen.weight, before)
    names = load_file(tmp_path / "checkpoints" / "step-000000007" / "tensors.safetensors").keys()
    assert not [name for name in names if "frozen" in name]
    assert "optimiser.exp_avg_sq.network.0.weight" in names
    assert "average.network.0.weight" in names
    assert "module.std" in names


def test_what_is_written_is_the_average_not_the_last_weights(tmp_path):
    module = toy()
    state = fit(module, random_batches, configuration(), tmp_path)
    written = read_weights(tmp_path / "weights.safetensors").tensors["toy.0.weight"]
    assert torch.equal(written, state.average.averages["network.0.weight"])
    assert not torch.equal(written, module.network.get_parameter("0.weight"))


def test_a_loss_that_is_not_finite_stops_the_training_before_it_is_saved(tmp_path):
    class Diverging(Toy):
        def forward(self, batch, step):
            losses = super().forward(batch, step)
            return {**losses, "loss": losses["loss"] * (float("nan") if step >= 3 else 1.0)}

    with pytest.raises(TrainingError, match="'loss' is nan at step 4"):
        fit(Diverging(6), random_batches, configuration(), tmp_path)
    assert sorted(path.name for path in (tmp_path / "checkpoints").iterdir()) == ["step-000000000", "step-000000003"]


def test_another_network_cannot_go_on_from_a_checkpoint(tmp_path):
    fit(toy(6), random_batches, configuration(steps=3), tmp_path)
    with pytest.raises(TrainingError, match=r"network\.0\.bias' is missing, unknown or of another shape"):
        fit(toy(5), random_batches, configuration(), tmp_path)


def test_bf16_hands_features_over_unrounded_and_keeps_weights_in_float32(tmp_path):
    seen = []

    class Watching(Toy):
        def forward(self, batch, step):
            seen.append((batch.features.dtype, self.network(batch.features).dtype))
            return super().forward(batch, step)

    module = Watching(6)
    fit(module, random_batches, configuration(precision="bf16-mixed", steps=2), tmp_path)
    assert set(seen) == {(torch.float32, torch.bfloat16)}
    assert {parameter.dtype for parameter in module.parameters()} == {torch.float32}


def test_validation_sees_the_average_in_evaluation_mode_and_changes_nothing(uninterrupted, tmp_path):
    seen = []

    def validate(module):
        seen.append((module.training, module.network[0].weight.clone()))
        torch.rand(5)  # draws of a validation must not reach the training
        return {"loss": 3.0 - len(seen)}

    state = fit(toy(), random_batches, validated(every=5), tmp_path, validate=validate)
    weights, _, rows = final_files(tmp_path)
    assert (weights, rows) == uninterrupted[::2], "the last weights are the best"
    assert [training for training, _ in seen] == [False, False]
    assert state.validations == [{"step": 5, "loss": 2.0}, {"step": 7, "loss": 1.0}]
    assert torch.equal(seen[1][1], state.average.averages["network.0.weight"])
    assert state.module.training


def test_a_validation_that_a_stop_came_before_is_made_up_for(tmp_path):
    batches = signalled_in(5, signal.SIGTERM)
    with pytest.raises(TrainingStopped):
        fit(toy(), batches, validated(every=5), tmp_path, validate=lambda module: {"loss": 1.0})
    state = fit(toy(), random_batches, validated(every=5), tmp_path, validate=lambda module: {"loss": 2.0})
    assert [row["step"] for row in state.validations] == [5, 7]


class Judge:
    """Measures given losses, one validation after the other, and remembers the weights that it saw."""

    def __init__(self, *losses: float) -> None:
        self.losses = list(losses)
        self.seen = []

    def __call__(self, module):
        self.seen.append(module.network[0].weight.detach().clone())
        return {"loss": self.losses[len(self.seen) - 1]}


def written(out):
    return read_weights(out / "weights.safetensors").tensors["toy.0.weight"]


def test_the_weights_of_the_best_validation_are_kept_and_of_equal_ones_the_first(tmp_path):
    judge = Judge(3.0, 1.0, 2.0, 1.0)
    state = fit(toy(), random_batches, validated(every=2), tmp_path, validate=judge)
    assert (state.step, state.best_validation()) == (7, {"step": 4, "loss": 1.0})
    assert torch.equal(written(tmp_path), judge.seen[1])
    assert not torch.equal(written(tmp_path), judge.seen[3])


def test_validations_of_another_phase_and_without_a_value_are_never_the_best(tmp_path):
    module = toy()
    module.comparable_from = lambda: 4
    judge = Judge(0.5, 3.0, 2.0, 4.0)
    state = fit(module, random_batches, validated(every=2, patience=3), tmp_path, validate=judge)
    assert state.best_validation() == {"step": 6, "loss": 2.0}
    assert torch.equal(written(tmp_path), judge.seen[2])
    lost = fit(toy(), random_batches, validated(every=7), tmp_path / "lost", validate=lambda module: {"root": 1.0})
    assert (lost.best_validation(), lost.exhausted(1)) == (None, False)


@pytest.mark.parametrize("step", [4, 5])  # before and after the best validation
def test_a_training_ends_early_with_the_same_bits_however_often_it_is_interrupted(step, tmp_path):
    ending = validated(every=2, patience=1)
    state = fit(toy(), random_batches, ending, tmp_path / "whole", validate=Judge(3.0, 1.0, 2.0))
    assert state.step == 6, "the third validation was not better, and one is waited for"
    judge = Judge(3.0, 1.0, 2.0)
    with pytest.raises(TrainingStopped):
        fit(toy(), signalled_in(step, signal.SIGTERM), ending, tmp_path / "parts", validate=judge)
    judge.losses = judge.losses[len(judge.seen) :]
    judge.seen = []
    for _ in range(2):  # the second call finds the training over
        fit(toy(), random_batches, ending, tmp_path / "parts", validate=judge)
    assert final_files(tmp_path / "parts") == final_files(tmp_path / "whole")
    assert [row["step"] for row in final_files(tmp_path / "whole")[2]] == [4, 6]


@pytest.mark.parametrize(("slow", "chosen"), [("bf16-mixed", "32-true"), ("32-true", "bf16-mixed"), (None, "32-true")])
def test_the_precision_is_the_one_that_was_faster_and_trying_changes_nothing(slow, chosen, monkeypatch):
    class Timed(Toy):
        def forward(self, batch, step):
            time.sleep(0.03 if (slow == "bf16-mixed") is torch.is_autocast_enabled("cpu") else 0.0)
            return super().forward(batch, step)

    monkeypatch.setattr("prbench_adapters.training.loop._TRIAL", 0.0)
    module = Timed(6) if slow else toy()
    before = {name: tensor.clone() for name, tensor in module.state_dict().items()}
    random = torch.get_rng_state()
    if slow is None:  # as fast as each other
        monkeypatch.setattr("prbench_adapters.training.loop.time.perf_counter", itertools.count().__next__)
    assert faster_precision(module, random_batch(0), torch.device("cpu")) == chosen
    assert all(torch.equal(tensor, before[name]) for name, tensor in module.state_dict().items())
    assert all(parameter.grad is None for parameter in module.parameters())
    assert torch.equal(torch.get_rng_state(), random)


def test_a_module_knows_how_often_it_will_be_called_and_may_scale_the_learning_rate(tmp_path):
    """Seven steps; the module halves the rate from its fifth call on."""
    module = toy()
    module.learning_rate_factor = lambda step: 0.5 if step >= 4 else 1.0
    state = fit(module, random_batches, configuration(schedule="constant", warmup_steps=0, log_every=1), tmp_path)
    assert module.calls == 7
    assert [row["learning_rate"] for row in state.rows] == pytest.approx([1e-2] * 4 + [5e-3] * 3)
    assert state.optimisers[0].param_groups[0]["lr"] == pytest.approx(5e-3)


CONFIGURATION = TrainingConfiguration(
    model={}, training=OptimisationConfiguration(steps=5, learning_rate=1e-2, ema=0.5, save_every=2, log_every=1)
)


class Plain(TrainingModule):
    """Without noise, so that the gradient of a batch is the mean of those of its halves."""

    def __init__(self) -> None:
        super().__init__()
        self.network = torch.nn.Linear(263, 4)

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        return {"loss": (self.network(batch.features) - batch.features[..., :4]).square().mean()}

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        return dict(self.network.state_dict()), {"kind": "plain", "configuration": "{}"}


def made(seed: int) -> Plain:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Plain()


def train_half(fabric, out: Path) -> None:
    """What each process does: its half of every batch. The second starts from other weights, and gets the first's."""
    rank, size = fabric.global_rank, fabric.world_size
    torch.set_num_threads(1)

    def halves(start: int):
        while True:
            yield rows_of(random_batch(start), slice(rank, None, size))
            start += 1

    module = made(rank)
    state = fit(module, halves, CONFIGURATION, out / "together", fabric=fabric)
    rows = [{key: row[key] for key in ("step", "loss")} for row in state.rows]
    save_file({"weights": module.network.weight.detach()}, out / f"rank-{rank}.safetensors")
    write_json(out / f"rank-{rank}.json", rows)


@pytest.mark.slow
@pytest.mark.skipif(not torch.distributed.is_available(), reason="this build of torch has no process groups")
def test_two_processes_end_with_the_weights_of_one_with_all_the_data(tmp_path):
    fabric = make_fabric("cpu", devices=2, spawn=True)
    fabric.launch(train_half, tmp_path)
    first, second = (load_file(tmp_path / f"rank-{rank}.safetensors")["weights"] for rank in (0, 1))
    assert torch.equal(first, second)
    rows = read_json(tmp_path / "rank-0.json")
    assert rows == read_json(tmp_path / "rank-1.json"), "the log holds means over the processes"

    def whole(start: int):
        while True:
            yield random_batch(start)
            start += 1

    alone = made(0)
    state = fit(alone, whole, CONFIGURATION, tmp_path / "alone")
    torch.testing.assert_close(first, alone.network.weight.detach(), rtol=1e-4, atol=1e-6)
    assert [row["loss"] for row in rows] == pytest.approx([row["loss"] for row in state.rows], rel=1e-4)
    checkpoint = load_file(tmp_path / "together" / "checkpoints" / "step-000000005" / "tensors.safetensors")
    assert torch.equal(checkpoint["module.network.weight"], first)
