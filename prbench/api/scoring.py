"""Finished motions against a table: the command ``prbench score``, for files and for arrays in memory.

Two runs on the same sequences: the command ``prbench leaderboard compare``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyarrow as pa

from prbench.api import arguments as args
from prbench.api.pictures import frame_from_rows, frame_of, notebook_table, progress
from prbench.api.runs import Run, described, scores_for_notebook, summary_frame
from prbench.api.tables import Tables, table_folders
from prbench.errors import PredictionsError, UsageError
from prbench.files.storage import bytes_digest, text_digest
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder import DatasetSummary, Predictions

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import ArrayLike

    from prbench.board.comparison import RunComparison
    from prbench.harness.request import Progress
    from prbench.harness.score_predictions import ScoreReport


# What messages and records call motions that come from memory.
_IN_MEMORY = Path("motions")
_FORM = "an array (n, 22, 3) of metres, or (samples, n, 22, 3) for several motions of one sequence"


class Scores:
    """Scores of finished motions on one table or several; the result of :func:`prbench.score`."""

    def __init__(self, reports: tuple[ScoreReport, ...], folder: Path | None) -> None:
        self._reports = reports
        self._folder = folder

    @property
    def folder(self) -> Path | None:
        """The folder that the scores were written to; None without ``out``."""
        return self._folder

    @property
    def summaries(self) -> tuple[DatasetSummary, ...]:
        """The content of each ``summary.json``, one a dataset."""
        return tuple(report.summary for report in self._reports)

    @property
    def summary(self) -> pd.DataFrame:
        """One row a dataset and metric: ``mean`` over sequences with the interval from ``low`` to ``high``.

        Rates lie between 0 and 1, lengths are in metres (column ``unit``).
        """
        return summary_frame(self.summaries, motionless=self._motionless)

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a sequence, sample and metric.

        Returns:
            Columns ``sequence_id, dataset, sample, metric, value, flag``; rates are 0 or 1, lengths are in metres.
        """
        return frame_of(pa.concat_tables(report.scores for report in self._reports).combine_chunks())

    @property
    def _motionless(self) -> bool:
        return any(report.motionless for report in self._reports)

    def __repr__(self) -> str:
        return f"<Scores of {described(self.summaries)}>"

    def _repr_html_(self) -> str:
        where = "" if self.folder is None else f"<p>scores: {self.folder}</p>"
        return scores_for_notebook(self.summaries, motionless=self._motionless) + where


def score(
    motions: args.PathLike | Mapping[str, ArrayLike],
    table: Tables,
    *,
    conditions: args.PathLike | None = None,
    name: str | None = None,
    split: Literal["train", "validation", "test"] | None = None,
    limit: int | None = None,
    seed: int | None = None,
    condition: Literal["none", "text", "goal-pose", "goal-loc"] | None = None,
    control: Literal["shuffled-goal"] | None = None,
    max_frames: int | None = None,
    native_fps: float | None = None,
    allow_length_mismatch: bool = False,
    protocol: args.PathLike | None = None,
    out: args.PathLike | None = None,
    workers: args.Workers = 1,
) -> Scores:
    """Score finished motions against the recorded ones, as ``prbench score`` does.

    The test split is scored unless you name another one with ``split``. Every sequence of it needs its motion, with as
    many frames as the recorded one; ``table.sequence_ids(split="test")`` lists them. Else the error counts the
    sequences that are missing, repeated or unknown and names the first of each. Score a table's sequences of all splits
    with one call a split.

    Args:
        motions: A dictionary from ``sequence_id`` to an array (n, 22, 3) of joint positions in the canonical frame of
            the sequence, metres, or (samples, n, 22, 3) where several motions were drawn of each sequence; or a run
            folder, or a Parquet or ``.npz`` file, as the command takes them.
        table: The table that the motions belong to, or its folder, or several.
        conditions: The file of ``prbench export-conditions`` that the motions were made from; says seed, split, limit,
            samples and condition, and is checked.
        name: Name of the method, for summaries and leaderboards; by default that of the file, ``motions`` for a
            dictionary.
        split: The split to score: by default that of the run or the conditions, else ``test``.
        limit: Number of sequences of each dataset to score, those of ``table.sequence_ids(split=…, limit=…)``; None
            for all.
        seed: Seed behind opaque ids, where the motions have those.
        condition: What the method was given; leaderboards need it.
        control: ``shuffled-goal`` if the method was given other sequences' goals.
        max_frames: Longer sequences count as unsupported.
        native_fps: Frames per second of the motions, if it is not the table's.
        allow_length_mismatch: Score motions of another length than the recorded one.
        protocol: Your own ``protocol.toml``; by default that of the run, else prbench's.
        out: Write ``scores.parquet``, ``summary.json`` and so on there; nothing is written without it.
        workers: Processes to use, or a :class:`prbench.Cluster`; changes no result. A script that asks for several
            processes needs ``if __name__ == "__main__":``.

    Returns:
        The scores.

    Raises:
        PredictionsError: if sequences are missing, repeated or unknown (named), or a motion has a wrong shape, another
            length than the recorded one, or coordinates that no body has.
        UsageError: if arguments do not fit together.
        RunError: if a run folder belongs to another table.
        TableError: if a table is missing, empty, edited or of an unknown version.
        StorageError: if ``out`` cannot be written.
        ClusterError: if a cluster cannot be reached, or a node is unfit.
    """
    chosen: dict[str, Any] = dict(locals())
    from prbench.harness.score_predictions import ScoreRequest, score_predictions

    args.require_positive(limit=limit, max_frames=max_frames)
    given = _given(motions) if isinstance(motions, Mapping) else None
    same = ("split", "limit", "seed", "control", "max_frames", "native_fps", "name", "allow_length_mismatch")
    paths: dict[str, Any] = {name: args.as_optional_path(chosen[name]) for name in ("conditions", "protocol")}
    request = ScoreRequest(
        **{name: chosen[name] for name in same},
        **paths,
        predictions=_IN_MEMORY if isinstance(motions, Mapping) else args.as_path(motions),
        data=table_folders(table),
        condition=None if condition is None else args.as_condition(condition),
    )
    read = (*request.data, *(() if given else (request.predictions,)))
    with (
        args.optional_output_folder(out) as folder,
        args.engine_of(workers, reads=read) as engine,
        progress("scoring") as show,
    ):

        def told(step: Progress) -> None:
            show(step.done, step.total, step.dataset)

        reports = score_predictions(replace(request, out=folder), given=given, engine=engine, progress=told)
    return Scores(reports, folder)


def _given(motions: Mapping[str, ArrayLike]) -> tuple[Predictions, str]:
    """Return motions by ``sequence_id`` as the scoring takes them.

    Raises:
        PredictionsError: if there are none, or one is not of the right form.
    """
    from prbench.harness.run_folder.predictions import ArrayMotions, as_float32

    if not motions:
        problem = "expected a dictionary from sequence_id to arrays (n, 22, 3), found none in it."
        raise PredictionsError(f"motions: {problem}")
    ids: list[str] = []
    samples: list[int] = []
    arrays: list[np.ndarray] = []
    for name, value in motions.items():
        if not isinstance(name, str):
            raise PredictionsError(f"motions: expected sequence ids as keys, found {name!r}.")
        where = f"{_IN_MEMORY}['{name}']"
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise PredictionsError(f"{where}: expected {_FORM}, found {type(value).__name__} ({error}).") from error
        if array.shape[-2:] != (N_JOINTS, 3) and array.shape[-1:] == (N_JOINTS * 3,):
            array = array.reshape(*array.shape[:-1], N_JOINTS, 3)
        if array.ndim not in (3, 4) or array.shape[-2:] != (N_JOINTS, 3):
            raise PredictionsError(f"{where}: expected {_FORM}, found the shape {array.shape}.")
        motions_of_it = [array] if array.ndim == 3 else list(array)
        if not motions_of_it or not len(motions_of_it[0]):
            raise PredictionsError(f"{where}: expected a motion, found no frames.")
        # One motion a sample.
        for sample, motion in enumerate(motions_of_it):
            ids.append(name)
            samples.append(sample)
            arrays.append(as_float32(motion))
    store = ArrayMotions(tuple(arrays), (str(_IN_MEMORY),) * len(arrays))
    predictions = Predictions((), "sequence_id", tuple(ids), tuple(samples), store)
    digests = [bytes_digest(np.ascontiguousarray(array).tobytes()) for array in arrays]
    parts = [part for item in zip(ids, map(str, samples), digests, strict=True) for part in item]
    return predictions, text_digest(*parts)


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """The differences of two runs, sequence by sequence, and the support that the data give them.

    Attributes:
        first: Folder of the first run.
        second: Folder of the second run.
    """

    first: Path
    second: Path
    _found: RunComparison

    @property
    def unverified(self) -> tuple[str, ...]:
        """A line for each run and dataset whose scores could not be held against the motions, with the reason."""
        return self._found.unverified

    @property
    def summary(self) -> str:
        """One line a dataset and metric: the mean difference, first minus second, and what may be concluded."""
        from prbench.metrics import printed_unit

        lines = []
        for row in self._found.metrics:
            unit = " points" if row.info.unit == "rate" else printed_unit(row.info.unit)
            change = f"{row.comparison.difference.mean * row.info.scale:+.2f}{unit}"
            said = row.comparison.conclusion
            if said in ("higher", "lower"):
                said = f"{self.first.name} is {said}"
            lines.append(f"{row.dataset}, {row.info.title}: {change} ({said})")
        return "\n".join(lines)

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a dataset and metric.

        Returns:
            Columns ``dataset, metric, title, unit, difference`` (mean of first minus second), ``low, high`` (bounds of
            its 95 % interval), ``p_value, adjusted_p_value`` (after Holm's correction for all rows; None below six
            recordings) and ``conclusion`` (``higher``, ``lower``, ``not supported by the data`` or ``cannot be
            tested``). Rates lie between 0 and 1, lengths are in metres.
        """
        rows = []
        for row in self._found.metrics:
            difference = row.comparison.difference
            about = (row.dataset, row.info.id, row.info.title, row.info.unit)
            found = (row.comparison.p_value, row.comparison.adjusted_p_value, row.comparison.conclusion)
            rows.append((*about, difference.mean, difference.low, difference.high, *found))
        columns = ("dataset", "metric", "title", "unit", "difference", "low", "high", "p_value", "adjusted_p_value")
        return frame_from_rows(rows, (*columns, "conclusion"))

    def __repr__(self) -> str:
        return f"<Comparison of {self.first.name} with {self.second.name}>"

    def _repr_html_(self) -> str:
        columns = ["dataset", "title", "unit", "difference", "low", "high", "adjusted_p_value", "conclusion"]
        title = f"{self.first.name} against {self.second.name}, sequence by sequence"
        remarks = [f"unverified: {reason}" for reason in self.unverified]
        return notebook_table(title, self.to_pandas()[columns], remarks)


def compare(
    first: args.PathLike | Run | Scores, second: args.PathLike | Run | Scores, *, data: Tables = (), workers: int = 1
) -> Comparison:
    """Say where two runs on the same sequences differ, and whether the data support it.

    The command is ``prbench leaderboard compare``. Signs are flipped by recording and p-values corrected after Holm
    (docs/specification/protocol.md#comparisons).

    Args:
        first: A finished run, or its folder; scores that were written with ``out`` will do.
        second: Another one, of the same sequences.
        data: The tables of the runs: scores are held against the motions on them, and called unverified without. Those
            of runs that :func:`prbench.run` has just made, and prbench's own table, need not be named.
        workers: Processes to use; changes no result. A script that asks for several needs
            ``if __name__ == "__main__":``.

    Returns:
        The comparison.

    Raises:
        RunError: if a run is unfinished, its scores do not follow from its motions, or the two are not of the same
            protocol, tables and sequences.
        UsageError: if scores were never written.
    """
    from prbench.board import compare_runs
    from prbench.engine import engine_for
    from prbench.harness.first_run import table_finder
    from prbench.harness.results import RunChecker

    args.require_positive(workers=workers)
    folders = _folder_of(first), _folder_of(second)
    remembered = [folder for run in (first, second) if isinstance(run, Run) for folder in run.tables]
    tables = table_folders(data) or tuple(dict.fromkeys(remembered))
    checker = RunChecker(table_finder(tables), engine_for(workers))
    return Comparison(*folders, compare_runs(*folders, checker=checker))


def _folder_of(run: args.PathLike | Run | Scores) -> Path:
    """Return the folder of a run.

    Raises:
        UsageError: if there is none.
    """
    if isinstance(run, Run):
        return run.folder
    if isinstance(run, Scores):
        if run.folder is None:
            raise UsageError("these scores were not written: give score() a folder with out=, and compare that.")
        return run.folder
    return args.as_path(run)
