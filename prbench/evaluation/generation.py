"""One planned batch: generate its samples, measure what that took, write them as one part."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import psutil
from jaxtyping import Float, Int

from prbench.contract import ConditionBatch, Motions
from prbench.evaluation.best_of import ChoiceRules, best_motions
from prbench.evaluation.carry_on import placed
from prbench.methods.loaded_methods import MethodSpec
from prbench.methods.motions import generate_checked
from prbench.methods.parameters import count_parameters
from prbench.methods.users_environment import computing_threads
from prbench.runs.cost import BatchCost
from prbench.runs.predictions import PredictionRows, write_part


@dataclass(frozen=True)
class BatchTask:
    """The unit of work and of resumption. Goes to a worker as it is; a method sees nothing but ``conditions``."""

    index: int
    sequence_ids: tuple[str, ...]
    conditions: tuple[ConditionBatch, ...]
    """One batch for each motion drawn of a sequence; they differ in their noise seeds only."""
    choice: ChoiceRules
    """What is kept of them, which the method never sees."""
    method: MethodSpec | None
    """None for a control."""
    seed: int
    given: Motions | None
    """Motions that the harness itself supplies (controls), instead of the method's."""
    part: Path
    cost: Path
    protocol_version: int
    placements: tuple[Float[np.ndarray, "batch 4 4"], ...] = ()
    """For each sample the frames of the table from those of the conditions; empty where they are the same."""

    @property
    def name(self) -> str:
        """Name of the batch in messages."""
        return f"batch {self.index}, from sequence {self.sequence_ids[0]} on"


def run_batch(task: BatchTask) -> int:
    """Generate, check, measure and write one batch.

    Returns:
        The index of the batch.

    Raises:
        AdapterError: if the method breaks the contract; nothing is written then.
        StorageError: if the part cannot be written.
    """
    samples, seeds, cost = _controlled(task) if task.given is not None else _generated(task)
    cost.write(task.cost)  # first, so that a part on disk is never without its measurement
    rows = [_rows(motions) for motions in samples]
    write_part(task.part, task.sequence_ids, seeds, rows, protocol_version=task.protocol_version)
    return task.index


def _rows(motions: Motions) -> PredictionRows:
    rays = None
    if motions.gaze is not None:
        rays = np.stack((motions.gaze.origin, motions.gaze.direction), axis=2)
    return PredictionRows.from_padded(motions.joints, motions.n_frames, gaze=rays)


_Made = tuple[list[Motions], list[tuple[int, ...]], BatchCost]
"""The motions that are kept, sample by sample, the noise seeds that they come from, and what all draws have cost."""


def _generated(task: BatchTask) -> _Made:
    assert task.method is not None
    method = task.method.load()
    warm_up = not method.warmed_up
    _reset_device_peak()
    samples: list[Motions] = []
    seeds: list[tuple[int, ...]] = []
    halvings = 0
    peak = 0
    crashes_before = method.restarts
    started = _synchronised_time()
    with computing_threads(task.method.threads):
        for first in range(0, len(task.conditions), task.choice.best_of):
            batches = task.conditions[first : first + task.choice.best_of]
            draws: list[Motions] = []
            for batch in batches:
                motions, halved = generate_checked(
                    method.adapter, batch, seed=task.seed, method=method.name, sequence_ids=task.sequence_ids
                )
                draws.append(motions)
                halvings += halved
                peak = max(peak, psutil.Process().memory_info().rss)
            kept, chosen = best_motions(draws, batches, task.choice) if len(draws) > 1 else _only(draws)
            if task.placements:
                kept = placed(kept, task.placements[len(samples)])
            samples.append(kept)
            seeds.append(tuple(batches[draw].noise_seed[row] for row, draw in enumerate(chosen)))
    seconds = _synchronised_time() - started
    # A program's memory is not in the resident size of this process.
    peak += method.program_bytes()
    method.warmed_up = True
    declared = [motions.cost.network_passes for motions in samples if motions.cost is not None]
    cost = _cost(task, samples, seconds, warm_up, halvings, peak, sum(declared) if declared else None)
    restarts = method.restarts - crashes_before
    cost = msgspec.structs.replace(cost, restarts=restarts, parameters=count_parameters(method.adapter))
    return samples, seeds, cost


def _only(draws: list[Motions]) -> tuple[Motions, Int[np.ndarray, " batch"]]:
    """The one draw there is; under a condition without goal there is nothing to choose by."""
    return draws[0], np.zeros(len(draws[0].n_frames), dtype=np.int64)


def _controlled(task: BatchTask) -> _Made:
    assert task.given is not None
    samples = [task.given] * len(task.conditions)
    seeds = [batch.noise_seed for batch in task.conditions]
    return samples, seeds, _cost(task, samples, 0.0, False, 0, psutil.Process().memory_info().rss, None)


def _cost(
    task: BatchTask,
    samples: list[Motions],
    seconds: float,
    warm_up: bool,
    halvings: int,
    peak_process_bytes: int,
    network_passes: int | None,
) -> BatchCost:
    return BatchCost(
        batch=task.index,
        motions=len(samples) * len(task.sequence_ids),
        frames=sum(int(motions.n_frames.sum()) for motions in samples),
        seconds=seconds,
        warm_up=warm_up,
        peak_process_bytes=peak_process_bytes,
        peak_device_bytes=_device_peak(),
        halvings=halvings,
        network_passes=network_passes,
    )


def _synchronised_time() -> float:
    if cuda := _used_cuda():
        cuda.synchronize()  # the GPU works on after a call has returned
    return time.perf_counter()


def _reset_device_peak() -> None:
    if cuda := _used_cuda():
        cuda.reset_peak_memory_stats()


def _device_peak() -> int | None:
    cuda = _used_cuda()
    return None if cuda is None else int(cuda.max_memory_allocated())


def _used_cuda() -> Any:
    """Return ``torch.cuda`` where the method has used it; asking torch itself would import and start it."""
    torch = sys.modules.get("torch")
    used = torch is not None and torch.cuda.is_available() and torch.cuda.is_initialized()
    return torch.cuda if torch is not None and used else None
