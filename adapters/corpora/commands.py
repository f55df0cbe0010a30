"""``prbench build-corpus``: text-motion data into a corpus for pre-training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from prbench.cli import builds
from prbench.cli import options as opt
from prbench.cli.commands import Answer, command, progress
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.engine.choice import EngineChoice
    from prbench.engine.shards import ShardRecord
    from prbench.sequences.parts import BuildReport

_SYNTHETIC = "synthetic"  # Corpus that is generated on the spot.


@command(
    "build-corpus",
    section="data",
    example="prbench build-corpus nymeria --root /data/Nymeria --out corpora/nymeria --workers 4",
    resumes=True,
    report=builds.BuildsReport,
)
@click.argument("corpus")
@opt.root_option("Your copy of the dataset (not for synthetic).", required=False)
@opt.out_folder_option(
    "Folder of the corpus; an earlier one is replaced once the new one is ready, if that lacks nothing."
)
@opt.replace_option("corpus")
@opt.recordings_options
@opt.count_option("Number of synthetic recordings to make (only for synthetic; default 40).")
@opt.seed_option("of a synthetic corpus")
@click.option("--fps", type=opt.RATE, metavar="N", help="Frames a second of the clips (default 20).")
@opt.number_option("--max-frames", "Cut clips that have more frames (default: 12 s).")
@opt.flag("--dry-run", "Say what would be read, and write nothing.")
@opt.on_error_option()
@opt.reader_options("corpus'")
@opt.engine_options()
@opt.shard_option("the groups of recordings")
def build_corpus(
    *,
    corpus: str,
    root: Path | None,
    out: Path | None,
    count: int | None,
    seed: int,
    max_recordings: int | None,
    dry_run: bool,
    options: opt.Pairs,
    engine: EngineChoice,
    shard: str | None,
    **given: Any,
) -> Answer:
    """Turn text-motion data into a corpus for pre-training.

    CORPUS is nymeria, humanml3d or synthetic.
    """
    from prbench_adapters.corpora.build import plan_corpus
    from prbench_adapters.corpora.sources import CorpusOptions

    part = opt.chosen_shard(shard, replace=given["replace"], dry_run=dry_run)
    source = options
    if corpus == _SYNTHETIC:  # number and seed of synthetic recordings are options of their reader
        source = {"seed": str(seed), **source}
        if count is not None:
            source = {"recordings": str(count), **source}
    elif count is not None:
        raise UsageError("--count: belongs to the corpus 'synthetic'; --max-recordings N takes the first N that exist.")
    chosen = CorpusOptions(limit=max_recordings, source=tuple(sorted(source.items())), **given)
    if dry_run:
        workers = engine if isinstance(engine, int) else 1
        plan = plan_corpus(corpus, root, chosen)
        return Answer(builds.BuildsReport(planned=[plan]), lambda: builds.print_plan(plan, workers, unfit="unfit"))
    if out is None:
        raise UsageError("--out DIR is needed: the folder of the corpus. (--dry-run does without.)")
    where = opt.opened(engine, reads=() if root is None else (root,), writes=(out,))
    with progress(f"building {f'shard {part} of ' if part else ''}{corpus}") as tell:
        if part is None:
            from prbench_adapters.corpora.build import build_corpus as build

            return _corpus_answer(build(corpus, root, out, options=chosen, engine=where, progress=tell))
        from prbench_adapters.corpora.build import build_corpus_shard

        report = build_corpus_shard(corpus, root, out, part, options=chosen, engine=where, progress=tell)
    builds.note_unread(report.records, reused=report.reused)
    complete = all(record.status != "failed" for record in report.records)
    return builds.shard_answer(report, len(part.places(report.planned)), unit="groups of recordings", complete=complete)


def merge_corpus(shards: Sequence[tuple[Path, ShardRecord]], out: Path, *, replace: bool) -> Answer:
    """Answer ``prbench merge`` for shards of a corpus (:func:`prbench_adapters.corpora.build.merge_corpus_shards`)."""
    from prbench_adapters.corpora.build import merge_corpus_shards

    return _corpus_answer(merge_corpus_shards(shards, out, replace=replace))


def _corpus_answer(report: BuildReport) -> Answer:
    """Answer a command that has written a corpus."""
    builds.note_unread(report.records, reused=report.reused)
    # Count what is left from files to captions.
    counts = report.info.counts
    left_out = counts.recordings_failed + counts.recordings_skipped
    why = f"{counts.recordings_failed} failed, {counts.recordings_skipped} skipped" if left_out else ""
    stages = [
        ("recordings found", counts.recordings_found, 0, ""),
        ("recordings read", counts.recordings_read, left_out, why),
        ("texts", counts.annotations, 0, ""),
    ]
    kept = counts.annotations
    for outcome, number in report.info.outcomes.items():
        if number and outcome != "clip":
            kept -= number
            stages.append((f"without {outcome}", kept, number, _REASONS[outcome]))
    stages.append(("captions", counts.captions, 0, f"of {counts.clips} clips, {counts.frames} frames"))

    def show() -> None:
        builds.print_stages(f"{report.info.title}: from files to clips", stages)
        if marked := counts.approximate_clips:
            print(f"{marked} clips are marked approximate: their texts were placed by aligning starts")
        print(f"corpus: {report.folder}")

    exit_code = builds.NOT_EVERYTHING if counts.recordings_failed else 0
    return Answer(builds.BuildsReport(built=builds.built(report)), show, exit_code)


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
