"""Checks of what may decide a future: the observed frames, the seed, the window's key and the number of the sample."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from prbench.checking.conformance.answer import TOLERANCE, largest_changes, metres, same_bytes
from prbench.checking.conformance.check import check
from prbench.checking.conformance.predictors.answer import FuturesAnswer
from prbench.checking.conformance.predictors.subject import PredictorSubject, anchored
from prbench.checking.conformance.report import Observation, failed, passed, skipped, warning

_OTHER_KEYS = 104_729
_NO_FUTURE = (
    "A predictor learns from what it is given alone: the training windows in fit(), the observed frames in predict()."
    " Open no table of windows, and take nothing from the objects around the batch."
)
_PREFIX = (
    "Draw sample k from a generator of its own, so that it does not know how many are asked for. Where the K samples of"
    " a window are one design, say so: one_design = True; then fewer samples have no scores."
)


@check("firewall", "without futures in the table every prediction stays the same", of_motions=True)
def firewall(subject: PredictorSubject) -> Iterator[Observation]:
    """Make it anew where all frames after the observed ones are NaN, and compare every byte."""
    for condition in subject.working:
        usual = subject.standard(condition)
        blind = subject.ask_without_futures(condition, subject.rows)
        if blind.motions is None:
            yield failed(f"under {condition.value}, with NaN in all future frames: {blind.error}", _NO_FUTURE)
            return
        if same_bytes(usual, blind):
            continue
        again = subject.ask(usual.batch)
        moved = float(largest_changes(usual, blind).max())
        if again.motions is not None and not same_bytes(usual, again) and moved <= TOLERANCE:
            yield warning(
                f"under {condition.value}: joints moved by up to {moved:.1e} m, as they do when it is asked twice.",
                "That is rounding, which differs from call to call.",
                change_m=moved,
            )
            return
        yield failed(
            f"under {condition.value}, with NaN in all future frames, joints moved by up to {metres(moved)}.",
            _NO_FUTURE,
            change_m=moved,
        )
        return
    yield passed(
        f"with NaN in all future frames the same bytes, under {', '.join(each.value for each in subject.working)}."
    )


@check("seed", "seed, key and number of the sample decide what is drawn", needs=("determinism",), of_motions=True)
def seed(subject: PredictorSubject) -> Iterator[Observation]:
    """Ask with another seed, and with other keys."""
    first = subject.standard(subject.main)
    reseeded = subject.ask(first.batch, seed=1)
    renamed = subject.ask(subject.with_keys(first.batch, _OTHER_KEYS))
    for name, answer in (("another seed", reseeded), ("other keys", renamed)):
        if answer.motions is None:
            yield failed(f"with {name}: {answer.error}", subject.own_generators)
            return
    by_seed = largest_changes(first, reseeded) > 0
    by_key = largest_changes(first, renamed) > 0
    if not by_seed.any() and not by_key.any():
        yield passed("neither seed nor keys change anything: it draws nothing.")
        return
    for name, changed in (("another seed", by_seed), ("other keys", by_key)):
        if not changed.all():
            still = int((~changed).sum())
            yield failed(f"with {name}, {still} of {len(changed)} windows stayed the same.", subject.own_generators)
            return
    if _all_samples_equal(first):
        yield warning(
            f"the {first.n_samples} futures of each window are the same, although the seed changes them.",
            subject.own_generators,
        )
        return
    moved = float(largest_changes(first, reseeded).max())
    yield passed(f"another seed or key moves joints, by up to {metres(moved)}.", change_m=moved)


@check("samples", "fewer samples are a prefix of more", needs=("determinism", "global-random", "seed"), of_motions=True)
def samples(subject: PredictorSubject) -> Iterator[Observation]:
    """Ask for one future, for five and for fifty of each window."""
    if subject.declared.one_design:
        yield skipped(f"its {subject.samples} samples are one design, as it declares; fewer have no scores.")
        return
    first = subject.standard(subject.main)
    worst = 0.0
    for number in (1, subject.many_samples):
        other = subject.ask(first.batch, n_samples=number)
        if other.motions is None:
            yield failed(f"asked for {number} futures of each window: {other.error}", _PREFIX)
            return
        shared = min(number, first.n_samples)
        apart = np.linalg.norm(_joints(first)[:, :shared] - _joints(other)[:, :shared], axis=-1).max()
        worst = max(worst, float(apart))
    asked = f"1, {first.n_samples} and {subject.many_samples} futures of each window"
    if worst == 0.0:
        yield passed(f"{asked} begin with the same bytes.", change_m=worst)
    elif worst <= TOLERANCE:
        yield warning(f"{asked} begin alike but for {worst:.1e} m.", "That is rounding.", change_m=worst)
    else:
        yield failed(f"{asked}: those that all share moved by up to {metres(worst)}.", _PREFIX, change_m=worst)


@check("rates", "windows of another rate and length", of_motions=True)
def rates(subject: PredictorSubject) -> Iterator[Observation]:
    """Ask about windows of 20 frames a second, as tables of prime-and-reach give them."""
    if subject.learns(subject.loaded):
        yield skipped("it learns from the windows of a run, which are of one rate.")
        return
    batch = anchored(subject.standard(subject.main).batch)
    answer = subject.ask(batch)
    shape = f"{batch.shape[1]} observed and {batch.n_future} future frames at {batch.fps:g} a second"
    if answer.motions is None:
        yield warning(
            f"{shape}: {answer.error}",
            "Windows around the events of a prime-and-reach table have 20 frames a second. Take lengths and rate from"
            " the batch, or interpolate to your own.",
        )
        return
    yield passed(f"{shape} work, too.")


def _joints(answer: FuturesAnswer) -> np.ndarray:
    assert answer.motions is not None
    return answer.motions.joints


def _all_samples_equal(answer: FuturesAnswer) -> bool:
    joints = _joints(answer)
    return answer.n_samples > 1 and bool((joints == joints[:, :1]).all())


CHECKS = (firewall, seed, samples, rates)
