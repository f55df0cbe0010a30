"""The quicker of two precisions, measured once a machine: processors without bfloat16 units are slower with it."""

from __future__ import annotations

import platform
import time
from pathlib import Path
from typing import Literal

import torch
from torch import nn

from prbench.files.storage import cache_folder, read_json, write_json
from prbench_adapters.training.record import RECORD, read_record

Precision = Literal["32-true", "bf16-mixed"]

_ROWS = 2048
_WIDTH = 128
"""Sizes of a small network's layer over a batch."""
_SECONDS = 0.5
_PRECISIONS: tuple[Precision, Precision] = ("32-true", "bf16-mixed")


def chosen_precision(wanted: Literal["32-true", "bf16-mixed", "auto"], *, device: str, out: Path) -> Precision:
    """Return the precision to train in.

    Args:
        wanted: ``auto`` for the quicker one on this machine.
        device: ``cpu``, ``cuda`` …
        out: The training folder; a training that goes on keeps its precision.
    """
    if wanted != "auto":
        return wanted
    if (out / RECORD).is_file():
        earlier = read_record(out).configuration.training.precision
        return "32-true" if earlier == "auto" else earlier
    if not device.startswith("cpu"):
        return "bf16-mixed"  # every GPU that trains such networks has units for it
    kept = cache_folder() / "precision.json"
    machine = f"{platform.node()}/{platform.machine()}/{torch.__version__}/{torch.get_num_threads()}"
    known = read_json(kept) if kept.is_file() else {}
    known = dict(known) if isinstance(known, dict) else {}
    if known.get(machine) not in _PRECISIONS:
        known[machine] = quicker_precision()
        write_json(kept, known)
    return known[machine]


def quicker_precision() -> Precision:
    """Train a layer on the processor for a second, half of it in each precision, and return the quicker one."""
    layer = nn.Sequential(nn.Linear(_WIDTH, 3 * _WIDTH), nn.GELU(), nn.Linear(3 * _WIDTH, _WIDTH))
    rows = torch.ones((_ROWS, _WIDTH))
    seconds = {precision: _seconds_a_step(layer, rows, precision) for precision in _PRECISIONS}
    return min(_PRECISIONS, key=lambda precision: seconds[precision])


def _seconds_a_step(layer: nn.Module, rows: torch.Tensor, precision: Precision) -> float:
    def step() -> None:
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=precision == "bf16-mixed"):
            made = layer(rows)
        made.float().square().mean().backward()

    step()  # the first one chooses kernels and reserves memory
    steps = 0
    started = time.perf_counter()
    while time.perf_counter() - started < _SECONDS:
        step()
        steps = steps + 1
    return (time.perf_counter() - started) / steps
