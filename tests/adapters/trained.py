"""Trainings of every method at a tiny size, on made-up sequences that are written once a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from prbench.harness.methods.installed import load_task
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.task import TrainingData
from prbench_adapters.training.weights import write_weights
from tests.adapters.dart.tiny import SIZES as DART
from tests.adapters.wandr.tiny import TINY as WANDR
from tests.fakes import fake_dataset
from tests.shared import made_once

_DENOISER = {
    "width": 16,
    "heads": 2,
    "layers": 2,
    "feed_forward": 32,
    "dropout": 0.0,
    "text_encoder": "hashed-ngrams",
    "text_dimension": 64,
    "diffusion_steps": 10,
}
_UNETS = {"motion_widths": [8, 8], "trajectory_widths": [8, 8], "condition_width": 8, "padded_frames": 64}
_TEXT = {"text_encoder": "hashed-ngrams", "text_dimension": 64, "diffusion_steps": 10}
_FRAMES = {"architecture": "frames", "features": "goal-frame", "frames_per_token": 2, "diffusion_steps": 4}
_SCORED = {"ray_loss_weight": 2.0, "foot_loss_weight": 10.0, "wrist_loss_weight": 1.0}
# The table [model] of each method, and the method whose task reads it.
MODELS: dict[str, tuple[str, dict[str, Any]]] = {
    "mdm": ("mdm", _DENOISER),
    "pr": ("pr", {**_DENOISER, "goal": "location"}),
    "pr-frames": ("pr", {**_DENOISER, "goal": "location", **_FRAMES, **_SCORED}),
    "gmd": ("gmd", {**_UNETS, **_TEXT}),
    "dart": ("dart", {**DART, "diffusion_steps": 2, "vae_share": 0.5, "primitives": 2}),
    "wandr": ("wandr", {**WANDR, "frames_per_step": 200, "steps_per_chunk_frame": 1, "dropout": 0.0}),
}
CALLS = 100


def table(n: int = 24) -> Path:
    """The folder of a table of ``n`` sequences."""
    return made_once(f"training-{n}", lambda path: fake_dataset(path, n))


def sequences(n: int = 24, **options: Any) -> SequenceDataset:
    """The training split of that table; its features are computed once a run."""
    return SequenceDataset([table(n)], cache=made_once("training-cache", Path.mkdir), **options)


def batch_of(data: SequenceDataset, n: int = 6) -> MotionBatch:
    """The first items together."""
    return collate([data[index] for index in range(n)])


def build(
    name: str,
    data: SequenceDataset | None = None,
    *,
    initial: Path | None = None,
    stage: str = "finetune",
    seed: int = 0,
    **model: object,
) -> Any:
    """The module of a method before its first step, of a training of 100 calls."""
    torch.manual_seed(seed)
    data = sequences() if data is None else data
    given = TrainingData(train=data, mode=data.mode, max_frames=data.max_frames, fps=data.fps)
    task, own = MODELS[name]
    module = load_task(task).build({**own, **model}, data=given, initial=initial, stage=stage)
    module.calls = CALLS
    return module


def saved(module: Any, path: Path, **keywords: Any) -> Path:
    """The module's weights as a file."""
    tensors, metadata = module.weights()
    write_weights(path, tensors, metadata, {}, **keywords)
    return path
