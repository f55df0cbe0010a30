"""Checks that a method returns one finite motion of the asked length for each sequence."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from prbench.checking.conformance.answer import Answer
from prbench.checking.conformance.check import check
from prbench.checking.conformance.report import Observation, Remedy, failed, passed, skipped, warning
from prbench.checking.conformance.subject import Subject
from prbench.contract import Condition, Motions

_GENERATE = Remedy(
    "Run generate() on this batch and repair what it raises; a method may only refuse options, weights and goals that"
    " nobody could reach.",
    "Repair what keeps the program from answering 'generate' with 'motions': its log (stderr) is shown with the error."
    " A program may only refuse options, weights and goals that nobody could reach.",
)
_SHAPES = Remedy(
    "Return prbench.contract.Motions(joints, batch.n_frames): joints is a NumPy array (sequences, frames, 22, 3) with"
    " at least batch.n_frames.max() frames; behind a shorter motion stands padding.",
    "Send one row a sequence: its opaque_id, and joints with exactly n_frames times 66 numbers, frame by frame and"
    " joint by joint, without padding (docs/wire-protocol.md).",
)
_DTYPE = Remedy("Return decimals: joints.astype(np.float32), in metres.", "Send joints as list<float>, in metres.")
_COARSE = Remedy(
    "Compute the last steps (the sum of velocities above all) in float32 and return float32.",
    "Compute the last steps (the sum of velocities above all) in 32 bits and send list<float>.",
)
_LIMIT = Remedy(
    "Raise max_frames (the protocol's sequences have 41 to 241 frames at 20 a second), or set it to None.",
    "Raise max_frames in the hello (the protocol's sequences have 41 to 241 frames at 20 a second), or leave it out.",
)
_REFUSED_PAYLOAD = "sent motions that cannot be used"
_FINITE = (
    "Look for a division by zero or by a length that can be zero (an empty step, a single frame) and for weights that"
    " hold NaN. Frames behind n_frames[i] may hold anything."
)


@check("generates", "it generates under every condition that it declares", needs=("load",))
def generates(subject: Subject) -> Iterator[Observation]:
    """Generate under each declared condition; none may raise."""
    # The method takes no sequence of the cases at all, so there is nothing to ask it.
    if not len(subject.source.n_frames):
        yield failed(
            f"max_frames is {subject.declared.max_frames}, and the shortest of the sequences has"
            f" {int(subject.cases.source.n_frames.min())} frames at {subject.cases.source.fps:g} a second.",
            _LIMIT,
        )
        return
    answers = {condition: subject.standard(condition) for condition in subject.conditions}
    yield from _by_condition(
        answers,
        lambda answer: answer.raised and not _program_misshaped(answer),
        _GENERATE,
        said="one motion for each sequence",
    )
    if restarts := getattr(subject.adapter, "restarts", 0):
        yield failed(
            f"the program ended by itself and was started again ({restarts} times); its log says why.",
            "Repair what ends it: a run starts a program again only once for each batch.",
        )
    if any(answer.halvings for answer in answers.values()):
        yield warning(
            f"a batch of {len(subject.rows)} sequences did not fit in memory and was halved.",
            "Nothing is wrong with the motions; --batch-size makes a run's batches smaller.",
        )


@check("shapes", "motions have the asked shape and lengths", needs=("load",))
def shapes(subject: Subject) -> Iterator[Observation]:
    """Compare shapes and lengths with (batch, frames, 22, 3) and the lengths that were asked for."""
    answers = _answered(subject)
    yield from _by_condition(answers, _misshapen, _SHAPES, said="(sequences, frames, 22, 3) with the asked lengths")


@check("dtype", "positions are decimals of enough digits", needs=("load",))
def dtype(subject: Subject) -> Iterator[Observation]:
    """Require floating point, and warn of half precision."""
    answers = {name: answer for name, answer in _answered(subject).items() if not _misshapen(answer)}
    yield from _by_condition(answers, lambda answer: not _is_floating(answer), _DTYPE, said="floating point")
    coarse = [name.value for name, answer in answers.items() if _dtype_of(answer) == np.dtype(np.float16)]
    if coarse:
        yield warning(
            f"{', '.join(coarse)}: joints come as float16, whose steps are 1 mm at 2 m from the origin.",
            _COARSE,
        )


@check("finite", "no position is NaN or infinite", needs=("load",))
def finite(subject: Subject) -> Iterator[Observation]:
    """Require a finite number in every valid frame."""
    answers = {
        name: answer for name, answer in _answered(subject).items() if not _misshapen(answer) and _is_floating(answer)
    }
    yield from _by_condition(answers, lambda answer: answer.motions is None, _FINITE, said="all positions are numbers")


def _answered(subject: Subject) -> dict[Condition, Answer]:
    if not len(subject.source.n_frames):
        return {}
    answers = {condition: subject.standard(condition) for condition in subject.conditions}
    return {
        condition: answer for condition, answer in answers.items() if not answer.raised or _program_misshaped(answer)
    }


def _by_condition(
    answers: dict[Condition, Answer], is_wrong: Callable[[Answer], bool], remedy: str | Remedy, *, said: str
) -> Iterator[Observation]:
    wrong = {condition: answer for condition, answer in answers.items() if is_wrong(answer)}
    for condition, answer in wrong.items():
        yield failed(f"under {condition.value}: {answer.error}", remedy)
    if not answers:
        yield skipped("there are no motions to look at.")
    elif not wrong:
        yield passed(f"{said}, under {', '.join(condition.value for condition in answers)}.")


def _program_misshaped(answer: Answer) -> bool:
    """A program's payload is refused before it becomes motions."""
    return answer.raised and _REFUSED_PAYLOAD in answer.error


def _misshapen(answer: Answer) -> bool:
    if answer.motions is not None:
        return False
    if _program_misshaped(answer):
        return True
    returned = answer.returned
    if not isinstance(returned, Motions) or not isinstance(returned.joints, np.ndarray):
        return True
    if np.issubdtype(returned.joints.dtype, np.floating):
        return "expected finite positions" not in answer.error
    return "with decimals" not in answer.error or returned.joints.ndim != 4 or returned.joints.shape[2:] != (22, 3)


def _dtype_of(answer: Answer) -> np.dtype | None:
    joints = getattr(answer.returned, "joints", None)
    return joints.dtype if isinstance(joints, np.ndarray) else None


def _is_floating(answer: Answer) -> bool:
    found = _dtype_of(answer)
    return found is None or np.issubdtype(found, np.floating)


CHECKS = (generates, shapes, dtype, finite)
