"""The request of a run, and the reports on how far it has got."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from prbench.errors import UsageError
from prbench.files.storage import turn_into_paths
from prbench.harness.methods.installed import METHOD_CONTROLS, SHUFFLED_GOAL
from prbench.harness.methods.programs import short_name
from prbench.protocol.manifests import PROTOCOL_NAME

DEFAULT_BATCH_SIZE = 64


def require_settings(
    counts: Mapping[str, int | None],
    *,
    seed: int | None = None,
    control: str | None = None,
    native_fps: float | None = None,
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
        fold: A fold of the tables' participants, such as ``2/6``, whose split is meant; None for the tables as they
            are.
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

    def __post_init__(self) -> None:
        turn_into_paths(self, "data", "weights", "protocol", "out")
        if not self.data:
            raise UsageError("a run needs one dataset folder or more (--data DIR).")
        if self.sequences and self.limit is not None:
            raise UsageError("--sequence names the sequences already; leave --limit out.")
        require_settings(
            {"--samples": self.samples, "--batch-size": self.batch_size, "--threads": self.threads},
            seed=self.seed,
            control=self.control,
        )
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
