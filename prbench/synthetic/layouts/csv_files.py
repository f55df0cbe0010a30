"""CSV files as the releases of the Aria datasets write them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from prbench.storage import atomic_path


def split_columns(names: Sequence[str], columns: np.ndarray) -> dict[str, object]:
    """The columns of an array under their names."""
    return {name: columns[:, index] for index, name in enumerate(names)}


def write_csv(path: Path, columns: Mapping[str, object]) -> None:
    """Write a table: plain header, no quotes, empty cells for NaN.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    table = pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        file.write((",".join(columns) + "\n").encode())
        pyarrow.csv.write_csv(
            table, file, pyarrow.csv.WriteOptions(include_header=False, quoting_style="none", batch_size=65536)
        )
