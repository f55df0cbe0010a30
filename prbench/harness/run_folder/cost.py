"""The cost of generating: seconds and memory measured by the harness, network passes declared by the method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from prbench.files.bounded import foreign_input
from prbench.files.storage import write_json
from prbench.harness.run_folder.record import read_record


class RunCost(msgspec.Struct, frozen=True, kw_only=True):
    """``cost.json``, of a run or of one of its batches. Not reproducible, unlike the other files of a run.

    The first batch of a process also pays for compilation and for weights that load on first use: it is warm-up.

    Attributes:
        motions: Generated motions that were timed, without warm-up.
        seconds: Seconds of ``generate`` alone, device synchronised, without warm-up.
        parameters: Parameters of the method's networks; None for a program, and in runs of earlier versions.
    """

    motions: int = 0
    frames: int = 0
    seconds: float = 0.0
    seconds_per_motion: float | None = None
    warm_up_motions: int = 0
    warm_up_frames: int = 0
    warm_up_seconds: float = 0.0
    peak_process_bytes: int = 0
    peak_device_bytes: int | None = None
    network_passes_declared: int | None = None
    parameters: int | None = None

    def write(self, path: Path) -> None:
        """Write as JSON."""
        write_json(path, msgspec.to_builtins(self))

    @classmethod
    @foreign_input()
    def read(cls, path: Path) -> RunCost:
        """Read ``cost.json``, or the measurement of a batch.

        Raises:
            RunError: if it is missing or damaged.
        """
        return read_record(
            path,
            cls,
            missing=f"{path}: expected the cost of a run, found no file. Run the method again: it resumes.",
            remedy="Delete it and run the method again.",
        )


def total_cost(costs: Sequence[RunCost]) -> RunCost:
    """Sum up the costs of batches, or of runs."""

    def known(name: str) -> list[int]:
        return [value for cost in costs if (value := getattr(cost, name)) is not None]

    sums = {
        name: sum(getattr(cost, name) for cost in costs)
        for name in ("motions", "frames", "seconds", "warm_up_motions", "warm_up_frames", "warm_up_seconds")
    }
    return RunCost(
        **sums,
        seconds_per_motion=sums["seconds"] / sums["motions"] if sums["motions"] else None,
        peak_process_bytes=max((cost.peak_process_bytes for cost in costs), default=0),
        peak_device_bytes=max(known("peak_device_bytes"), default=None),
        network_passes_declared=sum(known("network_passes_declared")) or None,
        parameters=max(known("parameters"), default=None),
    )
