"""``prbench validate``: a dataset's own results beside prbench's rules."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from prbench.cli.builds import NOT_EVERYTHING
from prbench.cli.commands import Answer, command, note
from prbench.cli.options import PATH, reader_options, recordings_options, root_option, workers_option
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.checking.hd_epic import Validation


@command(
    "validate",
    example="prbench validate hd-epic --root /data/HD --workers 4",
    report="prbench.checking.hd_epic:Validation",
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
    from prbench.checking.hd_epic import validate_build, validate_root
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
    return Answer(validation, lambda: _print(validation), NOT_EVERYTHING if validation.failed else 0)


def _print(validation: Validation) -> None:
    from prbench.checking.hd_epic import PUBLISHED_OUTCOMES, RULE_OUTCOMES, shares_of

    if validation.synthetic:
        print("synthetic videos, with priming results that an invented pipeline published")
    print_table(
        "published priming (rows) and the rule (columns): events",
        ("action", "published", *RULE_OUTCOMES),
        [
            (each.action, published, *(str(each.count(published, rule=(rule,))) for rule in RULE_OUTCOMES))
            for each in validation.agreements
            for published in PUBLISHED_OUTCOMES
        ],
        numbers=(2, 3, 4),
    )
    rows = []
    for each in validation.agreements:
        tested, primed = shares_of(each, validation)
        gaps = [f"{gap.mean:.2f} ± {gap.sd:.2f}" for gap in (each.published_gaps, each.rule_gaps)]
        ours = [f"{share:.1%}" for share in (each.tested_share, each.primed_share, each.agreement)]
        rows.append((each.action, ours[0], tested, ours[1], primed, ours[2], *gaps))
    print_table(
        "shares, and prime gaps in seconds (mean ± sd)",
        ("action", "tested", "dataset", "primed", "dataset", "same answer", "gap published", "gap rule"),
        rows,
        numbers=range(1, 8),
    )
    rows = []
    for each in validation.agreements:
        spread = each.difference
        numbers = (f"{value:.3f}" for value in (spread.bias, spread.median, spread.p95, spread.largest))
        rows.append((each.action, str(spread.n), *numbers))
    print_table(
        "prime time by the rule minus published, seconds",
        ("action", "both primed", "mean", "median size", "95 % size", "largest"),
        rows,
        numbers=range(1, 6),
    )
    print_table(
        "from movements to sequences",
        ("stage", "rule", "published priming", "published count"),
        [(line.stage, line.rule, line.published_priming, line.reference) for line in validation.funnel],
        numbers=(1, 2, 3),
    )
    for remark in validation.remarks:
        print(f"[{remark.kind}] {remark.text}")
