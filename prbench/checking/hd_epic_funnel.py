"""Counts from HD-EPIC's movements to sequences, ours beside the published ones, with reasons for differences."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources
from typing import Literal

import msgspec

from prbench.checking.validate_hd_epic import Agreement, Validation

_FILE = "hd_epic_priming.toml"


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
    file = resources.files("prbench_benchmarks.prime_and_reach.published") / _FILE
    return msgspec.convert(tomllib.loads(file.read_text(encoding="utf-8")), PublishedCounts)


@dataclass(frozen=True)
class FunnelLine:
    """One stage: our counts by both ways of priming, and what is published; texts, empty where there is none."""

    stage: str
    rule: str
    published_priming: str
    reference: str


def funnel_lines(validation: Validation) -> list[FunnelLine]:
    """Return one line a stage, from videos to sequences; synthetic videos have no published counts beside them."""
    known = published_counts()
    both = validation.agreements[-1]
    rule = validation.outcomes
    taken = validation.published_outcomes
    tracks = str(both.events // 2)
    tested = both.published("primed", "not_primed")
    primed = both.published("primed")
    lines = [
        FunnelLine("videos read", str(validation.recordings), "", f"{known.videos:,}"),
        FunnelLine("movements (tracks)", tracks, tracks, f"{known.tracks:,}"),
        FunnelLine("starts and ends", str(both.events), str(both.events), f"{2 * known.tracks:,}"),
        FunnelLine("with a place", str(both.located), str(both.located), f"at most {known.most_places:,}"),
        FunnelLine("tested", str(both.located), str(tested), _shares(known, "tested")),
        FunnelLine("primed", str(both.rule("primed")), str(primed), f"{known.priming_annotations:,}"),
    ]
    for stage, names in (
        ("with a body", ("sequence", "minimum_movement", "too_short")),
        ("long enough", ("sequence", "minimum_movement")),
        ("sequences", ("sequence",)),
    ):
        reference = f"{known.study.sequences:,}" if stage == "sequences" else ""
        lines.append(FunnelLine(stage, _total(rule, names), _total(taken, names) if taken else "", reference))
    # Published counts beside synthetic videos would invite a comparison that means nothing.
    return [replace(line, reference="") for line in lines] if validation.synthetic else lines


def _shares(known: PublishedCounts, name: Literal["tested", "primed"]) -> str:
    return f"{getattr(known.pick, name):.1%} of picks, {getattr(known.put, name):.1%} of puts"


def _total(outcomes: dict[str, int], names: tuple[str, ...]) -> str:
    return str(sum(outcomes.get(name, 0) for name in names))


@dataclass(frozen=True)
class Remark:
    """One sentence about the difference to the study's count, and whether it is known or a guess."""

    kind: Literal["known", "measured here", "guess"]
    text: str


def remarks(validation: Validation) -> list[Remark]:
    """Explain why our count is not the study's; for synthetic videos only what was measured is said."""
    measured = _measured(validation)
    return measured if validation.synthetic else [*_known(), *measured, *_guesses()]


def _known() -> list[Remark]:
    known = published_counts()
    # 18,134 sequences in the study against the dataset's own annotations of primed events.
    fewer = known.priming_annotations - known.study.sequences
    return [
        Remark(
            "known",
            f"The published shares give {known.primed_a_track:.3f} primed starts and ends a track; the"
            f" {known.priming_annotations:,} annotations are those of {known.implied_tracks:,} of the {known.tracks:,}"
            " tracks.",
        ),
        Remark(
            "known",
            f"The study has {fewer} fewer ({fewer / known.priming_annotations:.1%}), with a mean gap of"
            f" {known.study.gap_mean} s; the published picks and puts together have {known.implied_gap:.2f} s.",
        ),
    ]


def _measured(validation: Validation) -> list[Remark]:
    both = validation.agreements[-1]
    found: list[Remark] = []
    if both.published("primed", "not_primed", "excluded"):
        extra = {name: both.counts.get((name, "primed"), 0) for name in ("excluded", "not_primed", "not in the file")}
        missed = both.counts.get(("primed", "not_primed"), 0)
        found.append(
            Remark(
                "measured here",
                f"The rule primes {sum(extra.values())} events more than the file: {extra['excluded']} that the dataset"
                f" excluded, {extra['not_primed']} that it tested in vain, {extra['not in the file']} that it does not"
                f" mention; it misses {missed} that the dataset primed.",
            )
        )
    else:
        found.append(Remark("measured here", "No published priming belongs to these events: only the rule's numbers."))
    lost = {name: validation.outcomes.get(name, 0) for name in ("no_body", "too_short", "minimum_movement")}
    found.append(
        Remark(
            "measured here",
            f"Of the events that the rule primes, {lost['no_body']} have no body, {lost['too_short']} no 2 s of body"
            f" before the prime, and {lost['minimum_movement']} start within 20 cm of the goal.",
        )
    )
    if validation.failed:
        found.append(Remark("measured here", f"{len(validation.failed)} videos could not be read and add nothing."))
    return found


def _guesses() -> list[Remark]:
    fewer = published_counts().priming_annotations - published_counts().study.sequences
    return [
        Remark(
            "guess",
            "The annotations count primed events only, after the dataset's own exclusions, and the study starts from"
            " them: no paper says so, the counts and the mean gap do. --priming published starts there, too.",
        ),
        Remark(
            "guess",
            f"Its {fewer} missing events fell to the 20 cm filter, to missing bodies, or to a body that does not reach"
            " 2 s back: which of them is not published. Our filter compares the nearer wrist with the goal; what the"
            " study compares is not said.",
        ),
        Remark(
            "guess",
            "The pipeline behind the published results is not released (annotations, issue 18): its distance, its"
            " view test and its boxes may differ from the rule's point with 5 cm.",
        ),
    ]


def shares_of(agreement: Agreement, validation: Validation) -> tuple[str, str]:
    """Published shares of one action: tested, and primed of the tested; empty for both together and synthetic ones."""
    known = {"pick": published_counts().pick, "put": published_counts().put}.get(agreement.action)
    return ("", "") if known is None or validation.synthetic else (f"{known.tested:.1%}", f"{known.primed:.1%}")


def as_json(validation: Validation) -> dict[str, object]:
    """Everything that was counted, for a file; what has no sample is null."""
    return {
        "recordings": validation.recordings,
        "synthetic": validation.synthetic,
        "failed": list(validation.failed),
        "outcomes": validation.outcomes,
        "published_outcomes": validation.published_outcomes,
        "agreements": [_agreement_as_json(each) for each in validation.agreements],
        "funnel": [asdict(line) for line in funnel_lines(validation)],
        "remarks": [asdict(remark) for remark in remarks(validation)],
    }


def _agreement_as_json(each: Agreement) -> dict[str, object]:
    return {
        "action": each.action,
        "events": each.events,
        "located": each.located,
        "counts": [
            {"published": published, "rule": rule, "events": count} for (published, rule), count in each.counts.items()
        ],
        "prime_time_difference_s": _without_nan(asdict(each.difference)),
        "published_gap_s": _without_nan(asdict(each.published_gaps)),
        "rule_gap_s": _without_nan(asdict(each.rule_gaps)),
    }


def _without_nan(numbers: Mapping[str, float | int]) -> dict[str, float | int | None]:
    return {name: None if math.isnan(value) else value for name, value in numbers.items()}
