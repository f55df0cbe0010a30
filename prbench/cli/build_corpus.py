"""``prbench build-corpus``: text-motion data into a corpus for pre-training.

``prbench build-windows``: recordings, or a table of sequences, into windows for motion prediction.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click
import msgspec

from prbench.cli.builds import (
    NOT_EVERYTHING,
    BuildsReport,
    BuiltTable,
    built_table,
    made_shard,
    note_unread,
    planned,
    print_plan,
    print_stages,
)
from prbench.cli.commands import Answer, command, note, progress
from prbench.cli.options import (
    PATH,
    POSITIVE,
    MadeShard,
    chosen_shard,
    count_option,
    engine_options,
    on_error_option,
    opened,
    out_folder_option,
    reader_options,
    recordings_options,
    replace_option,
    root_option,
    seed_option,
    shard_answer,
    shard_option,
)
from prbench.cli.terminal import print_table
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.corpora import CorpusOptions, CorpusReport
    from prbench.curation.provenance import FunnelRow
    from prbench.engine import Engine
    from prbench.engine.choice import EngineChoice
    from prbench.engine.shards import Shard
    from prbench.prediction.table import WindowsInfo


_SYNTHETIC = "synthetic"
"""Corpus that is generated on the spot."""


@command(
    "build-corpus",
    example="prbench build-corpus nymeria --root /data/Nymeria --out corpora/nymeria --workers 4",
    resumes=True,
    report=BuildsReport,
)
@click.argument("corpus")
@root_option("Your copy of the dataset (not for synthetic).", required=False)
@out_folder_option("Folder of the corpus; an earlier one is replaced once the new one is ready, if that lacks nothing.")
@replace_option("corpus")
@recordings_options
@count_option("Number of synthetic recordings to make (only for synthetic; default 40).")
@seed_option("of a synthetic corpus")
@click.option("--fps", type=float, metavar="N", help="Frames a second of the clips (default 20).")
@click.option("--max-frames", type=POSITIVE, metavar="N", help="Cut clips that have more frames (default: 12 s).")
@click.option("--dry-run", is_flag=True, help="Say what would be read, and write nothing.")
@on_error_option()
@reader_options("corpus'")
@engine_options()
@shard_option("the groups of recordings")
def build_corpus(
    *,
    corpus: str,
    root: Path | None,
    out: Path | None,
    replace: bool,
    recordings: str,
    max_recordings: int | None,
    count: int | None,
    seed: int,
    fps: float | None,
    max_frames: int | None,
    dry_run: bool,
    on_error: Literal["skip", "fail"],
    options: tuple[tuple[str, str], ...],
    engine: EngineChoice,
    shard: str | None,
) -> Answer:
    """Turn text-motion data into a corpus for pre-training.

    CORPUS is nymeria, humanml3d or synthetic.
    """
    from prbench.corpora import CorpusOptions

    part = chosen_shard(shard, replace=replace, dry_run=dry_run)
    chosen = CorpusOptions(
        fps=fps,
        max_frames=max_frames,
        recordings=recordings,
        limit=max_recordings,
        source=_source_options(corpus, dict(options), count=count, seed=seed),
        on_error=on_error,
        replace=replace,
    )
    if dry_run:
        return _plan(corpus, root, chosen, engine if isinstance(engine, int) else 1)
    if out is None:
        from prbench.errors import UsageError

        raise UsageError("--out DIR is needed: the folder of the corpus. (--dry-run does without.)")
    roots = () if root is None else (root,)
    where = opened(engine, reads=roots, writes=(out,))
    if part is not None:
        return _build_shard(corpus, root, out, part, chosen, where)
    return _build(corpus, root, out, chosen, where)


def _source_options(corpus: str, given: dict[str, str], *, count: int | None, seed: int) -> tuple[tuple[str, str], ...]:
    """Return the reader's options; number and seed of synthetic recordings are options of their reader.

    Raises:
        UsageError: for ``--count`` with a corpus that is read from files.
    """
    if corpus == _SYNTHETIC:
        given = {"seed": str(seed), **given}
        if count is not None:
            given = {"recordings": str(count), **given}
    elif count is not None:
        from prbench.errors import UsageError

        raise UsageError("--count: belongs to the corpus 'synthetic'; --max-recordings N takes the first N that exist.")
    return tuple(sorted(given.items()))


def _plan(corpus: str, root: Path | None, options: CorpusOptions, workers: int) -> Answer:
    from prbench.corpora import plan_corpus

    plan = planned(plan_corpus(corpus, root, options), workers, dataset=corpus, root=root)
    return Answer(BuildsReport(built=[], not_built=[], planned=[plan]), lambda: print_plan(plan, unfit="unfit"))


def _build(corpus: str, root: Path | None, out: Path, options: CorpusOptions, engine: Engine) -> Answer:
    from prbench.corpora import build_corpus as build

    with progress(f"building {corpus}") as tell:
        report = build(corpus, root, out, options=options, engine=engine, progress=tell)
    return corpus_answer(report)


def _build_shard(
    corpus: str, root: Path | None, out: Path, shard: Shard, options: CorpusOptions, engine: Engine
) -> Answer:
    from prbench.corpora.build import build_corpus_shard

    with progress(f"building shard {shard} of {corpus}") as tell:
        report = build_corpus_shard(corpus, root, out, shard, options=options, engine=engine, progress=tell)
    note_unread(report.records, reused=report.reused)
    made = made_shard(report, made_of=len(shard.places(report.planned)))
    failed = any(record.status == "failed" for record in report.records)
    answer = BuildsReport(built=[], not_built=[], planned=[], shard=made)
    return shard_answer(answer, made, unit="groups of recordings", exit_code=NOT_EVERYTHING if failed else 0)


def corpus_answer(report: CorpusReport) -> Answer:
    """Answer a command that has written a corpus."""
    note_unread(report.records, reused=report.reused)
    table = built_table(report, _stages(report))
    return Answer(
        BuildsReport(built=[table], not_built=[], planned=[]),
        lambda: _print_corpus(table),
        NOT_EVERYTHING if report.info.counts.recordings_failed else 0,
    )


def _stages(report: CorpusReport) -> list[FunnelRow]:
    """Count what is left from files to captions."""
    from prbench.curation.provenance import FunnelRow

    counts = report.info.counts
    left_out = counts.recordings_failed + counts.recordings_skipped
    why = f"{counts.recordings_failed} failed, {counts.recordings_skipped} skipped" if left_out else ""
    stages = [
        FunnelRow("recordings found", counts.recordings_found, 0, ""),
        FunnelRow("recordings read", counts.recordings_read, left_out, why),
        FunnelRow("texts", counts.annotations, 0, ""),
    ]
    kept = counts.annotations
    for outcome, number in report.info.outcomes.items():
        if number and outcome != "clip":
            kept -= number
            stages.append(FunnelRow(f"without {outcome}", kept, number, _REASONS[outcome]))
    size = f"of {counts.clips} clips, {counts.frames} frames"
    return [*stages, FunnelRow("captions", counts.captions, 0, size)]


def _print_corpus(table: BuiltTable) -> None:
    print_stages(f"{table.title}: from files to clips", table.stages)
    approximate = table.counts["approximate_clips"]
    if approximate:
        print(f"{approximate} clips are marked approximate: their texts were placed by aligning starts")
    print(f"corpus: {table.folder}")


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
    from prbench.curation.window_building import build_planned_windows, build_windows_shard
    from prbench.workflows.build_windows import plan_windows

    plan = plan_windows(dataset, root, joints=joints, recordings=recordings, limit=max_recordings, reader=options)
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
