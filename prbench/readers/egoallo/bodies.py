"""The outputs of one recording as one body: read, checked against the recording, joined."""

from __future__ import annotations

import numpy as np

from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.belonging import require_belongs
from prbench.readers.egoallo.joints import read_window
from prbench.readers.egoallo.places import MODEL_ROLE, OUTPUT_ROLE
from prbench.readers.egoallo.to_recording import NO_OUTPUTS, joined_windows
from prbench.readers.found import RecordingFiles
from prbench.recording.streams import PoseStream
from prbench.skeleton import Joint

__all__ = ["NO_OUTPUTS", "read_bodies"]


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
        require_belongs(path, window.time_ns, points, cpf, exact=head is not None)
        windows.append(window)
    return joined_windows(windows)
