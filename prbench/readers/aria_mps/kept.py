"""Trajectories in the cache of parsed files."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa

from prbench.readers.aria_mps import format as mps
from prbench.readers.parse_cache import keep_parsed, load_parsed
from prbench.readers.zipped import Source

_FACTS = b"prbench.trajectory"
_WISH = b"aria trajectory 1 "
_NUMBERS = ("x", "y", "z", "qw", "qx", "qy", "qz", "quality")


def load_trajectory(source: Source, wish: bytes) -> mps.AriaTrajectory | None:
    """What was read before from a file that has not changed since; None if nothing was."""
    table = load_parsed(source, _WISH + wish)
    if table is None:
        return None
    facts = json.loads(table.schema.metadata[_FACTS])
    numbers = np.column_stack([table[name].to_numpy() for name in _NUMBERS])
    return mps.AriaTrajectory(
        time_us=table["time_us"].to_numpy(),
        position=numbers[:, :3],
        rotation=numbers[:, 3:7],
        quality=numbers[:, 7],
        up=np.array(facts["up"]),
        graph_uids=tuple(facts["graph_uids"]),
        left_out=facts["left_out"],
    )


def keep_trajectory(source: Source, wish: bytes, trajectory: mps.AriaTrajectory) -> None:
    """Keep what was read from a file."""
    numbers = np.column_stack([trajectory.position, trajectory.rotation, trajectory.quality])
    facts = {
        "up": trajectory.up.tolist(),
        "graph_uids": list(trajectory.graph_uids),
        "left_out": trajectory.left_out,
    }
    columns = {name: numbers[:, index] for index, name in enumerate(_NUMBERS)}
    table = pa.table({"time_us": trajectory.time_us, **columns})
    keep_parsed(source, _WISH + wish, table.replace_schema_metadata({_FACTS: json.dumps(facts)}))
