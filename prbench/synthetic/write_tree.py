"""The truth record of synthetic recordings as Parquet (docs/specification/synthetic-recordings.md#truth-record).

It lies in ``truth/`` beside the native files. Readers and curation never open it; only comparisons do. Times are
seconds from the recording's first frame: add ``clock_offset_s`` of its stream to get the times of the native files.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

import prbench
from prbench.engine import engine_for
from prbench.errors import UsageError
from prbench.files.storage import atomic_folder, atomic_path, sole_writer, write_json
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.layouts import SHARED_PARTS, layout_for
from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Sensing, Switches, gaze_bias_of

_TRUTH_FOLDER = "truth"
_TRUTH_SCHEMA = 1

_STREAMS = ("glasses", "gaze", "objects", "body")
_METADATA = {"prbench.truth_schema": str(_TRUTH_SCHEMA)}
_DECIMALS = 5  # 10 micrometres; keeps digests equal where the last bits of a sine differ
_POINT = pa.list_(pa.float64(), 3)


# Maps the columns of the truth record that hold times to the attributes of a true event.
TIMES = {
    "contact_s": "contact_time",
    "event_s": "event_time",
    "release_s": "release_time",
    "motor_start_s": "motor_start",
    "reach_start_s": "reach_start",
    "prime_planned_s": "prime_planned",
    "prime_s": "prime_time",
    "prime_first_s": "prime_first",
}
# Columns of the tables of events and of looks in their order; those without a type here are texts.
_EVENT_COLUMNS = (
    *("event_id", "kind", "tag", "object_id", "object_name", "hand", "contact_s", "event_s", "release_s"),
    *("goal", "box_min", "box_max", "prime_planned_s", "prime_s", "prime_first_s", "prime_kind"),
    *("motor_start_s", "reach_start_s", "expected", "thin"),
)
_LOOK_COLUMNS = ("start_s", "end_s", "target", "kind", "event_id")
_TYPES = dict.fromkeys((*TIMES, "start_s", "end_s"), pa.float64()) | {"thin": pa.bool_()}
_TYPES |= dict.fromkeys(("goal", "box_min", "box_max", "target"), _POINT)


def shared_tables(performance: Performance, *, noise: float = 1.0) -> dict[str, pa.Table]:
    """Return the rows of a recording in the tables that all recordings share.

    Returns:
        ``recordings``: one row: who, where, which clock and which constant errors. ``events``: one row a pick, put or
        provocation. ``fixations``: one row a planned look.
    """
    layout = layout_for(performance.preset)
    yaw, pitch = np.rad2deg(gaze_bias_of(Sensing(performance, noise, Switches()), layout.gaze_bias))
    person = performance.person
    about = {
        "recording_id": [performance.recording_id],
        "preset": [performance.preset],
        "room_id": [performance.room_id],
        "participant_id": [person.participant_id],
        "split": [performance.split],
        "seed": pa.array([performance.seed], pa.int64()),
        "duration_s": [performance.duration],
        "stature_m": [person.body.stature],
        "neck_tilt_deg": [person.neck_tilt_deg],
        "style": [dict(sorted(person.style.items()))],
        "clock_offset_s": [dict.fromkeys(_STREAMS, layout.clock_start(performance))],
        "clock_drift_ppm": [dict.fromkeys(_STREAMS, 0.0)],
        "gaze_bias_yaw_deg": [float(yaw)],
        "gaze_bias_pitch_deg": [float(pitch)],
        "world_from_native": pa.array([np.eye(4).ravel().tolist()], pa.list_(pa.float64(), 16)),
    }
    tables = {"recordings": about}
    events = []
    for event in layout.events(performance):
        named = {"kind": event.action, "object_id": layout.object_id(event.object_id)}
        events.append(vars(event) | named | {column: getattr(event, name) for column, name in TIMES.items()})
    looks = [vars(look) | {"start_s": look.start, "end_s": look.end} for look in performance.fixations]
    for name, columns, rows in (("events", _EVENT_COLUMNS, events), ("fixations", _LOOK_COLUMNS, looks)):
        tables[name] = {"recording_id": pa.array([performance.recording_id] * len(rows), pa.string())}
        for column in columns:
            kind = _TYPES.get(column, pa.string())
            values = [np.asarray(row[column]).tolist() if kind is _POINT else row[column] for row in rows]
            tables[name][column] = pa.array(values, kind)
    return {name: _table(columns) for name, columns in tables.items()}


def own_tables(performance: Performance, *, rate: float) -> dict[str, pa.Table]:
    """Return the tables of which every recording has its own.

    Args:
        performance: The truth.
        rate: Frames a second of ``joints`` that are kept; a divisor of the performance's rate.

    Returns:
        ``joints``: one row a frame: body, segment rotations, eyes, gaze, the head's own direction, planted feet.
        ``objects``: poses of every object's box centre: rows while it moves, and its first and last.
    """
    rows = slice(None, None, round(performance.rate / rate))
    times = performance.times[rows]
    forward = Rotation.from_quat(performance.head_rotation[rows], scalar_first=True).apply((0.0, 0.0, 1.0))
    joints = {"recording_id": _repeated(performance.recording_id, len(times)), "t": times}
    joints |= {name: _rows(getattr(performance, name)[rows]) for name in ("joints", "rotations", "eye", "gaze")}
    joints |= {"head_forward": _rows(forward), "planted": _rows(performance.planted[rows])}
    objects = []
    layout = layout_for(performance.preset)
    for motion in performance.objects:
        # Rows at rest repeat the one before; without them the file of a long recording stays small.
        changes = (np.diff(np.concatenate([motion.position, motion.rotation], axis=1), axis=0) != 0).any(axis=1)
        kept = np.zeros(len(motion.position), dtype=bool)
        kept[:-1] |= changes
        kept[1:] |= changes
        kept[[0, -1]] = True
        times = performance.times[: len(motion.position)][kept]
        columns = {
            "recording_id": _repeated(performance.recording_id, len(times)),
            "object_id": _repeated(layout.object_id(motion.object_id), len(times)),
            "t": times,
            "position": _rows(motion.position[kept]),
            "quaternion": _rows(motion.rotation[kept]),
            "held_by": motion.held_by[kept].astype(np.int8),
        }
        objects.append(_table(columns))
    return {"joints": _table(joints), "objects": pa.concat_tables(objects)}


def write_truth(table: pa.Table, tree: Path, name: str, *, part: str | None = None) -> None:
    """Write one table, or one recording's part of it, below ``truth/``; equal tables give equal bytes."""
    folder = tree / _TRUTH_FOLDER
    path = folder / f"{name}.parquet" if part is None else folder / name / f"{part}.parquet"
    with atomic_path(path) as temporary:
        pq.write_table(table, temporary, compression="zstd", compression_level=1)


def _rows(values: np.ndarray) -> pa.Array:
    """Return one fixed-size list a row: float32 rounded to 10 micrometres, or booleans."""
    flat = values.reshape(len(values), -1)
    if flat.dtype == bool:
        return pa.FixedSizeListArray.from_arrays(pa.array(flat.ravel()), flat.shape[1])
    return pa.FixedSizeListArray.from_arrays(np.round(flat, _DECIMALS).astype(np.float32).ravel(), flat.shape[1])


def _repeated(text: str, count: int) -> pa.Array:
    return pa.array([text], pa.string()).take(pa.array(np.zeros(count, dtype=np.int64)))


def _table(columns: dict[str, object]) -> pa.Table:
    return pa.table(columns).replace_schema_metadata(_METADATA)


SYNTHETIC_FILE = "synthetic.json"
Size = Literal["tiny", "default", "large"]


# Recordings, events of each, and frames a second of the joints in the truth record, by size of a tree.
SIZES = {"tiny": (2, 6, 30.0), "default": (24, 10, 120.0)}


@dataclass(frozen=True)
class WrittenRecording:
    """Result of writing one recording of a tree.

    Attributes:
        recording_id: Its name.
        split: ``train``, ``validation`` or ``test``.
        duration: Its length, in seconds.
        n_events: Number of picks and puts; in a text-motion layout the number of texts.
        n_objects: Number of objects; 0 in a text-motion layout.
    """

    recording_id: str
    split: str
    duration: float
    n_events: int
    n_objects: int


@dataclass(frozen=True)
class WrittenTree:
    """Result of writing a tree."""

    root: Path
    recordings: tuple[WrittenRecording, ...]


def synthesize_tree(
    preset: str,
    out: Path,
    *,
    recordings: int | None = None,
    seed: int = 0,
    size: Size = "tiny",
    workers: int = 1,
    n_events: int | None = None,
    bystander_objects: int | None = None,
    provocations: Mapping[str, float] | None = None,
    noise: float = 1.0,
    estimates: bool = False,
    on_written: Callable[[WrittenRecording], None] | None = None,
) -> WrittenTree:
    """Write native files of synthetic recordings, complete or not at all.

    Args:
        preset: A preset that has native files (``adt``).
        out: Folder of the tree; an older synthetic tree there is replaced.
        recordings: How many; the size's number if None.
        seed: Seed of the whole tree.
        size: ``tiny`` or ``default``; ``large`` is refused.
        workers: Processes; the bytes do not depend on it.
        n_events: Picks and puts a recording; the size's number if None.
        bystander_objects: Objects that never move; 3 to 12 if None.
        provocations: See :func:`prbench.synthetic.people.perform`.
        noise: Multiplies every sensor error; 0 for ideal sensors.
        estimates: Write bodies as EgoAllo estimates them, beside the layout's own.
        on_written: Called after each recording, in their order.

    Raises:
        UsageError: for a preset without native files (or without ``estimates``), the size ``large``, or a folder that
            holds something else.
        StorageError: if the disk is full or the folder cannot be written.
    """
    layout = layout_for(preset)
    if estimates and layout.write_estimates is None:
        raise UsageError(f"{preset} has no bodies of its own beside which EgoAllo's estimates could stand.")
    _, events, truth_rate = _amount(size)
    require_free(out)
    count = planned_recordings(size, recordings)
    with sole_writer(out), atomic_folder(out) as root:
        wanted = {"n_events": events if n_events is None else n_events, "bystander_objects": bystander_objects}
        wanted["provocations"] = None if provocations is None else dict(provocations)
        act = partial(perform, preset, seed=seed, **wanted)
        write_one = partial(_write_recording, act, root=root, noise=noise, truth_rate=truth_rate, estimates=estimates)
        done = []
        for result in engine_for(workers).map(write_one, range(count)):
            done.append(result)
            if on_written:
                on_written(result[0])
        written = tuple(recording for recording, _, _ in done)
        layout.finish(root)
        shutil.rmtree(root / SHARED_PARTS, ignore_errors=True)
        for name in ("recordings", "events", "fixations"):
            write_truth(pa.concat_tables([tables[name] for _, _, tables in done]), root, name)
        write_mark(root, preset, seed, done[0][1], {each.recording_id: each.split for each in written})
    return WrittenTree(out, written)


def planned_recordings(size: str, recordings: int | None) -> int:
    """Return how many recordings a tree will have.

    Raises:
        UsageError: for less than one, or a size that is not written.
    """
    count = _amount(size)[0] if recordings is None else recordings
    if count < 1:
        raise UsageError(f"a synthetic tree needs at least one recording, {count} were asked for.")
    return count


def _write_recording(
    act: Callable[..., Performance], index: int, *, root: Path, noise: float, truth_rate: float, estimates: bool
) -> tuple[WrittenRecording, str, dict[str, pa.Table]]:
    """Write one recording, and return it, its world, and its rows of the tables that recordings share."""
    performance = act(index=index)
    name = performance.recording_id
    layout = layout_for(performance.preset)
    readings = layout.sense(performance, noise=noise)
    layout.write(readings, root)
    if estimates and layout.write_estimates is not None:
        layout.write_estimates(performance, readings, root, noise=noise)
    for table, rows in own_tables(performance, rate=truth_rate).items():
        write_truth(rows, root, table, part=name)
    counts = (len(performance.events), len(performance.objects))
    summary = WrittenRecording(name, performance.split, performance.duration, *counts)
    return summary, performance.world, shared_tables(performance, noise=noise)


def write_mark(root: Path, preset: str, seed: int, world: str, split: Mapping[str, str]) -> None:
    """Write the mark that tells readers and people that a tree is synthetic, and which recording is in which split."""
    generated = {"generator": f"prbench {prbench.__version__}", "version": GENERATOR_VERSION, "seed": seed}
    write_json(root / SYNTHETIC_FILE, {**generated, "preset": preset, "world": world, "split": dict(split)})


def _amount(size: str) -> tuple[int, int, float]:
    if size == "large":
        raise UsageError(
            "size 'large' (480 recordings a preset) is not written as native files: that would be about 30 GB of text"
            " which nobody needs to read. Take 'tiny' or 'default', with --count N for more; for training data of"
            " that size add --table, which writes the finished table of sequences instead."
        )
    if size not in SIZES:
        raise UsageError(f"unknown size '{size}'; use tiny or default.")
    return SIZES[size]


def require_free(out: Path) -> None:
    """Refuse to replace anything but an older synthetic tree."""
    if out.is_dir() and any(out.iterdir()) and not (out / SYNTHETIC_FILE).is_file():
        raise UsageError(f"{out} holds files that are no synthetic tree; choose an empty or new folder.")
