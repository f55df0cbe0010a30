"""Run every control on a table, to see what each metric pays for (``docs/audit.md``).

The controls are runs like any other: the same scoring, the same summaries, the same folders. What is new here is the
list of them and the comparison with recorded people.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from prbench.board.cheat_search import FoundMotion, Progress, mean_of
from prbench.contract import Condition
from prbench.engine import Engine
from prbench.errors import UsageError
from prbench.files.storage import sole_writer
from prbench.harness.controls import CONTROLS, GROUND_TRUTH, RECORDED_MOTION, ROUND_TRIP_FPS, SHUFFLED_GOAL
from prbench.harness.planning import Selection, open_tables, select
from prbench.harness.request import RunRequest
from prbench.harness.results import RunChecker
from prbench.harness.run import run_method
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.summary import DatasetAgreement, DatasetSummary, MeanOverDatasets, means_over_datasets
from prbench.metrics import MetricInfo

_ONLY_METHOD = "--method"


@dataclass(frozen=True)
class AuditedControl:
    """What one control earned on one table.

    Attributes:
        name: Name of the control; ``ground-truth, shuffled-goal`` is scored against other sequences' goals.
        use: Sentence on what it does.
        is_recorded: The motions are the recorded ones, through another form at most.
        summary: Its scores, as in ``summary.json``.
        agreement: Agreement with recorded people, and rates by the goal's place.
    """

    name: str
    use: str
    is_recorded: bool
    summary: DatasetSummary
    agreement: DatasetAgreement


@dataclass(frozen=True)
class TableAudit:
    """All controls on one table.

    Attributes:
        controls: The controls, recorded motion last.
        found: The best motions of a search, which is made over all tables together.
    """

    controls: tuple[AuditedControl, ...]
    found: tuple[FoundMotion, ...] = ()

    @property
    def recorded(self) -> DatasetSummary:
        """Scores of the recorded motion."""
        return next(control.summary for control in self.controls if control.name == GROUND_TRUTH)

    @property
    def means(self) -> tuple[ControlMeans, ...]:
        """Mean of every metric, one entry a control."""
        return means_of_controls([self])


@dataclass(frozen=True)
class ControlMeans:
    """Means of one control, over one dataset or over several that count alike.

    Attributes:
        name: Name of the control.
        is_recorded: The motions are the recorded ones, through another form at most.
        means: Maps metric ids to means; without metrics that a dataset lacks.
    """

    name: str
    is_recorded: bool
    means: Mapping[str, MeanOverDatasets]


def means_of_controls(tables: Sequence[TableAudit]) -> tuple[ControlMeans, ...]:
    """Return the means of every control and found motion over some tables, each counting alike.

    Args:
        tables: Audits of the same controls.
    """
    found = []
    for on_each in zip(*(table.controls for table in tables), strict=True):
        means = means_over_datasets([control.summary for control in on_each])
        found.append(ControlMeans(on_each[0].name, on_each[0].is_recorded, means))
    for on_each in zip(*(table.found for table in tables), strict=True):
        means = mean_of([motion.means for motion in on_each])
        entries = {name: MeanOverDatasets(mean, None, None) for name, mean in means.items()}
        found.append(ControlMeans(on_each[0].name, is_recorded=False, means=entries))
    return tuple(found)


def not_worse_than_people(controls: Sequence[ControlMeans], info: MetricInfo) -> tuple[str, ...]:
    """Return the controls that are no recorded motion and score as well as it does, or better.

    A metric that compares with the recorded motion is never won this way, and one without a direction by nobody.
    """
    people = next(control for control in controls if control.name == GROUND_TRUTH).means.get(info.id)
    if info.higher_is_better is None or info.compares_with_recorded or people is None:
        return ()
    sign = 1 if info.higher_is_better else -1
    means = {each.name: each.means[info.id].mean for each in controls if not each.is_recorded and info.id in each.means}
    return tuple(name for name, mean in means.items() if sign * mean >= sign * people.mean)


def audit(
    data: Sequence[Path],
    *,
    runs: Sequence[Path] = (),
    split: str,
    limit: int | None,
    out: Path | None,
    engine: Engine,
    progress: Progress,
) -> tuple[TableAudit, ...]:
    """Score all controls on some tables.

    Args:
        data: Dataset folders.
        runs: Finished runs of methods on the same sequences, which stand beside the controls.
        split: Split of the tables.
        limit: Sequences of each table; None for all.
        out: Folder that keeps the run folders; without it they are thrown away.
        engine: Engine that runs the controls.
        progress: Called after every run.

    Returns:
        One audit a table, in the order of the tables.

    Raises:
        TableError: if a table is missing, empty or of an unknown version, or holds no training sequences to retrieve.
        UsageError: if a run was made on other sequences.
        RunError: if a run is damaged, or its scores do not follow from its motions.
        StorageError: if the folder cannot be written.
    """
    tables = open_tables(data)
    selections = [select(table, split=split, limit=limit) for table in tables]
    rates = {selection.fps for selection in selections}
    by_table = [list(_audited_runs(runs, selection, engine)) for selection in selections]
    # Method, control and what it does; recorded motion stands last.
    wanted: list[tuple[str, str | None, str]] = []
    methods = [control for control in CONTROLS if control.use == _ONLY_METHOD]
    for control in sorted(methods, key=lambda control: control.name in RECORDED_MOTION):
        if control.name == GROUND_TRUTH:
            wanted.append((control.name, SHUFFLED_GOAL, "the recorded motion, scored against another sequence's goal"))
        # A round trip through the table's own rate is the recorded motion itself.
        if ROUND_TRIP_FPS.get(control.name) not in rates:
            wanted.append((control.name, None, control.summary))
    with (
        nullcontext() if out is None else sole_writer(out),
        tempfile.TemporaryDirectory(prefix="prbench-audit-") as thrown_away,
    ):
        parent = out or Path(thrown_away)
        for done, (name, control, use) in enumerate(wanted):
            label = name if control is None else f"{name}, {control}"
            about = {"method": name, "control": control, "split": split, "limit": limit}
            place = parent / label.replace(", ", "-")
            request = RunRequest(data=tuple(data), condition=Condition.NONE, out=place, **about)
            report = run_method(request, engine=engine)
            for audited, summary in zip(by_table, report.summaries, strict=True):
                agreement = DatasetAgreement.read(report.folder.dataset(summary.dataset).path)
                audited.append(AuditedControl(label, use, name in RECORDED_MOTION, summary, agreement))
            progress(done + 1, len(wanted), label)
    return tuple(TableAudit(tuple(sorted(audited, key=lambda each: each.is_recorded))) for audited in by_table)


def _audited_runs(runs: Sequence[Path], selection: Selection, engine: Engine) -> Iterator[AuditedControl]:
    """Yield what methods earned in finished runs on the chosen sequences of one table, each run checked against it."""
    table = selection.table
    checker = RunChecker(lambda _: table, engine)
    for run in map(RunFolder.open, runs):
        chosen = {(record.content_digest, record.selection_digest): record for record in run.record.tables}
        record = chosen.get((table.content, selection.digest))
        if record is None or not run.dataset(record.dataset).finished:
            raise UsageError(
                f"{run.path}: expected a finished run on the {len(selection)} sequences of {table.folder} that are"
                " audited, found none. Run the method with the --data, --split and --limit of the audit."
            )
        agreement = DatasetAgreement.read(run.dataset(record.dataset).path)
        yield AuditedControl(run.path.name, f"the run {run.path}", False, checker.check(run, record).summary, agreement)
