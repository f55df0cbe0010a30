"""Checks that the same input and noise seed give the same motion, in any batch and in any process."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from prbench.checking.conformance.answer import STATE_SEED, TOLERANCE, AnyAnswer, largest_changes, metres, same_bytes
from prbench.checking.conformance.check import check
from prbench.checking.conformance.method_subject import MethodSubject
from prbench.checking.conformance.report import Observation, Remedy, failed, passed, skipped, warning

_ROUNDING = np.float32(1e-6)  # metres; about the last digit of a float32 position some metres away
_AMPLIFIED = 30.0  # how much more than such a nudge another batch may move a motion of a method that amplifies rounding


@check("determinism", "the same batch gives the same motions", of_motions=True)
def determinism(subject: MethodSubject) -> Iterator[Observation]:
    """Ask for the usual batch again, after another one."""
    first = subject.standard(subject.main)
    # Another batch in between shows a method that carries state from call to call.
    subject.ask(subject.batch(subject.rows[:1], subject.main, sample=7))
    again = subject.ask(first.batch)
    yield _compared(
        first, again, "asked for the same batch a second time",
        subject.own_generators.after("Something is left over from earlier calls, or drawn from time or the system."),
    )  # fmt: skip


@check("global-random", "nothing is drawn from global generators", needs=("determinism",), of_motions=True)
def global_random(subject: MethodSubject) -> Iterator[Observation]:
    """Ask for the usual batch with other states of Python's, NumPy's and torch's global generators."""
    if subject.is_program:
        yield skipped("a program's generators are its own; 'determinism' and 'process' see what they would change.")
        return
    first = subject.standard(subject.main)
    other = subject.ask(first.batch, state_seed=STATE_SEED + 1)
    drew = ", ".join(sorted(subject.drew_from)) or "a global generator"
    if other.motions is not None and same_bytes(first, other):
        if subject.drew_from:
            yield warning(
                f"it sets or draws from {drew}, though its motions do not change with it.",
                subject.own_generators.after(
                    "Leave global generators alone: another method or test in the process may use them."
                ),
            )
        else:
            yield passed("no global generator is touched.")
        return
    yield _compared(first, other, f"with {drew} in another state", subject.own_generators)


@check("noise-seed", "noise_seed is the only source of chance", needs=("determinism", "global-random"), of_motions=True)
def noise_seed(subject: MethodSubject) -> Iterator[Observation]:
    """Ask for the usual batch with another run's seed and opaque ids, then with other noise seeds."""
    first = subject.standard(subject.main)
    renamed = tuple(name[::-1] for name in first.batch.opaque_id)
    other_run = subject.ask(dataclasses.replace(first.batch, opaque_id=renamed), seed=1)
    finding = _compared(
        first, other_run, "with another 'seed' and other opaque ids, but the same noise seeds",
        subject.own_generators.after("Both are for the record: noise_seed alone tells sequences and samples apart."),
    )  # fmt: skip
    if finding.remedy:
        yield finding
        return
    redrawn = subject.ask(subject.batch(subject.rows, subject.main, sample=1))
    if redrawn.motions is None:
        yield failed(f"with other noise seeds: {redrawn.error}", subject.own_generators)
        return
    changes = largest_changes(first, redrawn)
    if not changes.any():
        yield passed("the run's seed changes nothing; the method draws nothing: more --samples would be copies.")
    elif not changes.all():
        still = int((changes == 0).sum())
        yield failed(
            f"with other noise seeds, {still} of {len(changes)} motions stayed the same and the others changed.",
            subject.own_generators.after("Use the noise_seed of each row, not that of the first."),
        )
    else:
        yield passed(
            f"the run's seed changes nothing, another noise_seed moves joints by up to {metres(changes.max())}.",
            change_m=changes.max(),
        )


@check("process", "another process generates the same motions", needs=("determinism",), fresh=True, of_motions=True)
def process(subject: MethodSubject) -> Iterator[Observation]:
    """Ask for the very first batch in a process that has done nothing else."""
    kept = subject.first_motions()
    if kept is None:
        yield skipped("there are no motions of the first process to compare with.")
        return
    answer = subject.first_answer
    if answer.motions is None:
        yield failed(f"in another process: {answer.error}", "Find out what the first process had that this one lacks.")
        return
    moved = float(np.linalg.norm(answer.motions.joints - kept, axis=-1).max())
    if not moved:
        yield passed("another process gave the same bytes.", change_m=0.0)
        return
    text = f"another process moved joints by up to {metres(moved)}."
    remedy = (
        "A run may use several processes and be resumed in new ones. Python's hash() of text and the order of sets"
        " change from process to process, and so does whatever is drawn or read while loading."
    )
    yield (failed if moved > TOLERANCE else warning)(text, remedy, change_m=moved)


@check("single-row", "a batch of one works", of_motions=True)
def single_row(subject: MethodSubject) -> Iterator[Observation]:
    """Ask for the first sequence alone."""
    answer = subject.ask(subject.batch(subject.rows[:1], subject.main))
    if answer.motions is None:
        yield failed(
            f"a batch of one {subject.case}: {answer.error}",
            "Keep the first axis: squeeze() without an axis and indexing by a boolean lose it when there is one row.",
        )
    else:
        yield passed(f"one {subject.case} alone works.")


@check(
    "batch",
    "neither order nor size of the batch changes a motion",
    needs=("determinism", "global-random", "noise-seed", "single-row"),
    of_motions=True,
)
def batch(subject: MethodSubject) -> Iterator[Observation]:
    """Ask for the usual sequences in reverse, and in two parts."""
    first = subject.standard(subject.main)
    n = len(first.batch)
    if n < 2:
        yield skipped(f"there is only one {subject.case} to ask about.")
        return
    orders = {"in reverse order": [list(range(n))[::-1]], "in two parts": [list(range(n // 2)), list(range(n // 2, n))]}
    moved: dict[str, float] = {}
    for name, parts in orders.items():
        for part in parts:
            answer = subject.ask(subject.rows_of(first.batch, part))
            if answer.motions is None:
                yield failed(f"the same {subject.case}s {name}: {answer.error}", subject.own_row)
                return
            moved[name] = max(moved.get(name, 0.0), largest_changes(first, answer, part).max())
    yield _judged(subject, first, moved)


def _compared(first: AnyAnswer, second: AnyAnswer, when: str, remedy: str | Remedy) -> Observation:
    """Pass equal bytes, warn of rounding, and fail anything else."""
    if second.motions is None:
        return failed(f"{when}: {second.error}", remedy)
    if same_bytes(first, second):
        return passed(f"{when}: the same bytes.", change_m=0.0)
    moved = largest_changes(first, second).max()
    if moved <= TOLERANCE:
        return warning(
            f"{when}: joints moved by up to {moved:.1e} m.",
            "That is rounding; resumed runs may differ in the last digits."
            " torch.use_deterministic_algorithms(True) names the operations.",
            change_m=moved,
        )
    return failed(f"{when}: joints moved by up to {metres(moved)}.", remedy, change_m=moved)


def _judged(subject: MethodSubject, first: AnyAnswer, moved: dict[str, float]) -> Observation:
    most = max(moved.values())
    told = " and ".join(f"by {metres(distance)} {name}" for name, distance in moved.items() if distance > TOLERANCE)
    if most <= TOLERANCE:
        return passed(f"the same within {metres(most)} (tolerance {metres(TOLERANCE)}).", change_m=most)
    # Optimisation at generation time amplifies rounding; the same nudge tells it from a defect.
    amplified = _amplified(subject, first)
    if most <= _AMPLIFIED * amplified:
        return warning(
            f"the same {subject.case}s move {told}; but a nudge of {_ROUNDING:.0e} m of their input alone moves them by"
            f" {metres(amplified)}: the method amplifies rounding, as optimisation does.",
            "Only scores can be compared between batch sizes, not motions; name the batch size beside your results.",
            change_m=most,
            amplified_m=amplified,
        )
    return failed(f"the same {subject.case}s move {told}.", subject.own_row, change_m=most, amplified_m=amplified)


def _amplified(subject: MethodSubject, first: AnyAnswer) -> float:
    """Return how far motions move, in metres, if their input changes in the last digit only."""
    nudged = subject.nudged(first.batch, _ROUNDING)
    if nudged is None:
        return 0.0
    answer = subject.ask(nudged)
    return 0.0 if answer.motions is None else float(largest_changes(first, answer).max())


CHECKS = (determinism, global_random, noise_seed, process, single_row, batch)
