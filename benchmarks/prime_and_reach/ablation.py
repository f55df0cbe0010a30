"""``prbench study ITEM --train``: train and run the rows of Tables 3, 4, S4 to S7, and make the table of what there is.

Every step goes into a folder that its content names, so that the same command goes on with what an interruption has
left, and rows that share a training or a run share its folder. When a row fails, the others go on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from prbench.board import collect_runs, make_leaderboard
from prbench.board.collect import Check
from prbench.board.export import part_title, table_notes
from prbench.board.tables import TableRow, of_all_methods
from prbench.contract import Condition
from prbench.engine import Engine
from prbench.errors import UsageError
from prbench.harness.methods.installed import load_task
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import FILE_NAME as RUN
from prbench.protocol.published import DATASETS, load_published, published_table
from prbench.tables import Block, Column, Row, Table
from prbench_adapters.training.ablations import Ablation, load_ablations, overrides
from prbench_adapters.training.report import WEIGHTS
from prbench_adapters.training.rows import PAPER, RUNS, SMOKE, RowsRequest, Say, row_by_row, training_stamp
from prbench_adapters.training.run import TrainRequest, resolved, train
from prbench_benchmarks.prime_and_reach.study.methods import (
    CONDITION_COLUMN,
    METRIC_COLUMNS,
    measured_row,
    measured_title,
    part_of,
    published_rows,
)

# Tables of ablations, as the study numbers them.
TABLES = tuple(dict.fromkeys(row.table for row in load_ablations()))
# Options of an optimisation at smoke size.
_FEW_ITERATIONS = {"iterations": "2", "ddim-steps": "2"}
_COLUMNS = (CONDITION_COLUMN, Column(key="method", title="Variant", text=True), *METRIC_COLUMNS)


@dataclass(frozen=True, kw_only=True)
class AblationRequest(RowsRequest):
    """The rows of one table, trained and run.

    Raises:
        UsageError: for a table without rows, or a row that nothing can be pre-trained on.

    Attributes:
        table: ``3``, ``4`` or ``S4`` to ``S7``.
        corpora: Maps ``nymeria`` and ``humanml3d`` to built corpus folders.
    """

    table: str
    corpora: Mapping[str, Path] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.table not in TABLES:
            raise UsageError(f"no ablations in table '{self.table}'; those of the study are: {', '.join(TABLES)}.")
        if not self.data:
            raise UsageError("an ablation needs one dataset folder or more (--data DIR).")
        if self.configuration == SMOKE:
            return
        for row in self.rows:
            if row.pretraining != "none" and row.pretraining not in self.corpora:
                remedy = f"name its folder with --{row.pretraining} DIR (`prbench build-corpus` builds it)."
                raise UsageError(f"table {self.table}, '{row.variant}': is pre-trained on {row.pretraining}; {remedy}")

    @property
    def rows(self) -> tuple[Ablation, ...]:
        """The rows of the table in printed order."""
        return tuple(row for row in load_ablations() if row.table == self.table)

    def options_of(self, row: Ablation) -> dict[str, str]:
        """Return the options of a row's run; at smoke size an optimisation takes few steps."""
        options = dict(row.options)
        if self.configuration == SMOKE and options.get("optimise") != "off":
            options |= _FEW_ITERATIONS
        return options


def run_ablation(request: AblationRequest, *, engine: Engine, say: Say) -> tuple[list[Path], dict[str, str]]:
    """Pre-train, fine-tune and run each row; what is finished is not done again.

    Returns:
        The run folders, and the reason for each row that failed.

    Raises:
        StorageError: if a file cannot be written.
        TrainingStopped: after SIGTERM or Ctrl-C; everything was saved.
    """
    runs: list[Path] = []
    same = {"configuration": request.configuration, "device": request.device, "threads": request.threads}

    def work(row: Ablation) -> None:
        initial = None
        if row.pretraining != "none":
            prior = request.folder / row.prior_name
            say(f"pre-training for '{row.variant}': {prior}")
            data = (request.corpora[row.pretraining],) if row.pretraining in request.corpora else request.data
            changes = overrides(row.pretrained_model)
            train(TrainRequest(method="mdm", stage="pretrain", data=data, out=prior, overrides=changes, **same))
            initial = prior / WEIGHTS
        trained = request.folder / row.training_name
        say(f"fine-tuning '{row.variant}': {trained}")
        learnt = {"data": request.data, "out": trained, "overrides": overrides(row.model), "initial": initial}
        train(TrainRequest(method="pr", stage="finetune", **learnt, **same))
        out = request.folder / RUNS / row.run_name
        say(f"running '{row.variant}': {out}")
        asked = {name: getattr(request, name) for name in ("data", "limit", "seed", "device", "threads")}
        asked |= {"weights": trained / WEIGHTS, "options": request.options_of(row), "out": out}
        run_method(RunRequest(method="pr", condition=Condition.GOAL_LOCATION, **asked), engine=engine)
        runs.append(out)

    failed = row_by_row(request.rows, work, name=lambda row: row.variant, say=say)
    return list(dict.fromkeys(runs)), failed


# The table of what is there.


def ablation_table(number: str, folder: Path, check: Check | None, *, with_published: bool) -> list[Table]:
    """Make a table of ablations from a folder that ``prbench study ITEM --train`` has filled, a part for each dataset.

    Args:
        number: ``3``, ``4`` or ``S4`` to ``S7``.
        folder: Folder of one configuration.
        check: Holds the scores against the motions.
        with_published: Show the study's rows in a block of their own.

    Raises:
        RunError: if there is no run of it in the folder, or one was edited.
    """
    rows = [row for row in load_ablations() if row.table == number]
    names = {row.run_name for row in rows}
    runs = [folder / RUNS / name for name in sorted(names) if (folder / RUNS / name / RUN).is_file()]
    board = make_leaderboard(collect_runs(runs or [folder / RUNS], check=check))
    published = []
    for dataset in DATASETS if with_published else ():
        numbers = [each for each in load_published(number) if each.dataset == dataset]
        title = f"Published: Prime and Reach, Table {number}, {dataset}"
        published.append(Block(title=title, rows=published_rows(numbers, lambda each: each.variant)))
    parts = []
    for table in of_all_methods(board.tables):
        by_name = {row.entry.run: row for row in table.rows}
        found = [(row, by_name[row.run_name]) for row in rows if row.run_name in by_name]
        missing = [row for row in rows if row.run_name not in by_name]
        stamps = {row.variant: ablation_stamp(row, run, folder) for row, run in found}
        measured = []
        for row, run in found:
            about = {"condition": row.condition, "variant": row.variant, "note": stamps[row.variant]}
            measured.append(measured_row(run, table, row.condition, row.variant, **about))
        lines = [Row(text={"condition": row.condition, "method": row.variant}) for row in missing]
        blocks = [Block(title=measured_title(table), rows=tuple(measured))]
        blocks.append(Block(title="Not run, or not finished", rows=tuple(lines)))
        notes = [f"{variant}: {stamp}." for variant, stamp in stamps.items() if stamp]
        notes += [*table_notes(table), *published_table(number).notes]
        # The first stamp stands in the title: one such row already makes a table that says nothing.
        about = {"columns": _COLUMNS, "stamp": next(filter(None, stamps.values()), "")}
        parts.append(part_of(number, table, part_title(table), (*blocks, *published), notes, **about))
    return parts


def ablation_stamp(row: Ablation, run: TableRow, folder: Path) -> str:
    """Return what sets a run and its training apart from the study's; empty if nothing does."""
    wanted = resolved(load_task("pr"), PAPER, stage="finetune", overrides=overrides(row.model))[1]
    method = run.entry.record.method
    if stamp := training_stamp(folder / row.training_name, method.weights_digest, wanted):
        return stamp
    return "" if method.options == dict(row.options) else "OTHER OPTIONS THAN THE STUDY'S ROW"
