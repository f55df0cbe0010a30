"""The cost of generating: seconds and memory measured by the harness, network passes declared by the method."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

from prbench.errors import RunError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import write_json
from prbench.harness.run_folder.record import read_record
from prbench.limits import LARGEST_JSON


class BatchCost(msgspec.Struct, frozen=True, kw_only=True):
    """One planned batch, all of its samples."""

    batch: int
    motions: int
    frames: int
    seconds: float
    warm_up: bool
    """The first batch of a process: it also pays for what loads on first use."""
    peak_process_bytes: int
    peak_device_bytes: int | None
    halvings: int
    """Number of times that a batch did not fit in memory and was cut in two."""
    network_passes: int | None
    restarts: int = 0
    """Number of times that the method's program crashed and was started again."""
    parameters: int | None = None
    """Parameters of the method's networks, where they are in this process."""

    def write(self, path: Path) -> None:
        """Write as JSON."""
        write_json(path, msgspec.to_builtins(self))


class RunCost(msgspec.Struct, frozen=True, kw_only=True):
    """``cost.json``. Not reproducible, unlike the other files of a run."""

    motions: int
    """Generated motions that were timed, without warm-up."""
    frames: int
    seconds: float
    """Seconds of ``generate`` alone, device synchronised, without warm-up."""
    seconds_per_motion: float | None
    warm_up_motions: int
    warm_up_seconds: float
    peak_process_bytes: int
    peak_device_bytes: int | None
    halved_batches: dict[str, int]
    """Number of halvings by planned batch."""
    network_passes_declared: int | None
    batches: int
    batches_measured: int
    """Fewer than ``batches`` if measurements were lost."""
    restarts: dict[str, int] = {}
    """Crashes after which the method's program was started again, by planned batch."""
    parameters: int | None = None
    """Parameters of the method's networks; None for a program, and in runs of earlier versions."""

    def write(self, path: Path) -> None:
        """Write as JSON."""
        write_json(path, msgspec.to_builtins(self))

    @classmethod
    @foreign_input()
    def read(cls, path: Path) -> RunCost:
        """Read ``cost.json``.

        Raises:
            RunError: if it is missing or damaged.
        """
        return read_record(
            path,
            cls,
            missing=f"{path}: expected the cost of a run, found no file. Run the method again: it resumes.",
            remedy="Delete it and run the method again.",
        )


@foreign_input()
def read_batch_costs(paths: Iterable[Path]) -> list[BatchCost]:
    """Read the measurements of single batches.

    Raises:
        RunError: if one is damaged.
    """
    costs = []
    for path in paths:
        try:
            costs.append(msgspec.json.decode(read_whole(path, largest=LARGEST_JSON), type=BatchCost))
        except (msgspec.ValidationError, msgspec.DecodeError) as error:
            raise RunError(f"{path}: not a valid measurement: {error}. Delete the file and run again.") from error
    return costs


def joined_costs(costs: Sequence[RunCost]) -> RunCost:
    """Sum up the costs of several runs; what belongs to single batches is left out."""
    motions = sum(cost.motions for cost in costs)
    seconds = sum(cost.seconds for cost in costs)
    device = [cost.peak_device_bytes for cost in costs if cost.peak_device_bytes is not None]
    parameters = [cost.parameters for cost in costs if cost.parameters is not None]
    passes = [cost.network_passes_declared for cost in costs if cost.network_passes_declared is not None]
    return RunCost(
        motions=motions,
        frames=sum(cost.frames for cost in costs),
        seconds=seconds,
        seconds_per_motion=seconds / motions if motions else None,
        warm_up_motions=sum(cost.warm_up_motions for cost in costs),
        warm_up_seconds=sum(cost.warm_up_seconds for cost in costs),
        peak_process_bytes=max((cost.peak_process_bytes for cost in costs), default=0),
        peak_device_bytes=max(device, default=None),
        halved_batches={},
        network_passes_declared=sum(passes) if passes else None,
        batches=sum(cost.batches for cost in costs),
        batches_measured=sum(cost.batches_measured for cost in costs),
        parameters=max(parameters, default=None),
    )


def total_cost(costs: list[BatchCost], *, batches: int) -> RunCost:
    """Sum up single batches."""
    # The first batch of a process also pays for compilation and for weights that load on first use.
    timed = [cost for cost in costs if not cost.warm_up]
    warm_up = [cost for cost in costs if cost.warm_up]
    motions = sum(cost.motions for cost in timed)
    seconds = sum(cost.seconds for cost in timed)
    device = [cost.peak_device_bytes for cost in costs if cost.peak_device_bytes is not None]
    parameters = [cost.parameters for cost in costs if cost.parameters is not None]
    passes = [cost.network_passes for cost in costs if cost.network_passes is not None]
    return RunCost(
        motions=motions,
        frames=sum(cost.frames for cost in timed),
        seconds=seconds,
        seconds_per_motion=seconds / motions if motions else None,
        warm_up_motions=sum(cost.motions for cost in warm_up),
        warm_up_seconds=sum(cost.seconds for cost in warm_up),
        peak_process_bytes=max((cost.peak_process_bytes for cost in costs), default=0),
        peak_device_bytes=max(device, default=None),
        halved_batches={f"{cost.batch:05d}": cost.halvings for cost in costs if cost.halvings},
        network_passes_declared=sum(passes) if passes else None,
        batches=batches,
        batches_measured=len(costs),
        restarts={f"{cost.batch:05d}": cost.restarts for cost in costs if cost.restarts},
        parameters=max(parameters, default=None),
    )
