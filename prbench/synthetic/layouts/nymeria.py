"""Native files of Nymeria (docs/specification/nymeria.md): suit, narrations, metadata, and the glasses' trajectory."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from prbench.corpora.nymeria import format as nymeria
from prbench.corpora.nymeria.format import Narration
from prbench.readers.aria_mps import format as mps
from prbench.storage import atomic_path, write_bytes, write_json
from prbench.synthetic.layouts.csv_files import split_columns, write_csv
from prbench.synthetic.sensors.nymeria import GlassesPoses, NymeriaReadings

_SCALAR_LAST = ("qx_world_device", "qy_world_device", "qz_world_device", "qw_world_device")
_GRAVITY = (0.0, 0.0, -9.81)
_CREATED = "2000-01-01T00:00:00"


def write_nymeria(readings: NymeriaReadings, root: Path, *, trajectory: bool) -> None:
    """Write one sequence folder.

    Args:
        readings: All that the files say.
        root: Folder of the dataset.
        trajectory: Whether the glasses' trajectory was downloaded; without it, clocks can be aligned by starts only.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    recording = readings.recording
    folder = root / recording.name
    write_suit(folder / "body" / nymeria.SUIT_FILE, readings)
    for kind, name in nymeria.NARRATION_FILES.items():
        rows = [row for row in recording.narrations if row.kind == kind]
        if rows:
            write_narrations(folder / "narration" / name, kind, rows)
    parts = recording.name.split("_")
    write_json(
        folder / nymeria.METADATA_FILE,
        {
            "date": parts[0],
            "session_id": parts[1],
            "fake_name": nymeria.participant_of(recording.name),
            "act_id": parts[-2],
            "uid": parts[-1],
            "script": "invented",
            "location": "nowhere",
        },
    )
    if trajectory:
        slam = folder / nymeria.HEAD_FOLDER / "mps" / "slam"
        write_csv(slam / nymeria.TRAJECTORY_FILE, _trajectory_columns(readings.glasses))


def write_suit(path: Path, readings: NymeriaReadings) -> None:
    """Write ``xdata.npz``; equal readings give equal bytes."""
    suit = readings.recording.suit
    n = len(suit.time_us)
    arrays = {
        "timestamps_us": suit.time_us,
        "frameCount": np.array([n]),
        "frameRate": np.array([round(nymeria.SUIT_RATE)]),
        "segmentCount": np.array([nymeria.N_SEGMENTS]),
        "segment_tXYZ": suit.position.reshape(n, -1),
        "segment_qWXYZ": suit.rotation.reshape(n, -1),
    }
    if suit.tpose is not None:
        arrays["tpose_segment_tXYZ"] = suit.tpose.ravel()
    with atomic_path(path) as temporary:
        np.savez(temporary, **arrays)


def write_narrations(path: Path, kind: str, rows: list[Narration], *, byte_order_mark: bool = True) -> None:
    """Write one narration file, with the byte order mark that the release has."""
    text = io.StringIO()
    writer = csv.writer(text, quoting=csv.QUOTE_ALL, lineterminator="\r\n")
    writer.writerow([*nymeria.NARRATION_HEADER, *nymeria.ANSWER_COLUMNS[kind]])
    for number, row in enumerate(rows):
        times = (f"{row.start:.6f}", f"{row.end:.6f}")
        writer.writerow([number, number, *times, row.annotator, _CREATED, *(answer for _, answer in row.texts)])
    write_bytes(path, text.getvalue().encode("utf-8-sig" if byte_order_mark else "utf-8"))


def _trajectory_columns(glasses: GlassesPoses) -> dict[str, object]:
    n = len(glasses.time_us)
    return {
        mps.GRAPH_COLUMN: ["00000000-0000-0000-0000-000000000000"] * n,
        mps.TIME_COLUMN: glasses.time_us,
        "utc_timestamp_ns": np.full(n, -1),
        **split_columns(mps.POSITION_COLUMNS, glasses.position),
        **split_columns(_SCALAR_LAST, glasses.rotation[:, [1, 2, 3, 0]]),
        **split_columns(mps.GRAVITY_COLUMNS, np.tile(_GRAVITY, (n, 1))),
        mps.QUALITY_COLUMN: np.ones(n),
    }
