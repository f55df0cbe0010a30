"""The request of scoring, what request and conditions file state about the motions, and whether they are all there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from prbench.contract import Condition
from prbench.errors import PredictionsError, UsageError
from prbench.files.storage import turn_into_paths
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.methods.installed import SHUFFLED_GOAL, name_problem
from prbench.harness.offline import GOALS, ConditionsFile, ExportRequest, conditions_of, fingerprints, given_columns
from prbench.harness.planning import Selection, select
from prbench.harness.request import require_settings
from prbench.harness.run_folder import CodedScores, DatasetAgreement, DatasetSummary, Predictions, run_folder_of
from prbench.harness.run_folder import record as run_record
from prbench.sequences import SequenceTable
from prbench.shown import listed


@dataclass(frozen=True, kw_only=True)
class ScoreRequest:
    """The predictions to score, and the tables to score them on.

    What is None is taken from the run, or from the conditions file; saying it otherwise than that file is an error.

    Attributes:
        predictions: A run folder, its part for one dataset, a Parquet file with the columns sequence_id (or opaque_id),
            sample (0 if absent) and joints, a folder of such files, or an ``.npz``.
        data: The dataset folders.
        conditions: The file of `prbench export-conditions` that the motions were made from.
        split: Split; by default that of the run, else ``test``.
        limit: Sequences of each dataset; by default as many as the run has, else all.
        seed: Seed behind the opaque ids, if the predictions have those; 0 by default.
        condition: Condition that the method was given, for the record.
        control: ``shuffled-goal`` if that is how the conditions were made; a conditions file tells by its goals.
        max_frames: The method makes no more: longer sequences are not missed but count as unsupported.
        native_fps: Rate of the motions, if it is another than the table's; they are resampled.
        name: Name of the method; by default that of the file.
        protocol: The user's own protocol; by default that of the run, else prbench's.
        out: Folder that gets ``<dataset>/scores.parquet``, ``<dataset>/summary.json`` and what a leaderboard needs
            beside them; nothing is written without it.
        keep_motions: The motions of a file are kept there, too, so that they can be submitted.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    predictions: Path
    data: tuple[Path, ...]
    conditions: Path | None = None
    split: str | None = None
    limit: int | None = None
    seed: int | None = None
    condition: Condition | None = None
    control: str | None = None
    max_frames: int | None = None
    native_fps: float | None = None
    name: str | None = None
    allow_length_mismatch: bool = False
    protocol: Path | None = None
    out: Path | None = None
    keep_motions: bool = False

    def __post_init__(self) -> None:
        turn_into_paths(self, "predictions", "data", "conditions", "protocol", "out")
        if not self.data:
            raise UsageError("scoring needs one dataset folder or more (--data DIR).")
        require_settings({}, control=self.control, native_fps=self.native_fps)
        if self.name is not None and (problem := name_problem(self.name)):
            raise UsageError(f"--name: {problem}.")


@dataclass(frozen=True)
class ScoreReport:
    """Scores of one dataset in long form, and their summary.

    Attributes:
        folder: Folder that they were written to; None if nowhere.
        origin: Origin of the motions, in words: ``MethodRecord.origin``.
        agreement: Agreement with recorded people, and rates by the goal's place.
        motionless: The run declares that its motions stand still, so that Foot Skating says nothing.
        changed: The first value of the run's own summary that is another one now, and how many more there are.
    """

    coded: CodedScores
    summary: DatasetSummary
    folder: Path | None
    origin: str
    agreement: DatasetAgreement
    motionless: bool = False
    changed: str = ""

    @property
    def scores(self) -> pa.Table:
        """The rows of ``scores.parquet``."""
        return self.coded.long_form()


def settled_by_conditions(
    request: ScoreRequest, conditions: ConditionsFile, tables: list[SequenceTable]
) -> ScoreRequest:
    """Return the request with what the conditions file says; the file is held, row by row, against the tables.

    Raises:
        UsageError: if the request says something else.
        PredictionsError: if the file was made from other tables, or its rows were changed.
    """
    info = conditions.info
    path = request.conditions
    assert path is not None
    names = ("condition", "seed", "split", "limit", "max_frames", "native_fps")
    stated: dict[str, Any] = {name: getattr(info, name) for name in names}
    for name, found in stated.items():
        asked = getattr(request, name)
        if asked is not None and asked != found:
            flag = f"--{name.replace('_', '-')}"
            shown = "none" if found is None else found
            raise UsageError(f"{flag} {asked}: {path} was exported with {shown}. Leave {flag} out.")
    samples = int(conditions.sample.max(initial=-1)) + 1
    if info.samples != samples:
        remedy = "It was changed; export it again."
        raise PredictionsError(f"{path}: expected rows of {info.samples} samples, found {samples}. {remedy}")
    listed = ", ".join(str(table.folder) for table in tables)
    # Fingerprints instead of names: the file must not tell a method which data it is asked about.
    if info.tables != fingerprints(table.identity for table in tables):
        raise PredictionsError(
            f"{path}: expected conditions of {listed}, found those of {len(info.tables)} table"
            f"{'' if len(info.tables) == 1 else 's'} of which not all are given or one is another. Give --data the"
            " very tables that the conditions were exported from."
        )
    # Nothing in the file says whether goals were shuffled; the goals themselves do.
    has_goals = bool(GOALS & set(given_columns(info.condition)))
    different = []
    for control in (None, SHUFFLED_GOAL) if has_goals else (None,):
        wanted = ExportRequest(data=request.data, out=path, samples=info.samples, control=control, **stated)
        made = conditions_of(tables, wanted)[0]
        difference = None  # column and row of the file that the tables do not give
        if len(made) != len(conditions):
            difference = f"{len(conditions)} rows"
        else:
            for name in ("opaque_id", "sample", "noise_seed", "n_frames", "fps", *conditions.given):
                wrong = np.asarray(getattr(conditions, name)) != np.asarray(getattr(made, name))
                rows = np.flatnonzero(wrong.reshape(len(made), -1).any(axis=1))
                if rows.size:
                    difference = f"column '{name}', row {rows[0]}"
                    break
        if difference is None:
            break
        different.append(difference)
    else:
        raise PredictionsError(
            f"{path}, {different[0]}: expected what {listed} give, found something else. The file was changed, or"
            " exported from another build of the same recordings: export the conditions again."
        )
    if request.control not in (None, control):
        raise UsageError(f"--control {request.control}: the goals in {path} are each sequence's own.")
    return replace(request, control=control, **stated)


def require_complete(
    predictions: Predictions, request: ScoreRequest, selections: Sequence[Selection], *, seed: int, samples: int | None
) -> list[int]:
    """Return the samples, if every sequence has each of them exactly once and nothing else is there.

    Args:
        predictions: The motions.
        request: Names files in messages.
        selections: The sequences of each table.
        seed: Seed behind opaque ids.
        samples: Motions of each sequence; None for as many as are there.

    Raises:
        PredictionsError: naming sequences that are missing, repeated or unknown.
    """

    def names_of(selection: Selection) -> Sequence[str]:
        if predictions.id_column == "sequence_id":
            return selection.sequence_ids
        return opaque_ids(selection.sequence_ids, run_salt(seed, selection.table.identity))

    sequence_of = {
        name: sequence_id
        for selection in selections
        for name, sequence_id in zip(names_of(selection), selection.sequence_ids, strict=True)
    }
    # Every sequence needs the same samples, or means over them would weigh sequences differently.
    wanted = sorted(set(predictions.samples)) if samples is None else list(range(samples))
    counts = Counter(zip(predictions.ids, predictions.samples))
    missing = [
        sequence_id
        for name, sequence_id in sequence_of.items()
        if not wanted or not all((name, sample) in counts for sample in wanted)
    ]
    repeated = sorted({name for (name, _), count in counts.items() if count > 1})
    unknown = set(predictions.ids) - set(sequence_of)
    for selection in selections if unknown else ():
        # The whole split is known, not only what --limit chose: a complete file may be scored in part.
        unknown -= set(names_of(select(selection.table, split=selection.split, limit=None)))
    surplus = sorted(set(predictions.samples) - set(wanted))
    if not missing and not repeated and not unknown and not surplus:
        return wanted
    there = {sequence_id for name, sequence_id in sequence_of.items() if name in set(predictions.ids)}
    expected = " and ".join(f"{len(one)} {one.split} sequences of {one.table.info.dataset}" for one in selections)
    each = f", each with samples {', '.join(map(str, wanted))}" if len(wanted) > 1 else ""
    if (run_folder_of(request.predictions) / run_record.FILE_NAME).is_file():
        remedy = "Run the same command again: it resumes."
    elif predictions.id_column == "opaque_id" and unknown and not there:
        remedy = f"Opaque ids hold for one seed and one table: is --seed {seed} that of the run, and --data its table?"
        if request.conditions is not None:
            remedy = f"None of the ids stands in {request.conditions}: is it the file that the motions were made from?"
    elif repeated and len(repeated) == len(set(predictions.ids)):
        remedy = "Where a sequence has several motions, number them from 0 in 'sample', as the conditions file does."
    else:
        remedy = (
            "Hand in every sequence exactly once for each sample, or name the split that the motions are of (--split,"
            f" split=; {selections[0].split} is scored) or a part of it (--limit, limit=)."
        )
    raise PredictionsError(
        f"{request.predictions}: expected the {expected}{each}, found {len(there - set(missing))}:"
        f" missing {listed(missing)}, repeated {listed(repeated)}, unknown {listed(sorted(unknown))}"
        f"{f', samples that were not asked for {surplus[:3]}' if surplus else ''}. {remedy}"
    )
