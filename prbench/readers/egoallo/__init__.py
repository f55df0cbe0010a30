"""EgoAllo's output files as bodies, shared by the datasets without motion capture (docs/specification/egoallo.md).

A dataset's ``find`` adds :func:`find_outputs` to a recording's files; its ``read`` calls :func:`read_bodies` with the
head poses of the recording and gives what comes back to :func:`prbench.readers.egoallo.to_recording.body_stream`.
"""

from __future__ import annotations

from prbench.readers.egoallo.bodies import NO_OUTPUTS, check_output, read_bodies
from prbench.readers.egoallo.places import MODEL_ROLE, OUTPUT_ROLE, find_model, find_outputs, poses_folder

__all__ = [
    "MODEL_ROLE",
    "NO_OUTPUTS",
    "OUTPUT_ROLE",
    "check_output",
    "find_model",
    "find_outputs",
    "poses_folder",
    "read_bodies",
]
