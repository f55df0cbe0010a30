"""The training loop: batches in, averaged weights out, resumable at any step to the same bits.

Nothing in a step depends on what came before except through the state that a checkpoint holds: batches are a function
of seed and step, a module draws its noise from a generator of seed and step, torch's global generator (dropout) is
seeded anew for every batch, and the learning rate is a function of the step. Lightning Fabric (extra ``train``) is
imported on first use. A training that the system or the user stops ends after the step at hand, so that what was learnt
is saved first.
"""

from __future__ import annotations

import contextlib
import math
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Literal, get_args

import torch

from prbench.errors import MissingExtraError, TrainingError, TrainingStopped, UsageError
from prbench.randomness import named_generator
from prbench_adapters.training.configuration import TrainingConfiguration
from prbench_adapters.training.report import Describe, Log, Outputs
from prbench_adapters.training.state import Row, TrainingState, learning_rate, restore_checkpoint
from prbench_adapters.training.task import TrainingModule

if TYPE_CHECKING:
    from lightning_fabric import Fabric


def make_fabric(device: str, *, devices: int = 1, spawn: bool = False) -> Fabric:
    """Return the Fabric that a training runs on; launch it before anything else.

    Args:
        device: ``cpu``, ``cuda``, ``cuda:1``, ``mps``.
        devices: Processes that train together, each on a device of its own.
        spawn: Start the processes from functions instead of running the command again (for tests and notebooks).

    Raises:
        UsageError: if there is no such device, or too few of them.
        MissingExtraError: if Lightning Fabric is not installed.
    """
    try:
        from lightning_fabric import Fabric
    except ModuleNotFoundError as error:
        raise MissingExtraError("lightning-fabric", "train", "training") from error
    kind, _, number = device.partition(":")
    if kind not in ("cpu", "cuda", "mps") or (number and not number.isdigit()):
        raise UsageError(f"--device: expected cpu, cuda, cuda:1 … or mps, found '{device}'.")
    if number and devices > 1:
        raise UsageError(f"--device {device} names one device; leave the number out to use {devices} of them.")
    available = {"cpu": None, "cuda": torch.cuda.device_count(), "mps": int(torch.backends.mps.is_available())}[kind]
    if available is not None and available < (int(number) + 1 if number else devices):
        why = f"torch {torch.__version__} finds {available or 'no'} such device{'s' if available != 1 else ''} here."
        remedy = "Use --device cpu, or install a build of torch for your GPU and its driver."
        raise UsageError(f"--device {device}{f' --devices {devices}' if devices > 1 else ''}: {why} {remedy}")
    chosen: Any = [int(number)] if number else devices
    strategy = "auto" if devices == 1 else ("ddp_spawn" if spawn else "ddp")
    return Fabric(accelerator=kind, devices=chosen, strategy=strategy)


Precision = Literal["32-true", "bf16-mixed"]
# bfloat16 has to be this much faster, so that chance does not decide between equals.
_WORTHWHILE = 1.2
_TRIAL = 1.0  # seconds


def autocast(device: torch.device, precision: str) -> torch.autocast:
    """Return the context of a network's call: ``bf16-mixed`` has matrix products in bfloat16, the rest in float32.

    Fabric's own would also round features and targets before the module sees them.
    """
    return torch.autocast(device.type, torch.bfloat16, enabled=precision == "bf16-mixed")


def faster_precision(module: TrainingModule, batch: Any, device: torch.device) -> Precision:
    """Time forward and backward passes in both precisions, a second each; the module is left as it was.

    Args:
        module: The module before the first step.
        batch: What it is fed.
        device: Device of the training.
    """
    before = {name: tensor.clone() for name, tensor in module.state_dict().items()}
    module.train().to(device)
    batch = batch.to(device)
    shortest: dict[str, float] = {}
    for precision in get_args(Precision):
        begun = time.perf_counter()
        times: list[float] = []
        while len(times) < 2 or time.perf_counter() - begun < _TRIAL:  # the first of them warms up
            start = time.perf_counter()
            with torch.random.fork_rng(devices=[]), autocast(device, precision):
                loss = module(batch, 0)["loss"]
            loss.float().backward()
            loss.item()  # waits for a GPU
            times.append(time.perf_counter() - start)
        shortest[precision] = min(times)
    module.zero_grad()
    module.load_state_dict(before)
    return "bf16-mixed" if shortest["bf16-mixed"] * _WORTHWHILE < shortest["32-true"] else "32-true"


@contextlib.contextmanager
def stop_on_signals() -> Iterator[list[int]]:
    """Note SIGTERM and Ctrl-C in a list instead of dying of them; a second one is obeyed at once.

    Outside of the main thread signals cannot be caught, and the list stays empty.
    """
    asked: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return

    def note(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - what Python hands over
        # The second Ctrl-C comes from somebody who does not want to wait for the step.
        if asked:
            raise KeyboardInterrupt
        asked.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


_CHECKPOINTS = "checkpoints"
_STEPS_BETWEEN_QUESTIONS = 10  # processes that train together agree to stop; asking costs a message each

# Maps the number of batches taken before to the batches that follow, without end.
Batches = Callable[[int], Iterable[Any]]
# Maps a module with the averaged weights, in evaluation mode, to what was measured.
Validate = Callable[[TrainingModule], Row]


@dataclass(frozen=True)
class Progress:
    """Progress of a training.

    Attributes:
        row: A new line of the log, if there is one.
        validation: Measurements of a validation, if there was one.
    """

    step: int
    steps: int
    row: Row | None = None
    validation: Row | None = None


def silent(progress: Progress) -> None:
    """Show nothing."""


def fit(
    module: TrainingModule,
    batches: Batches,
    configuration: TrainingConfiguration,
    out: Path,
    *,
    fabric: Fabric | None = None,
    describe: Describe = lambda state: {"steps": state.step},
    validate: Validate | None = None,
    report: Callable[[Progress], None] = silent,
    log: Log | None = None,
) -> TrainingState:
    """Train a module, or go on with it; ends with the averaged weights in ``out/weights.safetensors``.

    With validations they are those of the best one.

    Args:
        module: The module before the first step; a checkpoint in ``out`` replaces that state.
        batches: Called once, with the number of batches that were taken before.
        configuration: Everything that decides the result, together with module and batches.
        out: The training folder: checkpoints, log, weights and their card.
        fabric: Device and processes, launched; the CPU by default.
        describe: The card for a state.
        validate: Called every ``validation.every`` steps, by the first process.
        report: Called after every step, by the first process.
        log: Called with every line of the log beside TensorBoard, by the first process.

    Returns:
        The state after the last step.

    Raises:
        TrainingStopped: after SIGTERM or Ctrl-C; everything was saved.
        TrainingError: if a loss is no longer finite, or a checkpoint does not fit the module.
        StorageError: if a file cannot be written.
    """
    fabric = fabric or make_fabric("cpu")
    settings = configuration.training
    module.seed, module.rank, module.calls = settings.seed, fabric.global_rank, settings.steps
    module.train().to(fabric.device)
    state = TrainingState.start(module, settings)
    # A checkpoint is everything that the result depends on; logs and weights are made again from it.
    resumed = restore_checkpoint(out / _CHECKPOINTS, state)
    fabric.barrier()  # nobody writes a new checkpoint before everybody has read the old one
    outputs = None
    if fabric.is_global_zero:
        outputs = Outputs(out, out / _CHECKPOINTS, describe, log, dtype=settings.weights_dtype, resumed_at=state.step)
    try:
        with stop_on_signals() as asked, torch.random.fork_rng(devices=[]):
            session = _Session(state, configuration, fabric, outputs, asked, validate, report)
            if not resumed:
                session.save()  # from here on the folder resumes
            session.train(batches)
            if resumed and outputs is not None:
                outputs.write_results(state)  # the last session may have been killed before it could
    finally:
        if outputs is not None:
            outputs.tensorboard.close()
    return state


@dataclass
class _Session:
    """A training between its start, or resumption, and its end."""

    state: TrainingState
    configuration: TrainingConfiguration
    fabric: Fabric
    outputs: Outputs | None
    asked: list[int]
    validate: Validate | None
    report: Callable[[Progress], None]

    def train(self, batches: Batches) -> None:
        """Go on to the last step.

        Raises:
            TrainingStopped: if asked to stop before that.
        """
        state = self.state
        settings = self.configuration.training
        # Set up here, after a checkpoint was restored: a process group copies the first process's weights to all.
        network = self.fabric.setup_module(state.module, move_to_device=False)
        self._validated()  # if the session before was stopped instead
        incoming = iter(batches(state.step))
        while not self._over():
            self._step(network, incoming)
            asked = state.step < settings.steps and self._asked_to_stop()
            measured = None if asked else self._validated()
            row = self._log() if self._due(settings.log_every) else None
            if self.outputs is not None:
                self.report(Progress(state.step, settings.steps, row, measured))
            if asked or self._due(settings.save_every):
                self.save()
            if asked:
                raise TrainingStopped(
                    f"stopped after step {state.step} of {settings.steps}; everything is saved."
                    " The same command goes on from there.",
                    signal=self.asked[0] if self.asked else None,
                )

    def save(self) -> None:
        """Write all outputs; the other processes wait."""
        if self.outputs is not None:
            self.outputs.save(self.state)
        self.fabric.barrier()

    def _over(self) -> bool:
        """Return True after the last step, or when the validations have not become better for long enough."""
        last = self.state.step >= self.configuration.training.steps
        return last or self.state.exhausted(self.configuration.validation.patience)

    def _due(self, every: int) -> bool:
        return self.state.step % every == 0 or self._over()

    def _rate(self, step: int) -> float:
        return self.state.module.learning_rate_factor(step) * learning_rate(step, self.configuration.training)

    def _step(self, network: Any, incoming: Iterator[Any]) -> None:
        """One step of the optimisers over the next batch."""
        state = self.state
        settings = self.configuration.training
        for optimiser in state.optimisers:
            for group in optimiser.param_groups:
                factor = 1.0 if group.get("steady") else state.module.learning_rate_factor(state.step)
                group["lr"] = factor * learning_rate(state.step, settings) * group.get("scale", 1.0)
        batch = next(incoming).to(self.fabric.device)
        # Dropout draws from torch's global generators; seeded anew, a resumed run drops the same.
        generator = named_generator("prbench-dropout", settings.seed, state.step, self.fabric.global_rank)
        torch.manual_seed(int(generator.integers(2**63 - 1)))
        with autocast(self.fabric.device, settings.precision):
            losses = network(batch, state.step)
        self.fabric.backward(losses["loss"].float())
        for name, loss in losses.items():
            state.losses[name] = state.losses.get(name, 0.0) + loss.detach()
        state.batches += 1
        if settings.gradient_clip is not None:
            for group in state.module.gradient_groups():
                torch.nn.utils.clip_grad_norm_(group, settings.gradient_clip)
        for optimiser in state.optimisers:
            optimiser.step()
            optimiser.zero_grad()
        state.step += 1
        state.average.update(state.step)

    def _reduced(self, values: list[float], how: str) -> list[float]:
        """Reduce numbers over all processes."""
        if self.fabric.world_size == 1:
            return values
        reduced = self.fabric.all_reduce(torch.tensor(values, device=self.fabric.device), reduce_op=how)
        assert isinstance(reduced, torch.Tensor)
        return reduced.tolist()

    def _log(self) -> Row:
        """Mean losses since the last line of the log, over all processes; waits for the device.

        Raises:
            TrainingError: if one is not finite.
        """
        state = self.state
        own = [float(total) / state.batches for total in state.losses.values()]
        means = dict(zip(state.losses, self._reduced(own, "mean")))
        for name, value in means.items():
            if not math.isfinite(value):
                why = "the training has diverged. The checkpoints are from before;"
                reason = "try a lower learning rate or a gradient_clip in another folder."
                raise TrainingError(f"'{name}' is {value} at step {state.step}: {why} {reason}")
        state.losses, state.batches = {}, 0
        row: Row = {"step": state.step, **means, "learning_rate": self._rate(state.step - 1)}
        state.rows.append(row)
        if self.outputs is not None:
            self.outputs.add(row, group="train")
        return row

    def _validated(self) -> Row | None:
        """Validate the averaged weights if it is time; the first process does, and tells the others."""
        state = self.state
        every = self.configuration.validation.every
        if self.validate is None or not every or not state.step or not self._due(every):
            return None
        if state.validations and state.validations[-1]["step"] == state.step:
            return None
        measured: Row = {}
        if self.outputs is not None:
            state.module.eval()
            with state.average.applied(), autocast(self.fabric.device, self.configuration.training.precision):
                measured = {"step": state.step, **self.validate(state.module)}
            state.module.train()
            self.outputs.add(measured, group="validation")
        measured = self.fabric.broadcast(measured)
        state.add_validation(measured)
        return measured

    def _asked_to_stop(self) -> bool:
        if self.fabric.world_size > 1 and self.state.step % _STEPS_BETWEEN_QUESTIONS:
            return False
        return self._reduced([float(bool(self.asked))], "sum")[0] > 0
