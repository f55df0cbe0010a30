"""``prbench candidates``: propose events for a person to confirm."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from prbench.cli.arguments import add_workers, command, key_value
from prbench.cli.progress import progress

NOT_EVERYTHING = 3
"""Exit code when segments could not be read; their lines say why."""


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "candidates",
        summary="propose pick events where a dataset has none, for a person to confirm",
        example="prbench candidates gimo --root /data/GIMO --out candidates.csv",
        execute=_candidates,
    )
    parser.add_argument("dataset", help="gimo: its events are annotated by hand")
    parser.add_argument("--root", type=Path, required=True, metavar="DIR", help="your copy of the dataset")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="new CSV file; never overwritten")
    parser.add_argument(
        "--option",
        type=key_value,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an option of the dataset's reader; repeatable (a wrong name lists them)",
    )
    add_workers(parser)


def _candidates(arguments: argparse.Namespace) -> int:
    from prbench.engine import engine_for
    from prbench.workflows.candidates import write_candidates

    with progress(f"looking for reaches in {arguments.dataset}") as show:
        proposals = write_candidates(
            arguments.dataset,
            arguments.root,
            arguments.out,
            options=dict(arguments.option),
            engine=engine_for(arguments.workers),
            progress=show,
        )
    unread = [proposal for proposal in proposals if proposal.problem]
    for proposal in unread:
        print(f"{proposal.segment.name}: {proposal.problem}", file=sys.stderr)
    proposed = sum(proposal.candidate is not None for proposal in proposals)
    print(f"{proposed} proposals for {len(proposals)} segments, {len(unread)} not read")
    print(f"look at the videos, write yes or no into the column 'confirmed', and build with it: {arguments.out}")
    return NOT_EVERYTHING if unread else 0
