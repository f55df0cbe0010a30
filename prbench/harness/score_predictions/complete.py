"""Check before any motion is read that every sequence has its motions, each once and of the right length."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prbench.errors import PredictionsError
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.lengths import length_problem
from prbench.harness.methods.motions import native_frames
from prbench.harness.planning import Selection, select
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.scoring import SAME_LENGTH

_NAMED = 3  # ids listed in a message
_SEEDS_TRIED = 1000


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """The motions that have to be there."""

    path: Path
    """Path of the predictions, as the user named it."""
    selections: tuple[Selection, ...]
    """One a table."""
    seed: int
    """Seed behind opaque ids."""
    samples: int | None
    """Motions of each sequence; None for as many as are there."""
    native_fps: float | None
    conditions: Path | None


def require_complete(predictions: Predictions, wanted: Wanted) -> list[int]:
    """The samples, if every sequence has each of them exactly once and nothing else is there.

    Raises:
        PredictionsError: naming sequences that are missing, repeated or unknown.
    """
    names = [_names(predictions, selection, wanted.seed) for selection in wanted.selections]
    # Every sequence needs the same samples, or means over them would weigh sequences differently.
    samples = sorted(set(predictions.samples)) if wanted.samples is None else list(range(wanted.samples))
    if _is_complete(predictions, names, samples):
        return samples
    splits = {(one.table.folder, one.split): one for one in wanted.selections}
    # The whole split is known, not only what --limit chose: a complete file may be scored in part.
    known = {
        name
        for one in splits.values()
        for name in _names(predictions, select(one.table, split=one.split, limit=None), wanted.seed)
    }
    counts = Counter(zip(predictions.ids, predictions.samples))
    sequence_of = dict(
        zip(itertools.chain(*names), itertools.chain(*(selection.sequence_ids for selection in wanted.selections)))
    )
    missing = [
        sequence_id
        for name, sequence_id in sequence_of.items()
        if not samples or not all((name, sample) in counts for sample in samples)
    ]
    repeated = sorted({name for (name, _), count in counts.items() if count > 1})
    unknown = sorted(set(predictions.ids) - known)
    surplus = sorted(set(predictions.samples) - set(samples))
    if not missing and not repeated and not unknown and not surplus:
        return samples
    there = [name for name in sequence_of if name in set(predictions.ids)]
    found = len(there) - len(set(missing) & {sequence_of[name] for name in there})
    raise PredictionsError(
        f"{wanted.path}: expected the {_described(wanted.selections)}{_each(samples)}, found {found}:"
        f" missing {_listed(missing)}, repeated {_listed(repeated)}, unknown {_listed(unknown)}"
        f"{f', samples that were not asked for {surplus[:_NAMED]}' if surplus else ''}."
        f" {_remedy(predictions, wanted, names, unknown, repeated)}"
    )


def _is_complete(predictions: Predictions, names: Sequence[Sequence[str]], samples: Sequence[int]) -> bool:
    """Return True if the predictions are exactly those of some sequences, which takes no table of counts to see."""
    asked = sum(map(len, names))
    return (
        len(predictions.ids) == asked * len(samples)
        and not predictions.repeats
        and all((name, sample) in predictions for sample in samples for each in names for name in each)
        and len(set(itertools.chain.from_iterable(names))) == asked
    )


def require_lengths(predictions: Predictions, wanted: Wanted, samples: Sequence[int]) -> None:
    """Compare lengths that are known beforehand, so that a wrong file is refused before it is unpacked.

    Raises:
        PredictionsError: naming the first motion of another length, with the likely cause.
    """
    if predictions.n_frames is None:
        return
    for selection in wanted.selections:
        names = _names(predictions, selection, wanted.seed)
        expected = selection.n_frames
        fps = selection.fps
        if wanted.native_fps is not None:
            expected = native_frames(expected, fps=fps, native_fps=wanted.native_fps)
            fps = wanted.native_fps
        for sample in samples:
            found = np.array([predictions.length(name, sample) for name in names])

            def place(row: int) -> str:
                return f"{predictions.where(names[row], sample)}, {selection.sequence_ids[row]}"  # noqa: B023

            if (problem := length_problem(place, expected, found, fps=fps)) is not None:
                raise PredictionsError(f"{problem} {SAME_LENGTH}")


def _names(predictions: Predictions, selection: Selection, seed: int) -> Sequence[str]:
    """Ids of the chosen sequences as the predictions call them."""
    if predictions.id_column == "sequence_id":
        return selection.sequence_ids
    return opaque_ids(selection.sequence_ids, run_salt(seed, selection.table.identity))


def _described(selections: tuple[Selection, ...]) -> str:
    return " and ".join(f"{len(one)} {one.split} sequences of {one.table.info.dataset}" for one in selections)


def _each(samples: list[int]) -> str:
    return f", each with samples {', '.join(map(str, samples))}" if len(samples) > 1 else ""


def _listed(names: list[str]) -> str:
    if not names:
        return "0"
    return f"{len(names)} ({', '.join(names[:_NAMED])}{', …' if len(names) > _NAMED else ''})"


def _remedy(
    predictions: Predictions,
    wanted: Wanted,
    names: list[Sequence[str]],
    unknown: list[str],
    repeated: list[str],
) -> str:
    if (wanted.path / run_record.FILE_NAME).is_file():
        return "Run the same command again: it resumes."
    if predictions.id_column == "opaque_id" and unknown and not set(predictions.ids) & set(itertools.chain(*names)):
        if wanted.conditions is not None:
            return f"None of the ids stands in {wanted.conditions}: is it the file that the motions were made from?"
        seed = _seed_of(predictions, wanted.selections)
        return (
            f"Opaque ids hold for one seed and one table: is --seed {wanted.seed} that of the run,"
            f" and --data its table?{'' if seed is None else f' They are those of --seed {seed}.'}"
        )
    if repeated and len(repeated) == len(set(predictions.ids)):
        return "Where a sequence has several motions, number them from 0 in 'sample', as the conditions file does."
    return "Hand in every sequence exactly once for each sample."


def _seed_of(predictions: Predictions, selections: tuple[Selection, ...]) -> int | None:
    """The seed among the first thousand under which a sequence of each table is there."""
    ids = set(predictions.ids)
    for seed in range(_SEEDS_TRIED):
        salts = [(one.sequence_ids[:1], run_salt(seed, one.table.identity)) for one in selections]
        if any(name in ids for first, salt in salts for name in opaque_ids(first, salt)):
            return seed
    return None
