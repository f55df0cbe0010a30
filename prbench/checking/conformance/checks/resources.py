"""Checks the memory and the time that generating takes."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import numpy as np
import psutil

from prbench.checking.conformance.check import check
from prbench.checking.conformance.method_subject import MethodSubject
from prbench.checking.conformance.report import Observation, failed, passed, skipped, warning
from prbench.harness.methods.loading import unload_method
from prbench.harness.methods.process import EXIT_SECONDS, exit_story
from prbench.harness.methods.remote import RemoteMethod

_ROUNDS = 14
_FEWEST_ROUNDS = 8
_SETTLING = 3
_PATIENCE = 20.0  # seconds for all rounds
_GROWTH_WARNING = 32 * 1024
_GROWTH_FAILURE = 128 * 1024
"""Bytes a motion that stay behind; 128 KiB are 2.2 GiB in a run over 18,000 sequences."""
_LEAST_GROWTH = 4 * 1024 * 1024  # bytes in all that count as growth


@check("memory", "memory does not grow from batch to batch", needs=("determinism",), of_motions=True)
def memory(subject: MethodSubject) -> Iterator[Observation]:
    """Measure resident memory of this process and its children after each of many equal batches."""
    usual = subject.standard(subject.main)
    rounds = min(_ROUNDS, int(_PATIENCE / max(usual.seconds, 1e-6)))
    if rounds < _FEWEST_ROUNDS:
        yield skipped(
            f"a batch of {len(usual.batch)} takes {usual.seconds:.1f} s; {_FEWEST_ROUNDS} of them would take more than"
            f" {_PATIENCE:g} s."
        )
        return
    growth = np.inf
    resident: list[float] = []
    # What allocators, kernels and other threads of this process take is taken once, however late; a leak goes on. So
    # growth is looked at once more, and the smaller one counts.
    for _ in range(2):
        first = len(resident)
        gc.freeze()  # what is there already is not looked through again and again
        try:
            for _ in range(rounds):
                if error := subject.ask(usual.batch).error:
                    yield failed(f"in repeated batches: {error}", "Give back what a batch has taken.")
                    return
                resident.append(_resident_bytes())
        finally:
            gc.unfreeze()
        settled = np.array(resident[first + _SETTLING :], dtype=np.float64)
        growth = min(growth, growth_per_round(settled) / len(usual.batch))
        if growth < _GROWTH_WARNING:
            break
    total = max(resident) / 2**20
    kept = f"{growth / 1024:.0f} KiB a {subject.answer} stayed behind over {len(resident)} batches"
    text = f"{kept}; {total:.0f} MiB in all."
    remedy = "Keep nothing of a batch: look for lists and caches that grow, and for torch graphs (torch.no_grad())."
    numbers = {"growth_bytes_a_motion": growth, "resident_mib": total}
    if growth >= _GROWTH_FAILURE:
        yield failed(text, remedy, **numbers)
    elif growth >= _GROWTH_WARNING:
        yield warning(text, remedy, **numbers)
    else:
        yield passed(f"no growth over {len(resident)} batches; {total:.0f} MiB in all.", **numbers)


@check("speed", "how long it takes", of_motions=True)
def speed(subject: MethodSubject) -> Iterator[Observation]:
    """Measure the seconds of the first batch, which pays for what loads on first use, and of a usual one."""
    first = subject.first_answer
    usual = subject.standard(subject.main)
    a_motion = usual.seconds / len(usual.batch)
    yield passed(
        f"first batch ({len(first.batch)}) {first.seconds:.2f} s; then {len(usual.batch)} in {usual.seconds:.2f} s:"
        f" {a_motion:.3g} s a {subject.answer}, {1 / max(a_motion, 1e-9):.3g} {subject.answer}s a second on"
        f" {subject.spec.device}.",
        first_batch_s=first.seconds,
        motion_s=a_motion,
        motions_a_second=1 / max(a_motion, 1e-9),
    )


@check("exit", "its program ends by itself, with status 0", needs=("generates", "predicts"), of_motions=True)
def exits(subject: MethodSubject) -> Iterator[Observation]:
    """Close its stdin after a batch, as a run does at its end."""
    if subject.is_installed or not isinstance(subject.adapter, RemoteMethod):
        yield skipped("it has no program of its own.")
        return
    program = subject.adapter
    subject.ask(subject.batch(subject.rows[:1], subject.main))
    unload_method()
    status = program.exit_status
    subject.load_again()
    if status == 0:
        yield passed("it ended with exit status 0 when its stdin was closed.")
        return
    did = f"was still running after {EXIT_SECONDS:g} s and had to be ended" if status is None else exit_story(status)
    yield warning(
        f"when its stdin was closed, the program {did}.",
        "At the end of its input a program exits with status 0; motions are not touched by it, but schedulers and"
        " fences take it for a failure (docs/wire-protocol.md).",
    )


def _resident_bytes() -> int:
    """Return the memory of this process and its living children."""
    gc.collect()
    own = psutil.Process()
    total = own.memory_info().rss
    for child in own.children(recursive=True):
        try:
            total += child.memory_info().rss
        except psutil.Error:
            continue
    return total


def growth_per_round(resident: np.ndarray) -> float:
    """Return the bytes that a round adds: the median of all slopes (Theil and Sen), 0 unless most rounds add.

    Args:
        resident: Bytes after each round, settled.
    """
    # The median of slopes ignores single jumps, such as a cache that is filled once.
    first, second = np.triu_indices(len(resident), k=1)
    slope = float(np.median((resident[second] - resident[first]) / (second - first)))
    rising = np.mean(np.diff(resident) > 0)
    if resident[-1] - resident[0] < _LEAST_GROWTH or rising < 0.5:
        return 0.0
    return max(slope, 0.0)


CHECKS = (memory, speed, exits)
