"""Whether an output belongs to the recording it lies with (``formats/egoallo.md`` section 5)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.formats import egoallo as ego
from prbench.formats.aria_mps import LONGEST_POSE_STEP
from prbench.recording.streams import PoseStream
from prbench.skeleton import Joint
from prbench.timelines import covered, interpolate

_REMEDY = "Move it to the recording it was made from, or delete it and run `prbench poses egoallo` again."


def require_belongs(path: Path, window: ego.BodyWindow, head: Float[np.ndarray, "t 3"] | None, cpf: PoseStream) -> None:
    """Refuse an output of another recording: the head pose is an input of EgoAllo and must come back.

    Args:
        path: The output, for the message.
        window: Its frames.
        head: Central pupil frame in the output; None where the file holds joints only, whose head joint is then
            compared, with a wider limit.
        cpf: The recording's, in the world that the output is in, device seconds.

    Raises:
        InputFileError: if no frame falls into the tracked time, or the median distance is above 5 cm.
    """
    times = window.time_ns / 1e9
    posed = covered(cpf.times, cpf.valid, times, max_gap=LONGEST_POSE_STEP)
    if not posed.any():
        raise InputFileError(
            path,
            ego.TIMES,
            expected=f"times of this recording, {cpf.times[0]:.3f} … {cpf.times[-1]:.3f} s on the device clock",
            found=f"{times[0]:.3f} … {times[-1]:.3f} s: the output belongs to another recording",
            remedy=_REMEDY,
        )
    usable = cpf.valid if cpf.valid.any() else np.ones_like(cpf.valid)
    expected = interpolate(cpf.times[usable], cpf.position[usable], times[posed])
    points = window.joints[:, Joint.HEAD] if head is None else head
    limit = ego.LARGEST_HEAD_ERROR if head is None else ego.LARGEST_CPF_ERROR
    distance = float(np.median(np.linalg.norm(points[posed] - expected, axis=1)))
    if not distance <= limit:
        raise InputFileError(
            path,
            ego.JOINTS if head is None else ego.WORLD_FROM_CPF,
            expected=f"head poses of this recording at the same times, to {limit * 100:.0f} cm",
            found=f"a median distance of {distance * 100:.1f} cm: the output belongs to another recording or world",
            remedy=_REMEDY,
        )
