"""Score the answers of a finished run again, from what its record says."""

from __future__ import annotations

from prbench.engine import Engine
from prbench.errors import RunError
from prbench.harness.benchmark import CaseTable, load_benchmark
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.coded_scores import CodedScores
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import RunRecord
from prbench.protocol.own_protocol import FILE_NAME as PROTOCOL_FILE


def scored_again(run: RunFolder, table: CaseTable, engine: Engine) -> CodedScores:
    """Return the rows of ``scores.parquet`` that the answers of a run have now.

    Args:
        run: The run; its answers lie in its folder.
        table: The table that it was made on.
        engine: Where to score.

    Raises:
        RunError: if the run is of another table.
        PredictionsError: if answers are missing, or one cannot be scored.
    """
    record = run.record
    require_same_table(run, table)
    benchmark = load_benchmark(record.benchmark)
    request = _request_of(run, table)
    rules = benchmark.rules(request, [table])
    chosen = next(iter(benchmark.choose(request, [table])))
    cases = benchmark.answerable(request, chosen, record.method)
    condition = benchmark.condition(record.condition)
    work = benchmark.work(request, cases, method=record.method, condition=condition, rules=rules)
    return CodedScores.of(work.scores(run.dataset(table.info.dataset), engine))


def _request_of(run: RunFolder, table: CaseTable) -> RunRequest:
    """Return the request of a run for one of its tables, as far as its scores depend on it."""
    record = run.record
    own_protocol = run.path / PROTOCOL_FILE
    there = load_benchmark(record.benchmark).recordings_of(table) if record.sequences else {}
    return RunRequest(
        method=record.method.name,
        data=(table.folder,),
        benchmark=record.benchmark,
        condition=record.condition,
        split=record.split,
        limit=record.limit,
        sequences=tuple(name for name in record.sequences if name in there),
        seed=record.seed,
        samples=record.samples,
        batch_size=_of_table(record, table).batch_plan.batch_size or 1,
        control=record.control,
        protocol=own_protocol if own_protocol.is_file() else None,
    )


def require_same_table(run: RunFolder, table: CaseTable) -> None:
    """Refuse a table that a run was not made on.

    Raises:
        RunError: naming the digest that differs.
    """
    run.dataset(table.info.dataset)
    recorded = _of_table(run.record, table)
    for key, found in (("identity_digest", table.identity), ("content_digest", table.content)):
        expected = getattr(recorded, key)
        if expected != found:
            raise RunError(
                f"{run.path / run_record.FILE_NAME}, tables.{recorded.dataset}.{key}: the run is of table"
                f" {expected[:12]}…, but {table.folder} is {found[:12]}…. Score it on the table that it was run on."
            )


def _of_table(record: RunRecord, table: CaseTable) -> run_record.TableRecord:
    return next(item for item in record.tables if item.dataset == table.info.dataset)
