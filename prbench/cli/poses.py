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
    from prbench.curation.poses import PoseState
    from prbench.curation.poses.config import PosesConfig

_STILL_LACKING = 3
"""Exit code when some recording was to get a body and did not."""


class RecordingBody(msgspec.Struct, frozen=True, kw_only=True):
    """One recording, and what there was of its body before the command did anything.

    Attributes:
        recording: Its id.
        outputs: What EgoAllo's outputs are: ``complete``; ``partial``, covering a part; ``refused``, of another
            recording or damaged; ``missing``; ``unreadable``, without a trajectory to make any from; or ``skipped``,
            of a recording that is known to be bad.
        details: How much they cover, or what is wrong.
    """

    recording: str
    outputs: str
    details: str


class EstimatedBody(msgspec.Struct, frozen=True, kw_only=True):
    """The result of EgoAllo for one recording.

    Attributes:
        recording: Its id.
        state: ``made``, ``kept``, ``failed`` or ``skipped``.
        details: How much the outputs cover, or what went wrong.
    """

    recording: str
    state: str
    details: str


class PreparedInput(msgspec.Struct, frozen=True, kw_only=True):
    """The input folder that was written for one recording, with ``--prepare``.

    Attributes:
        recording: Its id.
        ready: Whether EgoAllo can be run on it.
        text: The command to run, or what is wrong.
    """

    recording: str
    ready: bool
    text: str


class PosesReport(msgspec.Struct, frozen=True, kw_only=True):
    """Which recordings lack a body, and what was done about it.

    Attributes:
        recordings: All recordings that were chosen.
        estimated: One entry for each of them, with ``--config``.
        prepared: One entry for each recording that lacks a body, with ``--prepare``.
        instructions: How to install EgoAllo and go on, where bodies are lacking and no ``--config`` was given.
    """

    recordings: list[RecordingBody]
    estimated: list[EstimatedBody]
    prepared: list[PreparedInput]
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
    from prbench.curation.poses import instructions, pose_states, read_config
    from prbench.curation.poses.states import Selection

    assert estimator == "egoallo", "the only choice"
    settings = read_config(config) if config else None
    states = tuple(pose_states(root, Selection(dataset, recordings, max_recordings, poses_root)))
    lacking = [state for state in states if state.lacking]
    prepared: list[PreparedInput] = []
    estimated: list[EstimatedBody] = []
    advice = None
    if prepare:
        prepared = _prepare(lacking, root, poses_root)
    elif dry_run:
        pass
    elif settings is not None:
        estimated = _estimate(states, settings, root=root, keep_inputs=keep_inputs)
    elif lacking:
        advice = instructions(root, lacking)
    report = PosesReport(
        recordings=[
            RecordingBody(recording=state.found.recording_id, outputs=state.state, details=state.message)
            for state in states
        ],
        estimated=estimated,
        prepared=prepared,
        instructions=advice,
    )
    complete = all(each.ready for each in prepared) and all(each.state != "failed" for each in estimated)
    return Answer(report, lambda: _print(report), 0 if complete else _STILL_LACKING)


def _estimate(
    states: tuple[PoseState, ...], settings: PosesConfig, *, root: Path, keep_inputs: bool
) -> list[EstimatedBody]:
    """Run EgoAllo on every recording that lacks a body, and note those that still lack it."""
    from prbench.curation.poses import make_poses

    with progress("running EgoAllo") as show:
        outcomes = make_poses(states, settings, root=root, keep_inputs=keep_inputs, progress=show)
    for outcome in outcomes:
        if outcome.failed:
            note(f"failed: {outcome.recording_id}: {outcome.message}")
    return [
        EstimatedBody(recording=outcome.recording_id, state=outcome.state, details=outcome.message)
        for outcome in outcomes
    ]


def _prepare(lacking: list[PoseState], root: Path, poses_root: Path | None) -> list[PreparedInput]:
    """Write an input folder for each recording, and note those for which something lacks."""
    from prbench.curation.poses.make import prepare_by_hand

    prepared = []
    for name, text, well in prepare_by_hand(lacking, root, poses_root):
        if not well:
            note(f"{name}: {text}")
        prepared.append(PreparedInput(recording=name, ready=well, text=text))
    return prepared


def _print(report: PosesReport) -> None:
    rows = [(each.recording, each.outputs, each.details) for each in report.recordings if each.outputs != "complete"]
    if rows:
        print_table("recordings without a whole EgoAllo body", ("recording", "outputs", "details"), rows)
    counts = Counter(each.outputs for each in report.recordings)
    print(f"{len(report.recordings)} recordings: {_counted(counts)}")
    for prepared in report.prepared:
        if prepared.ready:
            print(f"{prepared.recording}: {prepared.text}")
    if report.estimated:
        print(f"EgoAllo: {_counted(Counter(each.state for each in report.estimated))}")
    if report.instructions is not None:
        print(f"\n{report.instructions}", end="")


def _counted(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
