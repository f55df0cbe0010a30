"""HD-EPIC: folders, keys, the video's clock, and the content of one video (docs/specification/hd-epic.md).

World: one a participant, metres, Z up. Times: seconds of the video in the annotations, device nanoseconds elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.readers.aria_mps.format import MpsReadings
from prbench.readers.egoallo.format import EgoAlloBody
from prbench.recording import UnreadableEntry

DATA_FOLDER = "HD-EPIC"
ANNOTATIONS_FOLDER = "hd-epic-annotations"
VIDEOS_FOLDER = "Videos"
MPS_FOLDER = "SLAM-and-Gaze"
MULTI_SLAM_FOLDER = "SLAM/multi"
OTHER_SLAM_FOLDER = "SLAM/other_aligned"
GAZE_FOLDER = "GAZE_HAND"
SLAM_MAP_FILE = "vrs_to_multi_slam.json"
TIME_SUFFIX = "_mp4_to_vrs_time_ns.csv"
LOG_SUFFIX = "_vrs_to_mp4_log.json"
MOVEMENTS_FOLDER = "scene-and-object-movements"
ASSOCIATIONS_FILE = "assoc_info.json"
MASKS_FILE = "mask_info.json"
PRIMING_FOLDERS = ("eye-gaze-priming", "eye_gaze_priming")  # Spellings of the annotation repository and of its README.
PRIMING_FILE = "priming_info.json"

MP4_TIME = "mp4_time_ns"
RELATIVE_TIME = "relative_vrs_device_time_ns"
DEVICE_TIME = "vrs_device_time_ns"

FPS = 30.0
IMAGE_SIZE = 1408  # Pixels, both ways.
FOCAL_LENGTH = 607.0  # Pixels, of the 1408 image.

NO_FIXTURE = "Null"
# Values of ``frame_primed`` that are no frames: tested in vain, never tested.
NOT_PRIMED = -1
EXCLUDED = -2


@dataclass(frozen=True)
class VideoClock:
    """Device time of every video frame; an image that is shown twice repeats its time, a skipped one leaves a jump."""

    device_ns: Int[np.ndarray, " frames"]

    def device_seconds(self, frames: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the device time of (fractions of) frames, seconds: linear between rows, by the frame rate beyond."""
        last = len(self.device_ns) - 1
        inside = np.clip(frames, 0, last)
        start = self.device_ns[0]
        since_start = np.interp(inside, np.arange(last + 1), (self.device_ns - start).astype(np.float64))
        return start / 1e9 + since_start / 1e9 + (frames - inside) / FPS

    def frames(self, device_seconds: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the frame numbers of device times; of a repeat the first one."""
        first = np.append(True, np.diff(self.device_ns) > 0)
        start = self.device_ns[0]
        since_start = (self.device_ns[first] - start).astype(np.float64)
        return np.interp((device_seconds - start / 1e9) * 1e9, since_start, np.flatnonzero(first))

    def covers(self, frames: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Return True where frames lie in the video as far as its rows go; half a frame beyond the ends does."""
        return (frames >= -0.5) & (frames <= len(self.device_ns) - 0.5)

    @property
    def repeats(self) -> int:
        """Count the frames whose image is that of the frame before."""
        return int((np.diff(self.device_ns) == 0).sum())

    @property
    def span(self) -> tuple[float, float]:
        """Return the device time of the first and the last frame, seconds."""
        return float(self.device_ns[0] / 1e9), float(self.device_ns[-1] / 1e9)


@dataclass(frozen=True)
class ObjectMask:
    """Sighting of an object in one frame.

    Attributes:
        location: A single point, world (Z up), metres; None where the file gives none.
        box_px: x min, y min, x max, y max in the 1408 image; None in readings, since curation does not use it.
        fixture: Fixture under it, for example ``P01_counter.001``; None for ``Null`` and in readings.
    """

    mask_id: str
    frame: int
    location: Float[np.ndarray, "3"] | None
    box_px: Float[np.ndarray, "4"] | None = None
    fixture: str | None = None


@dataclass(frozen=True)
class ObjectTrack:
    """One movement: lifted at ``start``, released at ``end``.

    Attributes:
        object_id: Key of the association: one object in one video.
        start: Seconds of the video, not on the grid of its frames.
        masks: Masks in the order of the file, which says nothing.
    """

    track_id: str
    object_id: str
    name: str
    start: float
    end: float
    masks: tuple[ObjectMask, ...]


@dataclass(frozen=True)
class PublishedSide:
    """Result of the dataset's own pipeline for one start or end of a movement.

    Attributes:
        key: Object id in the priming file and ``start`` or ``end``.
        location: World (Z up), metres; None where the file gives none.
        frame_primed: Frame of the video; -1 tested and not primed, -2 never tested.
    """

    key: str
    is_start: bool
    frame: int
    location: Float[np.ndarray, "3"] | None
    frame_primed: int


@dataclass(frozen=True)
class HdEpicReadings:
    """All that curation needs of one video.

    Attributes:
        participant_id: Name of the folder that the video lies in; all videos of one participant share a kitchen and a
            world.
        priming: None where the dataset's priming file is not there.
        glasses: None where the annotations are read alone.
    """

    video: str
    participant_id: str
    clock: VideoClock
    tracks: tuple[ObjectTrack, ...]
    priming: tuple[PublishedSide, ...] | None
    glasses: MpsReadings | None
    body: EgoAlloBody | None
    messages: tuple[str, ...] = ()
    unreadable: tuple[UnreadableEntry, ...] = ()
