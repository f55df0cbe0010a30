"""Rows of a study's tables that are trained and run: what is asked, row after row, and what a training lacks.

:mod:`prbench_benchmarks.prime_and_reach.ablation` and :mod:`prbench_benchmarks.motion_prediction.trained_tables` train
and run them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import msgspec

from prbench.errors import PrbenchError, StorageError, TrainingStopped
from prbench.files.storage import file_digest
from prbench_adapters.training.configuration import TrainingConfiguration
from prbench_adapters.training.report import WEIGHTS, read_record

# Configuration of a few steps: shows that everything runs, and learns nothing.
SMOKE = "smoke"
PAPER = "paper"
RUNS = "runs"  # Folder of the runs, beside those of the trainings.
# Called with a line for every step that begins.
Say = Callable[[str], None]
_Row = TypeVar("_Row")


@dataclass(frozen=True, kw_only=True)
class RowsRequest:
    """Rows that are trained and run.

    Attributes:
        data: Built folders: their training split is learnt from, their test split is run.
        out: Folder of all configurations.
        configuration: Name of a configuration of the methods, or path of a file.
        limit: Test cases of each dataset that are run.
        seed: Seed of the runs.
    """

    data: tuple[Path, ...]
    out: Path
    configuration: str = PAPER
    device: str = "cpu"
    threads: int = 1
    limit: int | None = None
    seed: int = 0

    @property
    def folder(self) -> Path:
        """Folder of the trainings and runs of this configuration."""
        return self.out / Path(self.configuration).stem


def row_by_row(
    rows: Iterable[_Row], work: Callable[[_Row], None], *, name: Callable[[_Row], str], say: Say
) -> dict[str, str]:
    """Work on some rows; one that fails, of days perhaps, does not cost the others.

    Args:
        rows: The rows in the order of the work.
        work: Trains and runs one row.
        name: What messages call a row.
        say: Told of a failure at once.

    Returns:
        Maps the names of the rows that failed to the reasons.

    Raises:
        StorageError: if a file cannot be written.
        TrainingStopped: after SIGTERM or Ctrl-C; everything was saved.
    """
    failed: dict[str, str] = {}
    for row in rows:
        try:
            work(row)
        except (StorageError, TrainingStopped):
            raise
        except Exception as error:
            reason = str(error) if isinstance(error, PrbenchError) else f"{type(error).__name__}: {error}"
            failed[name(row)] = reason
            say(f"failed: {name(row)}: {reason}")
    return failed


def training_stamp(trained: Path, weights_digest: str | None, wanted: TrainingConfiguration) -> str:
    """Return what sets the training behind a run apart from the study's; empty if nothing does.

    The digest of the run's weights decides which training is meant, not the name of a folder.

    Args:
        trained: Folder of the training.
        weights_digest: Digest of the weights that the run was made with.
        wanted: The study's configuration.
    """
    weights = trained / WEIGHTS
    if not weights.is_file() or file_digest(weights) != weights_digest:
        return "TRAINING UNKNOWN: the weights of this run are not in the folder of its training"
    record = read_record(trained)
    found = record.configuration
    # How often is saved and logged decides no weight.
    bookkeeping = {"save_every": wanted.training.save_every, "log_every": wanted.training.log_every}
    if msgspec.structs.replace(found, training=msgspec.structs.replace(found.training, **bookkeeping)) != wanted:
        return f"NOT THE STUDY'S CONFIGURATION: {found.training.steps} steps of {wanted.training.steps}"
    return "TRAINED ON SYNTHETIC DATA" if any(one.synthetic for one in record.data) else ""
