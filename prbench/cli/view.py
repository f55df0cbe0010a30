"""``prbench view``: runs and recorded motion as pictures, films and pages."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_data, add_limit, add_permission, command
from prbench.cli.progress import progress

if TYPE_CHECKING:
    from prbench.workflows.view import ViewReport


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "view",
        summary="show recorded and generated motion beside one another, as PNG, MP4 or HTML",
        example="prbench view runs/static --data tables/adt --out static.png",
        execute=_view,
    )
    parser.add_argument(
        "runs", type=Path, nargs="*", metavar="RUN", help="run folder(s) to compare; none: --data alone"
    )
    add_data(parser, required=False, help="the table(s) of the runs; not needed for the embedded synthetic dataset")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help="picture (.png), film (.mp4) or page (.html)"
    )
    parser.add_argument(
        "--sequence",
        action="append",
        default=[],
        metavar="ID",
        help="show this one; the id, or a beginning, end or part that fits one only; repeatable",
    )
    add_limit(parser, default="4")
    parser.add_argument("--sample", type=int, default=0, metavar="K", help="of runs with several samples (default 0)")
    parser.add_argument(
        "--scene",
        type=Path,
        metavar="DIR",
        help="your copy of the dataset: draws what stood around the bodies behind them (needs the extra open3d)",
    )
    add_permission(parser)


def _view(arguments: argparse.Namespace) -> int:
    from prbench.workflows.view import ViewRequest, view

    request = ViewRequest(
        out=arguments.out,
        runs=tuple(arguments.runs),
        data=tuple(arguments.data or ()),
        sequences=tuple(arguments.sequence),
        limit=arguments.limit,
        sample=arguments.sample,
        permitted=tuple(arguments.permission),
        scene=arguments.scene,
    )
    with progress(f"drawing {request.out.name}") as show:
        report = view(request, show)
    _print_view(report)
    return 0


def _print_view(report: ViewReport) -> None:
    """Say what was shown: each sequence with what every motion scored."""
    from prbench.viewing.replay.measures import score_sentence

    for scene in report.scenes:
        print(f"{scene.sequence_id}: {scene.title}")
        for motion in scene.motions:
            print(f"  {motion.label}: {score_sentence(scene, motion) or 'not scored'}")
    for notice in report.notices:
        print(notice)
    print(f"view: {report.out}")
