"""The processes of a training: their devices and precision, and signals that stop them.

Lightning Fabric (extra ``train``) is imported on first use. A training that the system or the user stops ends after the
step at hand, so that what was learnt is saved first.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import TYPE_CHECKING, Any

import torch

from prbench.errors import MissingExtraError, UsageError

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
