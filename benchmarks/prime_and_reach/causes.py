"""``prbench analyse causes``: what keeps the motions of methods from being plausible.

Source: docs/specification/metrics.md#plausible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool

from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.errors import RunError
from prbench.harness.intervals import Estimate, clustered, rate_interval
from prbench.harness.prime_and_reach import MotionWork
from prbench.harness.results import CheckedSummary, RunChecker, cases_of_run, work_of_run
from prbench.harness.run_folder import Predictions, RunFolder
from prbench.harness.run_folder.scores import CodedScores
from prbench.harness.scoring import COLUMNS, targets_of
from prbench.metrics import MotionBatch
from prbench.metrics.batch import ScoringPair
from prbench.metrics.plausible import body_numbers, broken_limits
from prbench.protocol.manifests import Limit, load_protocol
from prbench.sequences import SequenceTable
from prbench.tables import Block, Cell, Column, Row, Table, metric_cell
from prbench.viewing.replay.read import run_labels

By = Literal["layout", "limit"]
_ROWS = 256  # motions that are measured together


@dataclass(frozen=True, eq=False)
class _Judged:
    """Motions of one run, one a row, and what each of them breaks.

    Attributes:
        broken: A mask for each cause: a flag of Plausible, or one of its limits.
    """

    sequences: np.ndarray
    recordings: np.ndarray
    broken: Mapping[str, Bool[np.ndarray, " n"]]

    @classmethod
    def together(cls, parts: Sequence[_Judged]) -> _Judged:
        """Put the motions of several tables together."""
        broken = {cause: np.concatenate([part.broken[cause] for part in parts]) for cause in parts[0].broken}
        sequences = np.concatenate([part.sequences for part in parts])
        return cls(sequences, np.concatenate([part.recordings for part in parts]), broken)

    def share(self, motions: Bool[np.ndarray, " n"]) -> Estimate:
        """Return the share of some motions, with its interval over recordings."""
        return rate_interval(clustered(motions.astype(float), self.recordings, self.sequences))

    @property
    def plausible(self) -> Estimate:
        """The share that breaks nothing."""
        return self.share(~np.any(list(self.broken.values()), axis=0))

    def cells(self, cause: str, metric: str, **about: Any) -> tuple[str, tuple[Cell, ...]]:
        """Return the share that breaks a cause, and that which breaks nothing else, in words and as cells."""
        count = np.sum(list(self.broken.values()), axis=0)
        found = {metric: self.broken[cause], f"{metric}_alone": self.broken[cause] & (count == 1)}
        shares = {name: self.share(mask) for name, mask in found.items()}
        cells = [metric_cell(name, "rate", each.mean, each.low, each.high, **about) for name, each in shares.items()]
        broken, alone = (100 * each.mean for each in shares.values())
        return ("0" if not broken else f"{broken:.1f} ({alone:.1f})"), tuple(cells)


def causes_tables(runs: Sequence[Path], checker: RunChecker, *, by: By | None = None) -> list[Table]:
    """Lay out the share of plausible motions of each run, and what the others break.

    Args:
        runs: Finished run folders.
        checker: Holds the tables at hand, on which the scores are checked.
        by: None for a row a run and a column a flag; ``layout`` for a row a run and table; ``limit`` for a row a limit
            and a column a run, measured anew on the tables, which have to be at hand.

    Returns:
        One table. Shares are in %; in brackets stands that of motions which break nothing else.

    Raises:
        RunError: if a run is damaged, or its table is needed and not at hand.
    """
    opened = [RunFolder.open(path) for path in runs]
    labels = run_labels([run.path for run in opened], [run.record for run in opened])
    limits = dict(load_protocol().metrics.plausible)
    judged: dict[str, dict[str, _Judged]] = {label: {} for label in labels}
    notes = ["In brackets: motions that break nothing else, which mending this alone would free."]
    for label, run in zip(labels, opened, strict=True):
        for record in run.record.tables:
            checked = checker.check(run, record)
            if by != "limit":
                judged[label][record.dataset] = _flagged(run, record.dataset, checked, limits)
            else:
                table = checker.find_table(record)
                if not isinstance(table, SequenceTable):
                    remedy = "Name it with --data DIR: limits are measured anew."
                    raise RunError(f"{run.path}: its table of {record.dataset} is not at hand. {remedy}")
                judged[label][record.dataset] = _measured(run, table, checked, limits)
            if checked.unverified:
                notes.append(f"{label} is unverified: {checked.unverified}")
    synthetic = any(record.synthetic for run in opened for record in run.record.tables)
    notes = [*dict.fromkeys(notes), *([ON_SYNTHETIC_DATA] if synthetic else [])]
    if by == "limit":
        whole = {label: _Judged.together(list(parts.values())) for label, parts in judged.items()}
        return [_by_limit(whole, limits, notes)]
    parts = [(label, dataset, part) for label, of in judged.items() for dataset, part in of.items()]
    if by is None:
        parts = [(label, "", _Judged.together(list(of.values()))) for label, of in judged.items()]
    return [_by_flag(parts, notes)]


def _flagged(run: RunFolder, dataset: str, checked: CheckedSummary, limits: Mapping[str, Limit]) -> _Judged:
    """Read the flags of Plausible from a run's scores."""
    assert checked.scored is not None, "a finished run was checked"
    scores = CodedScores.read(run.dataset(dataset).scores)
    rows = scores.rows_of("plausible")
    texts = [scores.flags[number].split(";") if number >= 0 else [] for number in scores.flag[rows]]
    flags = dict.fromkeys(limit.flag for limit in limits.values())
    broken = {flag: np.array([flag in each for each in texts], dtype=bool) for flag in flags}
    names = np.array(scores.sequence_ids)[scores.sequence[rows]]
    recordings = np.array([f"{dataset}/{checked.scored.recording_of[name]}" for name in names])
    return _Judged(names, recordings, broken)


def _measured(run: RunFolder, table: SequenceTable, checked: CheckedSummary, limits: Mapping[str, Limit]) -> _Judged:
    """Measure a run's motions again, to say which limit each of them breaks."""
    assert checked.scored is not None, "a finished run was checked"
    request, _, cases = cases_of_run(run, table)
    work = work_of_run(run, request, cases, run.protocol or load_protocol())
    assert isinstance(work, MotionWork), "runs of other benchmarks were refused"
    rules = work.rules
    motions = Predictions.open(run.dataset(table.info.dataset).predictions)
    parts = []
    for place, chunk in cases.windows(COLUMNS, rows=_ROWS):
        goals = chunk.vectors("goal_location") if rules.other_goals is None else rules.other_goals[place]
        targets = replace(targets_of(chunk, goals, None), pose_given=rules.pose_given)
        recorded = MotionBatch(chunk.joints, chunk.offsets)
        recordings = [f"{table.info.dataset}/{checked.scored.recording_of[name]}" for name in chunk.sequence_ids]
        for sample in range(run.record.samples):
            rows = motions.motions(chunk.sequence_ids, sample)
            pair = ScoringPair(MotionBatch(rows.values, rows.offsets), recorded, targets)
            numbers = body_numbers(pair, rules.constants)
            broken = {}
            for name, limit in limits.items():
                (broken[name],) = broken_limits(numbers, {name: limit}, rules.constants.threshold_tolerance).values()
            parts.append(_Judged(np.array(chunk.sequence_ids), np.array(recordings), broken))
    return _Judged.together(parts)


def _by_flag(parts: Sequence[tuple[str, str, _Judged]], notes: Sequence[str]) -> Table:
    flags = [flag for flag in parts[0][2].broken if any(part.broken[flag].any() for _, _, part in parts)]
    rows = []
    for label, dataset, part in parts:
        counts = {"sequences": len(set(part.sequences)), "recordings": len(set(part.recordings))}
        about: dict[str, Any] = {"method": label, "dataset": dataset, **counts}
        kept = part.plausible
        cells = [metric_cell("plausible", "rate", kept.mean, kept.low, kept.high, **about)]
        text = {"method": label, "layout": dataset, "motions": str(len(part.sequences))}
        for flag in flags:
            text[flag], more = part.cells(flag, flag, **about)
            cells += more
        rows.append(Row(text=text, cells=tuple(cells)))
    columns = [Column(key="method", title="method", text=True), Column(key="layout", title="layout", text=True)]
    columns.append(Column(key="motions", title="motions"))
    columns.append(Column(key="plausible", title="Plausible", unit="%", digits=1, better="higher"))
    columns += [Column(key=flag, title=flag.replace("_", " "), unit="%") for flag in flags]
    if not any(dataset for _, dataset, _ in parts):
        del columns[1]
    title = "Plausible, and what the other motions break"
    return Table(title=title, columns=tuple(columns), blocks=(Block(rows=tuple(rows)),), notes=tuple(notes))


def _by_limit(whole: Mapping[str, _Judged], limits: Mapping[str, Limit], notes: Sequence[str]) -> Table:
    judged = [(label, part.plausible) for label, part in whole.items()]
    cells = [metric_cell(label, "rate", kept.mean, kept.low, kept.high, variant="plausible") for label, kept in judged]
    rows = [Row(text={"limit": "all of them"}, cells=tuple(cells))]
    for name, limit in limits.items():
        if not any(part.broken[name].any() for part in whole.values()):
            continue
        text = {"limit": name, "flag": limit.flag, "kept": f"at {limit.bound} {limit.value:g} {limit.unit}".rstrip()}
        cells = []
        for label, part in whole.items():
            text[label], more = part.cells(name, label, method=label, variant=name)
            cells += more
        rows.append(Row(text=text, cells=tuple(cells)))
    heads = [Column(key=key, title=key, text=True) for key in ("limit", "flag", "kept")]
    heads += [Column(key=label, title=label, unit="%", digits=1) for label in whole]
    kept = f"{len(limits) - len(rows) + 1} of {len(limits)} limits are kept by all motions."
    title = "Motions that keep all limits of Plausible, and those that break each"
    return Table(title=title, columns=tuple(heads), blocks=(Block(rows=tuple(rows)),), notes=(kept, *notes))
