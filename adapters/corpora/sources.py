"""The options of a corpus build, and the sources of its recordings.

A new corpus is a new module with a ``CORPUS`` and one line here. All options are recorded in ``corpus.json``.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float

from prbench.curation.job import chosen_ids
from prbench.errors import PrbenchError, UsageError
from prbench.geometry.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.protocol.manifests import Manifest, load_manifest, load_protocol
from prbench.readers import ReaderOptions, described_options, parse_options
from prbench.sequences.corpus import Annotation, Clip
from prbench.sequences.sequence import FrameSource

CORPUS_MODULES = {name: f"prbench_adapters.corpora.{name}" for name in ("nymeria", "humanml3d", "synthetic")}


@dataclass(frozen=True)
class CorpusOptions:
    """Choices about a whole build.

    Attributes:
        fps: Frames a second of the clips; None = the protocol's 20.
        max_frames: Frames at which longer clips are cut; None = the manifest's longest clip.
        recordings: Glob over recording ids.
        limit: Only the first so many recordings, by name.
        source: Options of the corpus' own reader as name and value, sorted by name.
        on_error: ``skip`` reports a recording that cannot be read while the others go on, ``fail`` ends the build.
        replace: Replace a corpus that holds recordings which the new one lacks (:mod:`prbench.sequences.write`).
    """

    fps: float | None = None
    max_frames: int | None = None
    recordings: str = "*"
    limit: int | None = None
    source: tuple[tuple[str, str], ...] = ()
    on_error: Literal["skip", "fail"] = "skip"
    replace: bool = False

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


@dataclass(frozen=True)
class RecordingIdentity:
    """The identity of a recording, known before it is read.

    Attributes:
        dataset: Name that the clips will carry; ``synthetic-`` before it for synthetic people.
    """

    dataset: str
    recording_id: str
    participant_id: str
    split: str
    split_group: str


@dataclass(frozen=True)
class ReadRecording:
    """The result of reading one recording.

    Attributes:
        duration: Seconds of usable motion.
        clock_method: Method that brought text and motion onto one clock; ``same`` where they share one.
    """

    clips: tuple[Clip, ...]
    annotations: tuple[Annotation, ...]
    duration: float
    clock_method: str = "same"
    clock_quality: float | None = None
    message: str = ""
    measured: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class CorpusRecording:
    """One recording that can be read, here or in another process; instances are picklable.

    Attributes:
        root: The dataset's folder; None for what is generated.
        skip_reason: The reason why the recording must not be read; None for all that are fine.
        bytes_a_second: Rate of reading, measured on synthetic files with one core; for the dry run.
        table_share: Bytes of its rows, in the table and in the parts that the table is made from, a byte of input.
    """

    identity: RecordingIdentity
    limits: ClipLimits
    root: Path | None
    skip_reason: str | None
    bytes_a_second: ClassVar[float]
    table_share: ClassVar[float]

    @property
    def recording_id(self) -> str:
        """Name of the recording."""
        return self.identity.recording_id

    @property
    def split(self) -> str:
        """Its split; that of its person."""
        return self.identity.split

    @property
    def input_bytes(self) -> int:
        """Bytes of all input files."""
        raise NotImplementedError

    @property
    def cost(self) -> tuple[float, float]:
        """About what reading it takes: seconds, and bytes on the disk."""
        return self.input_bytes / self.bytes_a_second, self.input_bytes * self.table_share

    def input_digest(self) -> str:
        """Digest of everything that reading depends on, apart from the options."""
        raise NotImplementedError

    def read(self) -> ReadRecording:
        """Read it."""
        raise NotImplementedError

    def without_places(self, message: str) -> str:
        """Return a message without the dataset's folder and its parent: equal inputs give equal corpora anywhere."""
        if self.root is not None:
            root = self.root.expanduser().resolve()
            for folder in (root, root.parent):
                message = message.replace(f"{folder}{os.sep}", "")
        return message


# Name of recordings that are worked on and kept together, and they: tiny ones by the hundred, large ones alone.
RecordingGroup = tuple[str, tuple[CorpusRecording, ...]]


class Corpus:
    """One kind of corpus.

    Attributes:
        options: The corpus' own options.
        rates: Says which rates there are, for the message; :attr:`native_rate` must be a multiple of them.
    """

    name: str
    options: type[ReaderOptions] = ReaderOptions
    rates: str
    native_rate: float

    @property
    def manifest(self) -> Manifest | None:
        """Origin and licence; None for what prbench itself invents."""
        return load_manifest(self.name)

    def chosen(self, options: CorpusOptions) -> Any:
        """Return the corpus' own options.

        Raises:
            UsageError: for an option that it does not know.
        """
        return parse_options(self.options, dict(options.source), dataset=self.name)

    def limits(self, options: CorpusOptions) -> ClipLimits:
        """Lengths from the options, else from the manifest: a longest clip of 12 s at 20 fps has 241 frames.

        Raises:
            UsageError: for a rate that the corpus cannot give.
        """
        fps = options.rate
        if (self.native_rate / fps) % 1.0 > 1e-9:
            raise UsageError(f"--fps: {self.rates}, found {fps:g}.")
        thresholds = (self.manifest or load_manifest("nymeria")).thresholds
        longest = options.max_frames or int(thresholds["longest_clip"] * fps + 1e-6) + 1
        return ClipLimits(fps, int(thresholds["shortest_clip"] * fps + 1e-6), longest)

    def described(self, options: CorpusOptions) -> dict[str, str]:
        """Rate, lengths and the corpus' own options as text, without places of this machine.

        Raises:
            UsageError: for an option that it does not know, or a rate that it cannot give.
        """
        chosen = described_options(self.chosen(options))
        limits = self.limits(options)
        own = {f"reader.{name}": text for name, text in chosen.items()}
        return {"fps": f"{limits.fps:g}", "max_frames": str(limits.longest), **own}

    def find(self, root: Path | None, options: CorpusOptions) -> tuple[CorpusRecording, ...]:
        """Find all recordings below a folder.

        Raises:
            UsageError: for an option that the corpus does not know.
            InputFileError: if there is nothing to read.
        """
        raise NotImplementedError

    def group_of(self, recording_id: str) -> str:
        """Name of the group to which a recording belongs; by default it is worked on alone."""
        return recording_id


def corpus_for(name: str) -> Corpus:
    """Return the corpus of one name.

    Raises:
        UsageError: for an unknown one, naming those there are.
    """
    if name not in CORPUS_MODULES:
        raise UsageError(f"unknown corpus '{name}'; known ones are: {', '.join(CORPUS_MODULES)}.")
    return importlib.import_module(CORPUS_MODULES[name]).CORPUS


def find_groups(corpus: Corpus, root: Path | None, options: CorpusOptions) -> tuple[RecordingGroup, ...]:
    """Return the recordings that the options choose, in table order, by groups.

    Raises:
        InputFileError: if there is no recording, or none that matches the glob.
    """
    groups: dict[str, list[CorpusRecording]] = {}
    for recording in chosen_recordings(corpus.find(root, options), options, where=root or "invented people"):
        groups.setdefault(corpus.group_of(recording.identity.recording_id), []).append(recording)
    return tuple((name, tuple(members)) for name, members in groups.items())


def chosen_recordings(
    found: Sequence[CorpusRecording], options: CorpusOptions, *, where: Path | str
) -> list[CorpusRecording]:
    """Those whose names match the glob of the options, by name, as many as the options want.

    Raises:
        InputFileError: if there is none; ``where`` they were looked for begins the message.
    """
    by_name = {each.identity.recording_id: each for each in found}
    return [by_name[name] for name in chosen_ids(sorted(by_name), options.recordings, options.limit, where=where)]


def find_corpora(root: Path) -> tuple[tuple[str, Path, tuple[CorpusRecording, ...]], ...]:
    """Look for each corpus in the folder itself, and one folder below where there is nothing.

    Returns:
        The name under which each is built, its folder, and its recordings.
    """
    found = []
    below = sorted(entry for entry in root.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    for name in CORPUS_MODULES:
        if corpus_for(name).manifest is None:
            continue  # generated on the spot; no folder holds it
        for folder in (root, *below):
            try:
                recordings = corpus_for(name).find(folder, CorpusOptions())
            except PrbenchError:
                continue
            if recordings:
                found.append((name, folder, recordings))
                break
    return tuple(found)


def cut_clip(
    motion: Float[np.ndarray, "frames 22 3"],
    first: int,
    stride: int,
    n_frames: int,
    *,
    fps: float,
    start: float,
    **given: Any,
) -> Clip | None:
    """Every ``stride``-th frame from ``first`` on as a clip, in the canonical frame of the first of them.

    Args:
        motion: World frame, Y up, metres, without gaps.
        first: Index of the clip's first frame.
        stride: Frames of the motion for one of the clip.
        n_frames: Frames of the clip.
        fps: Their rate.
        start: Time of the first one, seconds on the motion's clock.
        given: The other columns of the clip.

    Returns:
        None if the first pose faces nowhere, so that no canonical frame exists.
    """
    taken = motion[first : first + stride * (n_frames - 1) + 1 : stride].astype(np.float64)
    try:
        world_from_canonical = canonical_frame(taken)
    except ValueError:
        return None
    before, previous_source = _neighbour(motion, first - stride, taken)
    # Turned round, the last two frames come first, and their speed is continued outwards.
    after, next_source = _neighbour(motion, first + stride * n_frames, taken[::-1])
    canonical_from_world = invert_rigid(world_from_canonical)
    return Clip(
        fps=fps,
        n_frames=n_frames,
        start_time=start,
        end_time=start + n_frames / fps,
        joints=transform_points(canonical_from_world, taken),
        previous_joints=transform_points(canonical_from_world, before),
        previous_source=previous_source,
        next_joints=transform_points(canonical_from_world, after),
        next_source=next_source,
        world_from_canonical=world_from_canonical,
        **given,
    )


def _neighbour(motion: np.ndarray, index: int, inwards: np.ndarray) -> tuple[np.ndarray, FrameSource]:
    """Return the frame just outside a clip: recorded, else continued with the speed of the two frames at that end."""
    if 0 <= index < len(motion):
        return motion[index].astype(np.float64), "recorded"
    return (inwards[0], "copied") if len(inwards) < 2 else (2 * inwards[0] - inwards[1], "extrapolated")
