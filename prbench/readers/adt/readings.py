"""The files of one ADT recording → :class:`prbench.readers.adt.format.AdtReadings`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.readers.adt import format as adt
from prbench.readers.adt import layouts
from prbench.readers.adt.for_egoallo import glasses_z_up
from prbench.readers.adt.layouts import AdtOptions
from prbench.readers.adt.objects import read_objects
from prbench.readers.adt.skeletons import read_skeletons
from prbench.readers.aria_mps.find import read_warnings
from prbench.readers.aria_mps.format import AriaTrajectory, GazeAngles
from prbench.readers.aria_mps.readings import OnlineCalibration, read_first_calibration, read_gaze_angles
from prbench.readers.aria_mps.trajectory import read_trajectory
from prbench.readers.egoallo.bodies import read_bodies
from prbench.readers.files import decode_json
from prbench.readers.found import RecordingFiles

_BEHIND = np.pi / 2  # radians; no eye looks there
_TOO_MANY = 0.2  # share of rows
_DEFAULTS = AdtOptions()


def read_readings(found: RecordingFiles, options: AdtOptions = _DEFAULTS) -> adt.AdtReadings:
    """Read all that curation needs of one recording.

    Raises:
        InputFileError: for a missing or damaged file, an unknown time domain, or a scene that is not Y up.
    """
    serial, concurrent = _read_identity(found)
    objects, remarks = read_objects(
        found.require(layouts.INSTANCES, adt.INSTANCES_FILE),
        found.require(layouts.BOXES, adt.BOXES_FILE),
        found.require(layouts.OBJECTS, adt.OBJECTS_FILE),
    )
    calibration, calibration_remarks = _read_calibration(found)
    trajectory = _read_trajectory(found)
    size = None if calibration is None else calibration.size
    return adt.AdtReadings(
        recording_id=found.recording_id,
        serial=serial,
        concurrent=concurrent,
        glasses_size=size,
        device_from_rgb=None if calibration is None else calibration.device_from_camera["camera-rgb"],
        glasses=trajectory,
        gaze=read_gaze(found.require(layouts.GAZE, adt.GAZE_FILE)),
        objects=objects,
        skeletons=read_skeletons(found),
        estimated_body=read_bodies(found, cpf=glasses_z_up(trajectory, size)) if options.poses == "egoallo" else None,
        messages=(*remarks, *trajectory.remarks, *calibration_remarks, *_gaze_warnings(found)),
    )


def _read_identity(found: RecordingFiles) -> tuple[str, str]:
    """Serial of the glasses, and the id of the concurrent recording (empty if there is none)."""
    path = found.require(layouts.METADATA, adt.METADATA_FILE)
    metadata = decode_json(path, layouts.METADATA_DECODER)
    tours = metadata.subtour_list()
    unnamed_before_2 = bool(tours) and metadata.gt_time_domain is None
    if metadata.gt_time_domain != adt.TIME_DOMAIN and not unnamed_before_2:
        raise InputFileError(
            path,
            "gt_time_domain",
            expected=f"'{adt.TIME_DOMAIN}' (the device clock)",
            found=f"'{metadata.gt_time_domain}'" if metadata.gt_time_domain else "nothing",
            remedy="Times on another clock would not meet gaze and poses; use a release on the device clock.",
        )
    if not tours:
        return metadata.serial or "", metadata.concurrent()
    for tour in tours:
        layouts.subtour_folder(path, tour)  # refused where the search found no recording of it
    own = next(tour for tour in tours if layouts.subtour_id(path.parent.name, tour.subtour_name) == found.recording_id)
    others = [tour for tour in tours if tour is not own]
    concurrent = min((layouts.subtour_id(path.parent.name, tour.subtour_name) for tour in others), default="")
    return own.device_serial, concurrent


def _read_calibration(found: RecordingFiles) -> tuple[OnlineCalibration | None, tuple[str, ...]]:
    """The optional calibration, and remarks; one whose own services call it an error is left aside."""
    path = found.path(layouts.CALIBRATION)
    status = found.path(layouts.SLAM_STATUS)
    if path is None:
        return None, ()
    try:
        remarks = () if status is None else read_warnings(status)
    except InputFileError as error:
        return None, (f"the online calibration is not used: {error}",)
    return read_first_calibration(path), remarks


def _read_trajectory(found: RecordingFiles) -> AriaTrajectory:
    path = found.require(layouts.TRAJECTORY, adt.TRAJECTORY_FILE)
    trajectory = read_trajectory(path)
    if np.linalg.norm(trajectory.up - np.array(adt.UP)) > 1e-3:
        raise InputFileError(
            path,
            "gravity columns",
            expected="gravity along -Y (ADT scenes are Y up)",
            found=f"up = {(np.round(trajectory.up, 3) + 0.0).tolist()}",
            remedy="This looks like a native MPS trajectory; use the recording's own aria_trajectory.csv.",
        )
    return trajectory


def read_gaze(path: Path) -> GazeAngles:
    """Read a gaze file and refuse angles that are no radians.

    Raises:
        InputFileError: as :func:`read_gaze_angles`; or if many angles would look backwards.
    """
    gaze = read_gaze_angles(path)
    largest = np.maximum(np.abs(gaze.yaw), np.abs(gaze.pitch))
    known = largest[np.isfinite(largest)]
    if len(known) and (known > _BEHIND).mean() > _TOO_MANY:
        raise InputFileError(
            path,
            "yaw and pitch",
            expected="angles in radians, below 1.57",
            found=f"angles up to {known.max():.1f} in {int((known > _BEHIND).sum())} of {len(known)} rows",
            remedy="They look like degrees; use the file as it was released.",
        )
    return gaze


def _gaze_warnings(found: RecordingFiles) -> tuple[str, ...]:
    """Refuses gaze of the services that they call an error; gaze of the release itself has no such status."""
    status = found.path(layouts.GAZE_STATUS)
    return () if status is None else read_warnings(status)
