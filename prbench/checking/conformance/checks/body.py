"""Checks that a body moves from where it stood, and of the memory that this takes."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import numpy as np
import psutil

from prbench.checking.conformance.findings import Finding, check, failed, passed, skipped, warning
from prbench.checking.conformance.subject import MethodSubject, Subject
from prbench.checking.doctor import Diagnosis, Expected, diagnose
from prbench.contract import Condition
from prbench.geometry.skeleton import bone_lengths
from prbench.harness.methods.motions import coordinate_problem

_INITIAL_WARNING = 0.10  # metres between the first frame and the initial pose, mean over joints (median over sequences)
_BONES_WARNING = 0.10
_BONES_FAILURE = 0.50  # relative change of bone lengths (median over bones and sequences)
# Kinds of diagnosis that already explain wrong bones, and a wrong first pose
_EXPLAINS_BONES = frozenset({"shape", "features", "not-finite", "empty-frames", "standardised", "unit", "joint-order"})
_EXPLAINS_POSE = _EXPLAINS_BONES | {"up-axis", "left-right", "mirrored", "root", "facing", "position"}
_CANONICAL = (
    "Give positions in the canonical frame of the sequence's first frame: metres, Y up, the pelvis of frame 0 over the"
    " origin and facing +Z (the left side on +X), the lowest joint of the motion on Y = 0."
)


@check("doctor", "no sign of a wrong frame rate, axis, unit, joint order …", of_motions=True)
def doctor(subject: Subject) -> Iterator[Finding]:
    """Run ``prbench doctor`` on the motions, with the conditions as expectations."""
    found = 0
    for condition in subject.working:
        diagnoses = _diagnosed(subject, condition)
        for diagnosis in diagnoses:
            # An average pose stands where the average person stood.
            if subject.declared.motionless and diagnosis.kind in ("facing", "position"):
                continue
            evidence = diagnosis.evidence.rstrip(".")
            cause = diagnosis.cause.rstrip(".")
            text = f"{diagnosis.kind}, under {condition.value}: {evidence}. Likely cause: {cause}."
            yield (failed if _is_failure(subject, diagnosis) else warning)(text, diagnosis.remedy)
            found += 1
        # What would end a run although every coordinate is a number.
        if not any(_is_failure(subject, diagnosis) for diagnosis in diagnoses):
            answer = subject.standard(condition)
            problems = [(row, coordinate_problem(answer.motion(row))) for row in range(len(answer.batch))]
            row, problem = next(((row, problem) for row, problem in problems if problem), (0, None))
            if problem is not None:
                yield failed(f"under {condition.value}: sequence #{row}, {problem}", _CANONICAL)
                found += 1
    if not found:
        yield passed("nothing that prbench doctor looks for.")


def _diagnosed(subject: Subject, condition: Condition) -> tuple[Diagnosis, ...]:
    answer = subject.standard(condition)
    batch = answer.batch
    return diagnose([answer.motion(row) for row in range(len(batch))], Expected.of_each(batch), fps=batch.fps)


def _is_failure(subject: Subject, diagnosis: Diagnosis) -> bool:
    return diagnosis.certain and not subject.declared.motionless  # a mean pose is nobody's pose


def _hidden_by(subject: Subject, kinds: frozenset[str]) -> Finding | None:
    """Return a skip if a diagnosed fault already explains a measurement, else None."""
    found = (each for condition in subject.working for each in _diagnosed(subject, condition))
    first = next((each.kind for each in found if each.kind in kinds and _is_failure(subject, each)), "")
    return skipped(f"not looked at before 'doctor' passes ({first}).") if first else None


@check("initial-pose", "motions begin with the pose that they were given", of_motions=True)
def initial_pose(subject: Subject) -> Iterator[Finding]:
    """Measure the distance between the first frame and ``initial_joints``."""
    given = [condition for condition in subject.working if subject.standard(condition).batch.initial_joints is not None]
    if hidden := _hidden_by(subject, _EXPLAINS_POSE):
        yield hidden
        return
    for condition in given:
        answer = subject.standard(condition)
        first = np.stack([answer.motion(row)[0] for row in range(len(answer.batch))])
        errors = np.linalg.norm(first - answer.batch.initial_joints, axis=-1).mean(axis=-1)
        error = float(np.median(errors))
        text = f"under {condition.value}: the first frame is {100 * error:.1f} cm from the initial pose (median;"
        text += f" largest {100 * errors.max():.1f} cm; mean over joints)."
        if error > _INITIAL_WARNING:
            yield warning(text, "Frame 0 is the initial pose, not the frame after it.", error_m=error)
        else:
            yield passed(text, error_m=error)
    if not given:
        yield skipped("it is given no initial pose.")


@check("bone-lengths", "one body, of one size, all the time", of_motions=True)
def bones(subject: Subject) -> Iterator[Finding]:
    """Measure how bone lengths change within a motion, and differ from the initial pose."""
    if hidden := _hidden_by(subject, _EXPLAINS_BONES):
        yield hidden
        return
    for condition in subject.working:
        answer = subject.standard(condition)
        lengths = [bone_lengths(answer.motion(row).astype(np.float64)) for row in range(len(answer.batch))]
        # The range of a bone's lengths within a motion, relative to its mean.
        ranges = [np.median(np.ptp(own, axis=0) / np.maximum(own.mean(axis=0), 1e-9)) for own in lengths]
        worst = change = float(np.median(ranges))
        text = f"under {condition.value}: bones change by {100 * change:.1f} % within a motion"
        if answer.batch.initial_joints is not None:
            own = bone_lengths(answer.batch.initial_joints.astype(np.float64))
            other = float(np.median([np.abs(np.median(one, axis=0) / own[row] - 1) for row, one in enumerate(lengths)]))
            worst = max(change, other)
            text += f" and differ by {100 * other:.1f} % from those of the initial pose"
        text += " (medians over bones and sequences)."
        if float(np.median([np.median(own) for own in lengths])) < 0.01:
            remedy = "These are not 22 joints of a body in metres: are positions filled in at all, not only rotations?"
            yield failed(f"under {condition.value}: the bones are shorter than 1 cm.", remedy, change=change)
        elif worst > _BONES_FAILURE:
            remedy = "Check that all 22 joints are positions of one body in Joint order."
            yield failed(text, remedy, change=change)
        elif worst > _BONES_WARNING:
            remedy = "Predict rotations, or put the bones back to their length (bone by bone from the pelvis)."
            yield warning(text, remedy, change=change)
        else:
            yield passed(text, change=change)


CHECKS = (doctor, initial_pose, bones)


_ROUNDS = 14
_FEWEST_ROUNDS = 8
_SETTLING = 3
_PATIENCE = 20.0  # seconds for all rounds
_GROWTH_WARNING = 32 * 1024
_GROWTH_FAILURE = 128 * 1024  # bytes a motion that stay behind; 128 KiB are 2.2 GiB in a run over 18,000 sequences
_LEAST_GROWTH = 4 * 1024 * 1024  # bytes in all that count as growth


@check("memory", "memory does not grow from batch to batch", needs=("determinism",), of_motions=True)
def memory(subject: MethodSubject) -> Iterator[Finding]:
    """Measure resident memory of this process and its children after each of many equal batches."""
    usual = subject.standard(subject.main)
    rounds = min(_ROUNDS, int(_PATIENCE / max(usual.seconds, 1e-6)))
    if rounds < _FEWEST_ROUNDS:
        yield skipped(f"{_FEWEST_ROUNDS} batches of {usual.seconds:.1f} s would take more than {_PATIENCE:g} s.")
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
    text = f"{growth / 1024:.0f} KiB a motion stayed behind over {len(resident)} batches; {total:.0f} MiB in all."
    remedy = "Keep nothing of a batch: look for lists and caches that grow, and for torch graphs (torch.no_grad())."
    numbers = {"growth_bytes_a_motion": growth, "resident_mib": total}
    if growth >= _GROWTH_FAILURE:
        yield failed(text, remedy, **numbers)
    elif growth >= _GROWTH_WARNING:
        yield warning(text, remedy, **numbers)
    else:
        yield passed(f"no growth over {len(resident)} batches; {total:.0f} MiB in all.", **numbers)


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


RESOURCES = (memory,)
