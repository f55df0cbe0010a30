"""One planned batch: ask the method, measure what that took, write its answer as one part."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import psutil

from prbench.harness.benchmark import Answer, Question
from prbench.harness.methods.loading import MethodSpec, count_parameters
from prbench.harness.methods.process import computing_threads
from prbench.harness.run_folder.cost import BatchCost
from prbench.harness.run_folder.predictions import write_part


@dataclass(frozen=True)
class BatchTask:
    """The unit of work and of resumption. Goes to a worker as it is; a method sees nothing but the question."""

    index: int
    sequence_ids: tuple[str, ...]
    question: Question
    method: MethodSpec | None
    """None for a control."""
    seed: int
    part: Path
    cost: Path
    protocol_version: int

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
    answer, cost = _controlled(task) if task.method is None else _asked(task, task.method)
    cost.write(task.cost)  # first, so that a part on disk is never without its measurement
    write_part(task.part, task.sequence_ids, answer.seeds, answer.samples, protocol_version=task.protocol_version)
    return task.index


def _asked(task: BatchTask, spec: MethodSpec) -> tuple[Answer, BatchCost]:
    method = spec.load()
    warm_up = not method.warmed_up
    _reset_device_peak()
    peak = 0

    def measure() -> None:
        nonlocal peak
        peak = max(peak, psutil.Process().memory_info().rss)

    crashes_before = method.restarts
    started = _synchronised_time()
    with computing_threads(spec.threads):
        answer = task.question.ask(method, seed=task.seed, sequence_ids=task.sequence_ids, measure=measure)
    seconds = _synchronised_time() - started
    # A program's memory is not in the resident size of this process.
    peak += method.program_bytes()
    method.warmed_up = True
    cost = _cost(task, answer, seconds, warm_up, peak)
    restarts = method.restarts - crashes_before
    return answer, msgspec.structs.replace(cost, restarts=restarts, parameters=count_parameters(method.adapter))


def _controlled(task: BatchTask) -> tuple[Answer, BatchCost]:
    answer = task.question.ask(None, seed=task.seed, sequence_ids=task.sequence_ids, measure=lambda: None)
    return answer, _cost(task, answer, 0.0, False, psutil.Process().memory_info().rss)


def _cost(task: BatchTask, answer: Answer, seconds: float, warm_up: bool, peak_process_bytes: int) -> BatchCost:
    return BatchCost(
        batch=task.index,
        motions=len(answer.samples) * len(task.sequence_ids),
        frames=sum(int(rows.offsets[-1]) for rows in answer.samples),
        seconds=seconds,
        warm_up=warm_up,
        peak_process_bytes=peak_process_bytes,
        peak_device_bytes=_device_peak(),
        halvings=answer.halvings,
        network_passes=answer.network_passes,
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
