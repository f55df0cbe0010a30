"""The rules of the motion prediction benchmark as frozen data classes, read once from its ``protocol.toml``."""

from __future__ import annotations

from functools import cache
from typing import Literal

import msgspec

from prbench.protocol.manifests import digest_of, read_toml

# ``room``: the recording's world; ``last-pose``: last observed pelvis over the origin, facing +Z.
FrameName = Literal["room", "last-pose"]


class WindowRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How recordings are cut into windows; seconds and frames."""

    fps: float
    observed_frames: int
    future_frames: int
    stride: int
    largest_gaze_age: float
    largest_gap: float
    fewest_gaze_frames: int
    fewest_segment_gaze: float

    @property
    def length(self) -> int:
        """Frames of a window: observed and future ones."""
        return self.observed_frames + self.future_frames

    def at(self, fps: float) -> WindowRules:
        """Return the rules with the same durations at another rate; counts of frames are rounded."""
        factor = fps / self.fps
        counts = ("observed_frames", "future_frames", "stride", "fewest_gaze_frames")
        scaled = {name: round(getattr(self, name) * factor) for name in counts}
        return msgspec.structs.replace(self, fps=fps, **scaled)


class EvaluationRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is scored: numbers of samples, horizons in seconds, and the distance of similar pasts in metres.

    ``coefficients`` is the number with which the truncation floor is computed.
    """

    samples: tuple[int, ...]
    horizons: tuple[float, ...]
    similar_past: float
    coefficients: int
    frame: FrameName


class AnchoredRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Windows around the events of a prime-and-reach table; seconds."""

    leads: tuple[float, ...]
    shortest_future: float
    gaze_delay: float


class PublishedSplit(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Recordings of a dataset by the split of the published evaluation."""

    train: tuple[str, ...]
    test: tuple[str, ...]

    def of(self, recording_id: str) -> str:
        """``train``, ``test``, or ``unused``."""
        if recording_id in self.train:
            return "train"
        return "test" if recording_id in self.test else "unused"


class PredictionProtocol(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One version of the benchmark's rules."""

    version: int
    conditions: tuple[str, ...]
    windows: WindowRules
    evaluation: EvaluationRules
    anchored: AnchoredRules
    published_splits: dict[str, PublishedSplit]

    @property
    def digest(self) -> str:
        """SHA-256 of the values; equal rules have equal digests, however the file is laid out."""
        return digest_of(self)


@cache
def load_prediction_protocol() -> PredictionProtocol:
    """Return the protocol of the motion prediction benchmark."""
    return read_toml("prbench_benchmarks.motion_prediction", "protocol.toml", PredictionProtocol)
