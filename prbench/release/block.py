"""The ``prbench`` block of an entry and the arrays of ``further/``: what the authors' layout has no place for.

Other tools pass over both. Together with the layout's own fields they hold every column of the sequence table, so that
a table comes back unchanged.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from prbench.errors import InputFileError
from prbench.numpy_files import Archive

_ARRAYS = (
    "previous_joints",
    "next_joints",
    "gaze_origin",
    "gaze_direction",
    "gaze_valid",
    "head_position",
    "head_rotation",
)


class Block(msgspec.Struct, frozen=True, kw_only=True):
    """Columns of one sequence that the layout lacks; world box in the world, everything else as in the table."""

    sequence_id: str
    event_id: str
    recording_id: str
    participant_id: str
    split_group: str
    action: str
    object_id: str
    object_name: str
    text: str
    hand: str | None
    n_frames: int
    start_time: float
    prime_time: float
    event_time: float
    prime_gap: float
    preroll: float
    prime_kind: str
    prime_time_uncertainty: float | None
    goal_box_world_min: tuple[float, float, float]
    goal_box_world_max: tuple[float, float, float]
    body_movement: float
    hand_movement: float
    pose_source: str
    head_tilt_deg: float
    previous_source: str
    next_source: str
    world_from_canonical: tuple[float, ...]
    motion_frame: str
    """``canonical`` or ``world``: what motions, goal and gazes of this file are in."""
    goal_frame: str = "known"
    """``unknown`` where the table itself came from a release whose goals could not be placed."""
    extra: dict[str, str]

    def __post_init__(self) -> None:
        numbers = (self.start_time, self.prime_time, self.event_time, *self.world_from_canonical)
        if len(self.world_from_canonical) != 16 or not all(map(math.isfinite, numbers)):
            raise ValueError("world_from_canonical must hold 16 finite numbers, and times be finite")


def parse_block(value: Any) -> Block | None:
    """The block of an entry.

    Raises:
        ValueError: if there is one of another form.
    """
    if value is None:
        return None
    return msgspec.convert(value, Block)


def pack_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """An uncompressed ``.npz``, equal bytes for equal values."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, values in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.ascontiguousarray(values), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue())
    return stream.getvalue()


def unpack_arrays(path: Path, content: bytes) -> dict[str, np.ndarray]:
    """The known arrays of a ``.npz`` that nobody vouches for.

    Raises:
        InputFileError: if it is damaged, compressed, or holds objects.
    """
    archive = Archive(path, content)
    if not all(map(archive.stored_as_is, archive.members)):
        raise InputFileError(path, "", expected="arrays without compression", found="compressed ones")
    return archive.load(_ARRAYS)


def fits(arrays: Mapping[str, np.ndarray], n_frames: int) -> bool:
    """Whether the arrays belong to a motion of this length."""
    shapes = {
        "previous_joints": (22, 3),
        "next_joints": (22, 3),
        "gaze_origin": (n_frames, 3),
        "gaze_direction": (n_frames, 3),
        "gaze_valid": (n_frames,),
        "head_position": (n_frames, 3),
        "head_rotation": (n_frames, 4),
    }
    needed = {"previous_joints", "next_joints", "gaze_origin", "gaze_direction", "gaze_valid"}
    heads = {"head_position", "head_rotation"} & set(arrays)
    return (
        needed <= set(arrays)
        and len(heads) != 1
        and all(values.shape == shapes[name] and values.dtype.kind in "fb" for name, values in arrays.items())
        and all(np.isfinite(values).all() for values in arrays.values())
    )
