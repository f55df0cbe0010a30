"""Where a function of prbench works: in processes of this machine, or on a Ray cluster."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from prbench.api.arguments import require_positive
from prbench.engine import close_engine
from prbench.engine.choice import DEFAULT_SPILL_LIMIT_GB, RAY, EngineChoice
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.engine import Engine


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster, in place of a number of ``workers`` (docs/ray.md); needs the extra ``ray``.

    Give it to :func:`prbench.build_dataset`, :func:`prbench.run` or :func:`prbench.score`. Results have the bytes of
    one process. Every node sees the same files under the same absolute paths.

    Raises:
        UsageError: for numbers that no cluster has.
    """

    address: str | None = None
    """Its head, such as ``10.0.0.1:6379``, or ``auto`` for the one that this machine belongs to; None for
    ``RAY_ADDRESS``, or without that for a Ray of this machine alone."""
    workers: int | None = None
    """Workers at a time; None for one a processor of the whole cluster."""
    gpus_per_worker: float = 0.0
    """GPUs that a worker occupies, such as 0.5."""
    spill_limit: float = DEFAULT_SPILL_LIMIT_GB
    """Gigabytes of work that may wait in Ray's memory, and be spilled to its disk, at a time."""

    def __post_init__(self) -> None:
        require_positive(workers=self.workers)
        if self.gpus_per_worker < 0:
            raise UsageError(f"gpus_per_worker: expected 0 or more, found {self.gpus_per_worker}.")
        if self.spill_limit <= 0:
            raise UsageError(f"spill_limit: expected gigabytes above 0, found {self.spill_limit}.")


Workers = int | Cluster
"""Processes of this machine, or a cluster."""


def local(workers: Workers) -> int:
    """Return the number of processes for work that stays on this machine.

    Raises:
        UsageError: for anything but a number of processes or a cluster.
    """
    if isinstance(workers, Cluster):
        return 1
    if not isinstance(workers, int):
        raise UsageError(f"workers: expected a number of processes or a prbench.Cluster, found {workers!r}.")
    require_positive(workers=workers)
    return workers


@contextlib.contextmanager
def engine_of(workers: Workers, **needs: Any) -> Iterator[Engine]:
    """Open the engine that the block works with, and close it after the block.

    Args:
        workers: Of the function that was called.
        needs: What work on a cluster needs of every node: see :meth:`prbench.engine.choice.EngineChoice.open`.

    Raises:
        UsageError: for anything but a number of processes or a cluster.
    """
    if isinstance(workers, Cluster):
        choice = EngineChoice(RAY, **vars(workers))
    else:
        choice = EngineChoice(workers=local(workers))
    engine = choice.open(**needs, tell=lambda line: warnings.warn(line, stacklevel=2))
    try:
        yield engine
    finally:
        close_engine(engine)
