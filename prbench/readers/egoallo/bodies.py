"""The outputs of one recording as one body: read, checked against the recording, joined.

Sources: docs/specification/egoallo.md#files and docs/specification/egoallo.md#bad-input.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input, require
from prbench.geometry.timelines import covered
from prbench.readers.aria_mps.format import LONGEST_POSE_STEP
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.files import MODEL_ROLE, OUTPUT_ROLE
from prbench.readers.egoallo.to_recording import body_from_outputs
from prbench.readers.files import require_increasing
from prbench.readers.found import RecordingFiles
from prbench.recording import PoseStream
from prbench.representation.converters import RestJoints, read_rest_joints

HOW_TO_GET = (
    "Download the 'Extended SMPL+H model' (16 shape parameters) from https://mano.is.tue.mpg.de/ (free registration)"
    " and give its smplh/neutral/model.npz with --option smplh_model=FILE, in the environment variable"
    " PRBENCH_SMPLH_MODEL, or as smplh/neutral/model.npz below the dataset's root."
)
_AGAIN = "Delete it and run `prbench poses egoallo` again."
_ELSEWHERE = "Move it to the recording it was made from, or delete it and run `prbench poses egoallo` again."
_MARGIN = 1.0  # seconds
_SHAPES: dict[str, tuple[int | str, ...]] = {
    ego.WORLD_FROM_CPF: ("T", 7),
    ego.WORLD_FROM_ROOT: ("S", "T", 7),
    ego.BODY_QUATS: ("S", "T", ego.N_BODY_QUATS, 4),
    ego.BETAS: ("S", "T", ego.N_BETAS),
}


def read_smplh_rest(path: Path) -> RestJoints:
    """Read the rest joints of the model, linear in the shape; of its 52 joints the first 22.

    Raises:
        InputFileError: if the file is missing, damaged, or no SMPL-H model with 16 shapes.
    """
    rest = read_rest_joints(path, joints=ego.N_MODEL_JOINTS, how_to_get=HOW_TO_GET)
    shapes = rest.directions.shape[-1]
    expected = f"at least {ego.N_BETAS} shapes (SMPL-H, extended)"
    require(path, (shapes >= ego.N_BETAS, "shapedirs", expected, shapes, HOW_TO_GET))
    return rest


@foreign_input()
def read_output(path: Path) -> ego.EgoAlloOutput:
    """Read one output file.

    Raises:
        InputFileError: if the file is missing or no npz archive of plain arrays, or a key is missing, empty, of another
            shape than the others, or holds NaN, quaternions of another length than 1, or times that do not increase.
    """
    archive = Archive(path, remedy=f"The file may be truncated. {_AGAIN}")
    archive.require((ego.TIMES, *_SHAPES))
    arrays = archive.load((ego.TIMES, *_SHAPES))  # what else it holds is not even unpacked
    times = arrays.pop(ego.TIMES)
    if times.ndim != 1 or not np.issubdtype(times.dtype, np.integer):
        found = f"{times.dtype} {times.shape}"
        raise InputFileError(path, ego.TIMES, expected="integers (T,), nanoseconds", found=found, remedy=_AGAIN)
    root = arrays[ego.WORLD_FROM_ROOT]
    sizes = {"T": len(times), "S": len(root) if root.ndim == 3 else -1}
    for size, what in (("T", "frame"), ("S", "sample")):
        require(path, (sizes[size] != 0, "", f"at least one {what}", f"{size} = 0", _AGAIN))
    require_increasing(path, times, unit="ns", place=f"{ego.TIMES}, frame", first=0, remedy=_AGAIN)
    for key, form in _SHAPES.items():
        array = arrays[key]
        shape = tuple(size if isinstance(size, int) else sizes[size] for size in form)
        if array.shape != shape or not np.issubdtype(array.dtype, np.floating):
            expected = f"floats of the shape {shape} (as many frames as '{ego.TIMES}' and as many samples everywhere)"
            found = f"{array.dtype} {array.shape}"
            raise InputFileError(path, key, expected=expected, found=found, remedy=_AGAIN)
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            found = f"NaN or infinity in {len(bad)} places"
            raise InputFileError(path, f"{key}{bad[0].tolist()}", expected="finite numbers", found=found, remedy=_AGAIN)
        if key != ego.BETAS:
            length = np.linalg.norm(array[..., :4].astype(np.float64), axis=-1)
            worst = np.unravel_index(int(np.argmax(np.abs(length - 1))), length.shape)
            is_unit = abs(length[worst] - 1) <= ego.QUATERNION_TOLERANCE
            place = f"{key}{[int(index) for index in worst]}"
            require(path, (is_unit, place, "a quaternion of length 1", f"length {length[worst]:.4f}", _AGAIN))
        arrays[key] = array if array.dtype == np.float64 else array.astype(np.float32)
    return ego.EgoAlloOutput(path.name, times.astype(np.int64), *(arrays[key] for key in _SHAPES))


def read_own_output(path: Path, cpf: PoseStream) -> ego.EgoAlloOutput:
    """Read an output and refuse one of another recording: the head pose is an input of EgoAllo and must come back.

    The frames may not all lie outside of the recording's time, and the median distance may be 5 cm. No body model is
    needed.

    Args:
        path: The output.
        cpf: The recording's central pupil frame, in the world that the output is in, device seconds.

    Raises:
        InputFileError: if the output is damaged, or belongs to another recording.
    """
    output = read_output(path)
    times = output.time_ns / 1e9
    begin, end = cpf.times[[0, -1]]
    # The part of a trajectory that can matter for some times: a recording has hundreds of outputs to compare.
    first, last = np.searchsorted(cpf.times, [times[0] - _MARGIN, times[-1] + _MARGIN])
    rows = slice(max(int(first) - 1, 0), int(last) + 1)
    cpf = PoseStream(cpf.times[rows], cpf.position[rows], cpf.rotation[rows], cpf.valid[rows])
    posed = covered(cpf.times, cpf.valid, times, max_gap=LONGEST_POSE_STEP)
    is_within = ((times >= begin) & (times <= end)).any()
    expected = f"times of this recording, {begin:.3f} … {end:.3f} s on the device clock"
    found = f"{times[0]:.3f} … {times[-1]:.3f} s: the output belongs to another recording"
    require(path, (posed.any() or is_within, ego.TIMES, expected, found, _ELSEWHERE))
    if not posed.any():
        return output  # all of it lies in a gap of the trajectory: nothing tells, and its frames become invalid
    expected, _ = cpf.pose_at(times[posed])
    distance = float(np.median(np.linalg.norm(output.world_from_cpf[posed, 4:].astype(np.float64) - expected, axis=1)))
    expected = f"head poses of this recording at the same times, to {ego.LARGEST_CPF_ERROR * 100:.0f} cm"
    found = f"a median distance of {distance * 100:.1f} cm: the output belongs to another recording or world"
    require(path, (distance <= ego.LARGEST_CPF_ERROR, ego.WORLD_FROM_CPF, expected, found, _ELSEWHERE))
    return output


def read_bodies(found: RecordingFiles, *, cpf: PoseStream) -> ego.EgoAlloBody | None:
    """Read the body of one recording from its output files (:func:`find_outputs` put them into ``found``).

    Args:
        found: The recording's files.
        cpf: Poses of the glasses' central pupil frame in the *source* world (that of the trajectory which EgoAllo was
            given, Z up), times in device seconds.

    Returns:
        Joints in the source world, on the device clock; None where there are no outputs.

    Raises:
        InputFileError: if an output is damaged, or belongs to another recording; or if the body model is missing or
            damaged.
    """
    outputs = [read_own_output(file.path, cpf) for file in found.files if file.role.startswith(OUTPUT_ROLE)]
    model = body_model(found)
    return None if model is None else body_from_outputs(outputs, read_smplh_rest(model))


def body_model(found: RecordingFiles) -> Path | None:
    """Return the body model that the outputs of a recording need; None where there are no outputs.

    Raises:
        InputFileError: if there are outputs and no model.
    """
    if not any(file.role.startswith(OUTPUT_ROLE) for file in found.files):
        return None
    model = found.path(MODEL_ROLE)
    if model is None:
        expected = "the SMPL-H body model, from which joints are computed"
        raise InputFileError(found.folder, "", expected=expected, found="no model", remedy=HOW_TO_GET)
    return model
