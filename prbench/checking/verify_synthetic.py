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
from prbench.engine import Engine, InProcess
from prbench.harness.synthetic_table import Staging
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.readers import reader_for
from prbench.readers.found import RecordingFiles
from prbench.sequences import Event
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.performance import Performance, TrueEvent
from prbench.synthetic.write_tree import read_truth

_LARGEST_DIFFERENCE = 0.5
"""Seconds between a found and a true event that may be the same."""
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
        return "not_an_event" if self.true is None else self.true.expected

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
class Verification:
    """Comparison of what curation found with what was acted out.

    Events that are ``thin``, and those around which the object was not tracked, are left out of every number but their
    own count and the hands.
    """

    recordings: int
    """Number of recordings."""
    true_events: int
    """Number of events that were acted out."""
    thin: int
    """Number of events within the sensors' resolution of a threshold."""
    recall: float
    """Share of the true events that were found."""
    precision: float
    """Share of the found events that are true."""
    timing: Spread
    """Found minus true event time, seconds."""
    priming_recall: float
    """Share of the matched events with a true prime that were primed."""
    false_primes: float
    """Share of the matched events without a true prime that were primed all the same."""
    prime: Spread
    """Found minus true prime time (first look of at least 50 ms), seconds."""
    prime_first: Spread
    """Found minus true first instant of looking there at all, seconds."""
    hands: dict[str, int]
    """Counts of located events by the hand that they name: ``right``, ``wrong`` or ``unknown``."""
    expected_sequences: int
    """Number of sequences that were acted out."""
    missed_sequences: tuple[str, ...]
    """Id and outcome of those of the expected ones that did not become sequences."""


def verification(matches: Sequence[Match], *, recordings: int) -> Verification:
    """Summarise the matches of some recordings."""
    # Thin events lie so close to a threshold that sensor noise decides them; nothing is asserted about these.
    counted = [m for m in matches if m.true is None or not (m.true.thin or m.true.tag == "lost")]
    real = [m for m in counted if m.true is not None and m.expected != "not_an_event"]
    found = [m for m in counted if m.found is not None]
    pairs = [(m.true, m.found) for m in real if m.true is not None and m.found is not None]
    judged = [(t, f) for t, f in pairs if f.stage in PRIMED_STAGES]
    primed = [f.prime_time is not None for t, f in judged if t.prime_time is not None]
    unprimed = [f.prime_time is not None for t, f in judged if t.prime_time is None]
    errors = [f.prime_time - t.prime_time for t, f in judged if f.prime_time is not None and t.prime_time is not None]
    late = [f.prime_time - t.prime_first for t, f in pairs if f.prime_time is not None and t.prime_first is not None]
    # The hands of all the wearer's events at a known place: being thin says nothing of the hand.
    hands = Counter({"right": 0, "wrong": 0, "unknown": 0})
    for m in matches:
        if m.true is None or m.found is None or m.found.location is None or m.found.outcome == "other_wearer":
            continue
        named = "right" if m.found.hand == m.true.hand else "wrong"
        hands["unknown" if m.found.hand is None else named] += 1
    expected = [m for m in real if m.expected == "sequence"]
    return Verification(
        recordings=recordings,
        true_events=len(real),
        thin=sum(m.true is not None and m.true.thin for m in matches),
        recall=_share(len(pairs), len(real)),
        precision=_share(len(pairs), len(found)),
        timing=Spread.of(f.event_time - t.event_time for t, f in pairs),
        priming_recall=_share(sum(primed), len(primed)),
        false_primes=_share(sum(unprimed), len(unprimed), empty=0.0),
        prime=Spread.of(errors),
        prime_first=Spread.of(late),
        hands=dict(hands),
        expected_sequences=len(expected),
        missed_sequences=tuple(
            f"{m.true.event_id} ({m.true.action}): {m.outcome}"
            for m in expected
            if m.true is not None and m.outcome != "sequence"
        ),
    )


def _share(part: int, whole: int, *, empty: float = 1.0) -> float:
    return part / whole if whole else empty


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


def staged_matches(staging: Staging, index: int) -> list[Match]:
    """Act out, sense and curate one recording in memory, and match what was found with what was acted out."""
    performance = staging.perform(index)
    recording = staging.sense(performance)
    curated = curate_recording(recording, load_manifest(staging.preset), load_protocol())
    return match_events(true_events(staging.preset, performance), curated.events)


def true_events(preset: str, performance: Performance) -> list[TrueEvent]:
    """Return the events of a performance as a layout names them, times on the recording's clock."""
    layout = layout_for(preset)
    # Truth counts from the performance's first frame, curation from the clock of the glasses.
    offset = layout.clock_start(performance) - float(performance.times[0])
    named = [dataclasses.replace(e, object_id=layout.object_id(e.object_id)) for e in layout.events(performance)]
    return [_on_clock(event, offset) for event in named]


def verify_tree(root: Path, *, dataset: str = "adt", engine: Engine = _IN_PROCESS) -> Verification:
    """Read and curate the native files of a synthetic tree, and compare with the truth beside them.

    Raises:
        InputFileError: if the tree holds no recordings, no truth, or one of an unknown version.
    """
    offsets = {row["recording_id"]: row["clock_offset_s"] for row in read_truth(root, "recordings").to_pylist()}
    truth: dict[str, list[TrueEvent]] = {name: [] for name in offsets}
    rows: list[dict[str, Any]] = read_truth(root, "events").to_pylist()
    for row in rows:
        recording_id = row.pop("recording_id")
        values = {_TIMES.get(name, name): value for name, value in row.items()}
        values["action"] = values.pop("kind")
        values |= {name: np.array(values[name]) for name in ("goal", "box_min", "box_max")}
        # Truth counts from the performance's first frame; the native files have clocks of their own.
        truth[recording_id].append(_on_clock(TrueEvent(**values), offsets[recording_id]["objects"]))
    found = [recording for recording in reader_for(dataset).find(root) if recording.recording_id in truth]
    matches: list[Match] = []
    for files, events in zip(found, engine.map(NativeCuration(dataset), found), strict=True):
        matches += match_events(truth[files.recording_id], events)
    return verification(matches, recordings=len(found))


@dataclass(frozen=True)
class NativeCuration:
    """Events of one native recording."""

    dataset: str

    def __call__(self, found: RecordingFiles) -> Sequence[Event]:
        """Read and curate."""
        reader = reader_for(self.dataset)
        return curate_recording(reader.read(found), load_manifest(reader.dataset), load_protocol()).events


def _on_clock(event: TrueEvent, offset: float) -> TrueEvent:
    """The event with all its times moved by ``offset`` seconds."""
    times = {name: getattr(event, name) for name in _TIMES.values()}
    moved = {name: time + offset for name, time in times.items() if time is not None}
    if event.lost_span is not None:
        moved["lost_span"] = (event.lost_span[0] + offset, event.lost_span[1] + offset)
    return dataclasses.replace(event, **moved)
