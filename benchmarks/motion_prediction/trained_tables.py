"""``prbench study prediction --train``: train and run every row of Tables 1, 2 and 3, and lay them out.

The windows of each dataset have networks of their own, as in the study. Every step goes into a folder named after its
row, so that the same command goes on with what an interruption has left. When a row fails, the others go on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import msgspec

from prbench.engine import Engine
from prbench.errors import UsageError
from prbench.harness.methods.installed import load_task
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import RunFolder
from prbench.tables import Table
from prbench_adapters.prediction.configuration import PRESETS
from prbench_adapters.training.ablations import overrides
from prbench_adapters.training.configuration import TrainingConfiguration, list_configurations
from prbench_adapters.training.report import WEIGHTS
from prbench_adapters.training.rows import PAPER, RUNS, SMOKE, RowsRequest, Say, row_by_row, training_stamp
from prbench_adapters.training.run import TrainRequest, resolved, train
from prbench_benchmarks.motion_prediction.benchmark import PUBLISHED
from prbench_benchmarks.motion_prediction.study_tables import TableRow, load_tables, prediction_tables, split_column
from prbench_benchmarks.motion_prediction.table import WindowsTable

CODE = "code"
_SAMPLES = 50  # K of the study
_FEW_SAMPLES = 5  # K at smoke size, for which DLow's is made
# Called with what is done, what there is in all, and what comes next.
Tell = Callable[[int, int, str], None]


class TrainedTables(msgspec.Struct, frozen=True, kw_only=True):
    """What one call has made.

    Attributes:
        tables: Maps each dataset to its tables.
        runs: Run folders that are finished.
        failed: Maps rows that failed, ``DATASET/ROW``, to the reasons.
    """

    tables: Mapping[str, list[Table]]
    runs: Sequence[Path]
    failed: Mapping[str, str]


def train_prediction(request: RowsRequest, *, engine: Engine, say: Say, tell: Tell) -> TrainedTables:
    """Train and run each row on each table of windows; what is finished is not done again.

    Args:
        request: Tables of windows, one a dataset, and how to train.
        engine: Generates and scores.
        say: Called with a line for every step that begins.
        tell: Called with the progress of each training and of the scoring.

    Raises:
        UsageError: for two tables of one dataset, or a configuration that a method does not have.
        TableError: if the windows cannot be read.
        StorageError: if a file cannot be written.
        TrainingStopped: after SIGTERM or Ctrl-C; everything was saved.
    """
    if request.configuration.endswith(".toml"):
        raise UsageError(f"--config {request.configuration}: rows are of several methods. Name a configuration of all.")
    opened: dict[str, WindowsTable] = {}
    for data in request.data:
        table = WindowsTable.open(data)
        other = opened.setdefault(table.info.dataset, table)
        if other is not table:
            raise UsageError(f"{data} and {other.folder} both hold {table.info.dataset}: name one table of a dataset.")
    rows = [row for row in load_tables().rows if row.weights]
    for row in rows:  # before anything is trained
        _resolved(row, _configuration(row, request.configuration))
    samples = _FEW_SAMPLES if request.configuration == SMOKE else _SAMPLES
    made: dict[str, list[Table]] = {}
    runs: list[Path] = []
    failed: dict[str, str] = {}
    for dataset, table in opened.items():
        folder = request.folder / dataset
        work = partial(_train_row, table=table, folder=folder, request=request, samples=samples)
        work = partial(work, engine=engine, say=say, tell=tell)
        reasons = row_by_row(rows, work, name=lambda row: row.name, say=say)
        finished = [row for row in rows if row.name not in reasons]
        own = [folder / RUNS / row.name for row in finished]
        about = {"failed": reasons, "samples": samples, "seed": request.seed, "device": request.device}
        limit = None if own else request.limit  # runs tell their windows
        tables = prediction_tables(table.folder, own, limit=limit, progress=tell, **about)
        made[dataset] = _stamped(tables, finished, table, folder)
        runs += own
        failed |= {f"{dataset}/{name}": reason for name, reason in reasons.items()}
    return TrainedTables(tables=made, runs=runs, failed=failed)


def _configuration(row: TableRow, asked: str) -> str:
    """Return the configuration of a row: ``code`` means ``paper`` for methods whose only source is their program."""
    task = load_task(row.method)
    only_one = asked == CODE and CODE not in list_configurations(task.configurations, task.name)
    return PAPER if only_one else asked


def _resolved(row: TableRow, configuration: str, *changes: tuple[str, str]) -> TrainingConfiguration:
    task = load_task(row.method)
    return resolved(task, configuration, stage=task.stages[-1], overrides=changes)[1]


def _changes(row: TableRow, table: WindowsTable) -> tuple[tuple[str, str], ...]:
    """Return the keys in which the training of a row differs from its method's configuration."""
    # Only the part that is removed: the rest of the network is the configuration's.
    model = dict(PRESETS[row.weights]) if row.is_ablation else {}
    model["windows.condition"] = row.condition.value
    if split_column(table) == "published_split":
        model["windows.split"] = PUBLISHED  # what is tested must not be learnt from
    return overrides(model)


def _train_row(
    row: TableRow,
    *,
    table: WindowsTable,
    folder: Path,
    request: RowsRequest,
    samples: int,
    engine: Engine,
    say: Say,
    tell: Tell,
) -> None:
    """Train all stages of a row, each from the weights of the one before, and run it."""
    same = {"data": (table.folder,), "device": request.device, "threads": request.threads}
    learnt = {"method": row.method, "overrides": _changes(row, table)}
    learnt["configuration"] = _configuration(row, request.configuration)
    initial = folder / row.starts_from / WEIGHTS if row.starts_from else None
    stages = load_task(row.method).stages
    for stage in stages:
        name = row.weights if stage == stages[-1] else f"{row.weights}-{stage}"
        out = folder / name
        say(f"training '{row.label}': {out}")
        train(
            TrainRequest(stage=stage, out=out, initial=initial, **learnt, **same),
            report=lambda now, name=name: tell(now.step, now.steps, name),
        )
        initial = out / WEIGHTS
    out = folder / RUNS / row.name
    say(f"running '{row.label}': {out}")
    split = PUBLISHED if split_column(table) == "published_split" else "test"
    asked = {"weights": initial, "split": split, "limit": request.limit, "samples": samples, "seed": request.seed}
    of_row = {"benchmark": "motion-prediction", "method": row.method, "condition": row.condition.value}
    run_method(RunRequest(out=out, **asked, **of_row, **same), engine=engine)


def _stamped(tables: Sequence[Table], rows: Sequence[TableRow], table: WindowsTable, folder: Path) -> list[Table]:
    """Say in the title and below what sets the trainings behind the rows apart from the study's."""
    stamps = {}
    for row in rows:
        digest = RunFolder.open(folder / RUNS / row.name, any_benchmark=True).record.method.weights_digest
        stamp = training_stamp(folder / row.weights, digest, _resolved(row, PAPER, *_changes(row, table)))
        if stamp:
            stamps[row] = stamp
    stamped = []
    for each in tables:
        # The table without a number compares conditions, in which ablations have no share.
        shown = [row for row in stamps if (each.number in row.tables if each.number else not row.is_ablation)]
        own = {row.label: stamps[row] for row in shown}
        notes = (*(f"{label}: {stamp}." for label, stamp in own.items()), *each.notes)
        stamped.append(msgspec.structs.replace(each, stamp=next(iter(own.values()), ""), notes=notes))
    return stamped
