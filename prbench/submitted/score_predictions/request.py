"""The request of scoring, and the report that comes of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from prbench.contract import Condition
from prbench.errors import UsageError
from prbench.methods.names import SHUFFLED_GOAL, name_problem
from prbench.runs.predictions import Predictions
from prbench.runs.summary import DatasetSummary
from prbench.storage import turn_into_paths


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
    out: Path | None = None
    """Folder for ``scores.parquet`` and ``summary.json`` (of several datasets, a sub-folder each), and for what a
    leaderboard needs beside them; nothing is written without it."""

    def __post_init__(self) -> None:
        turn_into_paths(self, "predictions", "data", "conditions", "out")
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

    scores: pa.Table
    summary: DatasetSummary
    folder: Path | None
    """Folder that they were written to; None if nowhere."""
    origin: str
    """Origin of the motions, in words: ``MethodRecord.origin``."""
    motionless: bool = False
    """The run declares that its motions stand still, so that Foot Skating says nothing."""
