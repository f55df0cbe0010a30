"""The request of a run, an experiment of several in one file, and the reports on how far a run has got.

An experiment's file is TOML. Its keys are the options of ``prbench run``; each method may have several conditions, and
each seed is a run of its own. ``docs/experiments.md`` shows one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import msgspec
import pyarrow as pa

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files.bounded import foreign_input, read_toml, structured
from prbench.files.storage import turn_into_paths
from prbench.harness.methods.installed import METHOD_CONTROLS, SHUFFLED_GOAL, short_name
from prbench.object_stores.store import is_url
from prbench.protocol.manifests import PROTOCOL_NAME, benchmarks, find_benchmark
from prbench.sequences.folds import ALL_FOLDS, parse_fold

DEFAULT_BATCH_SIZE = 64
# Folder of run folders that the user did not name.
DEFAULT_PARENT = Path("runs")


Counts = Mapping[str, int | None]


def require_settings(
    counts: Counts, *, seed: int | None = None, control: str | None = None, native_fps: float | None = None
) -> None:
    """Check settings that several commands share.

    Args:
        counts: Maps options to numbers of 1 or more; None for those that are not given.
        seed: ``--seed``.
        control: ``--control``.
        native_fps: ``--native-fps``.

    Raises:
        UsageError: naming the option, what it expects and what was found.
    """
    for name, value in counts.items():
        if value is not None and value < 1:
            raise UsageError(f"{name}: expected 1 or more, found {value}.")
    if seed is not None and seed < 0:
        raise UsageError(f"--seed: expected 0 or more, found {seed}.")
    if control not in (None, SHUFFLED_GOAL):
        raise UsageError(f"unknown control '{control}'; beside a method there is: {SHUFFLED_GOAL}.")
    if native_fps is not None and not 0 < native_fps <= 1000:
        raise UsageError(f"--native-fps: expected above 0 and at most 1000, found {native_fps:g}.")


@dataclass(frozen=True, kw_only=True)
class RunRequest:
    """One run of one method.

    Attributes:
        method: Name of an installed adapter; of a control (``prbench.harness.methods.installed.METHOD_CONTROLS``);
            ``cmd:`` and a command; or path of a TOML file that describes a program. What is recorded and shown is never
            this text but the method's own name (``RunRecord.method.name``).
        data: Dataset folders.
        benchmark: Name of the benchmark.
        condition: What the method is given; None for the only condition that it takes, and for none with a control.
        fold: A fold of the tables' participants, such as ``2/6``, whose split is meant; ``participant`` for a run on
            all folds of one table (:func:`prbench.board.merging.run_folds`); None for the tables as they are.
        limit: Run only this many sequences of each dataset: of every recording its share, by the hashes of their ids.
        sequences: Run only these: ids, or parts of ids that fit one sequence of the split only.
        samples: Motions kept of each sequence.
        threads: Torch's threads in each worker, on which its rounding may depend; NumPy's follow ``OMP_NUM_THREADS``.
        control: ``shuffled-goal`` or None.
        isolate: Run the method at a distance: in another process without paths, objects and environment, and without
            the file system where bubblewrap works.
        timeout: Seconds until another process answers a batch; by default 600, or what its TOML file says.
        protocol: The user's own protocol; None for prbench's (docs/specification/protocol.md#a-protocol-of-ones-own).
        out: The run folder; by default one under ``runs`` whose name says what was run.
        hidden: Files and folders beside tables and run that an isolated method must not see, such as a key.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    method: str
    data: tuple[Path, ...]
    benchmark: str = PROTOCOL_NAME
    condition: str | None = None
    weights: Path | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    split: str = "test"
    fold: str | None = None
    limit: int | None = None
    sequences: tuple[str, ...] = ()
    seed: int = 0
    samples: int = 1
    batch_size: int = DEFAULT_BATCH_SIZE
    device: str = "cpu"
    threads: int = 1
    control: str | None = None
    isolate: bool = False
    timeout: float | None = None
    protocol: Path | None = None
    out: Path | None = None
    hidden: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        turn_into_paths(self, "data", "weights", "protocol", "out")
        if not self.data:
            raise UsageError("a run needs one dataset folder or more (--data DIR).")
        if self.fold is not None and self.split != "test":
            raise UsageError(f"--split {self.split}: --fold says already who is tested on; leave --split out.")
        if self.sequences and self.limit is not None:
            raise UsageError("--sequence names the sequences already; leave --limit out.")
        counts = {"--samples": self.samples, "--batch-size": self.batch_size, "--threads": self.threads}
        require_settings(counts, seed=self.seed, control=self.control)
        if self.is_control and (self.weights is not None or self.options):
            raise UsageError(f"--method {self.method} takes neither --weights nor --option.")
        if self.is_control and (self.isolate or self.timeout is not None):
            raise UsageError(f"--method {self.method} is part of the harness; leave --isolate and --timeout out.")
        if self.timeout is not None and not 0 < self.timeout < math.inf:
            raise UsageError(f"--timeout: expected seconds above 0, found {self.timeout:g}.")

    @property
    def is_control(self) -> bool:
        """The motions come from the harness, not from an adapter."""
        return self.method in METHOD_CONTROLS

    @property
    def method_label(self) -> str:
        """Name of the method before it is loaded: its name, its command, or the name of its file."""
        return short_name(self.method)


@dataclass(frozen=True)
class Progress:
    """One step of the way through one dataset.

    Attributes:
        stage: ``generate`` (counted in planned batches) or ``score`` (in sequences).
    """

    dataset: str
    stage: str
    done: int
    total: int


ProgressCallback = Callable[[Progress], None]


def silent(progress: Progress) -> None:
    """Say nothing."""


def reported(scores: Iterator[pa.Table], dataset: str, total: int, progress: ProgressCallback) -> Iterator[pa.Table]:
    """Pass scores on, and report after each table how many cases are done.

    Args:
        scores: Rows of ``scores.parquet``, whole cases at a time.
        dataset: Name of the dataset.
        total: Number of all cases.
        progress: Called after each table.
    """
    done = 0
    for table in scores:
        yield table
        done += len(table["sequence_id"].unique())
        progress(Progress(dataset, "score", done, total))


class ExperimentMethod(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """One method of an experiment, and what it is run with.

    Attributes:
        name: An installed method, a control, ``cmd:`` and a command, or the path of a program's TOML file.
        conditions: Each is a run of its own; empty for the only condition that the method takes.
        weights: Name of bundled weights, or a path.
        control: ``shuffled-goal`` or nothing.
    """

    name: str
    conditions: tuple[str, ...] = ()
    weights: str | None = None
    options: dict[str, str | int | float | bool] = {}
    control: str | None = None

    @property
    def option_texts(self) -> dict[str, str]:
        """The options as the command line writes them: ``true``, not ``True``."""
        return {
            key: str(value).lower() if isinstance(value, bool) else str(value) for key, value in self.options.items()
        }


class Experiment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Everything that decides the results of some runs; the defaults are those of ``prbench run``.

    Attributes:
        benchmark: What is asked of the methods.
        data: Folders of tables, which every run is made on; empty for the embedded synthetic datasets.
        fold: Such as ``2/6``: the participants of this fold are tested on. ``participant``: of each in turn.
        limit: Sequences of each dataset.
        sequences: Single sequences: ids, or parts that fit one id only.
        seeds: Each is a run of its own.
        samples: Motions kept of each sequence; absent for the benchmark's usual number.
        batch_size: Sequences a batch; absent for the benchmark's usual number.
        threads: Threads of each worker.
        timeout: Seconds for each batch of a program or an isolated method.
        protocol: File of the user's own protocol; absent for prbench's.
        out: The run folder; of several runs the folder that gets one run folder for each.
    """

    methods: tuple[ExperimentMethod, ...]
    benchmark: str = PROTOCOL_NAME
    data: tuple[str, ...] = ()
    split: str = "test"
    fold: str | None = None
    limit: int | None = None
    sequences: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)
    samples: Annotated[int, msgspec.Meta(ge=1, le=100_000)] | None = None  # more is a slip of the key
    batch_size: int | None = None
    device: str = "cpu"
    threads: int = 1
    isolate: bool = False
    timeout: float | None = None
    protocol: str | None = None
    out: str | None = None

    def as_toml(self) -> str:
        """Return the experiment as a file that :func:`read_experiment` reads back."""
        return msgspec.toml.encode(self).decode("utf-8")

    def requests(self) -> Iterator[RunRequest]:
        """Yield the runs: method by method, condition by condition, seed by seed.

        Raises:
            UsageError: if a run's parts do not fit together, or two runs are the same.
        """
        if self.fold not in (None, ALL_FOLDS):
            parse_fold(self.fold)
        runs = [
            (method, condition, seed)
            for method in self.methods
            for condition in method.conditions or (None,)
            for seed in self.seeds
        ]
        about = find_benchmark(self.benchmark)
        same = ("benchmark", "data", "split", "fold", "limit", "sequences", "device", "threads", "isolate", "timeout")
        taken: set[str] = set()
        for method, condition, seed in runs:
            request = RunRequest(
                **{name: getattr(self, name) for name in same},
                protocol=Path(self.protocol) if self.protocol else None,
                out=Path(self.out) if self.out else None,
                method=method.name,
                condition=condition,
                weights=Path(method.weights) if method.weights else None,
                options=method.option_texts,
                seed=seed,
                samples=self.samples or about.samples,
                batch_size=self.batch_size or about.batch_size,
                control=method.control,
            )
            if len(runs) > 1:
                parts = [request.method_label, request.control, request.condition]
                if len(self.seeds) > 1:
                    parts.append(f"seed{request.seed}")
                name = "-".join(str(part) for part in parts if part).replace(" ", "_")
                if name in taken:
                    remedy = "run methods that differ only in weights or options from files of their own."
                    raise UsageError(f"two runs of the experiment are called '{name}': {remedy}")
                taken.add(name)
                request = replace(request, out=Path(self.out or DEFAULT_PARENT) / name)
            yield request


@foreign_input()
def read_experiment(path: Path) -> Experiment:
    """Read an experiment's TOML file.

    Raises:
        InputFileError: if it cannot be read, or a key is unknown or of another type (naming the key).
    """
    remedy = "`prbench run --method static --show-config` prints an example."
    experiment = structured(path, read_toml(path, "an experiment's TOML file", remedy), Experiment, remedy=remedy)
    known = find_benchmark(experiment.benchmark).conditions if experiment.benchmark in benchmarks() else ()
    named = [condition for method in experiment.methods for condition in method.conditions]
    strange = next((condition for condition in named if condition not in known), "")
    urls = [key for key, place in (("data", experiment.data), ("out", (experiment.out,))) if any(map(is_url, place))]
    key = "".join(urls[:1])
    wrong: list[tuple[bool, str, str, str, str]] = [
        (not experiment.methods, "methods", "one entry or more", "none", ""),
        (not experiment.seeds, "seeds", "one entry or more", "none", ""),
        (bool(urls), key, "paths on this machine", "a URL", f"Give it by --{key} in place of this."),
        (not known, "benchmark", " or ".join(benchmarks()), experiment.benchmark, ""),
        (bool(strange), "conditions", f"some of {', '.join(known)}", strange, did_you_mean(strange, known).strip()),
    ]
    for is_wrong, where, expected, found, remedy in wrong:
        if is_wrong:
            raise InputFileError(path, where, expected=expected, found=found, remedy=remedy)
    return experiment
