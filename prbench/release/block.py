"""The ``prbench`` block of an entry: the columns of a sequence that the authors' layout has no field for.

Other tools pass over it. Together with the layout's own fields and the arrays of ``further/`` it holds every column of
the sequence table, so that a table comes back unchanged.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import pyarrow as pa

from prbench.sequences import Sequence
from prbench.sequences.rows import is_bulky
from prbench.sequences.sequence import SEQUENCES

_IN_THE_LAYOUT = ("dataset", "split", "fps", "prime_frame", "goal_location")
_COLUMNS = [each for each in SEQUENCES if not is_bulky(each.type) and each.name not in _IN_THE_LAYOUT]
_JSON = {pa.string(): str, pa.float64(): float, pa.int32(): int}


def _json_type(column: pa.Field) -> Any:
    if pa.types.is_fixed_size_list(column.type):
        size = column.type.list_size
        return Annotated[list[float], msgspec.Meta(min_length=size, max_length=size)]
    # JSON has no NaN, so None stands for it.
    nullable = column.nullable or column.name == "prime_time_uncertainty"
    return _JSON[column.type] | None if nullable else _JSON[column.type]


_Block = msgspec.defstruct(
    "_Block",
    [
        *((each.name, _json_type(each)) for each in _COLUMNS),
        ("extra", dict[str, str]),
        ("event_id", str),
        ("motion_frame", Literal["canonical", "world"]),
        ("goal_frame", Literal["known", "unknown"], "known"),
    ],
)


def block_of(sequence: Sequence, *, event_id: str, motion_frame: str, goal_frame: str) -> dict[str, Any]:
    """Return the block of a sequence, as JSON holds it.

    Args:
        sequence: One row of the table.
        event_id: Id of its event.
        motion_frame: Frame of motion, goal and gaze as they are written: ``canonical`` or ``world``.
        goal_frame: ``unknown`` where the table itself came from a release whose goals could not be placed.
    """
    block: dict[str, Any] = {"sequence_id": sequence.sequence_id, "event_id": event_id}
    for column in _COLUMNS:
        value = getattr(sequence, column.name)
        if isinstance(value, np.ndarray):
            value = value.ravel().tolist()
        block[column.name] = None if value != value else value  # NaN alone differs from itself
    return block | {"motion_frame": motion_frame, "goal_frame": goal_frame, "extra": dict(sequence.extra)}


def convert_block(value: Any, *, fps: float, primed_frame: float, n_frames: int) -> dict[str, Any] | None:
    """Return the columns of a block, and the three names beside them; None for one that does not fit its sequence.

    Args:
        value: What stands in the entry; a user's file like any other, which may have been edited.
        fps: Frame rate of the import.
        primed_frame: Frame of the prime, from the entry.
        n_frames: Frames of the motion.
    """
    try:
        block = msgspec.structs.asdict(msgspec.convert(value, _Block))
    except msgspec.ValidationError:
        return None
    numbers = [number for each in block.values() for number in (each if isinstance(each, list) else [each])]
    if not all(math.isfinite(number) for number in numbers if isinstance(number, float)):
        return None
    # A block that no longer fits belongs to an entry that somebody changed; its fields then count, not the block.
    same_prime = abs(block["preroll"] * fps - primed_frame) <= 0.5 + 1e-6
    span = block["event_time"] - block["start_time"]
    same_length = block["n_frames"] == n_frames and abs(span * fps - n_frames + 1) < 1e-3
    if not (same_prime and same_length):
        return None
    if block["prime_time_uncertainty"] is None:
        block["prime_time_uncertainty"] = math.nan
    for name in ("goal_box_world_min", "goal_box_world_max"):
        block[name] = np.array(block[name])
    block["world_from_canonical"] = np.array(block["world_from_canonical"]).reshape(4, 4)
    return block
