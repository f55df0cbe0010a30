"""``Recording`` and its streams: the one form that every reader yields and all of curation works on."""

from prbench.recording.body_quality import plausible_body_frames
from prbench.recording.streams import (
    AnnotatedEvent,
    BodyStream,
    GazeStream,
    HandStream,
    ObjectTrack,
    OtherPerson,
    PoseStream,
    Recording,
)

__all__ = [
    "AnnotatedEvent",
    "BodyStream",
    "GazeStream",
    "HandStream",
    "ObjectTrack",
    "OtherPerson",
    "PoseStream",
    "Recording",
    "plausible_body_frames",
]
