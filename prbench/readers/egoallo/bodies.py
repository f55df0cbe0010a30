"""The outputs of one recording as one body: read, checked against the recording, joined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError
from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import covered
from prbench.readers.aria_mps.format import LONGEST_POSE_STEP
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.joints import read_window
from prbench.readers.egoallo.outputs import JointsOnly, read_output
from prbench.readers.egoallo.places import MODEL_ROLE, OUTPUT_ROLE
from prbench.readers.egoallo.to_recording import joined_windows
from prbench.readers.found import RecordingFiles
from prbench.recording.streams import PoseStream

_MARGIN = 1.0  # seconds
_REMEDY = "Move it to the recording it was made from, or delete it and run `prbench poses egoallo` again."


def check_output(path: Path, cpf: PoseStream) -> Int[np.ndarray, " t"]:
    """Read an output and check that it belongs to a recording; no body model is needed.

    Args:
        path: The output.
        cpf: See :func:`_require_belongs`.

    Returns:
        Its times, nanoseconds on the device clock.

    Raises:
        InputFileError: if the output is damaged, or belongs to another recording.
    """
    output = read_output(path)
    if isinstance(output, JointsOnly):
        _require_belongs(path, output.time_ns, output.joints[:, Joint.HEAD].astype(np.float64), cpf, exact=False)
    else:
        _require_belongs(path, output.time_ns, output.world_from_cpf[:, 4:].astype(np.float64), cpf, exact=True)
    return output.time_ns


def _require_belongs(
    path: Path, time_ns: Int[np.ndarray, " t"], points: Float[np.ndarray, "t 3"], cpf: PoseStream, *, exact: bool
) -> None:
    """Refuse an output of another recording: the head pose is an input of EgoAllo and must come back.

    Args:
        path: The output, for the message.
        time_ns: Its times on the device clock.
        points: The central pupil frame in the output, or its head joint.
        cpf: The recording's central pupil frame, in the world that the output is in, device seconds.
        exact: Whether ``points`` are the central pupil frame; the limit for head joints is wider.

    Raises:
        InputFileError: if no frame falls into the recording's time, or the median distance is above 5 cm.
    """
    times = time_ns / 1e9
    whole = cpf
    cpf = _around(cpf, times)
    posed = covered(cpf.times, cpf.valid, times, max_gap=LONGEST_POSE_STEP)
    during = (times >= whole.times[0]) & (times <= whole.times[-1])
    if during.any() and not posed.any():
        return  # all of it lies in a gap of the trajectory: nothing tells, and its frames become invalid
    if not posed.any():
        raise InputFileError(
            path,
            ego.TIMES,
            expected=f"times of this recording, {whole.times[0]:.3f} … {whole.times[-1]:.3f} s on the device clock",
            found=f"{times[0]:.3f} … {times[-1]:.3f} s: the output belongs to another recording",
            remedy=_REMEDY,
        )
    expected, _ = cpf.pose_at(times[posed])
    limit = ego.LARGEST_CPF_ERROR if exact else ego.LARGEST_HEAD_ERROR
    distance = float(np.median(np.linalg.norm(points[posed] - expected, axis=1)))
    if not distance <= limit:
        raise InputFileError(
            path,
            ego.WORLD_FROM_CPF if exact else ego.JOINTS,
            expected=f"head poses of this recording at the same times, to {limit * 100:.0f} cm",
            found=f"a median distance of {distance * 100:.1f} cm: the output belongs to another recording or world",
            remedy=_REMEDY,
        )


def _around(cpf: PoseStream, times: Float[np.ndarray, " t"]) -> PoseStream:
    """The part of a trajectory that can matter for some times: a recording has hundreds of outputs to compare."""
    first, last = np.searchsorted(cpf.times, [times[0] - _MARGIN, times[-1] + _MARGIN])
    rows = slice(max(int(first) - 1, 0), int(last) + 1)
    return PoseStream(cpf.times[rows], cpf.position[rows], cpf.rotation[rows], cpf.valid[rows])


def read_bodies(found: RecordingFiles, *, cpf: PoseStream) -> ego.EgoAlloBody | None:
    """The body of one recording from its output files (:func:`find_outputs` put them into ``found``).

    Args:
        found: The recording's files.
        cpf: Poses of the glasses' central pupil frame in the *source* world (that of the trajectory which EgoAllo was
            given, Z up), times in device seconds.

    Returns:
        Joints in the source world, on the device clock; None where there are no outputs.

    Raises:
        InputFileError: if an output is damaged, or belongs to another recording; or if joints must be computed and the
            body model is missing or damaged.
    """
    outputs = [file.path for file in found.files if file.role.startswith(OUTPUT_ROLE)]
    model = found.path(MODEL_ROLE)
    windows = []
    for path in outputs:
        window, head = read_window(path, model)
        points = window.joints[:, Joint.HEAD].astype(np.float64) if head is None else head
        _require_belongs(path, window.time_ns, points, cpf, exact=head is not None)
        windows.append(window)
    return joined_windows(windows)
