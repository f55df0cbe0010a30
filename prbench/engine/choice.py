"""Which engine a user has chosen, before it is known what the work needs of it."""

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
class EngineChoice:
    """Where work runs, and with how many workers."""

    name: str = LOCAL
    """``local`` for this process or a pool of processes, ``ray`` for a cluster."""
    workers: int | None = None
    """Workers at a time; None for the usual number: here what the command says, on a cluster all its processors."""
    address: str | None = None
    """Of the cluster; None for ``RAY_ADDRESS``, or without that a Ray of this machine alone."""
    gpus_per_worker: float = 0.0
    spill_limit: float = DEFAULT_SPILL_LIMIT_GB
    """Gigabytes of items that may wait in Ray's memory, and be spilled to disk by it, at a time."""

    def open(
        self,
        *,
        usual: int = 1,
        threads: int = 1,
        reads: Iterable[Path] = (),
        writes: Iterable[Path] = (),
        packages: Iterable[str] = (),
        tell: Callable[[str], None] = lambda _: None,
    ) -> Engine | RayEngine:
        """Return the engine; one on a cluster connects with its first work, and wants to be closed.

        Args:
            usual: Workers on this machine where no number was chosen.
            threads: Processors that a worker on a cluster occupies.
            reads: What the work reads, for the check of every node.
            writes: What it makes.
            packages: Distributions that it needs beside the usual ones.
            tell: Told, in a line, what the user should know of the cluster.

        Raises:
            UsageError: if options of a cluster were chosen without it.
        """
        if self.name != RAY:
            if self.address is not None or self.gpus_per_worker:
                raise UsageError("--address and --gpus-per-worker belong to --engine ray; add it, or leave them out.")
            return engine_for(self.workers or usual)
        from prbench.engine.cluster import Rules
        from prbench.engine.nodes import Needs
        from prbench.engine.on_ray import RayEngine

        return RayEngine(
            self.address,
            workers=self.workers,
            cpus_per_worker=threads,
            gpus_per_worker=self.gpus_per_worker,
            needs=Needs(tuple(reads), tuple(writes), tuple(packages)),
            rules=Rules(most_waiting_bytes=1e9 * self.spill_limit),
            tell=tell,
        )
