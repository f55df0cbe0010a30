"""The request of scoring and its report, and what request and conditions file state about the motions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.contract import Condition
from prbench.errors import PredictionsError, UsageError
from prbench.files.storage import turn_into_paths
from prbench.harness.methods.installed import SHUFFLED_GOAL, name_problem
from prbench.harness.offline.conditions_file import ConditionsFile, fingerprints, given_columns
from prbench.harness.offline.export import GOALS, ExportRequest, conditions_of
from prbench.harness.run_folder.agreement import DatasetAgreement
from prbench.harness.run_folder.coded_scores import CodedScores
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.summary import DatasetSummary
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
    (0 if absent) and joints, a folder of such files, an ``.npz``, or a folder of ``motions/%010d.npy``."""
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
