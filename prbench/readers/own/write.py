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
        UsageError: for an unknown table.
        StorageError: if the folder holds something else, or cannot be written.
    """
    folder = Path(folder).expanduser().absolute()
    require_replaceable(folder, own.ABOUT_FILE, kind="plain recording")
    if odd := next((name for name in tables if name not in own.TABLES), ""):
        raise UsageError(f"{folder}: there is no table '{odd}'.{did_you_mean(odd, own.TABLES)}")
    frames = {name: pd.DataFrame(dict(values)) for name, values in tables.items()}
    values = {key: value for key, value in msgspec.to_builtins(about).items() if value is not None}
    with atomic_folder(folder) as made:
        (made / own.ABOUT_FILE).write_text(tomli_w.dumps(values), encoding="utf-8")
        for name, frame in frames.items():
            if len(frame):
                write = frame.to_csv if suffix == ".csv" else frame.to_parquet
                write(made / f"{name}{suffix}", index=False)
