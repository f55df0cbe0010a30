"""The files of one HOT3D recording → :class:`prbench.readers.hot3d.format.Hot3dReadings`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.readers.aria_mps.readings import read_mps
from prbench.readers.aria_mps.to_recording import mps_streams
from prbench.readers.egoallo.bodies import read_bodies
from prbench.readers.egoallo.to_recording import NO_OUTPUTS
from prbench.readers.files import decode_json, read_columns
from prbench.readers.found import RecordingFiles
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import layout
from prbench.readers.hot3d.hands_mano import read_mano_hands
from prbench.readers.hot3d.hands_umetrack import read_profile, read_umetrack
from prbench.readers.hot3d.layout import MASK_PREFIX, Hot3dOptions
from prbench.readers.hot3d.objects import read_headset, read_objects

_TRUTH = {"True": True, "False": False, "true": True, "false": False, "1": True, "0": False}
_DEFAULTS = Hot3dOptions()


def read_readings(found: RecordingFiles, options: Hot3dOptions = _DEFAULTS) -> hot3d.Hot3dReadings:
    """Read all that curation needs of one recording.

    Raises:
        InputFileError: for a missing or damaged file, or a world that is not Z up.
        RecordingUnusable: for a recording of Quest 3, or without ground truth.
    """
    participant_id = _read_identity(found)
    objects, remarks = read_objects(found)
    headset = read_headset(found.require(layout.HEADSET, hot3d.HEADSET_FILE))
    hands, hand_remarks = read_umetrack(found.require(layout.UMETRACK, hot3d.UMETRACK_FILE))
    profile = found.path(layout.PROFILE)
    mano_hands, mano_remarks = read_mano_hands(found, options.mano_models) if options.hands == "mano" else (None, ())
    masks = _read_masks(found)
    mps = read_mps(found, thin=False)
    _require_z_up(found, mps.trajectory.up)
    body = read_bodies(found, cpf=mps_streams(mps, world_from_source=np.eye(4)).head)
    return hot3d.Hot3dReadings(
        recording_id=found.recording_id,
        participant_id=participant_id,
        headset=headset,
        objects=objects,
        hands=hands,
        hand_model=None if profile is None else read_profile(profile),
        masks=masks,
        mps=mps,
        body=body,
        mano_hands=mano_hands,
        messages=(*remarks, *hand_remarks, *mano_remarks, *(() if body is not None else (NO_OUTPUTS,))),
    )


def _read_identity(found: RecordingFiles) -> str:
    """The participant, if the recording can be used."""
    path = found.require(layout.METADATA, hot3d.METADATA_FILE)
    metadata = decode_json(path, layout.METADATA_DECODER)
    found.require_usable(layout.why_unusable(metadata))
    return metadata.participant_id


def _read_masks(found: RecordingFiles) -> dict[hot3d.MaskName, hot3d.MaskRows]:
    """Those masks that curation honours and the recording has.

    Raises:
        InputFileError: for a damaged file.
    """
    masks: dict[hot3d.MaskName, hot3d.MaskRows] = {}
    for name in hot3d.MASK_NAMES:
        path = found.path(f"{MASK_PREFIX}{name}")
        if path is not None:
            masks[name] = read_mask(path)
    return masks


def read_mask(path: Path) -> hot3d.MaskRows:
    """One mask of the RGB stream, in the order of time.

    Raises:
        InputFileError: if the file or a column is missing, or a value is neither True nor False.
    """
    table = read_columns(path, {hot3d.TIME: int, hot3d.STREAM: str, hot3d.MASK: str})
    values = table[hot3d.MASK].to_numpy()
    streams = table[hot3d.STREAM].to_numpy()
    unknown = np.flatnonzero(~np.isin(values, list(_TRUTH)))
    if len(unknown):
        row = int(unknown[0])
        raise InputFileError(path, f"line {row + 2}", expected="True or False", found=f"'{values[row]}'")
    rgb = streams == hot3d.RGB_STREAM
    time_ns, first = np.unique(table[hot3d.TIME].to_numpy()[rgb], return_index=True)
    return hot3d.MaskRows(time_ns, np.isin(values[rgb], [text for text, good in _TRUTH.items() if good])[first])


def _require_z_up(found: RecordingFiles, up: np.ndarray) -> None:
    if np.linalg.norm(up - np.array([0.0, 0.0, 1.0])) > 1e-3:
        raise InputFileError(
            found.folder / hot3d.MPS_FOLDER,
            "gravity columns of the trajectory",
            expected="gravity along -Z (HOT3D's world is Z up)",
            found=f"up = {(np.round(up, 3) + 0.0).tolist()}",
            remedy="This trajectory belongs to another dataset; download the recording's own.",
        )
