"""``prbench validate``: a dataset's own results beside prbench's rules."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_workers, command, positive
from prbench.cli.builds import NOT_EVERYTHING, add_reader_options
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.workflows.validate_hd_epic import Agreement, Validation


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "validate",
        summary="compare a dataset's own priming results with the rule, and its counts with the study's",
        example="prbench validate hd-epic --root /data/HD --workers 4",
        execute=_validate,
    )
    parser.add_argument("dataset", choices=["hd-epic"], help="a dataset that publishes priming results of its own")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--root", type=Path, metavar="DIR", help="your copy of the dataset: both ways of priming")
    where.add_argument("--data", type=Path, metavar="DIR", help="a table of it that was built by the rule")
    parser.add_argument("--recordings", default="*", metavar="GLOB", help="only videos with such names (with --root)")
    parser.add_argument("--limit", type=positive, metavar="N", help="only the first N videos, by name (with --root)")
    add_reader_options(parser, remark="with --root")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the numbers as JSON, too")
    add_workers(parser)


def _validate(arguments: argparse.Namespace) -> int:
    from prbench.curation.options import BuildOptions
    from prbench.engine import engine_for
    from prbench.locks import sole_writer
    from prbench.storage import write_json
    from prbench.workflows.hd_epic_funnel import as_json
    from prbench.workflows.validate_hd_epic import validate_build, validate_root

    if arguments.data is not None:
        validation = validate_build(arguments.data)
    else:
        options = BuildOptions(
            recordings=arguments.recordings,
            limit=arguments.limit,
            reader=tuple(sorted(dict(arguments.option).items())),
        )
        validation = validate_root(arguments.root, options=options, engine=engine_for(arguments.workers))
    if arguments.out is not None:
        with sole_writer(arguments.out):
            write_json(arguments.out, as_json(validation))
    _print(validation)
    for message in validation.failed:
        print(f"failed: {message}", file=sys.stderr)
    return NOT_EVERYTHING if validation.failed else 0


def _print(validation: Validation) -> None:
    from prbench.workflows.hd_epic_funnel import funnel_lines, remarks, shares_of
    from prbench.workflows.validate_hd_epic import PUBLISHED_OUTCOMES, RULE_OUTCOMES

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
        [(line.stage, line.rule, line.published_priming, line.reference) for line in funnel_lines(validation)],
        numbers=(1, 2, 3),
    )
    for remark in remarks(validation):
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
