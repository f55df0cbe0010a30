"""Reader of Tabletop: one folder a recording, three CSV files each, Z up, millimetres and microseconds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, Joint, y_up
from prbench.protocol.manifests import load_manifest
from prbench.readers import ReaderOptions, RecordingFiles
from prbench.readers.files import column_vectors, read_columns, require_increasing
from prbench.readers.found import input_file, is_present, names_in
from prbench.recording import AnnotatedEvent, BodyStream, GazeStream, PoseStream, Recording

FILES = {"glasses": "glasses.csv", "body": "body.csv", "events": "events.csv"}
"""Role and name of each file."""
POSITION = ("px_mm", "py_mm", "pz_mm")
ROTATION = ("qw", "qx", "qy", "qz")  # world from glasses; the glasses' axes: x left, y up, z forward
GAZE = ("gaze_x", "gaze_y", "gaze_z")  # in the glasses' frame
JOINTS = tuple(f"{joint.name.lower()}_{axis}_mm" for joint in Joint for axis in "xyz")
BOX = ("x_mm", "y_mm", "z_mm", "half_mm")  # centre and half edge of the cube around the object

TURN = Rotation.from_matrix(Y_UP_FROM_Z_UP[:3, :3])


@dataclass(frozen=True)
class TabletopReader:
    """See :class:`prbench.readers.Reader`."""

    dataset: str = "tabletop"
    options: ReaderOptions = ReaderOptions()  # noqa: RUF009 (frozen)
    files: ClassVar[dict[str, str]] = FILES

    @foreign_input()
    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        """List the recordings below the dataset's folder, or the one that ``root`` is itself."""
        root = Path(root).expanduser().resolve()
        folders = [root, *sorted(entry for entry in root.glob("*") if entry.is_dir())]
        found = tuple(self._listed(folder) for folder in folders if (folder / FILES["glasses"]).is_file())
        if not found:
            raise InputFileError(
                root,
                "",
                expected=f"folders with {FILES['glasses']}",
                found=names_in(root) if root.is_dir() else "nothing",
            )
        return found

    def _listed(self, folder: Path) -> RecordingFiles:
        present = {role: folder / name for role, name in self.files.items() if is_present(folder / name)}
        files = tuple(input_file(role, path) for role, path in present.items())
        return RecordingFiles(self.dataset, folder.name, folder, files)

    @foreign_input()
    def read(self, found: RecordingFiles) -> Recording:
        """Read one recording.

        Raises:
            InputFileError: for a missing or damaged file.
        """
        return self.recording(found, annotated_events=_read_events(found.require("events", FILES["events"])))

    def recording(self, found: RecordingFiles, **events: Any) -> Recording:
        """Put together what all recordings have, and what tells the events of this one."""
        manifest = load_manifest(self.dataset)
        glasses, gaze = _read_glasses(found.require("glasses", FILES["glasses"]))
        return Recording(
            dataset=found.dataset,
            recording_id=found.recording_id,
            participant_id=found.recording_id.partition("_")[0],
            pose_source=manifest.body.pose_source,
            head_tilt_deg=manifest.body.head_tilt_deg,
            span=(glasses.times[0], glasses.times[-1]),
            gaze=gaze,
            camera=glasses,
            head=glasses,
            body=_read_body(found.require("body", FILES["body"])),
            split_group=found.recording_id,
            **{"hands": (), "objects": (), **events},
        )


def read_times(path: Path, table) -> np.ndarray:
    """Times in seconds; a clock that runs backwards is refused with the line."""
    microseconds = table["time_us"].to_numpy()
    require_increasing(path, microseconds, unit="µs")
    return microseconds * 1e-6


def _read_glasses(path: Path) -> tuple[PoseStream, GazeStream]:
    table = read_columns(path, {"time_us": int, **dict.fromkeys(POSITION + ROTATION + GAZE, float)})
    times = read_times(path, table)
    position = y_up(column_vectors(table, POSITION)) / 1000
    rotation = TURN * Rotation.from_quat(column_vectors(table, ROTATION), scalar_first=True)
    direction = rotation.apply(column_vectors(table, GAZE))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    valid = np.ones(len(times), dtype=bool)
    glasses = PoseStream(times, position, rotation.as_quat(scalar_first=True), valid)
    return glasses, GazeStream(times, position, direction, valid)


def _read_body(path: Path) -> BodyStream:
    table = read_columns(path, {"time_us": int, **dict.fromkeys(JOINTS, float)})
    joints = column_vectors(table, JOINTS).reshape(-1, len(Joint), 3)
    measured = np.isfinite(joints).all(axis=(1, 2))  # an empty cell is NaN: the frame stays, marked as not measured
    joints = np.where(measured[:, None, None], joints, 0.0)
    return BodyStream(read_times(path, table), y_up(joints) / 1000, measured)


def _read_events(path: Path) -> tuple[AnnotatedEvent, ...]:
    table = read_columns(path, {"time_us": int, "action": str, "object": str, **dict.fromkeys(BOX, float)})
    boxes = column_vectors(table, BOX) / 1000
    events = []
    for row, time in enumerate(table["time_us"].to_numpy()):
        centre = y_up(boxes[row, :3])
        half = boxes[row, 3]
        name = table["object"][row].as_py()
        events.append(
            AnnotatedEvent(
                native_key=f"line {row + 2}",
                action=table["action"][row].as_py(),
                object_id=name,
                object_name=name,
                event_time=time * 1e-6,
                location=centre,
                box_min=centre - half,
                box_max=centre + half,
            )
        )
    return tuple(events)


READER = TabletopReader()
