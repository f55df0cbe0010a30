"""The request of scoring, what request and conditions file state about the motions, and whether they are all there."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.contract import Condition
from prbench.errors import PredictionsError, UsageError
from prbench.files.storage import turn_into_paths
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.methods.installed import SHUFFLED_GOAL, name_problem
from prbench.harness.methods.motions import native_frames
from prbench.harness.offline import GOALS, ConditionsFile, ExportRequest, conditions_of, fingerprints, given_columns
from prbench.harness.planning import Selection, select
from prbench.harness.recorded_motion import length_problem
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.agreement import DatasetAgreement
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.scores import CodedScores
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.harness.scoring import SAME_LENGTH
from prbench.sequences import SequenceTable

_STATED_TWICE = ("condition", "seed", "split", "limit", "max_frames", "native_fps")


@dataclass(frozen=True, kw_only=True)
class ScoreRequest:
    """The predictions to score, and the tables to score them on.

    What is None is taken from the run, or from the conditions file; saying it otherwise than that file is an error.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    predictions: Path
    """A run folder, its part for one dataset, a Parquet file with the columns sequence_id (or opaque_id), sample
    (0 if absent) and joints, a folder of such files, or an ``.npz``."""
    data: tuple[Path, ...]
    """The dataset folders."""
    conditions: Path | None = None
    """The file of `prbench export-conditions` that the motions were made from."""
    split: str | None = None
    """Split; by default that of the run, else ``test``."""
    limit: int | None = None
    """Sequences of each dataset; by default as many as the run has, else all."""
    seed: int | None = None
    """Seed behind the opaque ids, if the predictions have those; 0 by default."""
    condition: Condition | None = None
    """Condition that the method was given, for the record."""
    control: str | None = None
    """``shuffled-goal`` if that is how the conditions were made; a conditions file tells by its goals."""
    max_frames: int | None = None
    """The method makes no more: longer sequences are not missed but count as unsupported."""
    native_fps: float | None = None
    """Rate of the motions, if it is another than the table's; they are resampled."""
    name: str | None = None
    """Name of the method; by default that of the file."""
    allow_length_mismatch: bool = False
    protocol: Path | None = None
    """The user's own protocol; by default that of the run, else prbench's."""
    out: Path | None = None
    """Folder for ``scores.parquet`` and ``summary.json`` (of several datasets, a sub-folder each), and for what a
    leaderboard needs beside them; nothing is written without it."""

    def __post_init__(self) -> None:
        turn_into_paths(self, "predictions", "data", "conditions", "protocol", "out")
        if not self.data:
            raise UsageError("scoring needs one dataset folder or more (--data DIR).")
        if self.native_fps is not None and not 0 < self.native_fps <= 1000:
            raise UsageError(f"--native-fps: expected above 0 and at most 1000, found {self.native_fps:g}.")
        if self.control not in (None, SHUFFLED_GOAL):
            raise UsageError(f"unknown control '{self.control}'; beside a method there is: {SHUFFLED_GOAL}.")
        if self.name is not None and (problem := name_problem(self.name)):
            raise UsageError(f"--name: {problem}.")


@dataclass(frozen=True)
class GivenMotions:
    """Motions that are in memory already; ``ScoreRequest.predictions`` is what messages call them."""

    predictions: Predictions
    digest: str
    """Over their ids and values; the version of the submission."""


@dataclass(frozen=True)
class ScoreReport:
    """Scores of one dataset in long form, and their summary."""

    coded: CodedScores
    summary: DatasetSummary
    folder: Path | None
    """Folder that they were written to; None if nowhere."""
    origin: str
    """Origin of the motions, in words: ``MethodRecord.origin``."""
    agreement: DatasetAgreement
    """Agreement with recorded people, and rates by the goal's place."""
    motionless: bool = False
    """The run declares that its motions stand still, so that Foot Skating says nothing."""

    @property
    def scores(self) -> pa.Table:
        """The rows of ``scores.parquet``."""
        return self.coded.long_form()


@dataclass(frozen=True)
class Stated:
    """Everything known of motions beside themselves."""

    condition: Condition | None
    control: str | None
    seed: int
    split: str
    limit: int | None
    max_frames: int | None
    native_fps: float | None
    samples: int | None = None
    """Motions of each sequence; None for those that are there."""


def stated_by_request(request: ScoreRequest) -> Stated:
    """Take what the request says, where there is no conditions file."""
    return Stated(
        request.condition,
        request.control,
        request.seed or 0,
        request.split or "test",
        request.limit,
        request.max_frames,
        request.native_fps,
    )


def stated_by_conditions(conditions: ConditionsFile, tables: list[SequenceTable], request: ScoreRequest) -> Stated:
    """Read the conditions file, and compare it with the request and, row by row, with the tables.

    Raises:
        UsageError: if the request says something else.
        PredictionsError: if the file was made from other tables, or its rows were changed.
    """
    info = conditions.info
    path = request.conditions
    for name in _STATED_TWICE:
        asked = getattr(request, name)
        found = getattr(info, name)
        if asked is not None and asked != found:
            flag = f"--{name.replace('_', '-')}"
            raise UsageError(f"{flag} {asked}: {path} was exported with {_shown(found)}. Leave {flag} out.")
    found = int(conditions.sample.max(initial=-1)) + 1
    if info.samples != found:
        raise PredictionsError(
            f"{path}: expected rows of {info.samples} samples, found {found}. It was changed; export it again."
        )
    stated = Stated(
        info.condition, None, info.seed, info.split, info.limit, info.max_frames, info.native_fps, info.samples
    )
    # Fingerprints instead of names: the file must not tell a method which data it is asked about.
    if info.tables != fingerprints(table.identity for table in tables):
        raise PredictionsError(
            f"{path}: expected conditions of {_listed(tables)}, found those of {len(info.tables)} table"
            f"{'' if len(info.tables) == 1 else 's'} of which not all are given or one is another. Give --data the"
            " very tables that the conditions were exported from."
        )
    control = _control(conditions, tables, request)
    if request.control is not None and request.control != control:
        raise UsageError(f"--control {request.control}: the goals in {path} are each sequence's own.")
    return replace(stated, control=control)


def _control(conditions: ConditionsFile, tables: list[SequenceTable], request: ScoreRequest) -> str | None:
    """Return the control by which the goals are those of other sequences; the rows must be what the tables give."""
    # Nothing in the file says whether goals were shuffled; the goals themselves do.
    different = _first_difference(conditions, tables, request, control=None)
    if different is None:
        return None
    has_goals = bool(GOALS & set(given_columns(conditions.info.condition)))
    if has_goals and _first_difference(conditions, tables, request, control=SHUFFLED_GOAL) is None:
        return SHUFFLED_GOAL
    raise PredictionsError(
        f"{request.conditions}, {different}: expected what {_listed(tables)} give, found something else. The file was"
        " changed, or exported from another build of the same recordings: export the conditions again."
    )


def _first_difference(
    conditions: ConditionsFile, tables: list[SequenceTable], request: ScoreRequest, *, control: str | None
) -> str | None:
    """Column and row of the file that the tables do not give; None if there is none."""
    info = conditions.info
    assert request.conditions is not None
    made = conditions_of(
        tables,
        ExportRequest(
            data=request.data,
            condition=info.condition,
            out=request.conditions,
            seed=info.seed,
            samples=info.samples,
            split=info.split,
            limit=info.limit,
            max_frames=info.max_frames,
            native_fps=info.native_fps,
            control=control,
        ),
    ).file
    if len(made) != len(conditions):
        return f"{len(conditions)} rows"
    for name in ("opaque_id", "sample", "noise_seed", "n_frames", "fps", *conditions.given):
        wrong = np.asarray(getattr(conditions, name)) != np.asarray(getattr(made, name))
        rows = np.flatnonzero(wrong.reshape(len(made), -1).any(axis=1))
        if rows.size:
            return f"column '{name}', row {rows[0]}"
    return None


def _listed(tables: list[SequenceTable]) -> str:
    return ", ".join(str(table.folder) for table in tables)


def _shown(value: object) -> str:
    return "none" if value is None else str(value)


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
        f" missing {_names_of(missing)}, repeated {_names_of(repeated)}, unknown {_names_of(unknown)}"
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


def _names_of(names: list[str]) -> str:
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
