"""Curation against truth: does it find the events that were acted out, when they happened, and their primes?"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prbench.curation import curate_recording
from prbench.curation.options import DEFAULTS, CurationOptions
from prbench.engine import Engine, InProcess
from prbench.manifests import load_manifest, load_protocol
from prbench.readers import reader_for
from prbench.readers.found import RecordingFiles
from prbench.sequences import EventRecord
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.performance import TrueEvent
from prbench.synthetic.truth_files import read_truth
from prbench.workflows.matching import Match, Verification, match_events, verification
from prbench.workflows.synthetic_table import Staging, World

_IN_PROCESS = InProcess()
_SLACK = 1e-4
"""Seconds by which clocks and rounding may move a sample."""


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

    def __call__(self, found: RecordingFiles) -> Sequence[EventRecord]:
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
    for row in read_truth(root, "events").to_pylist():
        event = TrueEvent(
            event_id=row["event_id"],
            action=row["kind"],
            tag=row["tag"],
            object_id=row["object_id"],
            object_name=row["object_name"],
            hand=row["hand"],
            contact_time=row["contact_s"],
            event_time=row["event_s"],
            release_time=row["release_s"],
            goal=np.array(row["goal"]),
            box_min=np.array(row["box_min"]),
            box_max=np.array(row["box_max"]),
            prime_planned=row["prime_planned_s"],
            prime_time=row["prime_s"],
            prime_first=row["prime_first_s"],
            prime_kind=row["prime_kind"],
            motor_start=row["motor_start_s"],
            reach_start=row["reach_start_s"],
            expected=row["expected"],
            thin=row["thin"],
        )
        events[row["recording_id"]].append(on_clock(event, offsets[row["recording_id"]]["objects"]))
    return events


def on_clock(event: TrueEvent, offset: float) -> TrueEvent:
    """The event with all its times moved by ``offset`` seconds."""

    def moved(time: float | None) -> float | None:
        return None if time is None else time + offset

    return dataclasses.replace(
        event,
        contact_time=event.contact_time + offset,
        event_time=event.event_time + offset,
        release_time=event.release_time + offset,
        motor_start=event.motor_start + offset,
        reach_start=event.reach_start + offset,
        prime_planned=moved(event.prime_planned),
        prime_time=moved(event.prime_time),
        prime_first=moved(event.prime_first),
        lost_span=None if event.lost_span is None else (event.lost_span[0] + offset, event.lost_span[1] + offset),
    )


@dataclass(frozen=True)
class Limit:
    """One line of the verdict: a number, and what it must reach."""

    name: str
    value: float
    bound: float
    at_least: bool

    @property
    def holds(self) -> bool:
        """Return True if the number is on the right side of its bound; a number without sample counts as right."""
        return bool(np.isnan(self.value)) or (self.value >= self.bound if self.at_least else self.value <= self.bound)


def limits(level: SensorLevel, result: Verification, *, preset: str = "adt") -> list[Limit]:
    """The limits asserted at this level; periods are those of the dataset.

    Source: docs/specification/synthetic-recordings.md#truth-record.
    """
    rates = load_manifest(preset).rates_hz
    objects, gaze = (1.0 / rates.get(stream, 30.0) for stream in ("objects", "gaze"))
    if level.noise == 0:
        return [
            Limit("recall", result.recall, 1.0, at_least=True),
            Limit("precision", result.precision, 1.0, at_least=True),
            Limit("largest timing error, s", result.timing.largest, 2 * objects, at_least=False),
            Limit("priming recall", result.priming_recall, 1.0, at_least=True),
            Limit("largest prime time error, s", result.prime_first.largest, gaze + _SLACK, at_least=False),
        ]
    share = 0.95 if level.noise <= 1 else 0.90
    detection = [
        Limit("recall", result.recall, share, at_least=True),
        Limit("precision", result.precision, share, at_least=True),
    ]
    if level.noise > 1:
        return detection
    return [
        *detection,
        Limit("median timing error, s", result.timing.median, 0.05, at_least=False),
        Limit("priming recall", result.priming_recall, 0.97, at_least=True),
        Limit("false primes", result.false_primes, 0.06, at_least=False),
        Limit("median prime time error, s", result.prime.median, 0.08, at_least=False),
    ]
