"""A conditions file as ``.npz``: plain arrays that NumPy alone can read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from prbench.errors import InputFileError
from prbench.numpy_files import Archive
from prbench.skeleton import N_JOINTS
from prbench.storage import atomic_path
from prbench.submitted.offline.conditions_file import ConditionsFile, given_columns
from prbench.submitted.offline.information import METADATA_KEY, ConditionsInfo

_LARGEST_ARRAY = 8 * 1024**3
_POSE = (N_JOINTS, 3)
_FORMS: dict[str, tuple[str, tuple[int, ...]]] = {
    "opaque_id": ("U", ()),
    "sample": ("<i4", ()),
    "noise_seed": ("<i8", ()),
    "n_frames": ("<i4", ()),
    "fps": ("<f8", ()),
    "text": ("U", ()),
    "initial_joints": ("<f4", _POSE),
    "previous_joints": ("<f4", _POSE),
    "goal_joints": ("<f4", _POSE),
    "goal_location": ("<f8", (3,)),
}
"""Kind of each array, and the shape of one row of it."""
_ALWAYS = ("opaque_id", "sample", "noise_seed", "n_frames", "fps")


def write_npz(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    names = (*_ALWAYS, *given_columns(conditions.info.condition))
    arrays: dict[str, Any] = {METADATA_KEY: np.array(conditions.info.as_json())}
    arrays |= {name: np.asarray(getattr(conditions, name)).astype(_FORMS[name][0]) for name in names}
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def read_npz(path: Path) -> ConditionsFile:
    """Read a conditions file.

    Raises:
        InputFileError: if it is missing, damaged, or not one that prbench wrote.
    """
    archive = Archive(path)
    if METADATA_KEY not in archive.members:
        raise InputFileError(
            path,
            "",
            expected=f"a conditions file (with an array '{METADATA_KEY}')",
            found=f"the arrays {', '.join(sorted(archive.members)[:10])} without it",
            remedy="Export it with `prbench export-conditions`.",
        )
    info = ConditionsInfo.from_json(str(archive.read(METADATA_KEY, largest=1024**2)), path)
    names = (*_ALWAYS, *given_columns(info.condition))
    if set(archive.members) != {METADATA_KEY, *names}:
        found = ", ".join(sorted(set(archive.members) - {METADATA_KEY}))
        raise InputFileError(path, "", expected=f"the arrays {', '.join(names)}", found=found)
    arrays = {name: archive.read(name, largest=_LARGEST_ARRAY) for name in names}
    for name, values in arrays.items():
        _require_form(path, name, values, rows=len(arrays["n_frames"]))
    columns: dict[str, Any] = {
        name: tuple(values.tolist()) if values.dtype.kind == "U" else values for name, values in arrays.items()
    }
    return ConditionsFile(info=info, **columns)


def _require_form(path: Path, name: str, values: np.ndarray, *, rows: int) -> None:
    kind, shape = _FORMS[name]
    right_kind = values.dtype.kind == "U" if kind == "U" else values.dtype == np.dtype(kind)
    if not right_kind or values.shape != (rows, *shape):
        raise InputFileError(
            path,
            f"'{name}'",
            expected=f"shape {(rows, *shape)} of {'text' if kind == 'U' else np.dtype(kind)}",
            found=f"{values.shape} of {values.dtype}",
        )
