"""The summary of scores, and the check that a run's files follow from one another.

The summary is made anew from ``scores.parquet`` wherever a run is read, and one that says something else is refused.
The scores are made anew where the motions and their table are at hand (about 1 s for 7,000 sequences); where they are
not, the run is called unverified.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
from jaxtyping import Int
from msgspec.structs import asdict

from prbench.checking.doctor.motion_set import Diagnosis
from prbench.engine import Engine, InProcess
from prbench.errors import PredictionsError, RunError
from prbench.harness import claims
from prbench.harness.benchmark import CaseTable, CaseWork, load_benchmark
from prbench.harness.intervals import CONFIDENCE, clustered, metric_interval
from prbench.harness.request import RunRequest
from prbench.harness.run_folder import DatasetFolder, DatasetSummary, MetricSummary, RunFolder, RunRecord, TableRecord
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder import summary as run_summary
from prbench.harness.run_folder.predictions import Predictions, open_part
from prbench.harness.run_folder.scores import PIECE, SCORES, CodedScores, predictions_schema
from prbench.metrics import MetricInfo
from prbench.metrics.registry import LENGTH_MISMATCH
from prbench.protocol.own_protocol import FILE_NAME as PROTOCOL_FILE
from prbench.shown import listed, quoted

# Fields that a run's record and its request share.
_SHARED = ("benchmark", "condition", "split", "limit", "sequences", "seed", "samples", "device", "threads", "control")


def request_of(record: RunRecord, data: Sequence[Path], *, folder: Path, **changes: Any) -> RunRequest:
    """Return the request that a run was made by, as far as its results depend on it.

    Args:
        record: What is recorded about it.
        data: Its tables.
        folder: Holds the user's own protocol, if the run follows one.
        changes: Fields of the request that are wanted otherwise.
    """
    own_protocol = folder / PROTOCOL_FILE
    given: dict[str, Any] = {
        "method": record.method.name,
        "data": tuple(data),
        "batch_size": record.tables[0].batch_plan.batch_size or 1,
        "protocol": own_protocol if own_protocol.is_file() else None,
    }
    return RunRequest(**(given | {name: getattr(record, name) for name in _SHARED} | changes))


def cases_of_run(
    run: RunFolder, table: CaseTable, *, limit: int | None = None, same_values: bool = True
) -> tuple[RunRequest, Any, Any]:
    """Choose the cases of a run in one of its tables anew.

    Args:
        run: The run.
        table: The table that it was made on.
        limit: Number of cases, if it is to be another one than the run's.
        same_values: The table has to hold the same values, too, not only the same sequences.

    Returns:
        The request of the run for this table, the chosen cases, and those of them that the method can answer.

    Raises:
        RunError: if the run is of another table; names the digest that differs.
    """
    run.dataset(table.info.dataset)
    record = run.record
    recorded = next(item for item in record.tables if item.dataset == table.info.dataset)
    digests = {"identity_digest": table.identity} | ({"content_digest": table.content} if same_values else {})
    for key, found in digests.items():
        expected = getattr(recorded, key)
        if expected != found:
            why = f"the run is of table {expected[:12]}…, but {table.folder} is {found[:12]}…."
            remedy = "Score it on the table that it was run on."
            raise RunError(f"{run.path / run_record.FILE_NAME}, tables.{recorded.dataset}.{key}: {why} {remedy}")
    benchmark = load_benchmark(record.benchmark)
    changes: dict[str, Any] = {} if limit is None else {"limit": limit, "sequences": ()}
    if record.sequences and limit is None:
        here = benchmark.recordings_of(table)
        changes["sequences"] = tuple(name for name in record.sequences if name in here)
    batch_size = recorded.batch_plan.batch_size or 1
    request = request_of(record, [table.folder], folder=run.path, batch_size=batch_size, threads=1, **changes)
    chosen = next(iter(benchmark.choose(request, [table])))
    return request, chosen, benchmark.answerable(request, chosen, record.method)


def work_of_run(run: RunFolder, request: RunRequest, cases: Any, rules: Any) -> CaseWork:
    """Return the work on the cases of a run: its answers are scored by it under some rules, and lie in its folder."""
    benchmark = load_benchmark(run.record.benchmark)
    # Motions that came as a file may have an unstated condition; no score depends on it.
    known = {condition.value: condition for condition in benchmark.conditions}
    condition = known.get(run.record.condition, next(iter(known.values())))
    return benchmark.work(request, cases, method=run.record.method, condition=condition, rules=rules)


_VALUES_WITHIN = 1e-6  # metres, or as little of another unit: what other processors may make of the same motion
_OF_RECORDINGS = frozenset({"recordings", "low", "high", "interval", "marks", "detectable"})
_KEYS = ("sequence_id", "sample", "metric", "flag")
_AGAIN = "Delete it and run the same command again, which scores anew what was generated."


def require_summary(files: DatasetFolder, made: DatasetSummary, *, grouped: bool = True) -> None:
    """Compare ``summary.json`` with the summary that follows from the scores.

    Args:
        files: Files of the dataset.
        made: What follows from the scores.
        grouped: The recording of each sequence is known; without it intervals are not compared.

    Raises:
        RunError: naming the first entry that differs.
    """
    for key, expected, found in differences(tree_of(made), tree_of(DatasetSummary.read(files.path))):
        if not grouped and _OF_RECORDINGS.intersection(key.partition("[")[0].split(".")):
            continue
        why = f"which follows from {files.scores.name}, found {found}. One of the two was edited. {_AGAIN}"
        raise RunError(f"{files.path / run_summary.FILE_NAME}, {key}: expected {expected}, {why}")


class MetricDrift(msgspec.Struct, frozen=True, kw_only=True):
    """One metric as a run states it, and as its motions score now; rates from 0 to 1, lengths in metres.

    Attributes:
        metric: Id of the metric.
        title: Its name as printed.
        unit: Its unit.
        stored: Mean of the stored scores.
        rescored: Mean of the scores that the motions have now.
        drift: Mean over the motions of how far the two are apart.
        accepted: Largest drift that other values of the same recordings may cause.
    """

    metric: str
    title: str
    unit: str
    stored: float
    rescored: float
    drift: float
    accepted: float


def metric_drifts(stored: CodedScores, made: CodedScores, infos: Sequence[MetricInfo]) -> tuple[MetricDrift, ...]:
    """Compare two tables of scores that hold the same rows, metric by metric."""
    found = []
    for info in infos:
        rows = stored.rows_of(info.id)
        if not len(rows):
            continue
        mean = float(stored.value[rows].mean())
        # One millimetre, half a point; half a percent of what is neither.
        accepted = {"m": 1e-3, "rate": 5e-3, "ratio": 5e-3}.get(info.unit, 5e-3 * max(abs(mean), 1.0))
        # Of each motion, so that no exchange of values between motions stays unseen.
        drift = float(np.abs(made.value[rows] - stored.value[rows]).mean())
        values = {"stored": mean, "rescored": float(made.value[rows].mean()), "drift": drift, "accepted": accepted}
        found.append(MetricDrift(metric=info.id, title=info.title, unit=info.unit, **values))
    return tuple(found)


def require_scores(
    files: DatasetFolder, stored: CodedScores, made: CodedScores, *, drifting: Sequence[MetricInfo] | None = None
) -> None:
    """Compare ``scores.parquet`` with what the motions score now.

    Args:
        files: Files of the dataset.
        stored: What they hold.
        made: What the motions score.
        drifting: The metrics, where the table has the same sequences with other values, so that a little drift is
            accepted in each.

    Raises:
        RunError: naming the first row, or the metric, that differs.
    """
    keys = _KEYS if drifting is None else _KEYS[:3]  # the remarks depend on the values
    # Keys first: values can only be compared where both tables hold the same rows.
    pieces = itertools.zip_longest(made.pieces(), stored.pieces(), fillvalue=SCORES.empty_table())
    for number, (ours, theirs) in enumerate(pieces):
        one, other = (table.select(keys) for table in (ours, theirs))
        if one.equals(other):
            continue
        rows = itertools.zip_longest(one.to_pylist(), other.to_pylist())
        row = number * PIECE + next(place for place, (first, second) in enumerate(rows) if first != second)
        problem = f"expected {_row(made, row)} from the motions and their table, found {_row(stored, row)}"
        why = f"({len(made)} and {len(stored)} rows). The file was edited. {_AGAIN}"
        raise RunError(f"{files.scores}, row {row}: {problem} {why}")
    if drifting is not None:
        _require_little_drift(files, stored, made, metric_drifts(stored, made, drifting))
        return
    expected = made.value
    found = stored.value
    # Written as "not within", so that NaN counts as different.
    wrong = np.flatnonzero(~(np.abs(found - expected) <= _VALUES_WITHIN * np.maximum(np.abs(expected), 1.0)))
    if wrong.size:
        row = int(wrong[0])
        problem = f"expected {expected[row]:.6g}, which the motion in {files.predictions.name} scores on its table"
        told = f"found {found[row]:.6g} ({wrong.size} of {len(found)} values differ)"
        edited = f"The scores or the motions were edited. {_AGAIN}"
        raise RunError(f"{files.scores}, row {row} ({_row(stored, row)}): {problem}, {told}. {edited}")


def _require_little_drift(
    files: DatasetFolder, stored: CodedScores, made: CodedScores, drifts: Sequence[MetricDrift]
) -> None:
    remarks = [scores.long_form()["flag"].fill_null("").to_numpy() for scores in (stored, made)]
    differ = int((remarks[0] != remarks[1]).sum())
    if differ > 1 + 5e-3 * len(stored):
        raise RunError(f"{files.scores}: expected the remarks that the motions earn, found others in {differ} rows.")
    for each in drifts:
        if not each.drift <= each.accepted:  # NaN differs, too
            those = f"those that the motions in {files.predictions.name} score on the table at hand"
            found = f"{each.drift:.3g} of difference in the mean ({each.stored:.6g} stored,"
            found += f" {each.rescored:.6g} scored now)"
            why = f"The scores or the motions were edited, or the table was built of other data. {_AGAIN}"
            problem = f"expected values within {each.accepted:.3g} of {those}, found {found}"
            raise RunError(f"{files.scores}, {each.metric}: {problem}. {why}")


def _row(scores: CodedScores, row: int) -> str:
    if row >= len(scores):
        return "no row"
    key = scores.long_form(slice(row, row + 1)).to_pylist()[0]
    sequence_id, sample, metric, flag = (key[name] for name in _KEYS)
    return f"{sequence_id}, sample {sample}, {metric}{f', {flag}' if flag else ''}"


def tree_of(summary: DatasetSummary) -> dict[str, Any]:
    """Return a summary as plain values, metrics by their ids."""
    # The estimator first: bounds of another one differ, too, and say less about the cause.
    entries = {each.metric: {"interval": each.interval} | asdict(each) for each in summary.metrics}
    names = {"metrics": tuple(each.metric for each in summary.metrics)}
    # Kinds alone: the evidence holds numbers that other processors round otherwise.
    return asdict(summary) | names | {"findings": tuple(each.kind for each in summary.findings)} | entries


def differences(expected: object, found: object, key: str = "") -> Iterator[tuple[str, object, object]]:
    """Yield key, expected and found value of what differs in two trees of plain values."""
    if isinstance(expected, dict) and isinstance(found, dict):
        for name in expected | found:
            yield from differences(expected.get(name), found.get(name), f"{key}.{name}" if key else name)
    elif isinstance(expected, tuple) and isinstance(found, tuple):
        if len(expected) != len(found):
            yield key, f"{len(expected)} entries", f"{len(found)}"
        for number, (one, other) in enumerate(zip(expected, found, strict=False)):
            yield from differences(one, other, f"{key}[{number}]")
    elif isinstance(expected, float) and isinstance(found, float):
        if not abs(expected - found) <= _VALUES_WITHIN * max(abs(expected), 1.0):  # NaN differs, too
            yield key, expected, found
    elif expected != found:
        yield key, expected, found


def summary_of(
    record: RunRecord,
    table: TableRecord,
    scores: CodedScores | pa.Table,
    recording_of: Mapping[str, str],
    findings: tuple[Diagnosis, ...] = (),
) -> DatasetSummary:
    """Make ``summary.json`` of one dataset from ``run.json``, the scores and the recording of each scored case.

    Args:
        record: What the motions are of.
        table: Its entry for the dataset.
        scores: Rows of ``scores.parquet``.
        recording_of: Maps each scored case to its recording.
        findings: What is certainly wrong with the motions.
    """
    recording_of = {name: table.unit_of(recording) for name, recording in recording_of.items()}
    coded = CodedScores.of([scores]) if isinstance(scores, pa.Table) else scores
    infos = load_benchmark(record.benchmark).metrics
    compared = {info.id for info in load_benchmark(record.benchmark).compared_metrics}
    # Numbers in the order of the names take the place of the names, which are sorted many times.
    sequences = _ranks(coded.sequence_ids)
    recordings = _ranks([recording_of[name] for name in coded.sequence_ids])
    metrics = []
    for info in infos:
        if info.id not in coded.metrics:
            continue
        rows = coded.rows_of(info.id)
        sequence_ids = sequences[coded.sequence[rows]]
        recording_ids = recordings[coded.sequence[rows]]
        values = coded.value[rows]
        estimate = metric_interval(info, values, recording_ids, sequence_ids)
        detectable = None
        if info.id in compared:
            # The difference to an unrelated method of the same spread varies √2 times as much.
            twice = clustered(np.sqrt(2) * values, recording_ids, sequence_ids, rate=info.unit == "rate")
            detectable = twice.detectable(len(compared))
        flags: Counter[str] = Counter()
        for text, count in Counter(coded.flag[rows].tolist()).items():
            for name in coded.flags[text].split(";") if text >= 0 and coded.flags[text] else ():
                flags[name] += count
        summary = MetricSummary(
            metric=info.id,
            title=info.title,
            unit=info.unit,
            **{name: getattr(estimate, name) for name in ("mean", "low", "high", "marks")},
            level=CONFIDENCE,
            interval=estimate.method,
            sequences=estimate.n_sequences,
            recordings=estimate.n_recordings,
            flags=dict(sorted(flags.items())),
            detectable=detectable,
        )
        metrics.append(summary)
    says_synthetic = not table.synthetic or "synthetic" in table.title.lower()
    return DatasetSummary(
        **{name: getattr(table, name) for name in ("dataset", "synthetic", "redistribution", "sequences")},
        title=table.title if says_synthetic else f"{table.title} (synthetic)",
        method=record.method.name,
        **{name: getattr(record, name) for name in ("condition", "control", "split", "samples")},
        unsupported=table.sequences - len(recording_of),
        recordings=len(set(recording_of.values())),
        gaze=record.method.gaze,
        obstacles=record.method.wants_obstacles,
        length_mismatches=max((metric.flags.get(LENGTH_MISMATCH, 0) for metric in metrics), default=0),
        metrics=tuple(metrics),
        findings=findings,
    )


def _ranks(names: Sequence[str]) -> Int[np.ndarray, " names"]:
    """Return the place of each name among the different names, sorted."""
    return np.unique(np.array(names, dtype=object), return_inverse=True)[1]


# What is unverified for want of a table; more data may show it.
NOT_AT_HAND = "is not at hand"
_OTHER_PROTOCOL = (
    "it was scored under another protocol than this version's, so metrics and limits that are newer are missing;"
    " `prbench score RUN --data DIR` scores its motions by this version's"
)


@dataclass(frozen=True)
class CheckedSummary:
    """The summary of one dataset of a run, as it follows from the scores.

    Attributes:
        unverified: Reason why the scores could not be held against the motions; empty where they were.
        scored: What a summary of some of the sequences is made from; None where a test gives a summary alone.
        declared: What the run says and nothing here can show.
        drifts: Each metric as stored and as scored again; empty where the scores could not be held against the motions.
    """

    summary: DatasetSummary
    unverified: str
    scored: ScoredSequences | None = None
    declared: tuple[str, ...] = claims.DECLARED
    drifts: tuple[MetricDrift, ...] = ()


@dataclass(frozen=True)
class ScoredSequences:
    """The sequences behind a summary, to make one of some of them.

    Attributes:
        recording_of: Maps each sequence that was scored to its recording.
    """

    run: RunFolder
    record: TableRecord
    recording_of: Mapping[str, str]

    @property
    def ids(self) -> frozenset[str]:
        """Ids of the sequences that were scored."""
        return frozenset(self.recording_of)

    def summary_over(self, ids: frozenset[str]) -> DatasetSummary:
        """Summarise the scores of some sequences alone; none of them counts as unsupported.

        Args:
            ids: Sequences that were scored.
        """
        kept = CodedScores.read(self.run.dataset(self.record.dataset).scores).only(ids)
        record = msgspec.structs.replace(self.record, sequences=len(ids), unsupported=0)
        return summary_of(self.run.record, record, kept, {name: self.recording_of[name] for name in ids})


@dataclass(frozen=True)
class RunChecker:
    """Checks runs against the tables that are at hand.

    Attributes:
        find_table: Gives the table that a run was made on, if it is at hand.
        same_values: The table has to be the very same one; otherwise one of the same sequences with other values will
            do, and a little drift is accepted.
    """

    find_table: Callable[[TableRecord], CaseTable | None] = lambda _: None
    engine: Engine = field(default_factory=InProcess)
    same_values: bool = True

    def check(self, run: RunFolder, record: TableRecord) -> CheckedSummary:
        """Check one dataset of a finished run.

        Raises:
            RunError: if the summary does not follow from the scores, the scores from motions and table, or what the
                run says of its method and table is contradicted; names the file and the first value that differs.
        """
        table = self.find_table(record)
        claims.require_own_method(run, table)
        files = run.dataset(record.dataset)
        scores = CodedScores.read(files.scores)
        benchmark = load_benchmark(run.record.benchmark)
        # Without the table, ids tell which recording a sequence is of, and so which intervals follow.
        names = sorted(scores.sequence_ids)
        known = {} if table is None else benchmark.recordings_of(table)
        grouped = benchmark.ids_tell_recordings(names) if table is None else all(name in known for name in names)
        recording_of = {name: known.get(name) or benchmark.recording_key(name) for name in names}
        stored = DatasetSummary.read(files.path)
        made = summary_of(run.record, record, scores, recording_of, stored.findings)
        require_summary(files, made, grouped=grouped)
        if not grouped:
            made = stored
        claims.require_still(run, scores, benchmark)
        has_motions = any(files.predictions.glob("part-*.parquet"))
        rules = benchmark.rules_of(run)
        declared = claims.DECLARED
        unverified = ""
        if not has_motions:
            unverified = "its folder holds no motions"
            if run.record.method.kind == run_record.FILE:
                unverified += "; `prbench score FILE --keep-motions --out DIR` keeps them"
        elif rules is None:
            unverified = _OTHER_PROTOCOL
        elif table is None:
            unverified = f"its table of {record.dataset} {NOT_AT_HAND}: name it with --data DIR"
        drifts: tuple[MetricDrift, ...] = ()
        if table is not None and rules is not None:
            exact = self.same_values or table.content == record.content_digest
            request, chosen, cases = cases_of_run(run, table, same_values=exact)
            unknown = sorted(set(names) - set(cases.sequence_ids))
            if unknown:
                problem = f"expected sequences that the run was made on, found {quoted(unknown[0])}."
                raise RunError(f"{files.scores}: {problem}")
            work = work_of_run(run, request, cases, rules)
            if has_motions:
                require_motions(files, cases.sequence_ids, run.record.samples)
                # First: another condition is judged otherwise, too.
                declared = claims.require_questions(run, files, cases, work, exact=exact)
                again = CodedScores.of(work.scores(files, self.engine))
                require_scores(files, scores, again, drifting=None if exact else benchmark.metrics)
                drifts = metric_drifts(scores, again, benchmark.metrics)
                made = summary_of(run.record, record, scores if exact else again, recording_of, work.findings(files))
            claims.require_table(run, record, chosen, cases, work, rules, exact=exact)
            if exact:  # agreement with recorded people turns at single sequences
                cases = cases.chosen(np.isin(cases.sequence_ids, names))
                work_of_run(run, request, cases, rules).require_beside(files, scores)
        return CheckedSummary(made, unverified, ScoredSequences(run, record, recording_of), declared, drifts)


def require_motions(files: DatasetFolder, sequence_ids: Sequence[str], samples: int) -> None:
    """Refuse stored motions that are not those of some sequences, each once for every sample.

    Args:
        files: Files of the dataset.
        sequence_ids: The sequences.
        samples: Motions of each.

    Raises:
        PredictionsError: naming sequences that are missing, repeated or unknown.
    """
    there = Predictions.open(files.predictions)
    for part in there.paths:
        more = sorted(set(open_part(part).schema_arrow.names) - set(predictions_schema(gaze=True).names))
        if more:
            raise PredictionsError(f"{part}: expected the columns of motions alone, found {quoted(more[0])}, too.")
    counts = Counter(zip(there.ids, there.samples, strict=True))
    # A number of samples that nothing stands behind is not counted out.
    each = range(min(samples, len(there.ids) + 1))
    wanted = {(name, sample) for name in sequence_ids for sample in each}
    repeated = {key for key, count in counts.items() if count > 1}
    kinds = {"missing": wanted - counts.keys(), "repeated": repeated, "unknown": counts.keys() - wanted}
    if any(kinds.values()):
        named = {kind: sorted(f"{name}, sample {sample}" for name, sample in keys) for kind, keys in kinds.items()}
        expected = f"a motion of each of {len(sequence_ids)} sequences for each of {samples} samples"
        found = ", ".join(f"{kind} {listed(keys)}" for kind, keys in named.items())
        why = "The motions were edited or lost: run the same command again, it resumes."
        raise PredictionsError(f"{files.predictions}: expected {expected}, found {found}. {why}")
