"""Checks that a predictor answers with finite futures of the asked shape, which are not the past."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from prbench.checking.conformance.check import check
from prbench.checking.conformance.predictors.answer import FuturesAnswer
from prbench.checking.conformance.predictors.subject import PredictorSubject
from prbench.checking.conformance.report import Observation, Remedy, failed, passed, skipped, warning
from prbench.prediction.batch import Condition, Futures

_PREDICT = Remedy(
    "Run predict() on this batch and repair what it raises; a predictor may only refuse options and weights.",
    "Repair what keeps the program from answering 'predict' with 'futures': its log (stderr) is shown with the error.",
)
_SHAPES = Remedy(
    "Return prbench.prediction.Futures(joints=joints): joints is an array (windows, samples, frames, joints, 3) with"
    " n_samples futures of batch.n_future frames each, without the observed ones.",
    "Send one row a window: its opaque_id, and joints with n_samples times n_future times the numbers of a pose,"
    " sample by sample and frame by frame, without the observed frames (docs/wire-protocol.md).",
)
_DTYPE = Remedy("Return decimals: joints.astype(np.float32), in metres.", "Send joints as list<float>, in metres.")
_FINITE = "Look for a division by zero (a body that stands still has no speed) and for weights that hold NaN."
_PAST = "Leave the observed frames away: the first frame of a future is the one after the last observed frame."
_REFUSED_PAYLOAD = "cannot be used"
_SAME = 1e-4  # metres


@check("predicts", "it predicts under every condition that it declares", needs=("load",))
def predicts(subject: PredictorSubject) -> Iterator[Observation]:
    """Predict under each declared condition; none may raise."""
    if not subject.conditions:
        yield skipped("these windows have no gaze, without which it does not predict.")
        return
    yield from _by_condition(
        {condition: subject.standard(condition) for condition in subject.conditions},
        lambda answer: not answer.answered and not _program_misshaped(answer),
        _PREDICT,
        said=f"{subject.samples} futures of each window",
    )
    if restarts := getattr(subject.adapter, "restarts", 0):
        yield failed(
            f"the program ended by itself and was started again ({restarts} times); its log says why.",
            "Repair what ends it: a run starts a program again only once for each batch.",
        )


@check("shapes", "futures have the asked shape", needs=("load",))
def shapes(subject: PredictorSubject) -> Iterator[Observation]:
    """Compare shapes with (windows, samples, frames, joints, 3)."""
    yield from _by_condition(_answered(subject), _is_misshapen, _SHAPES, said="(windows, samples, frames, joints, 3)")


@check("dtype", "positions are decimals of enough digits", needs=("load", "shapes"))
def dtype(subject: PredictorSubject) -> Iterator[Observation]:
    """Require floating point, and warn of half precision."""
    answers = _answered(subject)
    yield from _by_condition(answers, lambda answer: not _is_floating(answer), _DTYPE, said="floating point")
    coarse = [name.value for name, each in answers.items() if _kind(each) == np.dtype(np.float16)]
    if coarse:
        yield warning(f"{', '.join(coarse)}: joints come as float16, whose steps are 1 mm at 2 m.", _DTYPE)


@check("finite", "no position is NaN or infinite", needs=("load", "shapes", "dtype"))
def finite(subject: PredictorSubject) -> Iterator[Observation]:
    """Require a finite number everywhere."""
    yield from _by_condition(_answered(subject), _has_nan, _FINITE, said="all positions are numbers")


@check("past", "futures are no copy of the past", needs=("load", "shapes", "dtype", "finite"))
def past(subject: PredictorSubject) -> Iterator[Observation]:
    """Look for futures that begin with the observed frames, or hold them in one piece."""
    answers = _answered(subject)
    copied = {condition: _copies(answer) for condition, answer in answers.items()}
    for condition, number in copied.items():
        if number:
            asked = len(answers[condition].batch)
            yield failed(
                f"under {condition.value}: the futures of {number} of {asked} windows begin with the observed frames.",
                _PAST,
            )
    if not answers:
        yield skipped("there are no futures to look at.")
    elif not any(copied.values()):
        yield passed(f"none begins with the observed frames, under {', '.join(each.value for each in answers)}.")


def _answered(subject: PredictorSubject) -> dict[Condition, FuturesAnswer]:
    answers = {condition: subject.standard(condition) for condition in subject.conditions}
    return {name: each for name, each in answers.items() if each.answered or _program_misshaped(each)}


def _by_condition(
    answers: Mapping[Condition, FuturesAnswer],
    is_wrong: Callable[[FuturesAnswer], bool],
    remedy: str | Remedy,
    *,
    said: str,
) -> Iterator[Observation]:
    wrong = {condition: answer for condition, answer in answers.items() if is_wrong(answer)}
    for condition, answer in wrong.items():
        yield failed(f"under {condition.value}: {answer.error}", remedy)
    if not answers:
        yield skipped("there are no futures to look at.")
    elif not wrong:
        yield passed(f"{said}, under {', '.join(condition.value for condition in answers)}.")


def _program_misshaped(answer: FuturesAnswer) -> bool:
    """Return True where a program's payload was refused before it became futures."""
    return not answer.answered and _REFUSED_PAYLOAD in answer.error and "finite" not in answer.error


def _is_misshapen(answer: FuturesAnswer) -> bool:
    if answer.motions is not None:
        return False
    if _program_misshaped(answer) or not isinstance(answer.returned, Futures):
        return True
    batch = answer.batch
    expected = (len(batch), answer.n_samples, batch.n_future, len(batch.joint_names), 3)
    return np.shape(answer.returned.joints) != expected


def _kind(answer: FuturesAnswer) -> np.dtype | None:
    joints = answer.given_joints
    return None if joints is None else joints.dtype


def _is_floating(answer: FuturesAnswer) -> bool:
    found = _kind(answer)
    return found is None or np.issubdtype(found, np.floating)


def _has_nan(answer: FuturesAnswer) -> bool:
    joints = answer.given_joints
    return answer.motions is None and joints is not None and not bool(np.isfinite(joints).all())


def _copies(answer: FuturesAnswer) -> int:
    """Count the windows of moving people all of whose futures begin with the observed frames."""
    joints = answer.given_joints
    if joints is None:
        return 0
    observed = answer.batch.observed_joints
    shared = min(observed.shape[1], joints.shape[2])
    moving = np.ptp(observed, axis=1).max(axis=(1, 2)) > 10 * _SAME
    apart = np.abs(joints[:, :, :shared] - observed[:, None, :shared]).max(axis=(1, 2, 3, 4))
    return int((moving & (apart < _SAME)).sum())


CHECKS = (predicts, shapes, dtype, finite, past)
