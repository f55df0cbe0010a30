"""``prbench merge``: the shards of a build or run as one table, corpus or run folder."""

from __future__ import annotations

from dataclasses import replace as with_values
from pathlib import Path
from typing import Literal

import click
import msgspec

from prbench.cli.build_corpus import corpus_answer
from prbench.cli.build_dataset import table_answer
from prbench.cli.build_windows import WindowsBuilt, windows_answer
from prbench.cli.builds import BuiltTable
from prbench.cli.commands import Answer, command
from prbench.cli.options import PATH, data_option, out_folder_option, replace_option, workers_option
from prbench.cli.progress import progress
from prbench.cli.run_answer import MadeRun, run_answer


class MergedShards(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a merge.

    Attributes:
        kind: ``dataset``, ``corpus``, ``windows`` or ``run``.
        shards: Number of shards.
        table: The table or corpus that was written; null for others.
        windows: The table of windows that was written; null for others.
        run: The run that was put together and scored; null for others.
    """

    kind: Literal["dataset", "corpus", "windows", "run"]
    shards: int
    table: BuiltTable | None = None
    windows: WindowsBuilt | None = None
    run: MadeRun | None = None


@command(
    "merge",
    example="prbench merge shards/adt-* --out tables/adt",
    report=MergedShards,
    resumes=True,
)
@click.argument("shards", type=PATH, nargs=-1, required=True, metavar="DIR...")
@out_folder_option("Folder of the table, corpus, windows or run.", required=True)
@data_option(required=False, help="Tables of a run, where they no longer lie where its shards found them.")
@replace_option("table or corpus")
@workers_option(help="Processes that score a run (default 1); changes no result.")
def merge(shards: tuple[Path, ...], out: Path, data: tuple[Path, ...], replace: bool, workers: int) -> Answer:
    """Put the shards of a build or run together, with the bytes of an unsharded one.

    DIR... are the folders of all shards of one `prbench build-dataset`, `build-corpus`, `build-windows` or `run` with
    --shard K/N, in any order. A run is scored here.
    """
    from prbench.corpora import CorpusReport
    from prbench.curation import BuildReport
    from prbench.curation.window_building import WindowsReport
    from prbench.engine import engine_for
    from prbench.workflows.merging import merge as merge_shards

    with progress("merging") as tell:
        report = merge_shards(
            shards,
            out,
            data=data,
            replace=replace,
            engine=engine_for(workers),
            progress=lambda step: tell(step.done, step.total, f"{step.stage} {step.dataset}"),
        )
    number = len(shards)
    if isinstance(report, BuildReport):
        answer = table_answer(report)
        merged = MergedShards(kind="dataset", shards=number, table=answer.report.built[0])
    elif isinstance(report, CorpusReport):
        answer = corpus_answer(report)
        merged = MergedShards(kind="corpus", shards=number, table=answer.report.built[0])
    elif isinstance(report, WindowsReport):
        answer = windows_answer(report.info, report.folder)
        merged = MergedShards(kind="windows", shards=number, windows=answer.report.built)
    else:
        answer = run_answer([report], single=bool(report.folder.record.sequences))
        merged = MergedShards(kind="run", shards=number, run=answer.report.runs[0])
    return with_values(answer, report=merged)
