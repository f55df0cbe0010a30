"""The summary of scores, stored results compared with what follows from their sources, and scores made again."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import msgspec
import numpy as np
import pyarrow as pa
from jaxtyping import Int

from prbench.engine import Engine
from prbench.errors import RunError
from prbench.harness.benchmark import CaseTable, load_benchmark
from prbench.harness.intervals import CONFIDENCE, metric_interval, smallest_detectable_unpaired, uncertainty_sources
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder import summary as run_summary
from prbench.harness.run_folder.folder import DatasetFolder, RunFolder
from prbench.harness.run_folder.record import RunRecord, TableRecord
from prbench.harness.run_folder.scores import CodedScores
from prbench.harness.run_folder.summary import DatasetSummary, MetricSummary
from prbench.metrics import MetricInfo
from prbench.metrics.registry import LENGTH_MISMATCH
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


_VALUES_WITHIN = 1e-6  # metres, or as little of another unit: what other processors may make of the same motion
_SHARES_WITHIN = 1e-3  # of the variance, whose small shares are differences of large numbers
_FORMER_INTERVALS = ("wilson-cluster", "bootstrap", "t-jackknife")  # up to 0.7.0
_OF_RECORDINGS = frozenset({"recordings", "low", "high", "interval", "marks", "detectable", "uncertainty"})
_KEYS = ("sequence_id", "sample", "metric", "flag")
_AGAIN = "Delete it and run the same command again, which scores anew what was generated."


def require_summary(files: DatasetFolder, made: DatasetSummary, *, grouped: bool = True) -> None:
    """Compare ``summary.json`` with the summary that follows from the scores.

    Args:
        files: Of the dataset.
        made: What follows from the scores.
        grouped: The recording of each sequence is known; without it intervals are not compared.

    Raises:
        RunError: naming the first entry that differs.
    """
    stored = DatasetSummary.read(files.path)
    for key, expected, found in _differences(made, stored):
        if not grouped and key.rpartition(".")[2] in _OF_RECORDINGS:
            continue
        cause = "One of the two was edited."
        if key.endswith(".interval") and found in _FORMER_INTERVALS:
            cause = "An earlier version of prbench wrote it, whose intervals covered too little."
        if key.endswith(".detectable"):
            cause = "Up to version 0.9.0 it was corrected for eight metrics, of which seven are compared. " + cause
        raise RunError(
            f"{files.path / run_summary.FILE_NAME}, {key}: expected {expected}, which follows from"
            f" {files.scores.name}, found {found}. {cause} {_AGAIN}"
        )


def require_scores(files: DatasetFolder, stored: CodedScores, made: CodedScores) -> None:
    """Compare ``scores.parquet`` with what the motions score now.

    Raises:
        RunError: naming the first row that differs.
    """
    # Keys first: values can only be compared where both tables hold the same rows.
    if (row := _first_other_key(stored, made)) is not None:
        raise RunError(
            f"{files.scores}, row {row}: expected {_row(made, row)} from the motions and their table, found"
            f" {_row(stored, row)} ({len(made)} and {len(stored)} rows). The file was edited. {_AGAIN}"
        )
    expected = made.value
    found = stored.value
    # Written as "not within", so that NaN counts as different.
    wrong = np.flatnonzero(~(np.abs(found - expected) <= _VALUES_WITHIN * np.maximum(np.abs(expected), 1.0)))
    if wrong.size:
        row = int(wrong[0])
        raise RunError(
            f"{files.scores}, row {row} ({_row(stored, row)}): expected {expected[row]:.6g}, which the motion in"
            f" {files.predictions.name} scores on its table, found {found[row]:.6g} ({wrong.size} of"
            f" {len(found)} values differ). The scores or the motions were edited. {_AGAIN}"
        )


def _first_other_key(stored: CodedScores, made: CodedScores) -> int | None:
    """Return the first row of which two scores differ in sequence, sample, metric or flag; None without any."""
    start = 0
    for expected, found in itertools.zip_longest(made.pieces(), stored.pieces()):
        if expected is None or found is None:
            return start
        keys = [table.select(_KEYS) for table in (found, expected)]
        if not keys[0].equals(keys[1]):
            rows = zip(*(table.to_pylist() for table in keys))
            common = min(table.num_rows for table in keys)
            return start + next((number for number, (one, other) in enumerate(rows) if one != other), common)
        start += expected.num_rows
    return None


def _row(scores: CodedScores, row: int) -> str:
    if row >= len(scores):
        return "no row"
    key = scores.long_form(slice(row, row + 1)).to_pylist()[0]
    sequence_id, sample, metric, flag = (key[name] for name in _KEYS)
    return f"{sequence_id}, sample {sample}, {metric}{f', {flag}' if flag else ''}"


def _differences(made: DatasetSummary, stored: DatasetSummary) -> Iterator[tuple[str, object, object]]:
    """Key, expected and found value of what a summary says otherwise than the scores."""
    for name in DatasetSummary.__struct_fields__:
        expected = getattr(made, name)
        found = getattr(stored, name)
        if name != "metrics" and expected != found:
            yield name, expected, found
    names = [metric.metric for metric in made.metrics]
    found_names = [metric.metric for metric in stored.metrics]
    if names != found_names:
        yield "metrics", ", ".join(names), ", ".join(found_names)
        return
    for expected, found in zip(made.metrics, stored.metrics, strict=True):
        yield from metric_differences(expected, found)


def metric_differences(made: MetricSummary, stored: MetricSummary) -> Iterator[tuple[str, object, object]]:
    """Key, expected and found value of what an entry says otherwise than the scores."""
    within = 1e-9 + _VALUES_WITHIN * abs(made.mean)
    limits = {"mean": within, "low": within, "high": within, "detectable": within}
    found = msgspec.structs.asdict(stored)
    # The estimator first: bounds of another one differ, too, and say less about the cause.
    for name, value in sorted(msgspec.structs.asdict(made).items(), key=lambda item: item[0] != "interval"):
        if name == "marks":  # since 0.5.0, values that only arithmetic tells apart are marked as equal, too
            same = set(value) - {"all_equal"} == set(found[name]) - {"all_equal"}
        elif name == "uncertainty":
            same = value.keys() == found[name].keys() and all(
                abs(share - found[name][source]) <= _SHARES_WITHIN for source, share in value.items()
            )
        elif name in limits and value is not None and found[name] is not None:
            same = abs(value - found[name]) <= limits[name]
        else:
            same = value == found[name]
        if not same:
            yield f"{made.metric}.{name}", value, found[name]


def summary_of(
    record: RunRecord, table: TableRecord, scores: CodedScores | pa.Table, recording_of: Mapping[str, str]
) -> DatasetSummary:
    """Make ``summary.json`` of one dataset from ``run.json``, the scores and the recording of each scored case.

    Args:
        record: What the motions are of.
        table: Its entry for the dataset.
        scores: Rows of ``scores.parquet``.
        recording_of: Maps each scored case to its recording.
    """
    coded = CodedScores.of([scores]) if isinstance(scores, pa.Table) else scores
    infos = load_benchmark(record.benchmark).metrics
    ranked = sum(info.main and info.ranked for info in infos)
    # Numbers in the order of the names take the place of the names, which are sorted many times.
    sequences = _ranks(coded.sequence_ids)
    recordings = _ranks([recording_of[name] for name in coded.sequence_ids])
    metrics = tuple(
        _summarised(info, coded, coded.rows_of(info.id), sequences, recordings, ranked)
        for info in infos
        if info.id in coded.metrics
    )
    says_synthetic = not table.synthetic or "synthetic" in table.title.lower()
    return DatasetSummary(
        dataset=table.dataset,
        title=table.title if says_synthetic else f"{table.title} (synthetic)",
        synthetic=table.synthetic,
        redistribution=table.redistribution,
        method=record.method.name,
        condition=record.condition,
        control=record.control,
        split=record.split,
        sequences=table.sequences,
        unsupported=table.sequences - len(recording_of),
        recordings=len(set(recording_of.values())),
        samples=record.samples,
        gaze=record.method.gaze,
        obstacles=record.method.wants_obstacles,
        length_mismatches=max((metric.flags.get(LENGTH_MISMATCH, 0) for metric in metrics), default=0),
        metrics=metrics,
    )


def _ranks(names: Sequence[str]) -> Int[np.ndarray, " names"]:
    """Return the place of each name among the different names, sorted."""
    if all(first < second for first, second in itertools.pairwise(names)):
        return np.arange(len(names))
    place = {name: number for number, name in enumerate(sorted(set(names)))}
    return np.array([place[name] for name in names], dtype=np.int64)


def _summarised(
    info: MetricInfo,
    scores: CodedScores,
    rows: Int[np.ndarray, " rows"],
    sequences: Int[np.ndarray, " sequences"],
    recordings: Int[np.ndarray, " sequences"],
    ranked: int,
) -> MetricSummary:
    sequence_ids = sequences[scores.sequence[rows]]
    recording_ids = recordings[scores.sequence[rows]]
    values = scores.value[rows]
    estimate = metric_interval(info, values, recording_ids, sequence_ids)
    sources = uncertainty_sources(values, recording_ids, sequence_ids)
    shares = {"recordings": sources.recordings, "sequences": sources.sequences, "samples": sources.samples}
    flags = _counted_flags(scores, rows)
    return MetricSummary(
        metric=info.id,
        title=info.title,
        unit=info.unit,
        mean=estimate.mean,
        low=estimate.low,
        high=estimate.high,
        level=CONFIDENCE,
        interval=estimate.method,
        sequences=estimate.n_sequences,
        recordings=estimate.n_recordings,
        marks=estimate.marks,
        flags=dict(sorted(flags.items())),
        detectable=smallest_detectable_unpaired(values, recording_ids, sequence_ids, comparisons=ranked),
        uncertainty={name: round(share, 4) for name, share in shares.items()},
    )


def _counted_flags(scores: CodedScores, rows: Int[np.ndarray, " rows"]) -> Counter[str]:
    """Count the rows that carry each flag; a row may carry several."""
    found: Counter[str] = Counter()
    flag = scores.flag[rows]
    for number, count in enumerate(np.bincount(flag[flag >= 0], minlength=len(scores.flags)).tolist()):
        for name in scores.flags[number].split(";") if count and scores.flags[number] else ():
            found[name] += count
    return found
