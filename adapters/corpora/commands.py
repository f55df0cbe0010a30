"""``prbench build-corpus``: text-motion data into a corpus for pre-training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

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
from prbench.cli.commands import Answer, command, progress
from prbench.cli.options import (
    POSITIVE,
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
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.curation.provenance import FunnelRow
    from prbench.engine import Engine
    from prbench.engine.choice import EngineChoice
    from prbench.engine.shards import Shard, ShardRecord
    from prbench_adapters.corpora import CorpusOptions, CorpusReport

_SYNTHETIC = "synthetic"
"""Corpus that is generated on the spot."""


@command(
    "build-corpus",
    section="data",
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
    from prbench_adapters.corpora import CorpusOptions

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
        raise UsageError("--count: belongs to the corpus 'synthetic'; --max-recordings N takes the first N that exist.")
    return tuple(sorted(given.items()))


def _plan(corpus: str, root: Path | None, options: CorpusOptions, workers: int) -> Answer:
    from prbench_adapters.corpora import plan_corpus

    plan = planned(plan_corpus(corpus, root, options), workers, dataset=corpus, root=root)
    return Answer(BuildsReport(built=[], not_built=[], planned=[plan]), lambda: print_plan(plan, unfit="unfit"))


def _build(corpus: str, root: Path | None, out: Path, options: CorpusOptions, engine: Engine) -> Answer:
    from prbench_adapters.corpora import build_corpus as build

    with progress(f"building {corpus}") as tell:
        report = build(corpus, root, out, options=options, engine=engine, progress=tell)
    return _corpus_answer(report)


def _build_shard(
    corpus: str, root: Path | None, out: Path, shard: Shard, options: CorpusOptions, engine: Engine
) -> Answer:
    from prbench_adapters.corpora.build import build_corpus_shard

    with progress(f"building shard {shard} of {corpus}") as tell:
        report = build_corpus_shard(corpus, root, out, shard, options=options, engine=engine, progress=tell)
    note_unread(report.records, reused=report.reused)
    made = made_shard(report, made_of=len(shard.places(report.planned)))
    failed = any(record.status == "failed" for record in report.records)
    answer = BuildsReport(built=[], not_built=[], planned=[], shard=made)
    return shard_answer(answer, made, unit="groups of recordings", exit_code=NOT_EVERYTHING if failed else 0)


def merge_corpus(shards: Sequence[tuple[Path, ShardRecord]], out: Path, *, replace: bool) -> Answer:
    """Answer ``prbench merge`` for shards of a corpus (:func:`prbench_adapters.corpora.build.merge_corpus_shards`)."""
    from prbench_adapters.corpora.build import merge_corpus_shards

    return _corpus_answer(merge_corpus_shards(shards, out, replace=replace))


def _corpus_answer(report: CorpusReport) -> Answer:
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
