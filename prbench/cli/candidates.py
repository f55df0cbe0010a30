"""``prbench candidates``: propose events for a person to confirm."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from prbench.cli.arguments import add_workers, command
from prbench.cli.builds import NOT_EVERYTHING, add_reader_options
from prbench.cli.progress import progress


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "candidates",
        summary="propose pick events where a dataset has none, for a person to confirm",
        example="prbench candidates gimo --root /data/GIMO --out candidates.csv",
        execute=_candidates,
    )
    parser.add_argument("dataset", help="a dataset whose events are annotated by hand, such as gimo")
    parser.add_argument("--root", type=Path, required=True, metavar="DIR", help="your copy of the dataset")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="new CSV file; never overwritten")
    add_reader_options(parser)
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
        print(f"{proposal.line.recording_id}: {proposal.problem}", file=sys.stderr)
    proposed = sum(proposal.candidate is not None for proposal in proposals)
    print(f"{proposed} proposals for {len(proposals)} segments, {len(unread)} not read")
    print(f"look at the videos, write yes or no into the column 'confirmed', and build with it: {arguments.out}")
    return NOT_EVERYTHING if unread else 0
