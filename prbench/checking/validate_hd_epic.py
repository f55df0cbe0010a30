"""HD-EPIC's own priming results beside the rule's, and why our number of sequences differs from the study's.

The dataset publishes priming (``priming_info.json``), the study counts 18,134 sequences. What the two have in common is
told here with what is known and what is a guess (docs/specification/hd-epic.md#events-and-priming).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prbench.checking.matching import PRIMED_STAGES, Spread
from prbench.curation import curate_recording
from prbench.curation.options import BuildOptions, CurationOptions
from prbench.curation.sources import NativeSource, native_sources
from prbench.engine import Engine, InProcess
from prbench.errors import PrbenchError, TableError, UsageError
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.readers import SYNTHETIC_PREFIX
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import DatasetInfo

DATASET = "hd-epic"
_IN_PROCESS = InProcess()

PUBLISHED_OUTCOMES = ("primed", "not_primed", "excluded", "not in the file")
RULE_OUTCOMES = ("primed", "not_primed", "no_location")
_ACTIONS = ("pick", "put")


@dataclass(frozen=True)
class JudgedEvent:
    """One candidate event: what the rule says, what the dataset says, and what became of it."""

    action: str
    event_time: float
    located: bool
    rule_prime: float | None
    published: str
    """One of :data:`PUBLISHED_OUTCOMES`."""
    published_prime: float | None
    outcome: str
    """Outcome of curation by the rule."""

    @property
    def rule(self) -> str:
        """One of :data:`RULE_OUTCOMES`."""
        if not self.located:
            return "no_location"
        return "not_primed" if self.rule_prime is None else "primed"


@dataclass(frozen=True)
class Gaps:
    """Prime gaps of some events, seconds."""

    n: int
    mean: float
    sd: float


@dataclass(frozen=True)
class Agreement:
    """Agreement of the dataset and the rule, for one action or both together."""

    action: str
    events: int
    located: int
    counts: dict[tuple[str, str], int]
    """Events by (published, rule)."""
    difference: Spread
    """Prime time by the rule minus the published one, where both find one, seconds."""
    published_gaps: Gaps
    rule_gaps: Gaps

    def published(self, *outcomes: str) -> int:
        """Events with one of these published outcomes."""
        return sum(count for (published, _), count in self.counts.items() if published in outcomes)

    def rule(self, outcome: str) -> int:
        """Events of which the rule says that."""
        return sum(count for (_, rule), count in self.counts.items() if rule == outcome)

    @property
    def tested_share(self) -> float:
        """Share of the published events that the dataset tested ("feasible")."""
        return _share(self.published("primed", "not_primed"), self.published("primed", "not_primed", "excluded"))

    @property
    def primed_share(self) -> float:
        """Share of the tested events that the dataset found primed."""
        return _share(self.published("primed"), self.published("primed", "not_primed"))

    @property
    def agreement(self) -> float:
        """Share of the events that both tested with the same answer."""
        both = [(p, r) for p in ("primed", "not_primed") for r in ("primed", "not_primed")]
        same = sum(self.counts.get((answer, answer), 0) for answer in ("primed", "not_primed"))
        return _share(same, sum(self.counts.get(pair, 0) for pair in both))


@dataclass(frozen=True)
class Validation:
    """The whole comparison."""

    recordings: int
    synthetic: bool
    """True for synthetic videos: nothing published is shown beside their numbers."""
    failed: tuple[str, ...]
    """Messages of the recordings that could not be read."""
    agreements: tuple[Agreement, ...]
    """Picks, puts, both."""
    outcomes: dict[str, int]
    """Number of events by outcome of the rule."""
    published_outcomes: dict[str, int]
    """Number of events by outcome with ``--priming published``; empty where that was not tried."""


def validate_root(root: Path, *, options: BuildOptions, engine: Engine = _IN_PROCESS) -> Validation:
    """Read a copy of the dataset and curate it both ways.

    Raises:
        UsageError: for an unknown option.
        InputFileError: if there is nothing to read.
    """
    sources = [source for source in native_sources(DATASET, root, options) if source.skip_reason is None]
    judged = list(engine.map(_judge_source, sources))
    read = [each for each in judged if not each.failure]
    return _validation(
        [event for each in read for event in each.events],
        recordings=len(read),
        synthetic=any(source.dataset.startswith(SYNTHETIC_PREFIX) for source in sources),
        failed=tuple(each.failure for each in judged if each.failure),
        outcomes=Counter(event.outcome for each in read for event in each.events),
        published=Counter(outcome for each in read for outcome in each.published_outcomes),
    )


def validate_build(folder: Path) -> Validation:
    """Compare from the ``events`` of a table that was built with ``--priming rule``.

    Raises:
        TableError: if there is no such table.
        UsageError: if it holds no HD-EPIC, or was built from the published priming, so that it lacks the rule's.
    """
    info = DatasetInfo.read(folder)
    if info.dataset.removeprefix(SYNTHETIC_PREFIX) != DATASET:
        raise UsageError(f"{folder}: expected a table of {DATASET}, found {info.dataset}.")
    if info.options.get("priming", "rule") != "rule":
        raise UsageError(
            f"{folder}: was built with --priming published, so it does not tell what the rule finds."
            " Give a table built by the rule, or the dataset itself with --root."
        )
    table = SequenceTable(folder, info)
    table.require_unchanged()
    rows = table.events().to_pylist()
    # Tables of earlier versions have the column without values.
    if rows and all(row["published_priming"] is None for row in rows):
        raise TableError(
            f"{folder}: no event tells a published priming. Was priming_info.json beside the data when it was built,"
            " and by this version of prbench? Build it again, or use --root."
        )
    return _validation(
        [_judged(row) for row in rows],
        recordings=info.counts.recordings_read,
        synthetic=info.synthetic,
        failed=tuple(each.message for each in info.quarantine if each.status == "failed"),
        outcomes=Counter(row["outcome"] for row in rows),
        published=Counter(),
    )


def agreement(action: str, events: Sequence[JudgedEvent]) -> Agreement:
    """Summarise some events."""
    both = [e for e in events if e.rule_prime is not None and e.published_prime is not None]
    return Agreement(
        action=action,
        events=len(events),
        located=sum(event.located for event in events),
        counts=dict(sorted(Counter((event.published, event.rule) for event in events).items())),
        # Only where both found a prime; elsewhere there is no difference to speak of.
        difference=Spread.of(e.rule_prime - e.published_prime for e in both if e.rule_prime and e.published_prime),
        published_gaps=_gaps(e.event_time - e.published_prime for e in events if e.published_prime is not None),
        rule_gaps=_gaps(e.event_time - e.rule_prime for e in events if e.rule_prime is not None),
    )


@dataclass(frozen=True)
class _JudgedRecording:
    events: tuple[JudgedEvent, ...]
    published_outcomes: tuple[str, ...]
    failure: str


def _judge_source(source: NativeSource) -> _JudgedRecording:
    """Read one recording and curate it by the rule and, where the dataset speaks, from what it publishes."""
    manifest = load_manifest(DATASET)
    protocol = load_protocol()
    try:
        recording = source.read()
    except PrbenchError as error:
        return _JudgedRecording((), (), f"{source.recording_id}: {source.without_places(str(error))}")
    events = curate_recording(recording, manifest, protocol, split=source.split).events
    # Without priming_info.json the second curation would only say that nothing was published.
    published: tuple[str, ...] = ()
    if any(event.published_priming is not None for event in recording.annotated_events):
        options = CurationOptions(priming="published")
        curated = curate_recording(recording, manifest, protocol, options, split=source.split)
        published = tuple(event.outcome for event in curated.events)
    return _JudgedRecording(tuple(_judged(vars(event)) for event in events), published, "")


def _judged(row: Mapping[str, Any]) -> JudgedEvent:
    """Judge one row of ``events``, as a table holds it or as the fields of :class:`prbench.sequences.Event`."""
    return JudgedEvent(
        action=row["action"],
        event_time=row["event_time"],
        located=row["stage"] == "priming" or row["stage"] in PRIMED_STAGES,
        rule_prime=row["prime_time"],
        published=row["published_priming"] or PUBLISHED_OUTCOMES[-1],
        published_prime=row["published_prime_time"],
        outcome=row["outcome"],
    )


def _validation(
    events: Sequence[JudgedEvent],
    *,
    recordings: int,
    synthetic: bool,
    failed: tuple[str, ...],
    outcomes: Counter[str],
    published: Counter[str],
) -> Validation:
    of_action = [agreement(action, [event for event in events if event.action == action]) for action in _ACTIONS]
    return Validation(
        recordings=recordings,
        synthetic=synthetic,
        failed=failed,
        agreements=(*of_action, agreement("both", events)),
        outcomes=dict(sorted(outcomes.items())),
        published_outcomes=dict(sorted(published.items())),
    )


def _gaps(values: Iterable[float]) -> Gaps:
    sample = np.array(list(values), dtype=np.float64)
    if len(sample) == 0:
        return Gaps(0, float("nan"), float("nan"))
    return Gaps(len(sample), float(sample.mean()), float(sample.std()))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
