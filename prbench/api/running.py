"""A method over tables, scored: the command ``prbench run``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from prbench.api.arguments import (
    PathLike,
    Workers,
    as_condition,
    as_optional_path,
    as_options,
    as_texts,
    engine_of,
    local,
    optional_output_folder,
    require_positive,
)
from prbench.api.progress import progress
from prbench.api.runs import Run
from prbench.api.tables import Table, embedded_tables, table_folders
from prbench.engine.choice import Cluster
from prbench.errors import UsageError
from prbench.protocol.benchmarks import find_benchmark
from prbench.protocol.manifests import PROTOCOL_NAME

_EVERYTHING = "all"


def run(
    method: str,
    *,
    benchmark: str = PROTOCOL_NAME,
    condition: Literal["none", "text", "goal-pose", "goal-loc", "pose", "pose+head", "pose+gaze"] | None = None,
    data: PathLike | Table | Iterable[PathLike | Table] = (),
    out: PathLike | None = None,
    split: Literal["train", "validation", "test", "participants", "published"] = "test",
    fold: str | None = None,
    limit: int | None = None,
    sequence: str | Iterable[str] = (),
    weights: PathLike | None = None,
    option: Mapping[str, object] | None = None,
    device: str = "cpu",
    threads: int = 1,
    control: Literal["shuffled-goal"] | None = None,
    seed: int = 0,
    samples: int | None = None,
    best_of: int = 1,
    carry_on: bool = False,
    batch_size: int | None = None,
    isolate: bool = False,
    timeout: float | None = None,
    protocol: PathLike | None = None,
    workers: Workers = 1,
) -> Run:
    """Run a method over tables and score what it generates, as ``prbench run`` does.

    A run that was interrupted goes on where it stopped: call the same again.

    Args:
        method: Name of an installed method (``prbench adapters list``); ``cmd:`` and a command line, or a TOML file,
            for a program; or ``ground-truth``, ``ground-truth-resampled`` or ``scripted``.
        benchmark: What is asked of the method: ``prime-and-reach``, or ``motion-prediction`` on tables of windows.
        condition: What the method is given: nothing (``none``), a sentence (``text``), the pose at the goal
            (``goal-pose``), or the goal's place (``goal-loc``); for motion prediction ``pose``, ``pose+head`` or
            ``pose+gaze``. By default what ``prbench run`` takes without
            ``--condition``.
        data: A table or its folder, or several; without it prbench's own five tables of synthetic people are used.
        out: Run folder; by default one below ``runs`` whose name says what was run.
        split: The sequences to run; ``participants`` goes with ``fold``, ``published`` with motion prediction.
        fold: Such as ``2/6``: the participants of this fold are tested on.
        limit: At most so many sequences of each dataset, of every recording its share; without ``data``
            10 by default.
        sequence: Run these only: ids, or parts of ids that fit one sequence only.
        weights: Bundled weights of the method by name, a file or a folder.
        option: Options of the method, by name.
        device: ``cpu``, ``cuda``, ``cuda:1`` and so on.
        threads: Threads of each worker.
        control: ``shuffled-goal`` gives every sequence another one's goal.
        seed: Seed of the run.
        samples: Motions for each sequence: 1 by default, 50 futures of each window for motion prediction.
        best_of: Motions drawn for each of these, of which the one is kept whose own head ray and wrist serve the given
            goal best; such runs are marked in tables and never ranked.
        carry_on: Run pairs of a pick and the put that follows it, which starts where the generated pick ends; marked
            and never ranked, too.
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
    from prbench.harness import first_run
    from prbench.harness.methods.installed import packages_of
    from prbench.harness.preparation import DEFAULT_PARENT
    from prbench.harness.request import RunRequest
    from prbench.harness.run import run_method

    if _EVERYTHING in (method, condition):
        raise UsageError(
            "'all' stands for many runs: name one method and one condition, or run `prbench run --method all` for the"
            " rows of the study's Table 2."
        )
    if (split == "participants") != (fold is not None):
        raise UsageError("split 'participants' and fold 'K/N' belong together.")
    require_positive(limit=limit, threads=threads, samples=samples, best_of=best_of)
    require_positive(batch_size=batch_size)
    sequences = as_texts(sequence)
    folders = table_folders(data)
    about = find_benchmark(benchmark)
    if not folders and not about.default:
        raise UsageError(f"data: {benchmark} has no embedded tables; `{about.build}` makes one.")
    if not folders:
        folders = table_folders(embedded_tables(workers=local(workers)))
        if not sequences:
            limit = limit or first_run.SEQUENCES
            batch_size = batch_size or first_run.BATCH_SIZE
    request = RunRequest(
        method=str(method),
        benchmark=benchmark,
        data=folders,
        weights=as_optional_path(weights),
        options=as_options(option),
        split="test" if fold is not None else split,
        fold=fold,
        limit=limit,
        sequences=sequences,
        seed=seed,
        samples=samples or about.samples,
        best_of=best_of,
        carry_on=carry_on,
        batch_size=batch_size or about.batch_size,
        device=device,
        threads=threads,
        control=control,
        isolate=isolate,
        timeout=timeout,
        protocol=as_optional_path(protocol),
    )
    if condition is not None:
        request = replace(request, condition=as_condition(condition) if about.default else str(condition))
    with optional_output_folder(out) as folder:
        needs: dict[str, Any] = {}
        if isinstance(workers, Cluster):  # every node needs the tables, the run folder and the method
            files = [path for path in (request.weights, Path(request.method)) if path is not None and path.exists()]
            needs = {
                "threads": threads,
                "reads": (*folders, *files),
                "writes": (folder or DEFAULT_PARENT / "run",),
                "packages": packages_of((request.method,), about.entry_points),
            }
        with engine_of(workers, **needs) as engine, progress(f"running {request.method_label}") as show:
            report = run_method(
                replace(request, out=folder),
                engine=engine,
                progress=lambda step: show(step.done, step.total, f"{step.stage} {step.dataset}"),
            )
    # A fold stands in prbench's cache, where the run finds its own.
    return Run(report.folder, () if fold is not None else folders, report.batches_found)
