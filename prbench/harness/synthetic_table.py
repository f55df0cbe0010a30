"""Build a table of synthetic people without native files: performances, sensors, ``Recording``, curation."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from prbench.curation import BuildOptions, BuildReport, build_from_sources
from prbench.curation.options import NO_OPTIONS
from prbench.datasets import SECOND_WORLD_PREFIX, SYNTHETIC_PREFIX
from prbench.engine import IN_PROCESS, Engine
from prbench.errors import UsageError
from prbench.files.storage import text_digest
from prbench.recording import ObjectTrack, Recording
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.layouts import layout_for, synthetic_recording
from prbench.synthetic.people.perform import name_of_recording, perform
from prbench.synthetic.people.world import Source, Split, assign
from prbench.synthetic.performance import Performance, World

# Called with finished recordings, all of them, and the one that was finished last.
Progress = Callable[[int, int, str], None]
# Recordings a preset of size ``large`` (docs/specification/synthetic-recordings.md#determinism-splits-sizes).
LARGE_RECORDINGS = 480


@dataclass(frozen=True)
class Staging:
    """The settings of performances and sensors: everything that recordings depend on, apart from their index.

    Attributes:
        provocations: Share of the movements for each tag (docs/specification/synthetic-recordings.md#provocations);
            None = the default 10 % together, () = none.
    """

    preset: str
    seed: int
    world: World = "default"
    n_events: int = 10
    noise: float = 1.0
    provocations: tuple[tuple[str, float], ...] | None = None

    @property
    def dataset(self) -> str:
        """Never the dataset's own name; that of the second world stands apart from what may be learnt from."""
        return f"{SECOND_WORLD_PREFIX if self.world == 'second' else SYNTHETIC_PREFIX}{self.preset}"

    def perform(self, index: int) -> Performance:
        """Act out one recording."""
        shares = None if self.provocations is None else dict(self.provocations)
        staged = {name: getattr(self, name) for name in ("seed", "world", "n_events")}
        return perform(self.preset, index=index, provocations=shares, **staged)

    def sense(self, performance: Performance) -> Recording:
        """Return what the sensors measure of a performance, and the furniture even where no sensor tracks any."""
        recording = replace(synthetic_recording(performance, noise=self.noise), dataset=self.dataset)
        if not all(track.movable for track in recording.objects):
            return recording
        start = recording.span[0]
        furniture = tuple(
            # Worlds of synthetic recordings are those of their performances.
            ObjectTrack(
                **{name: getattr(piece, name) for name in ("object_id", "name", "category")},
                times=np.array([start]),
                position=piece.position[:1],
                rotation=piece.rotation[:1],
                valid=np.ones(1, dtype=bool),
                box_min=-piece.half_extents,
                box_max=piece.half_extents,
                movable=False,
            )
            for piece in performance.objects
            if not piece.movable
        )
        return replace(recording, furniture=furniture)

    def described(self) -> dict[str, str]:
        """Return the staging as text, as ``dataset.json`` holds it."""
        shares = (
            "default" if self.provocations is None else " ".join(f"{tag}={share}" for tag, share in self.provocations)
        )
        return {
            "synthetic_seed": str(self.seed),
            "synthetic_world": self.world,
            "synthetic_events": str(self.n_events),
            "synthetic_noise": str(self.noise),
            "synthetic_provocations": shares,
            "synthetic_generator": str(GENERATOR_VERSION),
        }


@dataclass(frozen=True)
class SyntheticSource:
    """One recording that is acted out when it is read (see :class:`prbench.curation.RecordingSource`)."""

    staging: Staging
    index: int
    recording_id: str
    split: str
    skip_reason: None = None

    @property
    def dataset(self) -> str:
        """Name under which the recording is kept."""
        return self.staging.dataset

    def input_digest(self) -> str:
        """Digest of everything that the recording is made from."""
        described = [text for item in sorted(self.staging.described().items()) for text in item]
        return text_digest(self.staging.preset, str(self.index), *described)

    def read(self) -> Recording:
        """Act it out and sense it."""
        return self.staging.sense(self.staging.perform(self.index))

    def without_places(self, message: str) -> str:
        """Nothing of this machine is in the messages."""
        return message


def build_synthetic_table(
    preset: str,
    recordings: int | Sequence[int],
    seed: int,
    out: Path,
    *,
    engine: Engine = IN_PROCESS,
    world: World = "default",
    n_events: int = 10,
    noise: float = 1.0,
    provocations: Mapping[str, float] | None = None,
    options: BuildOptions = NO_OPTIONS,
    progress: Progress | None = None,
) -> BuildReport:
    """Build the dataset ``synthetic-<preset>``; recording i depends on seed, preset, world and i alone.

    That of the second world is called ``synthetic-second-<preset>``.

    Args:
        preset: A preset with sensors (``adt``).
        recordings: How many, or the indices of chosen ones.
        seed: Seed of the whole dataset.
        out: Folder of the new dataset.
        engine: Processes or cluster that acts out and curates recordings.
        world: Which people and rooms exist (:func:`prbench.synthetic.people.perform`).
        n_events: Picks and puts a recording.
        noise: Multiplies every sensor error; 0 for ideal sensors.
        provocations: Share of the movements for each tag; None = 10 % together, {} = none.
        options: How to curate.
        progress: Called after each recording.

    Raises:
        UsageError: for a preset without sensors, or no recordings.
        StorageError: if ``out`` cannot be written or holds something else.
    """
    # Refuses a preset without sensors before anything is acted out.
    layout_for(preset)
    indices = range(recordings) if isinstance(recordings, int) else recordings
    if not indices:
        raise UsageError(f"a synthetic table needs at least one recording, not {recordings}.")
    # Sorted, because the digest of the inputs must not depend on the order in which a user names them.
    shares = None if provocations is None else tuple(sorted(provocations.items()))
    staging = Staging(preset, seed, world, n_events, noise, shares)
    shown = str(recordings) if isinstance(recordings, int) else " ".join(map(str, recordings))
    sources = [synthetic_source(staging, index) for index in indices]
    told = staging.described() | {"recordings": shown}
    return build_from_sources(sources, out, options=options, engine=engine, progress=progress, extra_options=told)


def recordings_of_people(preset: str, seed: int, people: Mapping[Split, int]) -> tuple[int, ...]:
    """Return the first recording of each of some people, in the order of the indices.

    Args:
        preset: The preset.
        seed: Seed of the whole dataset.
        people: How many people of each split; not more than the default world has.
    """
    source = Source(seed, preset, "default")
    found: dict[Split, set[int]] = {split: set() for split in people}
    chosen = []
    for index in itertools.count():
        if all(len(found[split]) == wanted for split, wanted in people.items()):
            break
        _, person, split = assign(source, index)
        known = found.get(split, set())
        if len(known) < people.get(split, 0) and person not in known:
            known.add(person)
            chosen.append(index)
    return tuple(chosen)


def synthetic_source(staging: Staging, index: int) -> SyntheticSource:
    """Return recording ``index`` by name and split, not yet acted out."""
    _, _, split = assign(Source(staging.seed, staging.preset, staging.world), index)
    return SyntheticSource(staging, index, name_of_recording(staging.preset, staging.seed, index), split)
