"""HD-EPIC's own priming results beside the rule's (docs/specification/hd-epic.md#events-and-priming)."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from prbench.errors import InputFileError, TableError, UsageError
from prbench.readers import SYNTHETIC_PREFIX, AnnotationCounts, CountsAnnotations, reader_for
from prbench.sequences import SequenceTable

DATASET = "hd-epic"
PUBLISHED_OUTCOMES: tuple[str, ...] = ("primed", "not_primed", "excluded", "not in the file")
RULE_OUTCOMES: tuple[str, ...] = ("primed", "not_primed", "no_location")
PRIMED_STAGES = ("priming", "clipping", "body", "filters")  # stages at which it is known whether an event was primed


@dataclass(frozen=True)
class Spread:
    """A sample of differences, summarised; NaN for an empty one.

    Attributes:
        n: Size of the sample.
        bias: Mean.
        median: Median of the absolute values.
        p95: 95th percentile of the absolute values.
        largest: Largest absolute value.
    """

    n: int
    bias: float
    median: float
    p95: float
    largest: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Spread:
        """Summarise signed differences."""
        sample = np.array(list(values), dtype=np.float64)
        if len(sample) == 0:
            return cls(0, *(float("nan"),) * 4)
        size = np.abs(sample)
        largest = (float(np.quantile(size, 0.95)), float(size.max()))
        return cls(len(sample), float(sample.mean()), float(np.median(size)), *largest)


@dataclass(frozen=True)
class Agreement:
    """Agreement of the dataset and the rule, for one action or both together.

    Attributes:
        action: ``pick``, ``put`` or both together.
        events: Number of events.
        located: Number of those that have a place.
        counts: Events by what the dataset says of them (``primed``, ``not_primed``, ``excluded`` or ``not in the
            file``) and by what the rule says (``primed``, ``not_primed`` or ``no_location``).
        tested_share: Share of the published events that the dataset tested ("feasible").
        primed_share: Share of the tested events that the dataset found primed.
        agreement: Share of the events that both tested with the same answer.
        difference: Prime time by the rule minus the published one, where both find one, seconds.
        published_gap: Mean and standard deviation of the time between the published prime and the event, seconds.
        rule_gap: Mean and standard deviation of the time between the rule's prime and the event, seconds.
    """

    action: str
    events: int
    located: int
    counts: dict[str, dict[str, int]]
    tested_share: float
    primed_share: float
    agreement: float
    difference: Spread
    published_gap: tuple[float, float]
    rule_gap: tuple[float, float]


@dataclass(frozen=True)
class Validation:
    """A dataset's own priming beside the rule's.

    Attributes:
        recordings: Number of videos that were read.
        synthetic: True for synthetic videos: nothing published is shown beside their numbers.
        agreements: Picks, puts, both; empty where no table is compared.
        outcomes: Number of events by outcome of the rule.
        published_shares: Shares that the dataset's paper names, by action: tested, and primed of the tested; empty for
            synthetic videos.
        annotations: Numbers of the annotations, where their folder was given.
    """

    recordings: int
    synthetic: bool
    agreements: tuple[Agreement, ...]
    outcomes: dict[str, int]
    published_shares: dict[str, tuple[float, float]]
    annotations: AnnotationCounts | None = None


def validate_annotations(root: Path) -> Validation:
    """Count the annotations below a folder, and the priming that they publish.

    Raises:
        InputFileError: if there are none, or a file is no JSON.
    """
    reader = reader_for(DATASET, {"events_only": "true"})
    assert isinstance(reader, CountsAnnotations), "this one does"
    videos = reader.find(root)
    counts = reader.annotation_counts(videos)
    if counts is None:
        raise InputFileError(root, "", expected="HD-EPIC's annotations", found="its videos alone")
    synthetic = videos[0].dataset != DATASET
    return Validation(counts.totals["videos"], synthetic, (), {}, {} if synthetic else _published_shares(), counts)


def _published_shares() -> dict[str, tuple[float, float]]:
    file = resources.files("prbench_benchmarks.prime_and_reach.published") / "hd_epic_priming.toml"
    published = tomllib.loads(file.read_text(encoding="utf-8"))
    return {action: (published[action]["tested"], published[action]["primed"]) for action in ("pick", "put")}


def validate_build(folder: Path) -> Validation:
    """Compare from the ``events`` of a table that was built with ``--priming rule``.

    Raises:
        TableError: if there is no such table.
        UsageError: if it holds no HD-EPIC, or was built from the published priming, so that it lacks the rule's.
    """
    table = SequenceTable.open(folder)
    info = table.info
    if info.dataset.removeprefix(SYNTHETIC_PREFIX) != DATASET:
        raise UsageError(f"{folder}: expected a table of {DATASET}, found {info.dataset}.")
    if info.options.get("priming", "rule") != "rule":
        problem = "was built with --priming published, so it does not tell what the rule finds."
        raise UsageError(f"{folder}: {problem} Give a table built by the rule.")
    rows = [row for row in table.events().to_pylist() if row["outcome"] != "unreadable_entry"]
    # Tables of earlier versions have the column without values.
    if rows and all(row["published_priming"] is None for row in rows):
        asked = "Was priming_info.json beside the data when it was built, and by this version of prbench?"
        raise TableError(f"{folder}: no event tells a published priming. {asked} Build it again.")
    of_action = [agreement(action, [row for row in rows if row["action"] == action]) for action in ("pick", "put")]
    agreements = (*of_action, agreement("both", rows))
    outcomes = dict(sorted(Counter(row["outcome"] for row in rows).items()))
    shares = {} if info.synthetic else _published_shares()
    return Validation(info.counts.recordings_read, info.synthetic, agreements, outcomes, shares)


def agreement(action: str, rows: Sequence[Mapping[str, Any]]) -> Agreement:
    """Summarise some rows of ``events``."""
    counts: dict[str, dict[str, int]] = {each: dict.fromkeys(RULE_OUTCOMES, 0) for each in PUBLISHED_OUTCOMES}
    differences = []
    gaps: dict[str, list[float]] = {"published_prime_time": [], "prime_time": []}
    for row in rows:
        rule = "not_primed" if row["prime_time"] is None else "primed"
        if row["stage"] != "priming" and row["stage"] not in PRIMED_STAGES:
            rule = "no_location"
        counts[row["published_priming"] or PUBLISHED_OUTCOMES[-1]][rule] += 1
        for name, own in gaps.items():
            if row[name] is not None:
                own.append(row["event_time"] - row[name])
        if row["prime_time"] is not None and row["published_prime_time"] is not None:
            differences.append(row["prime_time"] - row["published_prime_time"])
    total = {published: sum(by_rule.values()) for published, by_rule in counts.items()}
    tested = total["primed"] + total["not_primed"]
    both = [counts[one][other] for one in ("primed", "not_primed") for other in ("primed", "not_primed")]
    published_gap, rule_gap = ((float(np.mean(own)), float(np.std(own))) if own else _NO_GAP for own in gaps.values())
    located = len(rows) - sum(by_rule["no_location"] for by_rule in counts.values())
    tested_and_primed = (_share(tested, tested + total["excluded"]), _share(total["primed"], tested))
    found = (_share(both[0] + both[3], sum(both)), Spread.of(differences), published_gap, rule_gap)
    return Agreement(action, len(rows), located, counts, *tested_and_primed, *found)


_NO_GAP = (float("nan"), float("nan"))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
