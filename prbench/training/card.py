"""The card beside the weights: what they are, what they were made from, and how far the training came."""

from __future__ import annotations

import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import msgspec
import torch

import prbench
from prbench.training.record import TrainingRecord
from prbench.training.state import Row, TrainingState

CARD_VERSION = 2
"""2: times stand in ``timing.json``, so that the same training has the same card."""
_CURVE_POINTS = 100
_PACKAGES = ("numpy", "pyarrow", "torch", "lightning-fabric", "safetensors", "transformers")


def training_card(record: TrainingRecord, state: TrainingState, device: torch.device, threads: int) -> dict[str, Any]:
    """The card of a state.

    Args:
        record: What decides the result.
        state: Its steps, learning curve and validations.
        device: Where it was trained.
        threads: Torch's threads, on which the last bits depend on a CPU.
    """
    steps = record.configuration.training.steps
    return {
        "card_version": CARD_VERSION,
        "prbench": prbench.__version__,
        "method": record.method,
        "stage": record.stage,
        "finished": state.step >= steps,
        "steps": state.step,
        "parameters": sum(parameter.numel() for parameter in state.average.parameters.values()),
        "averaged": record.configuration.training.ema > 0,
        "device": device_in_words(device),
        "devices": record.devices,
        "threads": threads,
        "packages": _packages(),
        "configuration": msgspec.to_builtins(record.configuration),
        "data": msgspec.to_builtins(record.data),
        "initial_weights_sha256": record.initial_weights_sha256,
        "learned_from": list(state.module.learned_from()),
        "learning_curve": thinned(state.rows, _CURVE_POINTS),
        "validation": state.validations,
    }


def training_times(state: TrainingState) -> dict[str, Any]:
    """Return how long a training took, which no two trainings have in common."""
    return {
        "steps": state.step,
        "seconds": round(state.seconds, 1),
        "waiting_fraction": round(state.waiting, 4),
        "timings": thinned(state.timings, _CURVE_POINTS),
    }


def thinned(rows: list[Row], points: int) -> list[Row]:
    """Select at most ``points`` rows, spread evenly, the last among them."""
    if len(rows) <= points:
        return rows
    places = sorted({round((place + 1) * len(rows) / points) - 1 for place in range(points)})
    return [rows[place] for place in places]


def device_in_words(device: torch.device) -> str:
    """``cpu (x86_64)``, or the name of the GPU."""
    if device.type == "cuda":
        return f"cuda ({torch.cuda.get_device_name(device)})"
    return f"{device.type} ({platform.machine()})"


def _packages() -> dict[str, str]:
    found = {"python": ".".join(map(str, sys.version_info[:3]))}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
