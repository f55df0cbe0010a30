"""``prbench build-corpus``: text-motion data into a corpus for pre-training."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_workers, command, positive
from prbench.cli.builds import (
    NOT_EVERYTHING,
    add_on_error,
    add_reader_options,
    add_recordings,
    add_replace,
    print_plan,
    print_unread,
)
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.corpora import CorpusOptions, CorpusReport


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "build-corpus",
        summary="turn text-motion data into a corpus for pre-training",
        example="prbench build-corpus nymeria --root /data/Nymeria --out corpora/nymeria --workers 4",
        execute=_build,
        resumes=True,
    )
    parser.add_argument("corpus", help="nymeria, humanml3d or synthetic")
    parser.add_argument("--root", type=Path, metavar="DIR", help="your copy of the dataset (not for synthetic)")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the corpus; an earlier one is replaced once the new one is ready, if that lacks nothing",
    )
    add_replace(parser, what="corpus")
    parser.add_argument(
        "--recordings", default="*", metavar="GLOB|N", help="only recordings whose name matches; of synthetic: how many"
    )
    parser.add_argument("--seed", type=int, default=0, help="of a synthetic corpus (default 0)")
    add_recordings(parser)
    parser.add_argument("--fps", type=float, metavar="N", help="frames a second of the clips (default 20)")
    parser.add_argument("--max-frames", type=positive, metavar="N", help="cut longer clips (default: 12 s)")
    parser.add_argument("--dry-run", action="store_true", help="say what would be read, and write nothing")
    add_on_error(parser)
    add_reader_options(parser, whose="corpus'")
    add_workers(parser)


def _build(arguments: argparse.Namespace) -> int:
    from prbench.corpora import build_corpus, plan_corpus
    from prbench.engine import engine_for
    from prbench.errors import UsageError

    options = _options(arguments)
    if arguments.dry_run:
        print_plan(plan_corpus(arguments.corpus, arguments.root, options), arguments.workers, unfit="unfit")
        return 0
    if arguments.out is None:
        raise UsageError("--out DIR is needed: the folder of the corpus. (--dry-run does without.)")
    with progress(f"building {arguments.corpus}") as show:
        report = build_corpus(
            arguments.corpus,
            arguments.root,
            arguments.out,
            options=options,
            engine=engine_for(arguments.workers),
            progress=show,
        )
    return _print_report(report)


def _options(arguments: argparse.Namespace) -> CorpusOptions:
    from prbench.corpora import CorpusOptions

    source = dict(arguments.option)
    recordings = arguments.recordings
    if arguments.corpus == "synthetic":
        source = {"seed": str(arguments.seed), **source}
        if recordings.isdecimal():
            source = {"recordings": recordings, **source}
            recordings = "*"
    return CorpusOptions(
        fps=arguments.fps,
        max_frames=arguments.max_frames,
        recordings=recordings,
        limit=arguments.limit,
        source=tuple(sorted(source.items())),
        on_error=arguments.on_error,
        replace=arguments.replace,
    )


def _print_report(report: CorpusReport) -> int:
    counts = report.info.counts
    info = report.info
    left_out = counts.recordings_failed + counts.recordings_skipped
    why = f"{counts.recordings_failed} failed, {counts.recordings_skipped} skipped" if left_out else ""
    rows = [
        ("recordings found", str(counts.recordings_found), "", ""),
        ("recordings read", str(counts.recordings_read), str(left_out or ""), why),
        ("texts", str(counts.annotations), "", ""),
    ]
    kept = counts.annotations
    for outcome, number in info.outcomes.items():
        if number and outcome != "clip":
            kept -= number
            rows.append((f"without {outcome}", str(kept), str(number), _REASONS[outcome]))
    rows.append(("captions", str(counts.captions), "", f"of {counts.clips} clips, {counts.frames} frames"))
    print_table(f"{info.title}: from files to clips", ("stage", "kept", "dropped", "why"), rows, numbers=(1, 2))
    if counts.approximate_clips:
        print(f"{counts.approximate_clips} clips are marked approximate: their texts were placed by aligning starts")
    print_unread(report.records, reused=report.reused)
    print(f"corpus: {report.folder}")
    return NOT_EVERYTHING if counts.recordings_failed else 0


_REASONS = {
    "no_text": "the text is empty",
    "duplicate": "the same text stands twice for the same span",
    "end_before_start": "the span ends before it begins",
    "too_short": "the span is shorter than the shortest clip",
    "outside_motion": "the span lies outside the motion",
    "clock_gap": "the motion's clock jumps within the span",
    "no_clock": "no way from the text's clock to the motion's",
    "no_heading": "the first pose faces nowhere",
}
