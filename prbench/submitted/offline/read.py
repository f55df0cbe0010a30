"""Write and read conditions files in either format, chosen by the suffix."""

from __future__ import annotations

from pathlib import Path

from prbench.boundary import foreign_input
from prbench.contract import ConditionBatch
from prbench.submitted.offline.as_npz import read_npz, write_npz
from prbench.submitted.offline.as_parquet import read_parquet, write_parquet
from prbench.submitted.offline.conditions_file import DEFAULT_BATCH_SIZE, ConditionsFile, require_suffix


def write_conditions(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        UsageError: if the suffix is neither ``.parquet`` nor ``.npz``.
        StorageError: if the file cannot be written.
    """
    require_suffix(path)
    (write_parquet if path.suffix.lower() == ".parquet" else write_npz)(conditions, path)


@foreign_input()
def read_conditions_file(path: Path) -> ConditionsFile:
    """Read a conditions file with all its columns.

    Raises:
        UsageError: if the suffix is neither ``.parquet`` nor ``.npz``.
        InputFileError: if the file is missing, damaged, or no conditions file.
    """
    require_suffix(path)
    return read_parquet(path) if path.suffix.lower() == ".parquet" else read_npz(path)


def read_conditions(path: Path, *, batch_size: int = DEFAULT_BATCH_SIZE) -> list[ConditionBatch]:
    """The batches of a conditions file as a method gets them in a run; sample after sample.

    Args:
        path: The file.
        batch_size: Largest number of rows in a batch.

    Raises:
        UsageError: if the suffix is neither ``.parquet`` nor ``.npz``.
        InputFileError: if the file is missing, damaged, or no conditions file.
    """
    return [each.batch for each in read_conditions_file(path).batches(batch_size)]
