"""``prbench validate``: a dataset's own results beside prbench's rules."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.builds import NOT_EVERYTHING
from prbench.cli.commands import Answer, command, note
from prbench.cli.options import PATH, reader_options, recordings_options, root_option, workers_option
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.checking.validate_hd_epic import Agreement, Validation


class EventCount(msgspec.Struct, frozen=True, kw_only=True):
    """A number of events.

    Attributes:
        published: What the dataset says of them: ``primed``, ``not_primed``, ``excluded`` or ``not in the file``.
        rule: What the rule says of them: ``primed``, ``not_primed`` or ``no_location``.
        events: How many there are.
    """

    published: str
    rule: str
    events: int


class TimeDifference(msgspec.Struct, frozen=True, kw_only=True):
    """Prime times by the rule minus the published ones, in seconds.

    Attributes:
        n: Number of events of which both know a prime time.
        bias: Mean difference; null without events, as all below.
        median: Median of the differences' sizes.
        p95: 95th percentile of the differences' sizes.
        largest: The largest of their sizes.
    """

    n: int
    bias: float | None
    median: float | None
    p95: float | None
    largest: float | None


class PrimeGaps(msgspec.Struct, frozen=True, kw_only=True):
    """Times between prime and event, in seconds.

    Attributes:
        n: Number of events.
        mean: Mean; null without events.
        sd: Standard deviation; null without events.
    """

    n: int
    mean: float | None
    sd: float | None


class ActionAgreement(msgspec.Struct, frozen=True, kw_only=True):
    """The agreement of dataset and rule on the events of one action.

    Attributes:
        action: ``pick``, ``put`` or both together.
        events: Number of events.
        located: Number of those that have a place.
        counts: Events by what the dataset and the rule say of them.
        prime_time_difference_s: By the rule minus published, in seconds.
        published_gap_s: Time between the published prime and the event, in seconds.
        rule_gap_s: Time between the rule's prime and the event, in seconds.
    """

    action: str
    events: int
    located: int
    counts: list[EventCount]
    prime_time_difference_s: TimeDifference
    published_gap_s: PrimeGaps
    rule_gap_s: PrimeGaps


class FunnelStage(msgspec.Struct, frozen=True, kw_only=True):
    """One stage between movements and sequences; every count is a text, empty where there is none.

    Attributes:
        stage: Name of the stage.
        rule: Our count with the rule.
        published_priming: Our count with the dataset's own priming.
        reference: What is published.
    """

    stage: str
    rule: str
    published_priming: str
    reference: str


class CountRemark(msgspec.Struct, frozen=True, kw_only=True):
    """One sentence about why our count is not the study's.

    Attributes:
        kind: ``known``, ``measured here`` or ``guess``.
        text: The sentence.
    """

    kind: str
    text: str


class ValidateReport(msgspec.Struct, frozen=True, kw_only=True):
    """A dataset's own priming beside the rule's.

    Attributes:
        recordings: Number of videos that were read.
        synthetic: Whether the videos are of synthetic people; then nothing published stands beside their numbers.
        failed: Messages of the videos that could not be read.
        outcomes: Number of events by what curation with the rule made of them.
        published_outcomes: The same with the dataset's own priming; empty where that was not tried.
        agreements: Picks, puts, and both together.
        funnel: From movements to sequences.
        remarks: Why the counts differ.
    """

    recordings: int
    synthetic: bool
    failed: list[str]
    outcomes: dict[str, int]
    published_outcomes: dict[str, int]
    agreements: list[ActionAgreement]
    funnel: list[FunnelStage]
    remarks: list[CountRemark]


@command(
    "validate",
    example="prbench validate hd-epic --root /data/HD --workers 4",
    report=ValidateReport,
    writes_report=True,
)
@click.argument("dataset", type=click.Choice(["hd-epic"]))
@root_option("Your copy of the dataset: both ways of priming.", required=False)
@click.option("--data", type=PATH, metavar="DIR", help="A table of it that was built by the rule, in place of --root.")
@recordings_options
@reader_options(remark="with --root")
@workers_option()
def validate(
    *,
    dataset: str,
    root: Path | None,
    data: Path | None,
    recordings: str,
    max_recordings: int | None,
    options: tuple[tuple[str, str], ...],
    workers: int,
) -> Answer:
    """Compare a dataset's own priming results with the rule, and its counts with the study's.

    Either --root or --data is needed.
    """
    from prbench.checking.hd_epic_funnel import as_json
    from prbench.checking.validate_hd_epic import validate_build, validate_root
    from prbench.curation.options import BuildOptions
    from prbench.engine import engine_for
    from prbench.errors import UsageError

    assert dataset == "hd-epic", "the only choice"
    if data is not None and root is None:
        validation = validate_build(data)
    elif root is not None and data is None:
        chosen = BuildOptions(recordings=recordings, limit=max_recordings, reader=tuple(sorted(dict(options).items())))
        validation = validate_root(root, options=chosen, engine=engine_for(workers))
    else:
        raise UsageError("expected either --root DIR, your copy of the dataset, or --data DIR, a table of it.")
    for message in validation.failed:
        note(f"failed: {message}")
    report = msgspec.convert(as_json(validation), ValidateReport)
    return Answer(report, lambda: _print(report, validation), NOT_EVERYTHING if validation.failed else 0)


def _print(report: ValidateReport, validation: Validation) -> None:
    from prbench.checking.hd_epic_funnel import shares_of
    from prbench.checking.validate_hd_epic import PUBLISHED_OUTCOMES, RULE_OUTCOMES

    if validation.synthetic:
        print("synthetic videos, with priming results that an invented pipeline published")
    print_table(
        "published priming (rows) and the rule (columns): events",
        ("action", "published", *RULE_OUTCOMES),
        [
            (each.action, published, *(str(each.counts.get((published, rule), 0)) for rule in RULE_OUTCOMES))
            for each in validation.agreements
            for published in PUBLISHED_OUTCOMES
        ],
        numbers=(2, 3, 4),
    )
    print_table(
        "shares, and prime gaps in seconds (mean ± sd)",
        ("action", "tested", "dataset", "primed", "dataset", "same answer", "gap published", "gap rule"),
        [_share_row(each, *shares_of(each, validation)) for each in validation.agreements],
        numbers=range(1, 8),
    )
    print_table(
        "prime time by the rule minus published, seconds",
        ("action", "both primed", "mean", "median size", "95 % size", "largest"),
        [_difference_row(each) for each in validation.agreements],
        numbers=range(1, 6),
    )
    print_table(
        "from movements to sequences",
        ("stage", "rule", "published priming", "published count"),
        [(line.stage, line.rule, line.published_priming, line.reference) for line in report.funnel],
        numbers=(1, 2, 3),
    )
    for remark in report.remarks:
        print(f"[{remark.kind}] {remark.text}")


def _share_row(each: Agreement, tested: str, primed: str) -> tuple[str, ...]:
    return (
        each.action,
        f"{each.tested_share:.1%}",
        tested,
        f"{each.primed_share:.1%}",
        primed,
        f"{each.agreement:.1%}",
        f"{each.published_gaps.mean:.2f} ± {each.published_gaps.sd:.2f}",
        f"{each.rule_gaps.mean:.2f} ± {each.rule_gaps.sd:.2f}",
    )


def _difference_row(each: Agreement) -> tuple[str, ...]:
    spread = each.difference
    numbers = (f"{value:.3f}" for value in (spread.bias, spread.median, spread.p95, spread.largest))
    return (each.action, str(spread.n), *numbers)
