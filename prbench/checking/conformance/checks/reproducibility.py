"""Checks that the same input and noise seed give the same motion, in any batch, after any input, in any process."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from prbench.checking.conformance import subject as asking
from prbench.checking.conformance.findings import Finding, Remedy, check, failed, passed, skipped, warning
from prbench.contract import GIVEN

_ROUNDING = np.float32(1e-6)  # metres; about the last digit of a float32 position some metres away
_AMPLIFIED = 30.0  # how much more than such a nudge another batch may move a motion of a method that amplifies rounding


@check("determinism", "the same batch gives the same motions", of_motions=True)
def determinism(subject: asking.MethodSubject) -> Iterator[Finding]:
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
def global_random(subject: asking.MethodSubject) -> Iterator[Finding]:
    """Ask for the usual batch with other states of Python's, NumPy's and torch's global generators."""
    if subject.is_program:
        yield skipped("a program's generators are its own; 'determinism' and 'process' see what they would change.")
        return
    first = subject.standard(subject.main)
    other = subject.ask(first.batch, state_seed=asking.STATE_SEED + 1)
    drew = ", ".join(sorted(subject.drew_from)) or "a global generator"
    if other.motions is not None and asking.same_bytes(first, other):
        if subject.drew_from:
            remedy = "Leave global generators alone: another method or test in the process may use them."
            remedy = subject.own_generators.after(remedy)
            yield warning(f"it sets or draws from {drew}, though its motions do not change with it.", remedy)
        else:
            yield passed("no global generator is touched.")
        return
    yield _compared(first, other, f"with {drew} in another state", subject.own_generators)


@check("noise-seed", "noise_seed is the only source of chance", needs=("determinism", "global-random"), of_motions=True)
def noise_seed(subject: asking.MethodSubject) -> Iterator[Finding]:
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
    changes = asking.largest_changes(first, redrawn)
    if not changes.any():
        yield passed("the run's seed changes nothing; the method draws nothing: more --samples would be copies.")
    elif not changes.all():
        still = int((changes == 0).sum())
        said = f"with other noise seeds, {still} of {len(changes)} motions stayed the same and the others changed."
        yield failed(said, subject.own_generators.after("Use the noise_seed of each row, not that of the first."))
    else:
        most = changes.max()
        said = f"the run's seed changes nothing, another noise_seed moves joints by up to {asking.metres(most)}."
        yield passed(said, change_m=most)


@check("process", "another process generates the same motions", needs=("determinism",), fresh=True, of_motions=True)
def process(subject: asking.MethodSubject) -> Iterator[Finding]:
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
    remedy = "A run may use several processes and be resumed in new ones. Python's hash() of text and the order of sets"
    remedy += " change from process to process, and so does whatever is drawn or read while loading."
    finding = failed if moved > asking.TOLERANCE else warning
    yield finding(f"another process moved joints by up to {asking.metres(moved)}.", remedy, change_m=moved)


@check("single-row", "a batch of one works", of_motions=True)
def single_row(subject: asking.MethodSubject) -> Iterator[Finding]:
    """Ask for the first sequence alone."""
    answer = subject.ask(subject.batch(subject.rows[:1], subject.main))
    if answer.motions is None:
        remedy = (
            "Keep the first axis: squeeze() without an axis and indexing by a boolean lose it when there is one row."
        )
        yield failed(f"a batch of one {subject.case}: {answer.error}", remedy)
    else:
        yield passed(f"one {subject.case} alone works.")


@check(
    "batch",
    "neither order nor size of the batch changes a motion",
    needs=("determinism", "global-random", "noise-seed", "single-row"),
    of_motions=True,
)
def batch(subject: asking.MethodSubject) -> Iterator[Finding]:
    """Ask for the usual sequences in reverse, and in two parts."""
    first = subject.standard(subject.main)
    n = len(first.batch)
    if n < 2:
        yield skipped(f"there is only one {subject.case} to ask about.")
        return
    orders = {"in reverse order": [list(range(n))[::-1]], "in two parts": [list(range(n // 2)), list(range(n // 2, n))]}
    moved = dict.fromkeys(orders, 0.0)
    for name, parts in orders.items():
        for part in parts:
            answer = subject.ask(subject.rows_of(first.batch, part))
            if answer.motions is None:
                yield failed(f"the same {subject.case}s {name}: {answer.error}", subject.own_row)
                return
            moved[name] = max(moved[name], asking.largest_changes(first, answer, part).max())
    most = max(moved.values())
    if most <= asking.TOLERANCE:
        said = f"the same within {asking.metres(most)} (tolerance {asking.metres(asking.TOLERANCE)})."
        yield passed(said, change_m=most)
        return
    # Optimisation at generation time amplifies rounding; a nudge of the input's last digit tells it from a defect.
    amplified = 0.0
    nudged = subject.nudged(first.batch, _ROUNDING)
    if nudged is not None and (answer := subject.ask(nudged)).motions is not None:
        amplified = float(asking.largest_changes(first, answer).max())
    far = {name: distance for name, distance in moved.items() if distance > asking.TOLERANCE}
    told = " and ".join(f"by {asking.metres(distance)} {name}" for name, distance in far.items())
    if most > _AMPLIFIED * amplified:
        yield failed(f"the same {subject.case}s move {told}.", subject.own_row, change_m=most, amplified_m=amplified)
        return
    yield warning(
        f"the same {subject.case}s move {told}; but a nudge of {_ROUNDING:.0e} m of their input alone moves them by"
        f" {asking.metres(amplified)}: the method amplifies rounding, as optimisation does.",
        "Only scores can be compared between batch sizes, not motions; name the batch size beside your results.",
        change_m=most,
        amplified_m=amplified,
    )


def _compared(first: asking.Answer, second: asking.Answer, when: str, remedy: str) -> Finding:
    """Pass equal bytes, warn of rounding, and fail anything else."""
    if second.motions is None:
        return failed(f"{when}: {second.error}", remedy)
    if asking.same_bytes(first, second):
        return passed(f"{when}: the same bytes.", change_m=0.0)
    moved = asking.largest_changes(first, second).max()
    if moved <= asking.TOLERANCE:
        rounding = "That is rounding; resumed runs may differ in the last digits."
        remedy = f"{rounding} torch.use_deterministic_algorithms(True) names the operations."
        return warning(f"{when}: joints moved by up to {moved:.1e} m.", remedy, change_m=moved)
    return failed(f"{when}: joints moved by up to {asking.metres(moved)}.", remedy, change_m=moved)


CHECKS = (determinism, global_random, noise_seed, process, single_row, batch)


_LENGTHS = Remedy(
    "Generate batch.n_frames.max() frames (pad the shorter rows), and declare max_frames if there is a limit.",
    "Answer every row with its own n_frames, and name max_frames in the hello if there is a limit.",
)
_REFUSE = Remedy(
    "Refuse a condition (raise) before anything of the method's own is changed.",
    'Refuse a condition ({"message": "error"}) before anything of the method\'s own is changed.',
)
_ODD_TEXTS = {
    "an empty text": "",
    "a text of blanks": "  \n\t ",
    "2,000 words": "the person walks to the table and picks a cup " * 200,
    "other scripts and signs": "Die Frau läuft, 人は歩く, человек идёт 🦶 (½ m) — “cup”\r\n",
}


@check("lengths", "every length that the protocol asks for", of_motions=True)
def lengths(subject: asking.Subject) -> Iterator[Finding]:
    """Ask for the protocol's shortest and longest sequence in one batch."""
    shortest = min(subject.shortest, subject.longest)
    batch = subject.batch([subject.rows[0], subject.rows[1 % len(subject.rows)]], subject.main)
    answer = subject.ask(dataclasses.replace(batch, n_frames=np.array([shortest, subject.longest])))
    if answer.motions is None:
        yield failed(f"{shortest} and {subject.longest} frames in one batch: {answer.error}", _LENGTHS)
        return
    wanted = subject.protocols_longest
    if subject.longest < wanted:
        yield warning(
            f"max_frames={subject.declared.max_frames} leaves out sequences of more than {subject.longest} frames; the"
            f" protocol's have up to {wanted}.",
            "They are counted as unsupported, and the method's scores are of the shorter sequences only.",
            longest_frames=float(subject.longest),
        )
    else:
        yield passed(f"{shortest} and {subject.longest} frames in one batch.", longest_frames=float(subject.longest))


@check("conditions", "conditions that it does not declare do no harm", needs=("determinism",), of_motions=True)
def conditions(subject: asking.Subject) -> Iterator[Finding]:
    """Ask under each of them; then the first batch must come out as before."""
    undeclared = [condition for condition in asking.RICHEST_FIRST if condition not in subject.conditions]
    if not undeclared:
        yield skipped("it declares all four conditions.")
        return
    answers = [subject.ask(subject.batch(subject.rows[:1], condition)) for condition in undeclared]
    before = subject.standard(subject.main)
    after = subject.ask(before.batch)
    moved = 0.0 if after.motions is None else asking.largest_changes(before, after).max()
    names = ", ".join(condition.value for condition in undeclared)
    if after.motions is None or moved:
        what = after.error or f"it moved joints by up to {asking.metres(moved)}."
        yield failed(f"asked under {names}, which it does not declare, and then again as before: {what}", _REFUSE)
        return
    refused = sum(answer.motions is None for answer in answers)
    yield passed(f"refuses {refused} of {len(undeclared)} ({names}); nothing changed by it.")


@check("text", "texts of any kind", of_motions=True)
def text(subject: asking.Subject) -> Iterator[Finding]:
    """Ask with empty, long and foreign texts."""
    with_text = [condition for condition in subject.working if "text" in GIVEN[condition]]
    if not with_text:
        yield skipped("it takes no text.")
        return
    # One sequence with many texts: only the text can be the reason if one of them fails.
    rows = [subject.rows[0]] * len(_ODD_TEXTS)
    own_ids = tuple(f"{place:064x}" for place in range(len(rows)))  # one row many times, which no batch may hold
    batch = dataclasses.replace(subject.batch(rows, with_text[-1]), text=tuple(_ODD_TEXTS.values()), opaque_id=own_ids)
    if subject.ask(batch).motions is not None:
        yield passed(f"{', '.join(_ODD_TEXTS)}: all work.")
        return
    errors = {name: subject.ask(batch.rows(row, row + 1)).error for row, name in enumerate(_ODD_TEXTS)}
    wrong = [f"{name}: {error}" for name, error in errors.items() if error] or ["all of them in one batch"]
    remedy = "Cut a text to what the encoder takes, and treat one without known words as no text."
    yield failed(" ".join(wrong), remedy)


INPUTS = (lengths, conditions, text)
