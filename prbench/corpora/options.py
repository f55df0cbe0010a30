"""What a user may choose about a corpus; everything here is recorded in ``corpus.json``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from prbench.errors import UsageError
from prbench.manifests import load_protocol


@dataclass(frozen=True)
class CorpusOptions:
    """Choices about a whole build."""

    fps: float | None = None
    """Frames a second of the clips; None = the protocol's 20."""
    max_frames: int | None = None
    """Frames at which longer clips are cut; None = the manifest's longest clip."""
    recordings: str = "*"
    """Glob over recording ids."""
    limit: int | None = None
    """Only the first so many recordings, by name."""
    source: tuple[tuple[str, str], ...] = ()
    """Options of the corpus' own reader as name and value, sorted by name."""
    on_error: Literal["skip", "fail"] = "skip"
    """Whether a recording that cannot be read is reported while the others go on, or ends the build."""
    replace: bool = False
    """Replace a corpus that holds recordings which the new one lacks (:mod:`prbench.sequences.replacing`)."""

    def __post_init__(self) -> None:
        if self.max_frames is not None and self.max_frames < 2:
            raise UsageError(f"--max-frames must be at least 2, found {self.max_frames}.")
        if self.fps is not None and self.fps <= 0:
            raise UsageError(f"--fps must be greater than 0, found {self.fps}.")

    @property
    def rate(self) -> float:
        """Frames a second."""
        return load_protocol().fps if self.fps is None else self.fps


@dataclass(frozen=True)
class ClipLimits:
    """Lengths of clips, in frames of the corpus."""

    fps: float
    shortest: int
    longest: int

    @classmethod
    def of(cls, options: CorpusOptions, thresholds: dict[str, float]) -> ClipLimits:
        """From the options, else from the manifest: a longest clip of 12 s at 20 fps has 241 frames."""
        fps = options.rate
        longest = options.max_frames or int(thresholds["longest_clip"] * fps + 1e-6) + 1
        return cls(fps, int(thresholds["shortest_clip"] * fps + 1e-6), longest)
