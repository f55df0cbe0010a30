"""``prbench poses``: bodies for recordings that have none."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, command, note
from prbench.cli.options import LOCAL_PATH, PATH, recordings_options, root_option
from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.curation.poses.make import Outcome

_STILL_LACKING = 3
"""Exit code when some recording was to get a body and did not."""


class PosesReport(msgspec.Struct, frozen=True, kw_only=True):
    """Which recordings lack a body, and what was done about it.

    Attributes:
        recordings: All recordings that were chosen, and what there was of their bodies before the command did anything.
            EgoAllo's outputs are ``complete``; ``partial``, covering a part; ``refused``, of another recording or
            damaged; ``missing``; ``unreadable``, without a trajectory to make any from; or ``skipped``, of a recording
            that is known to be bad.
        estimated: One entry for each of them, with ``--config``.
        prepared: One entry for each recording that lacks a body, with ``--prepare``: the command to run, or what is
            wrong.
        instructions: How to install EgoAllo and go on, where bodies are lacking and no ``--config`` was given.
    """

    recordings: list[Outcome]
    estimated: list[Outcome]
    prepared: list[Outcome]
    instructions: str | None


@command(
    "poses",
    example="prbench poses egoallo --root /data/HD-EPIC --config egoallo.toml",
    resumes=True,
    report=PosesReport,
    writes_report=True,
)
@click.argument("estimator", type=click.Choice(["egoallo"]))
@root_option(type=LOCAL_PATH)
@click.option("--dataset", metavar="NAME", help="Name of the dataset, such as adt (default: what the folder holds).")
@click.option("--config", type=PATH, metavar="FILE", help="How to run EgoAllo; without it, says what to do.")
@recordings_options
@click.option(
    "--poses-root", type=LOCAL_PATH, metavar="DIR", help="Folder of EgoAllo's outputs (default: ROOT/egoallo)."
)
@click.option("--dry-run", is_flag=True, help="Say which recordings lack a body, and run nothing.")
@click.option("--prepare", is_flag=True, help="Only write EgoAllo's input folders, to run it by hand.")
@click.option("--keep-inputs", is_flag=True, help="Leave prepared input folders in place.")
def poses(
    *,
    estimator: str,
    root: Path,
    dataset: str | None,
    config: Path | None,
    recordings: str,
    max_recordings: int | None,
    poses_root: Path | None,
    dry_run: bool,
    prepare: bool,
    keep_inputs: bool,
) -> Answer:
    """Say which recordings lack a body pose, and have EgoAllo estimate it."""
    from prbench.curation.poses import instructions, make_poses, pose_states, read_config
    from prbench.curation.poses.make import Outcome, prepare_by_hand
    from prbench.curation.poses.states import Selection

    assert estimator == "egoallo", "the only choice"
    settings = read_config(config) if config else None
    states = tuple(pose_states(root, Selection(dataset, recordings, max_recordings, poses_root)))
    lacking = [state for state in states if state.lacking]
    prepared: list[Outcome] = []
    estimated: list[Outcome] = []
    advice = None
    if prepare:
        prepared = list(prepare_by_hand(lacking, root, poses_root))
    elif dry_run:
        pass
    elif settings is not None:
        with progress("running EgoAllo") as show:
            estimated = list(make_poses(states, settings, root=root, keep_inputs=keep_inputs, progress=show))
    elif lacking:
        advice = instructions(root, lacking)
    failed = [outcome for outcome in (*prepared, *estimated) if outcome.failed]
    for outcome in failed:
        note(f"failed: {outcome.recording_id}: {outcome.message}")
    report = PosesReport(
        recordings=[Outcome(state.found.recording_id, state.state, state.message) for state in states],
        estimated=estimated,
        prepared=prepared,
        instructions=advice,
    )
    return Answer(report, lambda: _print(report), _STILL_LACKING if failed else 0)


def _print(report: PosesReport) -> None:
    rows = [(each.recording_id, each.state, each.message) for each in report.recordings if each.state != "complete"]
    if rows:
        print_table("recordings without a whole EgoAllo body", ("recording", "outputs", "details"), rows)
    print(f"{len(report.recordings)} recordings: {_counted(report.recordings)}")
    for prepared in report.prepared:
        if not prepared.failed:
            print(f"{prepared.recording_id}: {prepared.message}")
    if report.estimated:
        print(f"EgoAllo: {_counted(report.estimated)}")
    if report.instructions is not None:
        print(f"\n{report.instructions}", end="")


def _counted(outcomes: list[Outcome]) -> str:
    counts = Counter(each.state for each in outcomes)
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
