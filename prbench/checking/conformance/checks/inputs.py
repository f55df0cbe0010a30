"""Checks a method with unusual lengths, conditions and texts, and that it leaves its batches unchanged."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from prbench.checking.conformance.answer import largest_changes, metres
from prbench.checking.conformance.check import check
from prbench.checking.conformance.report import Observation, Remedy, failed, passed, skipped, warning
from prbench.checking.conformance.subject import RICHEST_FIRST, Subject
from prbench.contract import GIVEN, ConditionBatch

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
def lengths(subject: Subject) -> Iterator[Observation]:
    """Ask for the protocol's shortest and longest sequence in one batch."""
    shortest = min(subject.shortest, subject.longest)
    answer = subject.ask(_with_lengths(subject, [shortest, subject.longest]))
    if answer.motions is None:
        yield failed(
            f"{shortest} and {subject.longest} frames in one batch: {answer.error}",
            _LENGTHS,
        )
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


@check("short", "one frame and two", needs=("lengths",), of_motions=True)
def short(subject: Subject) -> Iterator[Observation]:
    """Ask for fewer frames than any sequence of the protocol has."""
    wrong = []
    for n_frames in (1, 2):
        answer = subject.ask(_with_lengths(subject, [n_frames]))
        if answer.motions is None:
            wrong.append(f"{n_frames} frame{'s' * (n_frames > 1)}: {answer.error}")
    if wrong:
        yield warning(
            " ".join(wrong),
            f"The protocol asks for {subject.shortest} frames at least; other tables may ask for less."
            " A division by n_frames - 1 is the usual cause.",
        )
    else:
        yield passed("one frame and two frames work.")


@check("conditions", "conditions that it does not declare do no harm", needs=("determinism",), of_motions=True)
def conditions(subject: Subject) -> Iterator[Observation]:
    """Ask under each of them; then the first batch must come out as before."""
    undeclared = [condition for condition in RICHEST_FIRST if condition not in subject.conditions]
    if not undeclared:
        yield skipped("it declares all four conditions.")
        return
    answers = {condition: subject.ask(subject.batch(subject.rows[:1], condition)) for condition in undeclared}
    before = subject.standard(subject.main)
    after = subject.ask(before.batch)
    moved = 0.0 if after.motions is None else largest_changes(before, after).max()
    if after.motions is None or moved:
        what = after.error or f"it moved joints by up to {metres(moved)}."
        yield failed(
            f"asked under {_listed(undeclared)}, which it does not declare, and then again as before: {what}",
            _REFUSE,
        )
        return
    refused = [condition for condition, answer in answers.items() if answer.motions is None]
    rest = [condition for condition in undeclared if condition not in refused]
    told = [f"refuses {_listed(refused)}"] if refused else []
    told += [f"answers {_listed(rest)}, which no run will ask it for"] if rest else []
    yield passed(f"{' and '.join(told)}; nothing changed by it.")


@check("text", "texts of any kind", of_motions=True)
def text(subject: Subject) -> Iterator[Observation]:
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
    yield failed(
        " ".join(wrong),
        "Cut a text to what the encoder takes, and treat one without known words as no text.",
    )


@check("inputs", "what it is given stays as it was", of_motions=True)
def inputs(subject: Subject) -> Iterator[Observation]:
    """Report every array of a batch that the method has changed so far."""
    if subject.is_program:
        yield skipped("a program gets its own copy.")
    elif subject.overwritten:
        yield warning(
            f"generate() writes into batch.{', batch.'.join(sorted(subject.overwritten))}.",
            "Copy an array before you change it (x = batch.goal_location.copy()). The harness hands out copies, so no"
            " score is wrong; whoever calls the method directly is surprised.",
        )
    else:
        yield passed("no array of a batch was written into.")


def _with_lengths(subject: Subject, n_frames: list[int]) -> ConditionBatch:
    rows = [subject.rows[row % len(subject.rows)] for row in range(len(n_frames))]
    return dataclasses.replace(subject.batch(rows, subject.main), n_frames=np.array(n_frames))


def _listed(names: list) -> str:
    return ", ".join(name.value for name in names)


CHECKS = (lengths, short, conditions, text, inputs)
