"""``prbench build-windows``: recordings, or a table of sequences, into windows for motion prediction."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click
import msgspec

from prbench.cli.builds import (
    NOT_EVERYTHING,
    made_shard,
)
from prbench.cli.commands import Answer, command, note, progress
from prbench.cli.options import (
    PATH,
    MadeShard,
    chosen_shard,
    engine_options,
    on_error_option,
    opened,
    out_folder_option,
    reader_options,
    recordings_options,
    root_option,
    shard_answer,
    shard_option,
)
from prbench.cli.terminal import print_table
from prbench.entry_points import CORPORA, load_built_in
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.engine.choice import EngineChoice
    from prbench.prediction.table import WindowsInfo


class WindowsBuilt(msgspec.Struct, frozen=True, kw_only=True):
    """One table of windows that was written.

    Attributes:
        dataset: Name of the dataset; ``synthetic-`` stands before that of synthetic people.
        title: Its title.
        folder: The table.
        joint_set: ``smpl22``, or native joints such as ``mogaze21``.
        fps: Frames a second.
        observed_frames: Frames that a predictor is given.
        future_frames: Frames that it predicts.
        has_gaze: False where no recording has measured gaze.
        estimated_bodies: True where bodies were estimated from whole tracks of the head.
        participants: Number of participants.
        recordings: Number of recordings with windows.
        runs: Number of runs of frames (segments, sequences).
        frames: Number of frames in all runs.
        windows: Number of windows by what became of them: ``window``, or the reason why they are not scored.
        left_out: Recordings without windows because they could not be read or are known to be bad, and why.
    """

    dataset: str
    title: str
    folder: Path
    joint_set: str
    fps: float
    observed_frames: int
    future_frames: int
    has_gaze: bool
    estimated_bodies: bool
    participants: int
    recordings: int
    runs: int
    frames: int
    windows: dict[str, int]
    left_out: dict[str, str]


class PublishedCount(msgspec.Struct, frozen=True, kw_only=True):
    """One split of a study, counted from the file that lists its segments.

    Attributes:
        split: ``train``, ``test`` or ``unused``.
        segments: Number of segments.
        frames: Number of frames in them.
        windows: Number of windows in them.
    """

    split: str
    segments: int
    frames: int
    windows: int


class WindowsReport(msgspec.Struct, frozen=True, kw_only=True):
    """The work of ``build-windows``, done or counted.

    Attributes:
        built: The table that was written; null with ``--dry-run`` and ``--shard``.
        counted: One entry for each split of the study, with ``--dry-run``.
        shard: The shard that was made, with ``--shard``; else null.
    """

    built: WindowsBuilt | None
    counted: list[PublishedCount]
    shard: MadeShard | None = None


@command(
    "build-windows",
    example="prbench build-windows mogaze --root /data/MoGaze --out windows/mogaze --workers 4",
    report=WindowsReport,
)
@click.argument("dataset", required=False)
@root_option(required=False)
@click.option("--data", type=PATH, metavar="DIR", help="In place of a dataset, a built table: windows at its events.")
@out_folder_option("Folder of the windows; earlier ones are replaced once the new ones are ready.")
@click.option(
    "--anchor",
    "anchors",
    multiple=True,
    metavar="NAME",
    help="With --data: windows at this anchor alone, prime or event-2, event-1.5, event-1, event-0.5; repeatable.",
)
@click.option("--dry-run", is_flag=True, help="Count what a study used, from gimo's dataset.csv alone; write nothing.")
@click.option(
    "--joints",
    type=click.Choice(["native", "smpl22"]),
    help="Joints that a study scored (default for mogaze and gimo), or the 22 joints of any dataset.",
)
@recordings_options
@on_error_option()
@reader_options()
@engine_options()
@shard_option("the dataset's recordings")
def build_windows(
    *,
    dataset: str | None,
    root: Path | None,
    data: Path | None,
    out: Path | None,
    anchors: tuple[str, ...],
    dry_run: bool,
    joints: Literal["native", "smpl22"] | None,
    recordings: str,
    max_recordings: int | None,
    on_error: Literal["skip", "fail"],
    options: tuple[tuple[str, str], ...],
    engine: EngineChoice,
    shard: str | None,
) -> Answer:
    """Cut recordings into windows for motion prediction: half a second to observe, two seconds to predict.

    DATASET is its name, for example mogaze (`prbench datasets` lists them).
    """
    if (data is None) is (dataset is None) or (dataset is None) is not (root is None):
        raise UsageError("expected either DATASET with --root DIR, or --data DIR alone.")
    part = chosen_shard(shard, dry_run=dry_run, data=data)
    if anchors and data is None:
        raise UsageError("--anchor: belongs to --data; windows of recordings slide.")
    if dry_run:
        return _counted(dataset, root)
    if out is None:
        raise UsageError("--out DIR is needed: the folder of the windows. (--dry-run does without.)")
    if data is not None:
        from prbench.prediction.anchored import build_anchored_windows

        if joints or recordings != "*" or max_recordings or options:
            raise UsageError("--data: a built table has its recordings and joints; leave the other options out.")
        return windows_answer(build_anchored_windows(data, out, only=anchors), out)
    assert dataset is not None
    assert root is not None
    from prbench.curation.window_building import build_planned_windows, build_windows_shard, plan_windows

    # Nymeria has no reader of recordings: its windows are cut where its corpus is read.
    planner = load_built_in(CORPORA, "windows") if dataset == "nymeria" else plan_windows
    plan = planner(dataset, root, joints=joints, recordings=recordings, limit=max_recordings, reader=options)
    where = opened(engine, reads=(root,), writes=(out,))
    if part is None:
        with progress(f"cutting {dataset}") as tell:
            report = build_planned_windows(plan, out, on_error=on_error, engine=where, progress=tell)
        return windows_answer(report.info, out)
    with progress(f"cutting shard {part} of {dataset}") as tell:
        done = build_windows_shard(plan, out, part, on_error=on_error, engine=where, progress=tell)
    for each in done.records:
        if each.status != "read":
            note(f"{each.recording_id}: {each.status}: {each.message}")
    made = made_shard(done, made_of=len(done.records))
    failed = any(each.status == "failed" for each in done.records)
    answer = WindowsReport(built=None, counted=[], shard=made)
    return shard_answer(answer, made, unit="recordings", exit_code=NOT_EVERYTHING if failed else 0)


def windows_answer(info: WindowsInfo, folder: Path) -> Answer:
    """Answer a command that has written a table of windows."""
    built = WindowsBuilt(
        **{name: getattr(info, name) for name in WindowsBuilt.__struct_fields__ if hasattr(info, name)},
        folder=folder,
        windows=info.outcomes,
        left_out={each.recording_id: f"{each.status}: {each.message}" for each in info.quarantine},
    )
    for recording, why in built.left_out.items():
        note(f"{recording}: {why}")
    if built.estimated_bodies:
        note("bodies were estimated from whole tracks of the head: an observed frame may carry later head motion")
    failed = any(each.status == "failed" for each in info.quarantine)
    return Answer(WindowsReport(built=built, counted=[]), lambda: _show(built), NOT_EVERYTHING if failed else 0)


def _counted(dataset: str | None, root: Path | None) -> Answer:
    """Count a study's segments and windows."""
    from prbench.curation.window_building import published_counts

    if dataset is None or root is None:
        raise UsageError("--dry-run: expected DATASET with --root DIR.")
    counts = [
        PublishedCount(split=split, segments=segments, frames=frames, windows=windows)
        for split, (segments, frames, windows) in published_counts(dataset, root).items()
    ]
    rows = [(each.split, str(each.segments), str(each.frames), str(each.windows)) for each in counts]
    title = f"{dataset}: what the study of prediction used"
    return Answer(
        WindowsReport(built=None, counted=counts),
        lambda: print_table(title, ("split", "segments", "frames", "windows"), rows, numbers=(1, 2, 3)),
    )


def _show(built: WindowsBuilt) -> None:
    rows = [
        ("participants", built.participants),
        ("recordings", built.recordings),
        ("runs", built.runs),
        ("frames", built.frames),
        *((f"windows: {outcome}" if outcome != "window" else "windows", n) for outcome, n in built.windows.items()),
    ]
    title = f"{built.title}: {built.joint_set}, {built.fps:g} frames a second"
    print_table(title, ("of", "number"), [(name, str(number)) for name, number in rows], numbers=(1,))
    print(f"windows: {built.folder}")
