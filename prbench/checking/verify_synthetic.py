"""Curation against truth: does it find the events that were acted out, when they happened, and their primes?"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prbench.checking.matching import Match, Verification, match_events, verification
from prbench.curation import curate_recording
from prbench.curation.options import DEFAULTS, CurationOptions
from prbench.engine import Engine, InProcess
from prbench.harness.synthetic_table import Staging, World
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.readers import reader_for
from prbench.readers.found import RecordingFiles
from prbench.sequences import Event
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.performance import TrueEvent
from prbench.synthetic.write_tree import read_truth

_IN_PROCESS = InProcess()
_TIMES = {
    "contact_s": "contact_time",
    "event_s": "event_time",
    "release_s": "release_time",
    "motor_start_s": "motor_start",
    "reach_start_s": "reach_start",
    "prime_planned_s": "prime_planned",
    "prime_s": "prime_time",
    "prime_first_s": "prime_first",
}
"""Maps the columns of the truth record that hold times to the fields of an event."""


@dataclass(frozen=True)
class SensorLevel:
    """One of the conditions under which curation is checked."""

    name: str
    noise: float
    provoked: bool
    """True if provocations are on, at their default share (docs/specification/synthetic-recordings.md#provocations)."""


LEVELS = (
    SensorLevel("ideal sensors", 0.0, provoked=False),
    SensorLevel("default noise", 1.0, provoked=False),
    SensorLevel("default noise, provocations", 1.0, provoked=True),
    SensorLevel("twice the noise, provocations", 2.0, provoked=True),
)


def verify_level(
    level: SensorLevel,
    *,
    preset: str = "adt",
    recordings: int = 20,
    seed: int = 0,
    world: World = "default",
    n_events: int = 10,
    engine: Engine = _IN_PROCESS,
) -> Verification:
    """Act out recordings, sense them, curate them, and compare with what was acted out."""
    staging = Staging(preset, seed, world, n_events, level.noise, None if level.provoked else ())
    matches = list(engine.map(StagedComparison(staging), range(recordings)))
    return verification([match for some in matches for match in some], recordings=recordings)


@dataclass(frozen=True)
class StagedComparison:
    """Matches of one recording, through the ``Recording`` exit."""

    staging: Staging
    options: CurationOptions = DEFAULTS

    def __call__(self, index: int) -> list[Match]:
        """Act out, sense, curate, match."""
        performance = self.staging.perform(index)
        recording = self.staging.sense(performance)
        curated = curate_recording(recording, load_manifest(self.staging.preset), load_protocol(), self.options)
        layout = layout_for(self.staging.preset)
        # Truth counts from the performance's first frame, curation from the clock of the glasses.
        offset = layout.clock_start(performance) - float(performance.times[0])
        true = [
            on_clock(dataclasses.replace(event, object_id=layout.object_id(event.object_id)), offset)
            for event in layout.events(performance)
        ]
        return match_events(true, curated.events)


def verify_tree(root: Path, *, dataset: str = "adt", engine: Engine = _IN_PROCESS) -> Verification:
    """Read and curate the native files of a synthetic tree, and compare with the truth beside them.

    Raises:
        InputFileError: if the tree holds no recordings or no truth.
    """
    truth = _read_true_events(root)
    found = [recording for recording in reader_for(dataset).find(root) if recording.recording_id in truth]
    curated = engine.map(NativeCuration(dataset), found)
    matches = [
        match
        for files, events in zip(found, curated, strict=True)
        for match in match_events(truth[files.recording_id], events)
    ]
    return verification(matches, recordings=len(found))


@dataclass(frozen=True)
class NativeCuration:
    """Events of one native recording."""

    dataset: str
    options: CurationOptions = DEFAULTS

    def __call__(self, found: RecordingFiles) -> Sequence[Event]:
        """Read and curate."""
        reader = reader_for(self.dataset)
        return curate_recording(reader.read(found), load_manifest(reader.dataset), load_protocol(), self.options).events


def _read_true_events(root: Path) -> dict[str, list[TrueEvent]]:
    """The true events of a synthetic tree by recording, times on the clock of its native files.

    Raises:
        InputFileError: if the tree has no truth, or one of an unknown version.
    """
    offsets = {row["recording_id"]: row["clock_offset_s"] for row in read_truth(root, "recordings").to_pylist()}
    events: dict[str, list[TrueEvent]] = {name: [] for name in offsets}
    rows: list[dict[str, Any]] = read_truth(root, "events").to_pylist()
    for row in rows:
        recording_id = row.pop("recording_id")
        values = {_TIMES.get(name, name): value for name, value in row.items()}
        values["action"] = values.pop("kind")
        values |= {name: np.array(values[name]) for name in ("goal", "box_min", "box_max")}
        events[recording_id].append(on_clock(TrueEvent(**values), offsets[recording_id]["objects"]))
    return events


def on_clock(event: TrueEvent, offset: float) -> TrueEvent:
    """The event with all its times moved by ``offset`` seconds."""
    times = {name: getattr(event, name) for name in _TIMES.values()}
    moved = {name: time + offset for name, time in times.items() if time is not None}
    if event.lost_span is not None:
        moved["lost_span"] = (event.lost_span[0] + offset, event.lost_span[1] + offset)
    return dataclasses.replace(event, **moved)
