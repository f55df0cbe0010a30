"""Finished runs: their scores, motions and pictures."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.api.arguments import PathLike, as_native_root, as_path, as_texts, require_positive
from prbench.api.frames import frozen
from prbench.api.pictures import Picture, Replay, picture_of, replay_of
from prbench.api.scored import described, irrelevant_metrics, scores_for_notebook, scores_frame, summary_frame
from prbench.api.tables import Table, table_folders
from prbench.errors import RunError, UsageError
from prbench.harness.run_folder import DatasetSummary, Predictions, RunCost, RunFolder, RunRecord, read_scores
from prbench.protocol.benchmarks import find_benchmark
from prbench.shown import html

if TYPE_CHECKING:
    import pandas as pd

    from prbench.viewing.replay.scene import Scene


class Run:
    """A finished run: the motions of one method for one table or several, and their scores.

    Make one with :func:`prbench.run` or :func:`prbench.open_run`.
    """

    def __init__(self, folder: RunFolder, data: tuple[Path, ...] = (), batches_found: int = 0) -> None:
        self._folder = folder
        self._data = data
        self._batches_found = batches_found

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self._folder.path

    @property
    def record(self) -> RunRecord:
        """The content of ``run.json``: method, version, weights, condition, seed, tables, packages."""
        return self._folder.record

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.record.method.name

    @property
    def tables(self) -> tuple[Path, ...]:
        """Folders of the tables that the method was run on; empty where the run was opened from its folder."""
        return self._data

    @property
    def datasets(self) -> tuple[str, ...]:
        """Names of the datasets that the method was run on."""
        return tuple(table.dataset for table in self.record.tables)

    @cached_property
    def summaries(self) -> tuple[DatasetSummary, ...]:
        """The content of each ``summary.json``, one a dataset.

        Raises:
            RunError: if the run is not finished.
        """
        return tuple(DatasetSummary.read(self._folder.dataset(name).path) for name in self.datasets)

    @property
    def summary(self) -> pd.DataFrame:
        """One row a dataset and metric: ``mean`` over sequences with the interval from ``low`` to ``high``.

        Rates lie between 0 and 1, lengths are in metres (column ``unit``). Metrics that say nothing of a method which
        stands still are left out.

        Raises:
            RunError: if the run is not finished.
        """
        return summary_frame(self.summaries, self._irrelevant)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks beside the scores, one line each: work taken over, crashes, names that are refused."""
        from prbench.harness.methods.installed import list_adapters

        notes = []
        if self._batches_found:
            notes.append(f"{self._batches_found} batches were taken over from an earlier run.")
        for name in self.datasets:
            path = self._folder.dataset(name).cost
            crashes = sum(RunCost.read(path).restarts.values()) if path.is_file() else 0
            if crashes:
                times = "once" if crashes == 1 else f"{crashes} times"
                notes.append(f"its program crashed {times} and was started again: {path}, restarts.")
        # Packages that offer a method under a name that belongs to prbench; theirs is never run.
        notes += [
            f"{adapter.package} {adapter.version} is not used: {adapter.problem}."
            for adapter in list_adapters()
            if adapter.name == self.method and adapter.problem
        ]
        return tuple(notes)

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a sequence, sample and metric.

        Returns:
            Columns ``sequence_id, dataset, sample, metric, value, flag``; rates are 0 or 1, lengths are in metres.

        Raises:
            RunError: if the run is not finished, or its scores cannot be read.
        """
        return scores_frame([read_scores(self._folder.dataset(name).scores) for name in self.datasets])

    def motion(self, sequence_id: str, *, sample: int = 0) -> Float[np.ndarray, "n 22 3"]:
        """Return the motion that the method made for one sequence.

        Args:
            sequence_id: The sequence's id, or a part of it that fits one sequence of the run only.
            sample: Number of the motion, where the run drew several of each sequence.

        Returns:
            Joint positions, canonical frame of the sequence, metres; read-only.

        Raises:
            UsageError: if the run has no motion of such a sequence, or no such sample.
            PredictionsError: if the run has no motions.
        """
        from prbench.sequences.table import find_sequence_id

        self._require_motions()
        if not 0 <= sample < self.record.samples:
            raise UsageError(f"{self.folder}: expected a sample from 0 to {self.record.samples - 1}, found {sample}.")
        opened = [Predictions.open(self._folder.dataset(name).predictions) for name in self.datasets]
        known = sorted({name for predictions in opened for name in predictions.ids})
        name = find_sequence_id(sequence_id, known, among=str(self.folder))
        predictions = next(each for each in opened if (name, sample) in each)
        return frozen(predictions.motions([name], sample).values.copy())

    def plot(
        self,
        sequence: str | Iterable[str] = (),
        *,
        data: PathLike | Table | Iterable[PathLike | Table] = (),
        limit: int | None = None,
        sample: int = 0,
        permission: str | Iterable[str] = (),
        scene: PathLike | None = None,
    ) -> Picture:
        """Draw motions of the run beside the recorded ones, as ``prbench view`` does.

        Args:
            sequence: Ids of sequences, or parts that fit one sequence only; four sequences by default.
            data: The table(s) of the run; not needed after :func:`prbench.run`, nor for prbench's own table.
            limit: Another number of sequences, chosen as ``prbench run --limit`` does.
            sample: Number of the motion, where the run drew several of each sequence.
            permission: Datasets whose licensor has given you permission to pass recorded motion on.
            scene: Your copy of the dataset: draws what stood around the bodies (needs the extra ``open3d``).

        Returns:
            The picture; a notebook shows it, :meth:`Picture.save` writes it.

        Raises:
            UsageError: if a sequence is unknown.
            RunError: if the run has no motions, or ``data`` names another table than the run's.
            TableError: if the run's table cannot be found.
            RedistributionError: if nothing is left that the licence lets be shown.
        """
        return picture_of(self._scenes(sequence, data, limit, sample, permission, scene))

    def replay(
        self,
        sequence: str | Iterable[str] = (),
        *,
        data: PathLike | Table | Iterable[PathLike | Table] = (),
        limit: int | None = None,
        sample: int = 0,
        permission: str | Iterable[str] = (),
        scene: PathLike | None = None,
    ) -> Replay:
        """Show motions of the run beside the recorded ones in 3-D, to turn and play.

        Args:
            sequence: See :meth:`plot`.
            data: See :meth:`plot`.
            limit: See :meth:`plot`.
            sample: See :meth:`plot`.
            permission: See :meth:`plot`.
            scene: See :meth:`plot`.

        Returns:
            The replay; a notebook shows it, :meth:`Replay.save` writes it.

        Raises:
            MissingExtraError: if the extra ``view`` is not installed.
            UsageError: if a sequence is unknown.
            RunError: if the run has no motions, or ``data`` names another table than the run's.
            TableError: if the run's table cannot be found.
            RedistributionError: if nothing is left that the licence lets be shown.
        """
        return replay_of(self._scenes(sequence, data, limit, sample, permission, scene))

    def _scenes(
        self,
        sequence: str | Iterable[str],
        data: PathLike | Table | Iterable[PathLike | Table],
        limit: int | None,
        sample: int,
        permission: str | Iterable[str],
        scene: PathLike | None,
    ) -> tuple[Scene, ...]:
        from prbench.viewing.view import ViewRequest, scenes_of

        self._require_motions()
        require_positive(limit=limit)
        request = ViewRequest(
            out=Path("notebook.png"),  # never written
            runs=(self.folder,),
            data=table_folders(data) or self._data,
            sequences=as_texts(sequence),
            limit=limit,
            sample=sample,
            permitted=as_texts(permission),
            scene=None if scene is None else as_native_root(scene),
        )
        return scenes_of(request)

    def _require_motions(self) -> None:
        """Refuse a run whose answers are no motions of a sequence.

        Raises:
            RunError: naming the benchmark.
        """
        if not find_benchmark(self.record.benchmark).default:
            raise RunError(
                f"{self.folder}: is a run of {self.record.benchmark}, whose answers cannot be shown here yet; its"
                " scores can."
            )

    @property
    def _irrelevant(self) -> frozenset[str]:
        return irrelevant_metrics(motionless=self.record.method.motionless)

    def __repr__(self) -> str:
        if not all(self._folder.dataset(name).finished for name in self.datasets):
            return f"<Run of {self.method}, not finished, {self.folder}>"
        return f"<Run of {described(self.summaries)}, {self.folder}>"

    def _repr_html_(self) -> str:
        shown = scores_for_notebook(self.summaries, self._irrelevant, origin=self.record.method.origin)
        lines = [*self.notes, f"run folder: {self.folder}"]
        return shown + "".join(f"<p>{html(line)}</p>" for line in lines)


def open_run(path: PathLike) -> Run:
    """Open a run folder.

    Args:
        path: The folder that ``prbench run --out`` or :func:`prbench.run` wrote.

    Returns:
        The run. Its scores are there once it is finished.

    Raises:
        RunError: if the folder holds no run, or a damaged one.
    """
    return Run(RunFolder.open(as_path(path), any_benchmark=True))
