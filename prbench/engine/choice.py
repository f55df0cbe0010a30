"""The place that a user chose for work: processes of this machine, or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.engine import Engine, engine_for
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.engine.on_ray import RayEngine

LOCAL = "local"
RAY = "ray"
DEFAULT_SPILL_LIMIT_GB = 4.0


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster, in place of a number of ``workers`` (docs/cluster.md#ray); needs the extra ``ray``.

    Give it to :func:`prbench.build_dataset`, :func:`prbench.run` or :func:`prbench.score`. Results have the bytes of
    one process. Every node sees the same files under the same absolute paths.

    Attributes:
        address: Its head, such as ``10.0.0.1:6379``, or ``auto`` for the one that this machine belongs to; None for
            ``RAY_ADDRESS``, or without that for a Ray of this machine alone.
        workers: Workers at a time; None for one a processor of the whole cluster.
        gpus_per_worker: GPUs that a worker occupies, such as 0.5.
        spill_limit: Gigabytes of work that may wait in Ray's memory, and be spilled to its disk, at a time.

    Raises:
        UsageError: for numbers that no cluster has.
    """

    address: str | None = None
    workers: int | None = None
    gpus_per_worker: float = 0.0
    spill_limit: float = DEFAULT_SPILL_LIMIT_GB

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"workers: expected a whole number of at least 1, found '{self.workers}'")
        if self.gpus_per_worker < 0:
            raise UsageError(f"gpus_per_worker: expected 0 or more, found {self.gpus_per_worker}.")
        if self.spill_limit <= 0:
            raise UsageError(f"spill_limit: expected gigabytes above 0, found {self.spill_limit}.")


# Processes of this machine, or a cluster; None for the usual number of processes.
EngineChoice = int | Cluster | None


def open_engine(
    choice: EngineChoice,
    *,
    usual: int = 1,
    threads: int = 1,
    reads: Iterable[Path] = (),
    writes: Iterable[Path] = (),
    packages: Iterable[str] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> Engine | RayEngine:
    """Return the engine that was chosen; one on a cluster connects with its first work, and wants to be closed.

    Args:
        choice: What the user chose.
        usual: Workers on this machine where no number was chosen.
        threads: Processors that a worker on a cluster occupies.
        reads: What the work reads, for the check of every node.
        writes: What it makes.
        packages: Distributions that it needs beside the usual ones.
        tell: Told, in a line, what the user should know of the cluster.
    """
    if not isinstance(choice, Cluster):
        return engine_for(choice or usual)
    from prbench.engine.cluster import Rules
    from prbench.engine.nodes import Needs
    from prbench.engine.on_ray import RayEngine

    return RayEngine(
        choice.address,
        workers=choice.workers,
        cpus_per_worker=threads,
        gpus_per_worker=choice.gpus_per_worker,
        needs=Needs(tuple(reads), tuple(writes), tuple(packages)),
        rules=Rules(most_waiting_bytes=1e9 * choice.spill_limit),
        tell=tell,
    )
