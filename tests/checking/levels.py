"""The levels of sensor noise at which curation is held against the synthetic truth, and what it must reach there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prbench.checking.hd_epic import PRIMED_STAGES, Spread
from prbench.curation import curate_recording
from prbench.harness.synthetic_table import Staging
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.readers import reader_for
from prbench.synthetic.performance import TrueEvent
from prbench.synthetic.write_tree import TIMES
from tests.checking.matching import Match, match_events, on_clock, true_events
from tests.synthetic.true_clips import read_truth

_SLACK = 1e-4  # Seconds by which clocks and rounding may move a sample


@dataclass(frozen=True)
class Verification:
    """Comparison of what curation found with what was acted out.

    Events that are ``thin``, and those around which the object was not tracked, are left out of every number but their
    own count and the hands.

    Times are in seconds: ``timing`` is found minus true event time, ``prime`` and ``prime_first`` found minus true
    prime time (first look of at least 50 ms, first instant of any look). ``thin`` events lie within the sensors'
    resolution of a threshold. ``hands`` counts located events by the hand that they name: right, wrong or unknown.
    """

    recordings: int
    true_events: int
    thin: int
    recall: float
    precision: float
    timing: Spread
    priming_recall: float
    false_primes: float
    prime: Spread
    prime_first: Spread
    hands: dict[str, int]
    expected_sequences: int
    missed_sequences: tuple[str, ...]


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


def staged_matches(staging: Staging, index: int) -> list[Match]:
    """Act out, sense and curate one recording in memory, and match what was found with what was acted out."""
    performance = staging.perform(index)
    recording = staging.sense(performance)
    curated = curate_recording(recording, load_manifest(staging.preset), load_protocol())
    return match_events(true_events(staging.preset, performance), curated.events)


def verify_tree(root: Path, dataset: str = "adt") -> Verification:
    """Read and curate the native files of a synthetic tree, and compare with the truth beside them.

    Raises:
        InputFileError: if the tree holds no recordings, no truth, or one of an unknown version.
    """
    offsets = {row["recording_id"]: row["clock_offset_s"] for row in read_truth(root, "recordings").to_pylist()}
    truth: dict[str, list[TrueEvent]] = {name: [] for name in offsets}
    rows: list[dict[str, Any]] = read_truth(root, "events").to_pylist()
    for row in rows:
        recording_id = row.pop("recording_id")
        values = {TIMES.get(name, name): value for name, value in row.items()}
        values["action"] = values.pop("kind")
        values |= {name: np.array(values[name]) for name in ("goal", "box_min", "box_max")}
        # Truth counts from the performance's first frame; the native files have clocks of their own.
        truth[recording_id].append(on_clock(TrueEvent(**values), offsets[recording_id]["objects"]))
    found = [recording for recording in reader_for(dataset).find(root) if recording.recording_id in truth]
    matches: list[Match] = []
    reader = reader_for(dataset)
    for files in found:
        curated = curate_recording(reader.read(files), load_manifest(reader.dataset), load_protocol())
        matches += match_events(truth[files.recording_id], curated.events)
    return verification(matches, recordings=len(found))


@dataclass(frozen=True)
class SensorLevel:
    """One of the conditions under which curation is checked.

    Attributes:
        provoked: True if provocations are on, at their default share
            (docs/specification/synthetic-recordings.md#provocations).
    """

    name: str
    noise: float
    provoked: bool


LEVELS = (
    SensorLevel("ideal sensors", 0.0, provoked=False),
    SensorLevel("default noise", 1.0, provoked=False),
    SensorLevel("default noise, provocations", 1.0, provoked=True),
    SensorLevel("twice the noise, provocations", 2.0, provoked=True),
)


def verify_level(
    level: SensorLevel, *, preset: str = "adt", recordings: int, seed: int, n_events: int = 10
) -> Verification:
    """Act out recordings, sense them, curate them, and compare with what was acted out."""
    staging = Staging(preset, seed, "default", n_events, level.noise, None if level.provoked else ())
    matches = [match for index in range(recordings) for match in staged_matches(staging, index)]
    return verification(matches, recordings=recordings)


# All levels; the gate runs them all, and other calls the one with default noise and provocations alone
MOSTLY_SLOW = [
    pytest.param(level, id=level.name, marks=[pytest.mark.slow] if level is not LEVELS[2] else []) for level in LEVELS
]


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
    # Beyond the datasets' own noise nothing is asserted about times: the page bounds detection alone.
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
