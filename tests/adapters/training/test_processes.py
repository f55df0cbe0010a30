"""Two processes that train together do what one would do with all their batches."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from prbench.files.storage import read_json, write_json
from prbench_adapters.training.configuration import OptimisationConfiguration, TrainingConfiguration
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.loop import fit, make_fabric
from prbench_adapters.training.task import TrainingModule
from tests.adapters.training.toy import random_batch, rows_of

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
