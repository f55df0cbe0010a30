"""A method over tables, scored, as ``prbench run`` does it; finished runs: their scores, motions and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from prbench.api import arguments as args
from prbench.api import pictures
from prbench.api.pictures import Picture, Replay
from prbench.api.tables import Tables, embedded_tables, table_folders
from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.engine.choice import Cluster
from prbench.errors import RunError, UsageError
from prbench.harness.run_folder import DatasetSummary, Predictions, RunFolder, RunRecord, read_scores
from prbench.metrics import METRICS
from prbench.protocol.manifests import PROTOCOL_NAME, find_benchmark
from prbench.shown import html

if TYPE_CHECKING:
    import pandas as pd

    from prbench.viewing.replay.scene import Scene


_METRIC = ("metric", "title", "unit", "mean", "low", "high", "level", "interval", "sequences", "recordings")


def summary_frame(summaries: Sequence[DatasetSummary], *, motionless: bool) -> pd.DataFrame:
    """Return one row a dataset and metric: the mean over sequences with its interval.

    Args:
        summaries: One a dataset.
        motionless: The method declares to stand still; metrics that say nothing of it are left out.
    """
    irrelevant = {info.id for info in METRICS if motionless and info.irrelevant_if_motionless}
    rows = []
    for summary in summaries:
        about = (summary.dataset, summary.method, summary.condition)
        for metric in summary.metrics:
            if metric.metric not in irrelevant:
                rows.append((*about, *(getattr(metric, name) for name in _METRIC), ";".join(metric.marks)))
    return pictures.frame_from_rows(rows, ("dataset", "method", "condition", *_METRIC, "marks"))


def scores_for_notebook(summaries: Sequence[DatasetSummary], *, motionless: bool) -> str:
    """Return the means with their intervals as a notebook shows them.

    Args:
        summaries: One a dataset.
        motionless: See :func:`summary_frame`.
    """
    remarks = [f"{each.dataset}: {each.mark}." for each in summaries if each.mark]
    if any(each.synthetic for each in summaries):
        remarks.append(ON_SYNTHETIC_DATA)
    columns = ["dataset", "title", "unit", "mean", "low", "high", "marks"]
    return pictures.notebook_table(
        described(summaries), summary_frame(summaries, motionless=motionless)[columns], remarks
    )


def described(summaries: Sequence[DatasetSummary]) -> str:
    """Return the method, its condition and the datasets in a few words.

    Args:
        summaries: One a dataset, at least one.
    """
    first = summaries[0]
    where = ", ".join(f"{summary.sequences} sequences of {summary.dataset}" for summary in summaries)
    return f"{first.method}, condition {first.condition}, {where}"


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
        return summary_frame(self.summaries, motionless=self.record.method.motionless)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks beside the scores, one line each: work taken over, names that are refused."""
        from prbench.harness.methods.installed import list_adapters

        notes = []
        if self._batches_found:
            notes.append(f"{self._batches_found} batches were taken over from an earlier run.")
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
        tables = [read_scores(self._folder.dataset(name).scores) for name in self.datasets]
        return pictures.frame_of(pa.concat_tables(tables).combine_chunks())

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
        return pictures.frozen(predictions.motions([name], sample).values.copy())

    @args.own_parameters
    def plot(
        self,
        sequence: args.Texts = (),
        *,
        data: Tables = (),
        limit: int | None = None,
        sample: int = 0,
        permission: args.Texts = (),
    ) -> Picture:
        """Draw motions of the run beside the recorded ones, as ``prbench view`` does.

        Args:
            sequence: Ids of sequences, or parts that fit one sequence only; four sequences by default.
            data: The table(s) of the run; not needed after :func:`prbench.run`, nor for prbench's own table.
            limit: Another number of sequences, chosen as ``prbench run --limit`` does.
            sample: Number of the motion, where the run drew several of each sequence.
            permission: Datasets whose licensor has given you permission to pass recorded motion on.

        Returns:
            The picture; a notebook shows it, :meth:`Picture.save` writes it.

        Raises:
            UsageError: if a sequence is unknown.
            RunError: if the run has no motions, or ``data`` names another table than the run's.
            TableError: if the run's table cannot be found.
            RedistributionError: if nothing is left that the licence lets be shown.
        """
        return pictures.picture_of(self._scenes(sequence, data, limit, sample, permission))

    @args.own_parameters
    def replay(
        self,
        sequence: args.Texts = (),
        *,
        data: Tables = (),
        limit: int | None = None,
        sample: int = 0,
        permission: args.Texts = (),
    ) -> Replay:
        """Show motions of the run beside the recorded ones in 3-D, to turn and play.

        Args:
            sequence: See :meth:`plot`.
            data: See :meth:`plot`.
            limit: See :meth:`plot`.
            sample: See :meth:`plot`.
            permission: See :meth:`plot`.

        Returns:
            The replay; a notebook shows it, :meth:`Replay.save` writes it.

        Raises:
            UsageError: if a sequence is unknown.
            RunError: if the run has no motions, or ``data`` names another table than the run's.
            TableError: if the run's table cannot be found.
            RedistributionError: if nothing is left that the licence lets be shown.
        """
        return pictures.replay_of(self._scenes(sequence, data, limit, sample, permission))

    def _scenes(
        self, sequence: args.Texts, data: Tables, limit: int | None, sample: int, permission: args.Texts
    ) -> tuple[Scene, ...]:
        from prbench.viewing.view import ViewRequest, scenes_of

        self._require_motions()
        args.require_positive(limit=limit)
        request = ViewRequest(
            out=Path("notebook.png"),  # never written
            runs=(self.folder,),
            data=table_folders(data) or self._data,
            sequences=args.as_texts(sequence),
            limit=limit,
            sample=sample,
            permitted=args.as_texts(permission),
        )
        return scenes_of(request)

    def _require_motions(self) -> None:
        """Refuse a run whose answers are no motions of a sequence.

        Raises:
            RunError: naming the benchmark.
        """
        if not find_benchmark(self.record.benchmark).default:
            why = f"is a run of {self.record.benchmark}, whose answers cannot be shown here yet; its scores can."
            raise RunError(f"{self.folder}: {why}")

    def __repr__(self) -> str:
        if not all(self._folder.dataset(name).finished for name in self.datasets):
            return f"<Run of {self.method}, not finished, {self.folder}>"
        return f"<Run of {described(self.summaries)}, {self.folder}>"

    def _repr_html_(self) -> str:
        shown = scores_for_notebook(self.summaries, motionless=self.record.method.motionless)
        return shown + "".join(f"<p>{html(line)}</p>" for line in [*self.notes, f"run folder: {self.folder}"])


def open_run(path: args.PathLike) -> Run:
    """Open a run folder.

    Args:
        path: The folder that ``prbench run --out`` or :func:`prbench.run` wrote.

    Returns:
        The run. Its scores are there once it is finished.

    Raises:
        RunError: if the folder holds no run, or a damaged one.
    """
    return Run(RunFolder.open(args.as_path(path), any_benchmark=True))


def run(
    method: str,
    *,
    benchmark: str = PROTOCOL_NAME,
    condition: Literal["none", "text", "goal-pose", "goal-loc", "pose", "pose+head", "pose+gaze"] | None = None,
    data: Tables = (),
    out: args.PathLike | None = None,
    split: Literal["train", "validation", "test", "published"] = "test",
    fold: str | None = None,
    limit: int | None = None,
    sequence: args.Texts = (),
    weights: args.PathLike | None = None,
    option: Mapping[str, object] | None = None,
    device: str = "cpu",
    threads: int = 1,
    control: Literal["shuffled-goal"] | None = None,
    seed: int = 0,
    samples: int | None = None,
    batch_size: int | None = None,
    isolate: bool = False,
    timeout: float | None = None,
    protocol: args.PathLike | None = None,
    workers: args.Workers = 1,
) -> Run:
    """Run a method over tables and score what it generates, as ``prbench run`` does.

    A run that was interrupted goes on where it stopped: call the same again.

    Args:
        method: Name of an installed method (``prbench adapters list``); ``cmd:`` and a command line, or a TOML file,
            for a program; or ``ground-truth``, ``ground-truth-resampled`` or ``scripted``.
        benchmark: What is asked of the method: ``prime-and-reach``, or ``motion-prediction`` on tables of windows.
        condition: What the method is given: nothing (``none``), a sentence (``text``), the pose at the goal
            (``goal-pose``), or the goal's place (``goal-loc``); for motion prediction ``pose``, ``pose+head`` or
            ``pose+gaze``. By default the only condition that the method takes.
        data: A table or its folder, or several; without it prbench's own five tables of synthetic people are used.
        out: Run folder; by default one below ``runs`` whose name says what was run.
        split: The sequences to run; ``published`` goes with motion prediction.
        fold: Such as ``2/6``: the participants of this fold are tested on. ``participant``: each of one table in turn,
            merged into one run.
        limit: Number of sequences of each dataset, of every recording its share; without ``data`` 10 by default.
        sequence: Run these only: ids, or parts of ids that fit one sequence only.
        weights: Bundled weights of the method by name, a file or a folder.
        option: Options of the method, by name.
        device: ``cpu``, ``cuda``, ``cuda:1`` and so on.
        threads: Threads of each worker.
        control: ``shuffled-goal`` gives every sequence another one's goal.
        seed: Seed of the run.
        samples: Motions for each sequence: 1 by default, 50 futures of each window for motion prediction.
        batch_size: Sequences a batch; 64 by default, 5 without ``data``, 16 windows for motion prediction.
        isolate: Run the method in a process that is given neither paths, objects nor environment.
        timeout: Seconds for each batch of a program or an isolated method; 600 by default.
        protocol: Your own ``protocol.toml``, stamped into the run; by default prbench's.
        workers: Processes to use, or a :class:`prbench.Cluster`; changes no result. A script that asks for several
            processes needs ``if __name__ == "__main__":``.

    Returns:
        The finished run.

    Raises:
        UsageError: if arguments are unknown or do not fit together.
        AdapterError: if the method is unknown, does not take the condition, or breaks its contract.
        TableError: if a table is missing, empty, edited or of an unknown version.
        RunError: if the run folder belongs to another run.
        StorageError: if the run folder cannot be written.
        ClusterError: if a cluster cannot be reached, or a node is unfit.
    """
    given: dict[str, Any] = dict(locals())
    from prbench.board.merging import run_folds
    from prbench.harness import first_run
    from prbench.harness.methods.installed import packages_of
    from prbench.harness.request import DEFAULT_PARENT, RunRequest
    from prbench.harness.run import run_method
    from prbench.sequences.folds import ALL_FOLDS

    if "all" in (method, condition):
        remedy = "run `prbench run --method all` for the rows of the study's Table 2."
        raise UsageError(f"'all' stands for many runs: name one method and one condition, or {remedy}")
    args.require_positive(limit=limit, threads=threads, samples=samples, batch_size=batch_size)
    sequences = args.as_texts(sequence)
    folders = table_folders(data)
    about = find_benchmark(benchmark)
    if not folders and not about.default:
        raise UsageError(f"data: {benchmark} has no embedded tables; `{about.build}` makes one.")
    if not folders:
        folders = table_folders(embedded_tables(workers=args.local(workers)))
        if not sequences:
            limit = limit or first_run.SEQUENCES
            batch_size = batch_size or first_run.BATCH_SIZE
    same = ("benchmark", "split", "fold", "seed", "device", "threads", "control", "isolate", "timeout")
    paths: dict[str, Any] = {name: args.as_optional_path(given[name]) for name in ("weights", "protocol")}
    request = RunRequest(
        **{name: given[name] for name in same},
        **paths,
        method=str(method),
        data=folders,
        options=args.as_options(option),
        limit=limit,
        sequences=sequences,
        samples=samples or about.samples,
        batch_size=batch_size or about.batch_size,
    )
    if condition is not None:
        request = replace(request, condition=args.as_condition(condition) if about.default else str(condition))
    with args.optional_output_folder(out) as folder:
        needs: dict[str, Any] = {}
        if isinstance(workers, Cluster):  # every node needs the tables, the run folder and the method
            files = [path for path in (request.weights, Path(request.method)) if path is not None and path.exists()]
            needs = {
                "threads": threads,
                "reads": (*folders, *files),
                "writes": (folder or DEFAULT_PARENT / "run",),
                "packages": packages_of((request.method,), about.entry_points),
            }
        with args.engine_of(workers, **needs) as engine, pictures.progress(f"running {request.method_label}") as show:
            make = run_folds if fold == ALL_FOLDS else run_method
            report = make(
                replace(request, out=folder),
                engine=engine,
                progress=lambda step: show(step.done, step.total, f"{step.stage} {step.dataset}"),
            )
    # A fold stands in prbench's cache, where the run finds its own.
    return Run(report.folder, () if fold is not None else folders, report.batches_found)
