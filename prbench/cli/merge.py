"""``prbench merge``: the shards of a build or run as one table, corpus or run folder; runs on all folds as one run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace as with_values
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.build_corpus import corpus_answer
from prbench.cli.build_dataset import table_answer
from prbench.cli.build_windows import WindowsBuilt, windows_answer
from prbench.cli.builds import BuiltTable
from prbench.cli.checked_runs import run_checker
from prbench.cli.commands import Answer, command, note
from prbench.cli.options import PATH, data_option, out_folder_option, replace_option, workers_option
from prbench.cli.progress import progress
from prbench.cli.run_answer import MadeRun, run_answer
from prbench.cli.summaries import print_summary
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.harness.run_folder.summary import DatasetSummary


class MergeReport(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a merge.

    Attributes:
        kind: ``dataset``, ``corpus``, ``windows`` or ``run`` of shards, or ``folds``.
        shards: Number of shards, or of runs on folds.
        table: The table or corpus that was written; null for others.
        windows: The table of windows that was written; null for others.
        run: The run that was put together and scored; null for others.
        folds: Scores of the runs on all folds as one; null for others.
        unverified: A sentence for each run on a fold whose scores could not be held against its motions.
    """

    kind: str
    shards: int
    table: BuiltTable | None = None
    windows: WindowsBuilt | None = None
    run: MadeRun | None = None
    folds: DatasetSummary | None = None
    unverified: list[str] = []


@command("merge", example="prbench merge shards/adt-* --out tables/adt", report=MergeReport, resumes=True)
@click.argument("parts", type=PATH, nargs=-1, required=True, metavar="DIR...")
@out_folder_option("Folder of the table, corpus, windows or run.", required=True)
@data_option(
    required=False,
    help="Tables of a run, where they no longer lie where its shards found them; of runs on folds, the tables on which"
    " their scores are checked.",
)
@replace_option("table or corpus")
@workers_option(help="Processes that score a run (default 1); changes no result.")
def merge(parts: tuple[Path, ...], out: Path, data: tuple[Path, ...], replace: bool, workers: int) -> Answer:
    """Put the shards of a build or run together, with the bytes of an unsharded one, or runs on folds as one run.

    DIR... are the folders of all shards of one `prbench build-dataset`, `build-corpus`, `build-windows` or `run` with
    --shard K/N, in any order, of which a run is scored here; or the runs of a method on all folds of a dataset, made by
    `prbench run --split participants --fold K/N`.
    """
    from prbench.engine.shards import FILE_NAME, require_whole
    from prbench.harness.run_folder.record import FILE_NAME as RUN_FILE

    if (parts[0] / RUN_FILE).is_file() and not (parts[0] / FILE_NAME).is_file():
        if replace:
            raise UsageError("--replace: belongs to a dataset or corpus; these are runs on folds. Leave it out.")
        return _merged_folds(parts, out, data, workers)
    if out.resolve() in [folder.resolve() for folder in parts]:
        raise UsageError(f"--out {out}: is one of the shards. Choose another folder.")
    opened = require_whole(parts)
    kind = opened[0][1].kind
    if data and kind != "run":
        raise UsageError(f"--data: belongs to shards of a run; these are of a {kind}. Leave it out.")
    if replace and kind not in ("dataset", "corpus"):
        raise UsageError(f"--replace: belongs to a dataset or corpus; these are shards of a {kind}. Leave it out.")
    report = MergeReport(kind=kind, shards=len(parts))
    if kind == "dataset":
        from prbench.curation.build import merge_dataset_shards

        answer = table_answer(merge_dataset_shards(opened, out, replace=replace))
        report = msgspec.structs.replace(report, table=answer.report.built[0])
    elif kind == "corpus":
        from prbench.corpora.build import merge_corpus_shards

        answer = corpus_answer(merge_corpus_shards(opened, out, replace=replace))
        report = msgspec.structs.replace(report, table=answer.report.built[0])
    elif kind == "windows":
        from prbench.curation.window_building import merge_windows_shards

        made = merge_windows_shards(opened, out)
        answer = windows_answer(made.info, made.folder)
        report = msgspec.structs.replace(report, windows=answer.report.built)
    else:
        from prbench.engine import engine_for
        from prbench.harness.sharded import merge_run_shards

        with progress("merging") as tell:
            run = merge_run_shards(
                opened,
                out,
                data=data,
                engine=engine_for(workers),
                progress=lambda step: tell(step.done, step.total, f"{step.stage} {step.dataset}"),
            )
        answer = run_answer([run], single=bool(run.folder.record.sequences))
        report = msgspec.structs.replace(report, run=answer.report.runs[0])
    return with_values(answer, report=report)


def _merged_folds(runs: Sequence[Path], out: Path, data: tuple[Path, ...], workers: int) -> Answer:
    from prbench.board.merging import merge_folds

    merged = merge_folds(runs, checker=run_checker(data, workers))
    protocol = merged.folds[0].protocol
    if protocol is not None and protocol.is_own:
        note(f"scored under a protocol of your own, {protocol.label}: no number here is the study's")
    merged.write(out)
    method = merged.record.method
    report = MergeReport(kind="folds", shards=len(runs), folds=merged.summary, unverified=list(merged.unverified))

    def show() -> None:
        print_summary(merged.summary, origin=method.origin, motionless=method.motionless)
        for reason in merged.unverified:
            print(f"unverified: {reason}")
        print(f"run folder: {out}")

    return Answer(report, show)
