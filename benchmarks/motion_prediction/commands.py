"""``prbench build-windows``: recordings, or a table of sequences, into windows for motion prediction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
import msgspec

from prbench.cli import builds
from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, note, progress
from prbench.entry_points import CORPORA, load_built_in
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.engine.choice import EngineChoice
    from prbench.engine.shards import ShardRecord
    from prbench_benchmarks.motion_prediction.table import WindowsInfo


class WindowsReport(msgspec.Struct, frozen=True, kw_only=True):
    """The work of ``build-windows``.

    Attributes:
        folder: The table of windows that was written; null with ``--shard``.
        built: The content of its ``windows.json``; null with ``--shard``.
        shard: The shard that was made, with ``--shard``; else null.
    """

    folder: Path | None = None
    built: WindowsInfo | None = None
    shard: opt.MadeShard | None = None


@command(
    "build-windows",
    section="data",
    example="prbench build-windows mogaze --root /data/MoGaze --out windows/mogaze --workers 4",
    report=WindowsReport,
)
@click.argument("dataset", required=False)
@opt.root_option(required=False)
@opt.path_option("--data", "In place of a dataset, a built table: windows at its events.", metavar="DIR")
@opt.out_folder_option("Folder of the windows; earlier ones are replaced once the new ones are ready.", required=True)
@click.option(
    "--anchor",
    "anchors",
    multiple=True,
    metavar="NAME",
    help="With --data: windows at this anchor alone, prime or event-2, event-1.5, event-1, event-0.5; repeatable.",
)
@click.option(
    "--joints",
    type=click.Choice(["native", "smpl22"]),
    help="Joints that a study scored (default for mogaze and gimo), or the 22 joints of any dataset.",
)
@opt.recordings_options
@opt.stream_options
@opt.on_error_option()
@opt.reader_options()
@opt.engine_options()
@opt.shard_option("the dataset's recordings")
def build_windows(
    *,
    dataset: str | None,
    root: Path | None,
    data: Path | None,
    out: Path,
    anchors: tuple[str, ...],
    joints: Literal["native", "smpl22"] | None,
    recordings: str,
    max_recordings: int | None,
    shift: opt.Pairs,
    scale: opt.Pairs,
    on_error: Literal["skip", "fail"],
    options: opt.Pairs,
    engine: EngineChoice,
    shard: str | None,
) -> Answer:
    """Cut recordings into windows for motion prediction: half a second to observe, two seconds to predict.

    DATASET is its name, for example mogaze (`prbench datasets` lists them).
    """
    if (data is None) is (dataset is None) or (dataset is None) is not (root is None):
        raise UsageError("expected either DATASET with --root DIR, or --data DIR alone.")
    part = opt.chosen_shard(shard, data=data)
    if anchors and data is None:
        raise UsageError("--anchor: belongs to --data; windows of recordings slide.")
    if data is not None:
        from prbench_benchmarks.motion_prediction.anchored import build_anchored_windows

        if joints or recordings != "*" or max_recordings or options or shift or scale:
            raise UsageError("--data: a built table has its recordings and joints; leave the other options out.")
        return windows_answer(build_anchored_windows(data, out, only=anchors), out)
    assert dataset is not None
    assert root is not None
    from prbench.curation.mending import stream_numbers
    from prbench_benchmarks.motion_prediction.windows import build_windows as build
    from prbench_benchmarks.motion_prediction.windows import build_windows_shard, plan_windows

    # Nymeria has no reader of recordings: its windows are cut where its corpus is read.
    planner = load_built_in(CORPORA, "windows") if dataset == "nymeria" else plan_windows
    given: dict[str, Any] = {"joints": joints, "recordings": recordings, "limit": max_recordings}
    mending = {"shift": stream_numbers(shift or {}, "shift"), "scale": stream_numbers(scale or {}, "scale")}
    if dataset != "nymeria":
        given |= mending
    elif any(mending.values()):
        raise UsageError("--shift, --scale: the streams of Nymeria are aligned (`prbench align`); leave them out.")
    plan = planner(dataset, root, reader=tuple(options.items()), **given)
    where = opt.opened(engine, reads=(root,), writes=(out,))
    if part is None:
        with progress(f"cutting {dataset}") as tell:
            report = build(plan, out, on_error=on_error, engine=where, progress=tell)
        builds.note_findings(report.records)
        return windows_answer(report.info, out)
    with progress(f"cutting shard {part} of {dataset}") as tell:
        done = build_windows_shard(plan, out, part, on_error=on_error, engine=where, progress=tell)
    builds.note_findings(done.records)
    for each in done.records:
        if each.status != "read":
            note(f"{each.recording_id}: {each.status}: {each.message}")
    report = builds.made_shard(done, len(done.records))
    exit_code = 0 if all(each.status != "failed" for each in done.records) else builds.NOT_EVERYTHING
    return opt.shard_answer(WindowsReport(shard=report), report, unit="recordings", exit_code=exit_code)


def windows_answer(info: WindowsInfo, folder: Path) -> Answer:
    """Answer a command that has written a table of windows."""
    if info.estimated_bodies:
        note("bodies were estimated from whole tracks of the head: an observed frame may carry later head motion")
    rows = [(name, str(getattr(info, name))) for name in ("participants", "recordings", "runs", "frames")]
    for outcome, number in info.outcomes.items():
        rows.append(("windows" if outcome == "window" else f"windows: {outcome}", str(number)))
    title = f"{info.title}: {info.joint_set}, {info.fps:g} frames a second"
    return builds.answer_of_table(WindowsReport(folder=folder, built=info), info, title, rows, f"windows: {folder}")


def merged_windows(shards: Sequence[tuple[Path, ShardRecord]], out: Path) -> Answer:
    """Put the shards of a table of windows together, and answer as the command that makes a whole table does."""
    from prbench_benchmarks.motion_prediction.windows import merge_windows_shards

    made = merge_windows_shards(shards, out)
    return windows_answer(made.info, made.folder)
