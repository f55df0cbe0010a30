"""The cost of a motion, as a leaderboard shows it beside the scores."""

from __future__ import annotations

from dataclasses import dataclass

from prbench.errors import RunError
from prbench.harness.run_folder.cost import RunCost
from prbench.harness.run_folder.folder import DatasetFolder

_MEBIBYTE = 2**20
_DASH = "–"


@dataclass(frozen=True)
class MotionCost:
    """Seconds, network passes, memory and parameters; None where nothing was measured or declared."""

    seconds: float | None
    """Seconds a motion, batched as the run was, without warm-up."""
    network_passes: float | None
    """Passes a motion, as the method declares."""
    memory_mebibytes: float | None
    """Largest memory of the device, else of the process."""
    parameters: int | None
    """Parameters of the method's networks, where they are in this process."""

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """The four as printed."""
        return (
            _DASH if self.seconds is None else f"{self.seconds:.3f}",
            _DASH if self.network_passes is None else f"{self.network_passes:.0f}",
            _DASH if self.memory_mebibytes is None else f"{self.memory_mebibytes:.0f}",
            _DASH if self.parameters is None else f"{self.parameters:,}",
        )


COST_TITLES = ("s/motion", "Passes/motion", "Memory (MiB)", "Parameters")
UNMEASURED = MotionCost(None, None, None, None)
"""Of controls, whose motions the harness makes, and of motions that came as a file."""


def cost_of(files: DatasetFolder) -> MotionCost:
    """Read the cost of one dataset of a run; nothing where the file is missing or damaged, since scores need none."""
    try:
        cost = RunCost.read(files.cost)
    except RunError:
        return UNMEASURED
    motions = cost.motions + cost.warm_up_motions
    if not motions or not cost.seconds + cost.warm_up_seconds:
        return UNMEASURED
    # A run of a single batch has warm-up alone, which is dearer than what follows, and better than nothing.
    seconds = cost.seconds_per_motion
    if seconds is None:
        seconds = cost.warm_up_seconds / motions
    memory = cost.peak_device_bytes if cost.peak_device_bytes is not None else cost.peak_process_bytes
    return MotionCost(
        seconds=seconds,
        network_passes=cost.network_passes_declared / motions if cost.network_passes_declared else None,
        memory_mebibytes=memory / _MEBIBYTE if memory else None,
        parameters=cost.parameters,
    )
