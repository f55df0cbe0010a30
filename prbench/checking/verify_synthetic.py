"""Compare what curation finds in synthetic recordings with the truth that they were made from."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prbench.curation import curate_recording
from prbench.curation.options import DEFAULTS, CurationOptions
from prbench.engine import Engine, InProcess
from prbench.harness.synthetic_table import Staging, World
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.readers import reader_for
from prbench.readers.found import RecordingFiles
from prbench.recording.streams import LEAST_DIFFERENCE
from prbench.sequences import Event
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.performance import TrueEvent
from prbench.synthetic.write_tree import read_truth

_LARGEST_DIFFERENCE = 0.5
"""Seconds between a found and a true event that may be the same."""
_NOT_AN_EVENT = "not_an_event"
_LOST = "lost"
_SEQUENCE = "sequence"
PRIMED_STAGES = ("priming", "clipping", "body", "filters")
"""Stages at which it is known whether an event was primed."""


@dataclass(frozen=True)
class Match:
    """One true event beside the found one; either may be missing."""

    true: TrueEvent | None
    """Times on the recording's clock."""
    found: Event | None

    @property
    def expected(self) -> str:
        """The outcome that curation should have reached."""
        return _NOT_AN_EVENT if self.true is None else self.true.expected

    @property
    def outcome(self) -> str:
        """The outcome that curation reached."""
        return "not_found" if self.found is None else self.found.outcome


def match_events(true: Sequence[TrueEvent], found: Sequence[Event]) -> list[Match]:
    """Pair the events of one recording one to one: same object and action, least time difference first, ≤ 0.5 s.

    Args:
        true: Times on the recording's clock.
        found: What curation says.

    Returns:
        Every true and every found event exactly once.
    """
    if not true or not found:
        return [Match(event, None) for event in true] + [Match(None, event) for event in found]
    difference = np.abs(np.subtract.outer([t.event_time for t in true], [f.event_time for f in found]))
    same = np.array([[t.object_id == f.object_id and t.action == f.action for f in found] for t in true])
    rows, columns = np.nonzero(same & (difference <= _LARGEST_DIFFERENCE))
    partner: dict[int, int] = {}
    taken: set[int] = set()
    # A stable sort, so that ties are resolved by the order of the events on every machine.
    for index in np.argsort(difference[rows, columns], kind="stable"):
        row = int(rows[index])
        column = int(columns[index])
        if row not in partner and column not in taken:
            partner[row] = column
            taken.add(column)
    matches = [Match(event, found[partner[row]] if row in partner else None) for row, event in enumerate(true)]
    return matches + [Match(None, event) for column, event in enumerate(found) if column not in taken]


@dataclass(frozen=True)
class Spread:
    """A sample of differences, summarised; NaN for an empty one."""

    n: int
    """Size of the sample."""
    bias: float
    """Mean."""
    median: float
    """Median of the absolute values."""
    p95: float
    """95th percentile of the absolute values."""
    largest: float
    """Largest absolute value."""

    @classmethod
    def of(cls, values: Iterable[float]) -> Spread:
        """Summarise signed differences."""
        sample = np.array(list(values), dtype=np.float64)
        if len(sample) == 0:
            return cls(0, *(float("nan"),) * 4)
        size = np.abs(sample)
        return cls(
            len(sample), float(sample.mean()), float(np.median(size)), float(np.quantile(size, 0.95)), float(size.max())
        )


@dataclass(frozen=True)
class HandCounts:
    """Counts of located events by the hand that they name."""

    right: int
    """With the hand that acted."""
    wrong: int
    """With the other hand."""
    unknown: int
    """Without a hand."""
    contradicted: int
    """Events of which the table's own wrists say that the other hand was nearer."""


@dataclass(frozen=True)
class Miss:
    """An event that should have become a sequence and did not: which stage said no, and by which number."""

    event_id: str
    """The true event that curation missed."""
    action: str
    """``pick`` or ``put``."""
    outcome: str
    """What it became."""
    stage: str
    """Stage that decided; empty for an event that was not found at all."""
    value: float | None
    """The number by which it decided."""
    threshold: float | None
    """What that number was compared with."""

    @property
    def text(self) -> str:
        """One line for a terminal."""
        decided = f" at {self.stage}" if self.stage else ""
        numbers = "" if self.value is None or self.threshold is None else f": {self.value:.3f} / {self.threshold:.3f}"
        return f"{self.event_id} ({self.action}): {self.outcome}{decided}{numbers}"


@dataclass(frozen=True)
class Verification:
    """Comparison of what curation found with what was acted out.

    Events that are ``thin`` are left out of every number but their own count and the hands. Events that are tagged
    ``lost`` (not tracked around the event) are counted apart.
    """

    recordings: int
    """Number of recordings."""
    true_events: int
    """Number of events that were acted out."""
    found_events: int
    """Number of events that curation found."""
    matched: int
    """Number of true events that were found."""
    thin: int
    """Number of events within the sensors' resolution of a threshold."""
    thin_missed: int
    """Number of those that were not found."""
    recall: float
    """Share of the true events that were found."""
    precision: float
    """Share of the found events that are true."""
    timing: Spread
    """Found minus true event time, seconds."""
    location: Spread
    """Distance between found and true goal, metres."""
    priming_recall: float
    """Share of the matched events with a true prime that were primed."""
    false_primes: float
    """Share of the matched events without a true prime that were primed all the same."""
    unprimed: int
    """Number of events without a true prime."""
    prime: Spread
    """Found minus true prime time (first look of at least 50 ms), seconds."""
    prime_quantiles: tuple[float, float, float]
    """5th, 50th and 95th percentile of the same."""
    prime_first: Spread
    """Found minus true first instant of looking there at all, seconds."""
    hands: HandCounts
    """Hands of all events that have a place."""
    expected_sequences: int
    """Number of sequences that were acted out."""
    missed_sequences: tuple[Miss, ...]
    """Those of the expected ones that did not become sequences."""
    lost: dict[str, int]
    """Count events around which the object was not tracked: found, reported or missed."""
    confusion: dict[str, int]
    """Events by ``expected → found`` outcome, ``lost`` and ``thin`` ones left out."""


def verification(matches: Sequence[Match], *, recordings: int) -> Verification:
    """Summarise the matches of some recordings."""
    # Thin events lie so close to a threshold that sensor noise decides them; nothing is asserted about these.
    thin = [m for m in matches if m.true is not None and m.true.thin]
    lost = [m for m in matches if m.true is not None and m.true.tag == _LOST]
    counted = [m for m in matches if m.true is None or not (m.true.thin or m.true.tag == _LOST)]
    real = [m for m in counted if m.expected != _NOT_AN_EVENT]
    found = [m for m in counted if m.found is not None]
    pairs = [(m.true, m.found) for m in real if m.true is not None and m.found is not None]
    primed = [(t, f) for t, f in pairs if f.stage in PRIMED_STAGES and t.prime_time is not None]
    unprimed = [(t, f) for t, f in pairs if f.stage in PRIMED_STAGES and t.prime_time is None]
    errors = [f.prime_time - t.prime_time for t, f in primed if f.prime_time is not None and t.prime_time is not None]
    late = [f.prime_time - t.prime_first for t, f in pairs if f.prime_time is not None and t.prime_first is not None]
    # Count what curation made of events that happened while tracking was lost.
    seen = [match.found for match in lost if match.found is not None]
    reported = sum(event.outcome == "tracking_lost" for event in seen)
    return Verification(
        recordings=recordings,
        true_events=len(real),
        found_events=len(found),
        matched=len(pairs),
        thin=len(thin),
        thin_missed=sum(m.found is None and m.expected != _NOT_AN_EVENT for m in thin),
        recall=_share(len(pairs), len(real)),
        precision=_share(len(pairs), len(found)),
        timing=Spread.of(f.event_time - t.event_time for t, f in pairs),
        location=Spread.of(float(np.linalg.norm(f.location - t.goal)) for t, f in pairs if f.location is not None),
        priming_recall=_share(sum(f.prime_time is not None for _, f in primed), len(primed)),
        false_primes=_share(sum(f.prime_time is not None for _, f in unprimed), len(unprimed), empty=0.0),
        unprimed=len(unprimed),
        prime=Spread.of(errors),
        prime_quantiles=_quantiles(errors),
        prime_first=Spread.of(late),
        hands=_hand_counts(matches),
        expected_sequences=sum(m.expected == _SEQUENCE for m in real),
        missed_sequences=tuple(
            Miss(
                event_id=m.true.event_id,
                action=m.true.action,
                outcome=m.outcome,
                stage="" if m.found is None else m.found.stage,
                value=None if m.found is None else m.found.value,
                threshold=None if m.found is None else m.found.threshold,
            )
            for m in real
            if m.true is not None and m.expected == _SEQUENCE and m.outcome != _SEQUENCE
        ),
        lost={"found": len(seen) - reported, "reported": reported, "missed": len(lost) - len(seen)},
        confusion=dict(sorted(Counter(f"{m.expected} → {m.outcome}" for m in counted).items())),
    )


def _hand_counts(matches: Sequence[Match]) -> HandCounts:
    """Count the hands of all the wearer's events at a known place: being ``thin`` says nothing of the hand."""
    pairs = [(m.true, m.found) for m in matches if m.true is not None and m.found is not None]
    located = [(t, f) for t, f in pairs if f.location is not None and f.outcome != "other_wearer"]
    return HandCounts(
        right=sum(f.hand == t.hand for t, f in located),
        wrong=sum(f.hand is not None and f.hand != t.hand for t, f in located),
        unknown=sum(f.hand is None for _, f in located),
        contradicted=sum(_is_contradicted(f) for _, f in located),
    )


def _is_contradicted(event: Event) -> bool:
    if event.hand is None or event.location is None or event.left_wrist is None or event.right_wrist is None:
        return False
    left, right = (float(np.linalg.norm(wrist - event.location)) for wrist in (event.left_wrist, event.right_wrist))
    # Hands that are about equally near contradict nothing: curation itself leaves those open.
    farther = left - right if event.hand == "left" else right - left
    return farther > LEAST_DIFFERENCE


def _share(part: int, whole: int, *, empty: float = 1.0) -> float:
    return part / whole if whole else empty


def _quantiles(values: Sequence[float]) -> tuple[float, float, float]:
    if not values:
        return float("nan"), float("nan"), float("nan")
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return float(low), float(middle), float(high)


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
