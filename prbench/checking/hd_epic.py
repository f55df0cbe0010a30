"""HD-EPIC's own priming results beside the rule's, and why our number of sequences differs from the study's.

The dataset publishes priming (``priming_info.json``), the study counts 18,134 sequences. What the two have in common is
told here with what is known and what is a guess (docs/specification/hd-epic.md#events-and-priming).
"""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from prbench.checking.verify_synthetic import PRIMED_STAGES, Spread
from prbench.curation import curate_recording
from prbench.curation.job import NativeSource, native_sources
from prbench.curation.options import BuildOptions, CurationOptions
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
    """Number of events."""
    mean: float
    """Mean; NaN without events."""
    sd: float
    """Standard deviation; NaN without events."""


@dataclass(frozen=True)
class EventCount:
    """A number of events."""

    published: str
    """What the dataset says of them: ``primed``, ``not_primed``, ``excluded`` or ``not in the file``."""
    rule: str
    """What the rule says of them: ``primed``, ``not_primed`` or ``no_location``."""
    events: int
    """How many there are."""


@dataclass(frozen=True)
class Agreement:
    """Agreement of the dataset and the rule, for one action or both together."""

    action: str
    """``pick``, ``put`` or both together."""
    events: int
    """Number of events."""
    located: int
    """Number of those that have a place."""
    counts: tuple[EventCount, ...]
    """Events by what the dataset and the rule say of them."""
    difference: Spread
    """Prime time by the rule minus the published one, where both find one, seconds."""
    published_gaps: Gaps
    """Time between the published prime and the event."""
    rule_gaps: Gaps
    """Time between the rule's prime and the event."""

    def count(self, *published: str, rule: Sequence[str] = ()) -> int:
        """Return how many events have one of these published outcomes and one of these by the rule; none means any."""
        return sum(
            each.events
            for each in self.counts
            if (not published or each.published in published) and (not rule or each.rule in rule)
        )

    @property
    def tested_share(self) -> float:
        """Share of the published events that the dataset tested ("feasible")."""
        return _share(self.count("primed", "not_primed"), self.count("primed", "not_primed", "excluded"))

    @property
    def primed_share(self) -> float:
        """Share of the tested events that the dataset found primed."""
        return _share(self.count("primed"), self.count("primed", "not_primed"))

    @property
    def agreement(self) -> float:
        """Share of the events that both tested with the same answer."""
        same = sum(self.count(answer, rule=(answer,)) for answer in ("primed", "not_primed"))
        return _share(same, self.count("primed", "not_primed", rule=("primed", "not_primed")))


@dataclass(frozen=True)
class FunnelLine:
    """One stage between movements and sequences; every count is a text, empty where there is none."""

    stage: str
    """Name of the stage."""
    rule: str
    """Our count with the rule."""
    published_priming: str
    """Our count with the dataset's own priming."""
    reference: str
    """What is published."""


@dataclass(frozen=True)
class Remark:
    """One sentence about why our count is not the study's."""

    kind: Literal["known", "measured here", "guess"]
    """Whether it is known or a guess."""
    text: str
    """The sentence."""


@dataclass(frozen=True)
class Validation:
    """A dataset's own priming beside the rule's."""

    recordings: int
    """Number of videos that were read."""
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
    funnel: tuple[FunnelLine, ...] = ()
    """From movements to sequences."""
    remarks: tuple[Remark, ...] = ()
    """Why the counts differ."""


class PublishedAction(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The dataset's own figures for its picks or puts; shares and seconds."""

    tested: float
    primed: float
    gap_mean: float
    gap_sd: float


class StudyCounts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The study's figures for HD-EPIC."""

    sequences: int
    gap_mean: float


class PublishedCounts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Counts of the dataset and of the study."""

    videos: int
    tracks: int
    tracks_by_masks: tuple[int, int, int, int]
    """Movements without a mask, with one, with two, with more."""
    priming_annotations: int
    pick: PublishedAction
    put: PublishedAction
    study: StudyCounts

    @property
    def most_places(self) -> int:
        """Starts and ends that can have a place: one mask serves one of them."""
        # A mask gives one place: with one mask only the start or the end has one.
        _, one, two, more = self.tracks_by_masks
        return one + 2 * (two + more)

    @property
    def primed_a_track(self) -> float:
        """Primed starts and ends a track, by the published shares."""
        return self.pick.tested * self.pick.primed + self.put.tested * self.put.primed

    @property
    def implied_tracks(self) -> int:
        """Tracks that give the published number of annotations with the published shares."""
        return round(self.priming_annotations / self.primed_a_track)

    @property
    def implied_gap(self) -> float:
        """Mean gap of primed starts and ends together, seconds."""
        picks = self.pick.tested * self.pick.primed
        puts = self.put.tested * self.put.primed
        return (picks * self.pick.gap_mean + puts * self.put.gap_mean) / (picks + puts)


@cache
def published_counts() -> PublishedCounts:
    """The published numbers."""
    file = resources.files("prbench_benchmarks.prime_and_reach.published") / "hd_epic_priming.toml"
    return msgspec.convert(tomllib.loads(file.read_text(encoding="utf-8")), PublishedCounts)


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
    counts = Counter((event.published, event.rule) for event in events)
    both = [e for e in events if e.rule_prime is not None and e.published_prime is not None]
    return Agreement(
        action=action,
        events=len(events),
        located=sum(event.located for event in events),
        counts=tuple(EventCount(*said, events=number) for said, number in sorted(counts.items())),
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
    counted = Validation(
        recordings=recordings,
        synthetic=synthetic,
        failed=failed,
        agreements=(*of_action, agreement("both", events)),
        outcomes=dict(sorted(outcomes.items())),
        published_outcomes=dict(sorted(published.items())),
    )
    return replace(counted, funnel=tuple(_funnel(counted)), remarks=tuple(_remarks(counted)))


def _gaps(values: Iterable[float]) -> Gaps:
    sample = np.array(list(values), dtype=np.float64)
    if len(sample) == 0:
        return Gaps(0, float("nan"), float("nan"))
    return Gaps(len(sample), float(sample.mean()), float(sample.std()))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def _funnel(validation: Validation) -> list[FunnelLine]:
    """Return one line a stage, from videos to sequences; synthetic videos have no published counts beside them."""
    known = published_counts()
    both = validation.agreements[-1]
    rule = validation.outcomes
    taken = validation.published_outcomes
    tracks = str(both.events // 2)
    tested = both.count("primed", "not_primed")
    primed = both.count("primed")
    shares = f"{known.pick.tested:.1%} of picks, {known.put.tested:.1%} of puts"
    annotated = f"{known.priming_annotations:,}"
    lines = [
        FunnelLine("videos read", str(validation.recordings), "", f"{known.videos:,}"),
        FunnelLine("movements (tracks)", tracks, tracks, f"{known.tracks:,}"),
        FunnelLine("starts and ends", str(both.events), str(both.events), f"{2 * known.tracks:,}"),
        FunnelLine("with a place", str(both.located), str(both.located), f"at most {known.most_places:,}"),
        FunnelLine("tested", str(both.located), str(tested), shares),
        FunnelLine("primed", str(both.count(rule=("primed",))), str(primed), annotated),
    ]
    for stage, names in (
        ("with a body", ("sequence", "minimum_movement", "too_short")),
        ("long enough", ("sequence", "minimum_movement")),
        ("sequences", ("sequence",)),
    ):
        reference = f"{known.study.sequences:,}" if stage == "sequences" else ""
        ours, theirs = (str(sum(counts.get(name, 0) for name in names)) for counts in (rule, taken))
        lines.append(FunnelLine(stage, ours, theirs if taken else "", reference))
    # Published counts beside synthetic videos would invite a comparison that means nothing.
    return [replace(line, reference="") for line in lines] if validation.synthetic else lines


def _remarks(validation: Validation) -> list[Remark]:
    """Explain why our count is not the study's; for synthetic videos only what was measured is said."""
    known = published_counts()
    both = validation.agreements[-1]
    measured = ["No published priming belongs to these events: only the rule's numbers."]
    if both.count("primed", "not_primed", "excluded"):
        extra = {name: both.count(name, rule=("primed",)) for name in ("excluded", "not_primed", "not in the file")}
        measured = [
            f"The rule primes {sum(extra.values())} events more than the file: {extra['excluded']} that the dataset"
            f" excluded, {extra['not_primed']} that it tested in vain, {extra['not in the file']} that it does not"
            f" mention; it misses {both.count('primed', rule=('not_primed',))} that the dataset primed."
        ]
    lost = {name: validation.outcomes.get(name, 0) for name in ("no_body", "too_short", "minimum_movement")}
    measured.append(
        f"Of the events that the rule primes, {lost['no_body']} have no body, {lost['too_short']} no 2 s of body"
        f" before the prime, and {lost['minimum_movement']} start within 20 cm of the goal."
    )
    if validation.failed:
        measured.append(f"{len(validation.failed)} videos could not be read and add nothing.")
    remarks = [Remark("measured here", text) for text in measured]
    if validation.synthetic:
        return remarks
    # 18,134 sequences in the study against the dataset's own annotations of primed events.
    fewer = known.priming_annotations - known.study.sequences
    published = (
        f"The published shares give {known.primed_a_track:.3f} primed starts and ends a track; the"
        f" {known.priming_annotations:,} annotations are those of {known.implied_tracks:,} of the {known.tracks:,}"
        " tracks.",
        f"The study has {fewer} fewer ({fewer / known.priming_annotations:.1%}), with a mean gap of"
        f" {known.study.gap_mean} s; the published picks and puts together have {known.implied_gap:.2f} s.",
    )
    guesses = (
        "The annotations count primed events only, after the dataset's own exclusions, and the study starts from"
        " them: no paper says so, the counts and the mean gap do. --priming published starts there, too.",
        f"Its {fewer} missing events fell to the 20 cm filter, to missing bodies, or to a body that does not reach"
        " 2 s back: which of them is not published. Our filter compares the nearer wrist with the goal; what the"
        " study compares is not said.",
        "The pipeline behind the published results is not released (annotations, issue 18): its distance, its"
        " view test and its boxes may differ from the rule's point with 5 cm.",
    )
    return [*(Remark("known", text) for text in published), *remarks, *(Remark("guess", text) for text in guesses)]


def shares_of(agreement: Agreement, validation: Validation) -> tuple[str, str]:
    """Published shares of one action: tested, and primed of the tested; empty for both together and synthetic ones."""
    known = {"pick": published_counts().pick, "put": published_counts().put}.get(agreement.action)
    return ("", "") if known is None or validation.synthetic else (f"{known.tested:.1%}", f"{known.primed:.1%}")
