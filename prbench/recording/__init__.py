"""``Recording`` and its streams: the one form that every reader yields and all of curation works on."""

from prbench.recording.streams import (
    AnnotatedEvent,
    BodyStream,
    GazeStream,
    HandStream,
    ObjectTrack,
    OtherPerson,
    PoseStream,
    PublishedPriming,
    Recording,
    UnreadableEntry,
    plausible_body_frames,
)
