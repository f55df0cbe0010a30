"""Per-frame flags of a HOT3D recording: ``masks/mask_*.csv``, of which the RGB stream's rows are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.readers.files import read_columns
from prbench.readers.found import RecordingFiles
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.layout import MASK_PREFIX

_TRUTH = {"True": True, "False": False, "true": True, "false": False, "1": True, "0": False}


def read_masks(found: RecordingFiles) -> dict[hot3d.MaskName, hot3d.MaskRows]:
    """Those masks that curation honours and the recording has.

    Raises:
        InputFileError: for a damaged file.
    """
    masks: dict[hot3d.MaskName, hot3d.MaskRows] = {}
    for name in hot3d.MASK_NAMES:
        path = found.path(f"{MASK_PREFIX}{name}")
        if path is not None:
            masks[name] = read_mask(path)
    return masks


def read_mask(path: Path) -> hot3d.MaskRows:
    """One mask of the RGB stream, in the order of time.

    Raises:
        InputFileError: if the file or a column is missing, or a value is neither True nor False.
    """
    table = read_columns(path, {hot3d.TIME: int, hot3d.STREAM: str, hot3d.MASK: str})
    values, streams = table[hot3d.MASK].to_numpy(), table[hot3d.STREAM].to_numpy()
    unknown = np.flatnonzero(~np.isin(values, list(_TRUTH)))
    if len(unknown):
        row = int(unknown[0])
        raise InputFileError(path, f"line {row + 2}", expected="True or False", found=f"'{values[row]}'")
    rgb = streams == hot3d.RGB_STREAM
    time_ns, first = np.unique(table[hot3d.TIME].to_numpy()[rgb], return_index=True)
    return hot3d.MaskRows(time_ns, np.isin(values[rgb], [text for text, good in _TRUTH.items() if good])[first])
