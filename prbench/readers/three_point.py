"""Bodies that were estimated from head and wrists: one file a recording, attached to what a reader read.

``prbench poses three-point`` writes ``ROOT/three-point/<recording>.npz``: ``times`` (n), seconds on the recording's
clock; ``joints`` (n, 22, 3), metres in the recording's world; ``valid`` (n); and ``about``, JSON of texts that say how
it was made. Source: docs/specification/three-points.md.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import require
from prbench.geometry.skeleton import Joint
from prbench.readers.egoallo.to_recording import NO_OUTPUTS
from prbench.readers.found import InputFile, RecordingFiles, input_file, is_present
from prbench.recording import BodyStream, Recording, hold_neighbours

THREE_POINT = "three-point"  # folder, role of its files, source of the bodies, and value of the readers' option poses
LONGEST_GAP = 0.105  # s between two measurements that tell what was in between: 10 Hz, and its jitter
_HEAD_TILT_DEG = 29.1  # of the mean adult's neck-head bone
_FARTHEST = 0.3  # m, median, between glasses and head joint; more is another recording or world
_AGAIN = "Make it again: prbench poses three-point."


def find_body(root: Path, recording_id: str) -> tuple[InputFile, ...]:
    """Return the file of one recording's body, if it is there."""
    path = root / THREE_POINT / f"{recording_id}.npz"
    return (input_file(THREE_POINT, path),) if is_present(path) else ()


def read_body(path: Path) -> tuple[BodyStream, dict[str, str]]:
    """Read a body, and how it was made.

    Raises:
        InputFileError: if an array is missing or has another form, or times do not increase.
    """
    archive = Archive(path, remedy=_AGAIN)
    archive.require(("times", "joints", "valid", "about"))
    times, joints, valid, about = archive.load(("times", "joints", "valid", "about")).values()
    n = times.size
    for key, fits, expected in (
        ("times", times.shape == (n,) and n > 0 and bool((np.diff(times) > 0).all()), "increasing seconds"),
        ("joints", joints.shape == (n, len(Joint), 3) and bool(np.isfinite(joints).all()), f"finite ({n}, 22, 3)"),
        ("valid", valid.shape == (n,) and valid.dtype == bool, f"{n} truth values"),
    ):
        require(path, (fits, key, expected, "others", _AGAIN))
    try:
        made = msgspec.json.decode(str(about), type=dict[str, str])
    except msgspec.DecodeError as error:
        raise InputFileError(path, "about", expected="JSON of texts", found=str(error), remedy=_AGAIN) from error
    return BodyStream(times, hold_neighbours(joints.astype(np.float64), valid), valid), made


def attached(recording: Recording, found: RecordingFiles) -> Recording:
    """Return a recording with the body of its file instead of its own; without the file it has none.

    Raises:
        InputFileError: if the file is damaged, or belongs to another recording.
    """
    told = tuple(text for text in recording.messages if text != NO_OUTPUTS)
    path = found.path(THREE_POINT)
    if path is None:
        told += ("no body from head and wrists (`prbench poses three-point` makes one)",)
        return replace(recording, body=None, pose_source="none", messages=told)
    body, made = read_body(path)
    away = body.joints[body.valid, Joint.HEAD] - recording.head.pose_at(body.times[body.valid])[0]
    median = float(np.median(np.linalg.norm(away, axis=-1))) if len(away) else np.inf
    expected = f"heads within {_FARTHEST:g} m of the glasses"
    require(path, (median <= _FARTHEST, "joints", expected, f"{median:.2f} m", _AGAIN))
    told += ("three-point body: " + ", ".join(f"{name} {text}" for name, text in sorted(made.items()) if text),)
    tilt = float(made.get("head_tilt_deg", _HEAD_TILT_DEG))
    return replace(recording, body=body, pose_source=THREE_POINT, head_tilt_deg=tilt, messages=told)
