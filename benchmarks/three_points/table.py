"""The table of tracks: the poses of head and wrists, and the body that they belong to, one stretch of time a row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from prbench.curation.job import PartReceipt, provenance_of
from prbench.files.storage import atomic_folder
from prbench.sequences import parts
from prbench.sequences.dataset_info import Count, Provenance
from prbench.sequences.schema import check_schema
from prbench.sequences.sequence import Hertz, Metres, Seconds, SequenceChunk, schema_of
from prbench.sequences.table import BuiltTable
from prbench.sequences.write import write_tables
from prbench_benchmarks.three_points.batch import Condition, TrackedBatch, track_key
from prbench_benchmarks.three_points.protocol import load_three_points_protocol

FILE_NAME = "tracks.json"


def _rows(size: int, number: pa.DataType) -> pa.DataType:
    """Return the type of a column that holds so many numbers a frame."""
    return pa.list_(pa.list_(number, size))


@dataclass(frozen=True, kw_only=True)
class Track:
    """One row: a stretch of one recording without a gap. World, metres, Y up; quaternions w x y z.

    Attributes:
        sequence_id: Dataset, recording, kind of devices, and the first frame in the suit's file.
        devices: ``real``: measured poses, moved to the joints; ``synthetic``: the suit's own head and hands.
        start_time: Seconds on the suit's clock.
        device_position: Head, left and right wrist; zero where not valid.
        device_rotation: The same joints' frames to world; the identity where not valid.
        joints: The measured positions of the 22 joints: the truth.
        rotations: Local rotation of each joint in its parent, the root's in the world.
        offsets: Each joint's rest offset from its parent in the T-pose.
        kinematic_deviation: 95th percentile of the distance between ``joints`` and forward kinematics of ``rotations``.
    """

    sequence_id: str
    recording_id: str
    participant_id: str
    split: str
    devices: Literal["real", "synthetic"]
    fps: Hertz
    start_time: Seconds
    n_frames: int
    device_position: Annotated[Float[np.ndarray, "n 9"], _rows(9, pa.float32()), "m"]
    device_rotation: Annotated[Float[np.ndarray, "n 12"], _rows(12, pa.float32()), "1"]
    device_valid: Annotated[Bool[np.ndarray, "n 3"], _rows(3, pa.bool_()), "none"]
    rotation_valid: Annotated[Bool[np.ndarray, "n 3"], _rows(3, pa.bool_()), "none"]
    joints: Annotated[Float[np.ndarray, "n 66"], _rows(66, pa.float32()), "m"]
    rotations: Annotated[Float[np.ndarray, "n 88"], _rows(88, pa.float32()), "1"]
    offsets: Annotated[Float[np.ndarray, "66"], pa.list_(pa.float32(), 66), "m"]
    kinematic_deviation: Metres


TRACKS = schema_of(Track)


class TrackCounts(msgspec.Struct, frozen=True, kw_only=True):
    """What a table of tracks holds.

    Attributes:
        recordings: Number of recordings with tracks.
        participants: Number of participants.
        tracks: Number of tracks.
        frames: Number of frames in all tracks.
    """

    recordings: Count
    participants: Count
    tracks: Count
    frames: Count


class TracksInfo(Provenance, frozen=True, kw_only=True):
    """Provenance of one table of tracks.

    Attributes:
        fps: Frame rate, in frames per second.
        devices: ``real`` or ``synthetic``, of all tracks.
        counts: What the table holds.
    """

    file_name = FILE_NAME
    described = "table of tracks"
    build_command = "build-tracks"
    why_not_scored: ClassVar[None] = None

    fps: float
    devices: Literal["real", "synthetic"]
    counts: TrackCounts


class TracksTable(BuiltTable[TracksInfo]):
    """A built table of tracks; rows are read when they are asked for."""

    description = TracksInfo
    main = "tracks"
    schemas: ClassVar = {"tracks": TRACKS}
    identity_columns = ("sequence_id", "split", "n_frames")
    check = staticmethod(check_schema)
    rows_at_once = 8  # a track of a minute takes 2.5 MB


def padded(chunk: SequenceChunk, column: str, *shape: int) -> np.ndarray:
    """Return a column of per-frame values as (rows, frames, *shape); zero beyond the last frame of a row."""
    within = np.arange(chunk.n_frames.max()) < chunk.n_frames[:, None]
    values = chunk.frames(column)
    whole = np.zeros((*within.shape, *shape), dtype=values.dtype)
    whole[within] = values.reshape(-1, *shape)
    return whole


GIVEN = ["fps", "device_position", "device_rotation", "device_valid", "rotation_valid", "offsets"]


def tracked_batch(chunk: SequenceChunk, condition: Condition) -> TrackedBatch:
    """Return rows with the columns :data:`GIVEN` as a tracker may see them under a condition."""
    valid = padded(chunk, "device_valid", 3)
    rotation_valid = padded(chunk, "rotation_valid", 3)
    if condition is Condition.HEAD:
        valid[:, :, 1:] = False
        rotation_valid[:, :, 1:] = False
    position = padded(chunk, "device_position", 3, 3)
    rotation = padded(chunk, "device_rotation", 3, 4)
    return TrackedBatch(
        condition=condition,
        fps=float(chunk.numbers("fps")[0]),
        n_frames=chunk.n_frames,
        position=np.where(valid[..., None], position, np.float32(0.0)),
        rotation=np.where(rotation_valid[..., None], rotation, np.array([1, 0, 0, 0], dtype=np.float32)),
        valid=valid,
        rotation_valid=rotation_valid,
        offsets=chunk.vectors("offsets").reshape(-1, 22, 3),
        key=tuple(map(track_key, chunk.sequence_ids)),
    )


def write_tracks(out: Path, finished: Sequence[PartReceipt], dataset: str, **settings: Any) -> TracksInfo:
    """Write the table of all parts of a build, whole or not at all.

    Args:
        out: The table's folder.
        finished: The parts, in table order.
        dataset: Name of the dataset; ``-suit`` stands behind that of tables with synthetic devices.
        settings: The fields ``options``, ``fps`` and ``devices`` of the description.
    """
    read = [each for each in finished if each.record.status == "read"]
    about = provenance_of(dataset, load_three_points_protocol(), finished, read)
    about["dataset"] += "-suit" if settings["devices"] == "synthetic" else ""
    counts = {"recordings": len(read), "participants": len({each.record.participant_id for each in read})}
    counts |= {name: sum(each.record.outcomes[name] for each in read) for name in ("tracks", "frames")}
    about["outcomes"] = {"track": counts["tracks"]}
    info = TracksInfo(**about, **settings, schema_version=1, counts=TrackCounts(**counts))
    tables = {"tracks": parts.read_batches([each.folder for each in finished], "tracks")}
    form: Any = (TracksTable.schemas, TracksTable.identity_columns)
    with atomic_folder(out) as temporary:
        return write_tables(temporary, info, tables, *form, row_group_rows=TracksTable.rows_at_once)
