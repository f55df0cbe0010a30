"""``Recording`` and its streams: the one form that every reader yields and all of curation works on."""

from prbench.recording.body_quality import plausible_body_frames
from prbench.recording.streams import (
    AnnotatedEvent,
    BodyStream,
    GazeStream,
    HandStream,
    ObjectTrack,
    Occluder,
    OtherPerson,
    PoseStream,
    PublishedPriming,
    Recording,
)

__all__ = [
    "AnnotatedEvent",
    "BodyStream",
    "GazeStream",
    "HandStream",
    "ObjectTrack",
    "Occluder",
    "OtherPerson",
    "PoseStream",
    "PublishedPriming",
    "Recording",
    "plausible_body_frames",
]
