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
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import torch

from prbench.errors import MissingExtraError, TrainingError, TrainingStopped, UsageError
from prbench.randomness import named_generator
from prbench_adapters.training.configuration import OptimisationConfiguration, TrainingConfiguration
from prbench_adapters.training.report import Describe, Outputs
from prbench_adapters.training.state import Checkpoints, Row, Tally, TrainingState, learning_rate
from prbench_adapters.training.task import TrainingModule

if TYPE_CHECKING:
    from lightning_fabric import Fabric

_STARTED_ON_EVERY_NODE = ("SLURM_JOB_ID", "TORCHELASTIC_RUN_ID", "MASTER_ADDR")
"""Set by srun, by torchrun, or by the user; Lightning Fabric finds the other nodes by them."""


def make_fabric(
    device: str, *, devices: int = 1, nodes: int = 1, precision: str = "32-true", spawn: bool = False
) -> Fabric:
    """The Fabric that a training runs on; launch it before anything else.

    Args:
        device: ``cpu``, ``cuda``, ``cuda:1``, ``mps``.
        devices: Processes that train together on this machine, each on a device of its own.
        nodes: Machines that train together, each with as many processes; the command runs on every one of them.
        precision: ``32-true``, or ``bf16-mixed``: matrix products in bfloat16, weights, losses and sums in float32.
        spawn: Start the processes from functions instead of running the command again (for tests and notebooks).

    Raises:
        UsageError: if there is no such device, or too few of them.
        MissingExtraError: if Lightning Fabric is not installed.
    """
    try:
        from lightning_fabric import Fabric
        from lightning_fabric.plugins import MixedPrecision, Precision
    except ModuleNotFoundError as error:
        raise MissingExtraError("lightning-fabric", "train", "training") from error

    class HeldPrecision(MixedPrecision):
        """Autocast alone: Fabric would also round features and targets to bfloat16 before the module sees them."""

        def convert_input(self, data: Any) -> Any:
            return data

    kind, index = _require_device(device, devices)
    if nodes > 1:
        _require_other_nodes(nodes)
    chosen: Any = [index] if index is not None else devices
    plugin = HeldPrecision("bf16-mixed", kind) if precision == "bf16-mixed" else Precision()
    several = "ddp_spawn" if spawn else "ddp"
    strategy = "auto" if devices * nodes == 1 else several
    return Fabric(accelerator=kind, devices=chosen, num_nodes=nodes, strategy=strategy, plugins=[plugin])


def _require_other_nodes(nodes: int) -> None:
    """Refuse several machines where nothing says how to find them: the processes would wait for each other for ever.

    Raises:
        UsageError: with the ways to start them.
    """
    if not any(name in os.environ for name in _STARTED_ON_EVERY_NODE):
        raise UsageError(
            f"--nodes {nodes}: nothing says where the other machines are. Start the same command on each of them, by"
            " srun or torchrun, or with MASTER_ADDR and MASTER_PORT (the first machine's) and NODE_RANK (0, 1, …) set."
        )


def _require_device(device: str, devices: int = 1) -> tuple[str, int | None]:
    """Kind and number of a device.

    Raises:
        UsageError: if there is no such device, or too few of them.
    """
    kind, _, number = device.partition(":")
    if kind not in ("cpu", "cuda", "mps") or (number and not number.isdigit()):
        raise UsageError(f"--device: expected cpu, cuda, cuda:1 … or mps, found '{device}'.")
    if number and devices > 1:
        raise UsageError(f"--device {device} names one device; leave the number out to use {devices} of them.")
    available = {"cpu": None, "cuda": torch.cuda.device_count(), "mps": int(torch.backends.mps.is_available())}[kind]
    wanted = int(number) + 1 if number else devices
    if available is not None and available < wanted:
        raise UsageError(
            f"--device {device}{f' --devices {devices}' if devices > 1 else ''}: torch {torch.__version__} finds"
            f" {available or 'no'} such device{'s' if available != 1 else ''} here. Use --device cpu, or install a"
            " build of torch for your GPU and its driver."
        )
    return kind, int(number) if number else None


class StopRequest:
    """Records whether, and by which signal, the training was asked to stop."""

    signal: int | None = None

    @property
    def name(self) -> str:
        """Name of the signal, such as ``SIGTERM``."""
        return signal.Signals(self.signal).name if self.signal is not None else ""

    def __bool__(self) -> bool:
        return self.signal is not None


@contextlib.contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Note SIGTERM and Ctrl-C instead of dying of them; a second one is obeyed at once.

    Outside of the main thread signals cannot be caught, and the request stays empty.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}

    def note(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - what Python hands over
        # The second Ctrl-C comes from somebody who does not want to wait for the step.
        if request.signal is not None:
            raise KeyboardInterrupt
        request.signal = number

    try:
        for number in before:
            signal.signal(number, note)
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


_CHECKPOINTS = "checkpoints"
_STEPS_BETWEEN_QUESTIONS = 10  # processes that train together agree to stop; asking costs a message each

Batches = Callable[[int], Iterable[Any]]
"""Maps the number of batches taken before to the batches that follow, without end."""
Validate = Callable[[TrainingModule], Row]
"""Maps a module with the averaged weights, in evaluation mode, to what was measured."""


@dataclass(frozen=True)
class Progress:
    """Progress of a training."""

    step: int
    steps: int
    row: Row | None = None
    """A new line of the log, if there is one."""
    validation: Row | None = None
    """Measurements of a validation, if there was one."""


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
) -> TrainingState:
    """Train a module, or go on with it; ends with the averaged weights in ``out/weights.safetensors``.

    Args:
        module: In its state before the first step; a checkpoint in ``out`` replaces that state.
        batches: Called once, with the number of batches that were taken before.
        configuration: Everything that decides the result, together with module and batches.
        out: The training folder: checkpoints, logs, curves, weights and their card.
        fabric: Device, processes and precision, launched; the CPU by default.
        describe: The card for a state.
        validate: Called every ``validation.every`` steps, by the first process.
        report: Called after every step, by the first process.

    Returns:
        The state after the last step.

    Raises:
        TrainingStopped: after SIGTERM or Ctrl-C; everything was saved.
        TrainingError: if a loss is no longer finite, or a checkpoint does not fit the module.
        StorageError: if a file cannot be written.
    """
    fabric = fabric or make_fabric("cpu", precision=configuration.training.precision)
    module.seed, module.rank = configuration.training.seed, fabric.global_rank
    module.calls = configuration.training.steps * configuration.training.micro_batches
    module.train().to(fabric.device)
    state = TrainingState.start(module, configuration.training)
    # A checkpoint is everything that the result depends on; logs and weights are made again from it.
    checkpoints = Checkpoints(out / _CHECKPOINTS)
    resumed = checkpoints.restore(state)
    fabric.barrier()  # nobody writes a new checkpoint before everybody has read the old one
    outputs = None
    if fabric.is_global_zero:
        dtype = configuration.training.weights_dtype
        outputs = Outputs(out, checkpoints, describe, dtype=dtype, resumed_at=state.step)
    try:
        with stop_on_signals() as stop, torch.random.fork_rng(devices=[]):
            session = _Session(state, configuration, fabric, outputs, stop, validate, report)
            if not resumed:
                session.save()  # from here on the folder resumes
            session.train(batches)
            if resumed and outputs is not None:
                outputs.write_results(state)  # the last session may have been killed before it could
    finally:
        if outputs is not None:
            outputs.close(state)
    return state


@dataclass
class _Session:
    """A training between its start, or resumption, and its end."""

    state: TrainingState
    configuration: TrainingConfiguration
    fabric: Fabric
    outputs: Outputs | None
    stop: StopRequest
    validate: Validate | None
    report: Callable[[Progress], None]

    @property
    def settings(self) -> OptimisationConfiguration:
        return self.configuration.training

    def train(self, batches: Batches) -> None:
        """Go on to the last step.

        Raises:
            TrainingStopped: if asked to stop before that.
        """
        state = self.state
        settings = self.settings
        # Set up here, after a checkpoint was restored: a process group copies the first process's weights to all.
        network = self.fabric.setup_module(state.module, move_to_device=False)
        self.validated_at = int(state.validations[-1]["step"]) if state.validations else 0
        self._validated()  # if the session before was stopped instead
        incoming = iter(batches(state.step * settings.micro_batches))
        while state.step < settings.steps:
            started = time.perf_counter()
            self._step(network, incoming)
            means = self._means() if self._due(settings.log_every) else None
            state.seconds += time.perf_counter() - started
            row = self._log(means) if means is not None else None
            asked = state.step < settings.steps and self._asked_to_stop()
            measured = None if asked else self._validated()
            if self.outputs is not None:
                self.report(Progress(state.step, settings.steps, row, measured))
            if asked or self._due(settings.save_every):
                self.save()
            if asked:
                raise TrainingStopped(
                    f"stopped after step {state.step} of {settings.steps}; everything is saved."
                    " The same command goes on from there.",
                    signal=self.stop.signal,
                )

    def save(self) -> None:
        """Write all outputs; the other processes wait."""
        if self.outputs is not None:
            self.outputs.save(self.state)
        self.fabric.barrier()

    def _due(self, every: int) -> bool:
        return self.state.step % every == 0 or self.state.step == self.settings.steps

    def _step(self, network: Any, incoming: Iterator[Any]) -> None:
        """One step of the optimiser over ``micro_batches`` batches."""
        state = self.state
        settings = self.settings
        for optimiser in state.optimisers:
            for group in optimiser.param_groups:
                group["lr"] = self._learning_rate(state.step) * group.get("scale", 1.0)
        for micro in range(settings.micro_batches):
            started = time.perf_counter()
            batch = next(incoming).to(self.fabric.device)
            state.waited += time.perf_counter() - started
            number = state.step * settings.micro_batches + micro
            _seed_dropout(settings.seed, number, self.fabric.global_rank)
            with self.fabric.no_backward_sync(network, enabled=micro < settings.micro_batches - 1):
                losses = network(batch, number)
                self.fabric.backward(losses["loss"] / settings.micro_batches)
            state.tally.add(losses)
        if settings.gradient_clip is not None:
            for group in state.module.gradient_groups():
                torch.nn.utils.clip_grad_norm_(group, settings.gradient_clip)
        for optimiser in state.optimisers:
            optimiser.step()
            optimiser.zero_grad()
        state.step += 1
        state.average.update(state.step)

    def _learning_rate(self, step: int) -> float:
        factor = self.state.module.learning_rate_factor(step * self.settings.micro_batches)
        return factor * learning_rate(step, self.settings)

    def _means(self) -> dict[str, float]:
        """Mean losses since the last line of the log, over all processes; waits for the device.

        Raises:
            TrainingError: if one is not finite.
        """
        means = self._over_processes(self.state.tally.means())
        for name, value in means.items():
            if not math.isfinite(value):
                raise TrainingError(
                    f"'{name}' is {value} at step {self.state.step}: the training has diverged. The checkpoints are"
                    " from before; try a lower learning rate or a gradient_clip in another folder."
                )
        return means

    def _over_processes(self, means: dict[str, float]) -> dict[str, float]:
        if self.fabric.world_size == 1:
            return means
        together = torch.tensor(list(means.values()), device=self.fabric.device)
        reduced = self.fabric.all_reduce(together, reduce_op="mean")
        assert isinstance(reduced, torch.Tensor)
        return dict(zip(means, reduced.tolist()))

    def _log(self, means: dict[str, float]) -> Row:
        state = self.state
        state.tally = Tally()
        rate = self._learning_rate(state.step - 1)
        row: Row = {"step": state.step, **means, "learning_rate": rate}
        timing: Row = {"step": state.step, "seconds": state.seconds, "waiting": state.waiting}
        state.rows.append(row)
        state.timings.append(timing)
        shown = {**row, **timing}
        if self.outputs is not None:
            self.outputs.add(shown, group="train")
        return shown

    def _validated(self) -> Row | None:
        """Validate the averaged weights if it is time; only the first process does, and the others wait."""
        state = self.state
        every = self.configuration.validation.every
        if self.validate is None or not every or not state.step or not self._due(every):
            return None
        if self.validated_at == state.step:
            return None
        self.validated_at, measured = state.step, None
        if self.outputs is not None:
            state.module.eval()
            with state.average.applied():
                measured = {"step": state.step, **self.validate(state.module)}
            state.module.train()
            state.validations.append(measured)
            self.outputs.add(measured, group="validation")
        self.fabric.barrier()
        return measured

    def _asked_to_stop(self) -> bool:
        if self.fabric.world_size == 1:
            return bool(self.stop)
        if self.state.step % _STEPS_BETWEEN_QUESTIONS:
            return False
        asked = torch.tensor(float(bool(self.stop)), device=self.fabric.device)
        votes = self.fabric.all_reduce(asked, reduce_op="sum")
        assert isinstance(votes, torch.Tensor)
        return bool(votes > 0)


def _seed_dropout(seed: int, number: int, rank: int) -> None:
    """Seed torch's global generators, from which dropout draws, for one batch."""
    torch.manual_seed(int(named_generator("prbench-dropout", seed, number, rank).integers(2**63 - 1)))
