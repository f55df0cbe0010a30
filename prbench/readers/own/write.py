"""Write plain recordings: for converters from other formats, and for tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec
import pandas as pd
import tomli_w

from prbench.errors import UsageError, did_you_mean
from prbench.files.storage import atomic_folder, require_replaceable
from prbench.readers.own import format as own


def write_recording(
    folder: Path | str,
    about: own.About,
    tables: Mapping[str, Mapping[str, Any] | pd.DataFrame],
    *,
    suffix: Literal[".parquet", ".csv"] = ".parquet",
) -> None:
    """Write one plain recording, whole or not at all; an earlier one there is replaced.

    Values are written as they are: in the units, axes and frames that ``about`` states. NaN becomes an empty cell.

    Args:
        folder: Folder of the recording, whose name becomes the recording's.
        about: Content of ``recording.toml``.
        tables: One value a row by column (:data:`prbench.readers.own.format.TABLES`), by the table's name; further
            columns are kept. A table without rows is not written.
        suffix: Kind of the files.

    Raises:
        UsageError: for an unknown table or a missing column.
        StorageError: if the folder holds something else, or cannot be written.
    """
    folder = Path(folder).expanduser().absolute()
    require_replaceable(folder, own.ABOUT_FILE, kind="plain recording")
    frames = {name: pd.DataFrame(dict(values)) for name, values in tables.items()}
    for name, frame in frames.items():
        if name not in own.TABLES:
            raise UsageError(f"{folder}: there is no table '{name}'.{did_you_mean(name, own.TABLES)}")
        for column in own.columns_of(name, about).required:
            if column not in frame:
                raise UsageError(f"{folder}, {name}: expected a column '{column}', found none.")
    values = {key: value for key, value in msgspec.to_builtins(about).items() if value is not None}
    with atomic_folder(folder) as made:
        (made / own.ABOUT_FILE).write_text(tomli_w.dumps(values), encoding="utf-8")
        for name, frame in frames.items():
            if len(frame) and suffix == ".csv":
                frame.to_csv(made / f"{name}.csv", index=False)
            elif len(frame):
                frame.to_parquet(made / f"{name}.parquet", index=False)
