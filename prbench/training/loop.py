"""The training loop: batches in, averaged weights out, resumable at any step to the same bits.

Nothing in a step depends on what came before except through the state that a checkpoint holds: batches are a function
of seed and step, a module draws its noise from a generator of seed and step, torch's global generator (dropout) is
seeded anew for every batch, and the learning rate is a function of the step.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from prbench.errors import TrainingError, TrainingStopped
from prbench.randomness import named_generator
from prbench.training.average import WeightAverage, trained_parameters
from prbench.training.checkpoints import Checkpoints
from prbench.training.configuration import OptimisationConfiguration, TrainingConfiguration
from prbench.training.devices import make_fabric
from prbench.training.learning_rate import learning_rate
from prbench.training.log import TrainingLog
from prbench.training.state import Row, Tally, TrainingState
from prbench.training.stopping import StopRequest, stop_on_signals
from prbench.training.task import TrainingModule
from prbench.training.weights import write_weights

if TYPE_CHECKING:
    from lightning_fabric import Fabric

WEIGHTS = "weights.safetensors"
CHECKPOINTS = "checkpoints"
_STEPS_BETWEEN_QUESTIONS = 10  # processes that train together agree to stop; asking costs a message each


@dataclass(frozen=True)
class Progress:
    """Where a training is."""

    step: int
    steps: int
    row: Row | None = None
    """A new line of the log, if there is one."""
    validation: Row | None = None
    """What a validation measured, if there was one."""


def silent(progress: Progress) -> None:
    """Show nothing."""


Batches = Callable[[int], Iterable[Any]]
"""From the number of batches taken before to the batches that follow, without end."""


def fit(
    module: TrainingModule,
    batches: Batches,
    configuration: TrainingConfiguration,
    out: Path,
    *,
    fabric: Fabric | None = None,
    describe: Callable[[TrainingState], dict[str, Any]] = lambda state: {"steps": state.step},
    validate: Callable[[TrainingState], Row] | None = None,
    report: Callable[[Progress], None] = silent,
) -> TrainingState:
    """Train a module, or go on with it; ends with the averaged weights in ``out/weights.safetensors``.

    Args:
        module: In its state before the first step; a checkpoint in ``out`` replaces that state.
        batches: Called once, with the number of batches that were taken before.
        configuration: Everything that decides the result, together with module and batches.
        out: The training folder: checkpoints, logs, curves, weights and their card.
        fabric: Device, processes and precision, launched; the CPU by default.
        describe: The card for a state.
        validate: Measures a state; called with the averaged weights in place, on the first process.
        report: Called after every step, on the first process.

    Returns:
        The state after the last step.

    Raises:
        TrainingStopped: after SIGTERM or Ctrl-C; everything was saved.
        TrainingError: if a loss is no longer finite, or a checkpoint does not fit the module.
        StorageError: if a file cannot be written.
    """
    return Fit(module, batches, configuration, out, fabric, describe, validate, report).run()


class Fit:
    """One session of a training. See :func:`fit`."""

    def __init__(
        self,
        module: TrainingModule,
        batches: Batches,
        configuration: TrainingConfiguration,
        out: Path,
        fabric: Fabric | None,
        describe: Callable[[TrainingState], dict[str, Any]],
        validate: Callable[[TrainingState], Row] | None,
        report: Callable[[Progress], None],
    ) -> None:
        self.settings: OptimisationConfiguration = configuration.training
        self.every = configuration.validation.every
        self.batches, self.out = batches, out
        self.describe, self.validate, self.report = describe, validate, report
        self.fabric = fabric or make_fabric("cpu", precision=self.settings.precision)
        module.seed, module.rank = self.settings.seed, self.fabric.global_rank
        module.train().to(self.fabric.device)
        optimiser = make_optimiser(module, self.settings)
        average = WeightAverage(module, self.settings.ema, warmup=self.settings.ema_warmup)
        self.state = TrainingState(module, optimiser, average)
        self.checkpoints = Checkpoints(out / CHECKPOINTS)

    def run(self) -> TrainingState:
        """Go on from the newest checkpoint to the last step."""
        resumed = self.checkpoints.restore(self.state)
        self.fabric.barrier()
        self.log = TrainingLog(self.out, resumed_at=self.state.step) if self.fabric.is_global_zero else None
        try:
            with stop_on_signals() as stop, torch.random.fork_rng(devices=[]):
                if not resumed:
                    self._save()  # from here on the folder resumes
                if self.state.step < self.settings.steps:
                    self._train(stop)
        finally:
            if self.log is not None:
                self.log.close()
        return self.state

    def _train(self, stop: StopRequest) -> None:
        state, settings = self.state, self.settings
        # Only now, because a process group may copy the weights of the first process to the others.
        self.network = self.fabric.setup_module(state.module, move_to_device=False)
        incoming = iter(self.batches(state.step * settings.micro_batches))
        while state.step < settings.steps:
            started = time.perf_counter()
            self._step(incoming)
            state.seconds += time.perf_counter() - started
            row = self._log_row() if self._due(settings.log_every) else None
            measured = self._validated() if self.every and self._due(self.every) else None
            if self.fabric.is_global_zero:
                self.report(Progress(state.step, settings.steps, row, measured))
            asked = self._asked_to_stop(stop)
            if asked or self._due(settings.save_every):
                self._save()
            if asked and state.step < settings.steps:
                raise TrainingStopped(
                    f"stopped{f' by {stop.name}' if stop else ''} after step {state.step} of {settings.steps};"
                    f" everything is saved in {self.out}. The same command goes on from there."
                )

    def _due(self, every: int) -> bool:
        return self.state.step % every == 0 or self.state.step == self.settings.steps

    def _step(self, incoming: Iterator[Any]) -> None:
        """One step of the optimiser over ``micro_batches`` batches."""
        state, settings = self.state, self.settings
        for group in state.optimiser.param_groups:
            group["lr"] = learning_rate(state.step, settings)
        for micro in range(settings.micro_batches):
            started = time.perf_counter()
            batch = next(incoming).to(self.fabric.device)
            state.waited += time.perf_counter() - started
            number = state.step * settings.micro_batches + micro
            _seed_dropout(settings.seed, number, self.fabric.global_rank)
            with self.fabric.no_backward_sync(self.network, enabled=micro < settings.micro_batches - 1):
                losses = self.network(batch, number)
                self.fabric.backward(losses["loss"] / settings.micro_batches)
            self._tally(losses)
        if settings.gradient_clip is not None:
            torch.nn.utils.clip_grad_norm_(list(state.average.parameters.values()), settings.gradient_clip)
        state.optimiser.step()
        state.optimiser.zero_grad()
        state.step += 1
        state.average.update(state.step)

    def _tally(self, losses: dict[str, torch.Tensor]) -> None:
        tally = self.state.tally
        for name, loss in losses.items():
            tally.losses[name] = tally.losses.get(name, 0.0) + float(loss.detach())
        tally.steps += 1

    def _log_row(self) -> Row:
        """Means since the last line, over all processes.

        Raises:
            TrainingError: if one is not finite.
        """
        state = self.state
        means = state.tally.means()
        if self.fabric.world_size > 1:
            together = torch.tensor(list(means.values()), dtype=torch.float64, device=self.fabric.device)
            reduced = self.fabric.all_reduce(together, reduce_op="mean")
            means = dict(zip(means, reduced.tolist()))  # pyright: ignore[reportAttributeAccessIssue]
        for name, value in means.items():
            if not math.isfinite(value):
                raise TrainingError(
                    f"'{name}' is {value} at step {state.step}: the training has diverged. The checkpoints in"
                    f" {self.checkpoints.folder} are from before; try a lower learning rate or gradient_clip in"
                    " another folder."
                )
        state.tally = Tally()
        rate = learning_rate(state.step - 1, self.settings)
        row = {"step": state.step, **means, "learning_rate": rate, "seconds": state.seconds, "waiting": state.waiting}
        state.rows.append(row)
        if self.log is not None:
            self.log.add(row)
        return row

    def _validated(self) -> Row | None:
        if self.validate is None:
            return None
        measured = None
        if self.fabric.is_global_zero:
            with self.state.average.applied(), torch.no_grad():
                self.state.module.eval()
                measured = {"step": self.state.step, **self.validate(self.state)}
                self.state.module.train()
            self.state.validations.append(measured)
            if self.log is not None:
                self.log.add(measured, group="validation")
        self.fabric.barrier()
        return measured

    def _asked_to_stop(self, stop: StopRequest) -> bool:
        if self.fabric.world_size == 1:
            return bool(stop)
        if self.state.step % _STEPS_BETWEEN_QUESTIONS:
            return False
        asked = torch.tensor(float(bool(stop)), device=self.fabric.device)
        return bool(self.fabric.all_reduce(asked, reduce_op="sum") > 0)  # pyright: ignore[reportOperatorIssue]

    def _save(self) -> None:
        """Checkpoint, averaged weights with their card, curves; by the first process."""
        if self.fabric.is_global_zero:
            self.checkpoints.save(self.state)
            self._write_weights()
            if self.log is not None:
                self.log.draw(self.state)
        self.fabric.barrier()

    def _write_weights(self) -> None:
        with self.state.average.applied():
            tensors, metadata = self.state.module.weights()
            write_weights(
                self.out / WEIGHTS, tensors, metadata, self.describe(self.state), dtype=self.settings.weights_dtype
            )


def make_optimiser(module: TrainingModule, settings: OptimisationConfiguration) -> torch.optim.AdamW:
    """AdamW over the parameters that require gradients."""
    parameters = list(trained_parameters(module).values())
    fused = all(parameter.device.type in ("cpu", "cuda") for parameter in parameters)
    return torch.optim.AdamW(
        parameters,
        lr=settings.learning_rate,
        betas=settings.betas,
        weight_decay=settings.weight_decay,
        fused=fused,
    )


def _seed_dropout(seed: int, number: int, rank: int) -> None:
    """Seed torch's global generators, from which dropout draws, for one batch."""
    torch.manual_seed(int(named_generator("prbench-dropout", seed, number, rank).integers(2**63 - 1)))
