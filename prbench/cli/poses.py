"""``prbench poses``: bodies for recordings that have none."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import command
from prbench.cli.builds import add_recordings
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.workflows.poses import PoseState

_STILL_LACKING = 3
"""Exit code when some recording was to get a body and did not."""


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command."""
    parser = command(
        commands,
        "poses",
        summary="say which recordings lack a body pose, and have EgoAllo estimate it",
        example="prbench poses egoallo --root /data/HD-EPIC --config egoallo.toml",
        execute=_poses,
        resumes=True,
    )
    parser.add_argument("estimator", choices=["egoallo"], help="what estimates bodies")
    parser.add_argument("--root", type=Path, required=True, metavar="DIR", help="your copy of the dataset")
    parser.add_argument("--dataset", metavar="NAME", help="such as adt (default: what the folder holds)")
    parser.add_argument("--config", type=Path, metavar="FILE", help="how to run EgoAllo; without it, says what to do")
    parser.add_argument("--recordings", default="*", metavar="GLOB", help="only recordings whose name matches")
    add_recordings(parser)
    parser.add_argument("--poses-root", type=Path, metavar="DIR", help="folder of outputs (default: ROOT/egoallo)")
    parser.add_argument("--dry-run", action="store_true", help="say which recordings lack a body, and run nothing")
    parser.add_argument("--prepare", action="store_true", help="only write EgoAllo's input folders, to run it by hand")
    parser.add_argument("--keep-inputs", action="store_true", help="leave prepared input folders in place")


def _poses(arguments: argparse.Namespace) -> int:
    from prbench.workflows.poses import instructions, pose_states, read_config
    from prbench.workflows.poses.states import Selection

    config = read_config(arguments.config) if arguments.config else None
    selection = Selection(arguments.dataset, arguments.recordings, arguments.limit, arguments.poses_root)
    states = tuple(pose_states(arguments.root, selection))
    lacking = [state for state in states if state.lacking]
    _print_states(states)
    if arguments.prepare:
        return _prepare(lacking, arguments)
    if arguments.dry_run:
        return 0
    if config is None and not lacking:
        return 0
    if config is None:
        print(f"\n{instructions(arguments.root, lacking)}", end="")
        return 0
    return _make(states, arguments)


def _print_states(states: tuple[PoseState, ...]) -> None:
    rows = [(state.found.recording_id, state.state, state.message) for state in states if state.state != "complete"]
    if rows:
        print_table("recordings without a whole EgoAllo body", ("recording", "outputs", "details"), rows)
    counts = Counter(state.state for state in states)
    print(f"{len(states)} recordings: " + ", ".join(f"{count} {name}" for name, count in sorted(counts.items())))


def _make(states: tuple[PoseState, ...], arguments: argparse.Namespace) -> int:
    from prbench.workflows.poses import make_poses, read_config

    with progress("running EgoAllo") as show:
        outcomes = make_poses(
            states,
            read_config(arguments.config),
            root=arguments.root,
            keep_inputs=arguments.keep_inputs,
            progress=show,
        )
    for outcome in outcomes:
        if outcome.failed:
            print(f"failed: {outcome.recording_id}: {outcome.message}", file=sys.stderr)
    counts = Counter(outcome.state for outcome in outcomes)
    print("EgoAllo: " + ", ".join(f"{count} {name}" for name, count in sorted(counts.items())))
    return _STILL_LACKING if any(outcome.failed for outcome in outcomes) else 0


def _prepare(lacking: list[PoseState], arguments: argparse.Namespace) -> int:
    from prbench.workflows.poses.make import prepare_by_hand

    failed = 0
    for name, text, well in prepare_by_hand(lacking, arguments.root, arguments.poses_root):
        print(f"{name}: {text}", file=sys.stdout if well else sys.stderr)
        failed += not well
    return _STILL_LACKING if failed else 0
