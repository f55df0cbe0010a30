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

if TYPE_CHECKING:
    from prbench.engine import Engine


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster, in place of a number of ``workers`` (docs/ray.md); needs the extra ``ray``.

    Give it to :func:`prbench.build_dataset`, :func:`prbench.run` or :func:`prbench.score`. Results have the bytes of
    one process. Every node sees the same files under the same absolute paths.
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


Workers = int | Cluster
"""Processes of this machine, or a cluster."""


def local(workers: Workers) -> int:
    """Return the number of processes for work that stays on this machine."""
    return 1 if isinstance(workers, Cluster) else workers


@contextlib.contextmanager
def engine_of(workers: Workers, **needs: Any) -> Iterator[Engine]:
    """Open the engine that the block works with, and close it after the block.

    Args:
        workers: Of the function that was called.
        needs: What work on a cluster needs of every node: see :meth:`prbench.engine.choice.EngineChoice.open`.

    Raises:
        UsageError: for a number of workers below 1.
    """
    if isinstance(workers, Cluster):
        require_positive(workers=workers.workers)
        choice = EngineChoice(RAY, **vars(workers))
    else:
        require_positive(workers=workers)
        choice = EngineChoice(workers=workers)
    engine = choice.open(**needs, tell=lambda line: warnings.warn(line, stacklevel=2))
    try:
        yield engine
    finally:
        close_engine(engine)
