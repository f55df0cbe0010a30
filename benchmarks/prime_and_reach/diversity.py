"""``prbench analyse``: how far a run's motions for one goal differ, and on which sequences methods succeed.

Source: docs/specification/metrics.md#diversity.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.errors import RunError, UsageError
from prbench.geometry.skeleton import Joint
from prbench.harness.agreement import Sides, agreement_with_people, pooled_agreement
from prbench.harness.controls import Tasks, at_length, laid_on_goal, read_motions
from prbench.harness.diversity import SPREADS, MotionsToGoal, spreads
from prbench.harness.first_run import tables_of_runs
from prbench.harness.intervals import clustered, difference_interval, mean_interval
from prbench.harness.results import RunChecker, cases_of_run
from prbench.harness.run_folder import CodedScores, DatasetAgreement, RunFolder
from prbench.harness.run_folder.summary import RateAgreement
from prbench.protocol.manifests import BenchmarkProtocol, load_protocol
from prbench.sequences import SequenceTable, find_sequence_id
from prbench.sequences.dataset_info import may_pass_on, notice, require_may_pass_on
from prbench.tables import Block, Cell, Column, Row, Table, metric_cell
from prbench.viewing.fan import Fan, FanGroup
from prbench.viewing.replay.read import RunMotions, run_labels
from prbench.viewing.replay.scene import METHOD_COLOURS, RECORDED_COLOUR

# Called with finished sequences, all of them, and the dataset.
Progress = Callable[[int, int, str], None]
_NUMBERS = ("start_time", "prime_time", "head_tilt_deg", "fps")
_COLUMNS = [*_NUMBERS, "goal_location", "recording_id", "joints"]


def measure_diversity(run: Path, data: Sequence[Path] = (), *, progress: Progress = lambda *_: None) -> list[Table]:
    """Measure the diversity of a run on each of its datasets.

    Args:
        run: A run folder of two samples or more.
        data: Tables of the run; the embedded ones are known.
        progress: Called after each sequence.

    Returns:
        A table for each dataset, a row for each measure: the mean of the method, that of recorded people in similar
        tasks, an upper bound of their spread in one task, and the difference, with intervals over recordings. People
        are missing where the table has too few recordings.

    Raises:
        UsageError: if the run has one motion a sequence, or was given other sequences' goals.
        RunError: if its motions are missing, or a table is another one than the run's.
        TableError: if a table cannot be found.
        PredictionsError: if a motion does not fit its sequence.
    """
    opened = _require_several(RunFolder.open(run))
    return [_measured(opened, table, progress) for table in tables_of_runs([opened], data)]


def read_fan(
    run: Path, data: Sequence[Path] = (), *, sequence: str | None = None, permitted: Collection[str] = ()
) -> Fan:
    """Read the motions of one sequence for a picture.

    Args:
        run: A run folder of two samples or more.
        data: Tables of the run; the embedded ones are known.
        sequence: Id of the sequence, or a part that fits one only; by default the first by name.
        permitted: Datasets for which the user has permission to pass recorded motion on.

    Raises:
        UsageError: if the sequence is unknown or not in the run; else as :func:`measure_diversity`.
        RedistributionError: if the run's motions are recorded ones that must not be passed on.
    """
    opened = _require_several(RunFolder.open(run))
    tables = tables_of_runs([opened], data)
    held = {name: table for table in tables for name in require_motions(opened, table)}
    among = ", ".join(table.info.dataset for table in tables)
    name = min(held)
    if sequence is not None:
        name = find_sequence_id(sequence, list(held), among=f"the motions of {run} on {among}")
    info = held[name].info
    label = run_labels([opened.path], [opened.record])[0]
    if opened.record.method.kind == "control":
        require_may_pass_on(info, f"the motions of '{label}'", permitted)
    ((_, generated, recorded, _),) = _pairs(opened, held[name], [name])
    shown = may_pass_on(info, permitted)
    groups = [FanGroup(label, METHOD_COLOURS[0], generated)]
    if shown and recorded is not None:
        groups.append(FanGroup("recorded people, similar tasks", RECORDED_COLOUR, recorded))
    return Fan(
        sequence_id=name,
        dataset=info.dataset,
        synthetic=info.synthetic,
        groups=tuple(groups),
        shows_goal=shown,
        constants=rules_of(opened).metrics,
        notice=notice(info, permitted),
    )


def _require_several(run: RunFolder) -> RunFolder:
    """Refuse runs whose motions cannot differ, or whose goals are not those of the table.

    Raises:
        UsageError: saying which run would do.
    """
    record = run.record
    if record.samples < 2:
        found = "found one, which differs from nothing. Run the method with --samples 5."
        raise UsageError(f"{run.path}: expected two motions or more of each sequence, {found}")
    if record.control is not None:
        raise UsageError(f"{run.path}: its motions were given other sequences' goals. Name the run without --control.")
    return run


def rules_of(run: RunFolder) -> BenchmarkProtocol:
    """Return the protocol of a run; the built-in one where it kept none."""
    return run.protocol or load_protocol()


def require_motions(run: RunFolder, table: SequenceTable) -> list[str]:
    """Return the sequences of which the run holds motions.

    Raises:
        RunError: if there are none.
    """
    motions = RunMotions.open(run, table.info.dataset, label="")
    names = [name for name in cases_of_run(run, table)[2].sequence_ids if name in motions]
    if not names:
        raise RunError(f"{run.path}: expected motions on {table.info.dataset}, found none. Run it again: it resumes.")
    return names


def beside_people(
    run: RunFolder, table: SequenceTable, progress: Progress = lambda *_: None, *, names: Sequence[str] = ()
) -> Iterator[tuple[str, str, MotionsToGoal, float]]:
    """Yield sequences of which a run holds motions, in table order.

    Args:
        run: The run.
        table: The table that it was made on.
        progress: Called after each sequence.
        names: Ids of some of them; all by default.

    Yields:
        The sequence, its recording, the recorded motion with each of the run's behind it, and the prime time.

    Raises:
        RunError: if the run has no motions on the table.
        PredictionsError: if a motion does not fit its sequence.
    """
    dataset = table.info.dataset
    samples = [RunMotions.open(run, dataset, label="", sample=sample) for sample in range(run.record.samples)]
    wanted = frozenset(names or require_motions(run, table))
    for done, chunk in enumerate(table.chunks(columns=_COLUMNS, ids=wanted, rows=1), 1):
        (name,) = chunk.sequence_ids
        begin, prime_time, tilt, fps = (float(chunk.numbers(column)[0]) for column in _NUMBERS)
        joints = np.stack([chunk.joints, *(motion.joints(name, len(chunk.joints)) for motion in samples)])
        motions = MotionsToGoal(joints, chunk.vectors("goal_location")[0], tilt, fps)
        yield name, chunk.strings("recording_id")[0], motions, prime_time - begin
        progress(done, len(wanted), dataset)


def _measured(run: RunFolder, table: SequenceTable, progress: Progress) -> Table:
    constants = rules_of(run).metrics
    info = table.info
    names = require_motions(run, table)
    recordings: list[str] = []
    method: list[dict[str, float]] = []
    people: list[dict[str, float]] = []
    apart: list[np.ndarray] = []
    for recording, generated, recorded, distances in _pairs(run, table, names, progress):
        recordings.append(recording)
        method.append(spreads(generated, constants))
        if recorded is not None:
            people.append(spreads(recorded, constants))
        apart.append(distances)
    if len(people) == len(method):
        goals_apart, lengths_apart = np.median(np.concatenate(apart), axis=0)
        said = (
            "People: the sequence and similar tasks of other recordings, laid on its start and goal; an upper bound of"
            f" what one task brings forth (goals {goals_apart:.2f} m apart in median, lengths {lengths_apart:.2f} s)."
        )
    else:
        people = []
        said = "People: the table has too few recordings to put people beside one another."
    notes = [said]
    rows = []
    for spread, (title, unit) in SPREADS.items():
        own = np.array([values[spread] for values in method])
        estimates = {"method": mean_interval(clustered(own, recordings), nonnegative=True)}
        if people:
            theirs = np.array([values[spread] for values in people])
            estimates["people"] = mean_interval(clustered(theirs, recordings), nonnegative=True)
            estimates["difference"], _ = difference_interval(clustered(own - theirs, recordings))
        about: dict[str, Any] = {"dataset": info.dataset, "condition": run.record.condition}
        about |= {"method": run.record.method.name, "variant": spread, "unit": unit}
        cells = []
        for name, each in estimates.items():
            about |= {"value": each.mean, "low": each.low, "high": each.high, "note": "; ".join(each.marks)}
            about |= {"sequences": each.n_sequences, "recordings": each.n_recordings}
            cells.append(Cell(metric=name, **about))
        rows.append(Row(text={"measure": title, "unit": unit}, cells=tuple(cells)))
        if "few_recordings" in estimates["method"].marks and len(notes) == 1:
            notes.append("Few recordings (below ten): the intervals say little.")
    if info.synthetic:
        notes.append(ON_SYNTHETIC_DATA)
    count = len(set(recordings))
    return Table(
        title=(
            f"{info.title}: {run.record.method.name}, condition {run.record.condition}; {run.record.samples} motions of"
            f" each of {len(names)} sequences of {count} recording{'' if count == 1 else 's'}; means over sequences and"
            " their 95 % intervals"
        ),
        dataset=info.dataset,
        columns=(
            *(Column(key=name, title=name, text=True) for name in ("measure", "unit")),
            *(Column(key=name, title=name, digits=3) for name in ("method", "people")),
            Column(key="difference", title="method - people", digits=3),
        ),
        blocks=(Block(rows=tuple(rows)),),
        notes=tuple(notes),
    )


def _pairs(
    run: RunFolder, table: SequenceTable, names: Sequence[str], progress: Progress = lambda *_: None
) -> Iterator[tuple[str, MotionsToGoal, MotionsToGoal | None, np.ndarray]]:
    """Yield the motions of some sequences, in table order.

    Yields:
        The recording; the generated and the recorded motions, None where there are too few; and how far the goal
        (metres) and the length (seconds) of each similar task are from the sequence's own (others, 2).
    """
    tasks = Tasks.read(table)
    row_of = {name: row for row, name in enumerate(tasks.sequence_ids)}
    similar = {name: tasks.most_similar(row_of[name], run.record.samples - 1) for name in names}
    motions = read_motions(table, frozenset(tasks.sequence_ids[row] for rows in similar.values() for row in rows))
    for name, recording, together, _ in beside_people(run, table, progress, names=names):
        row = row_of[name]
        others = similar[name]
        goal = tasks.goal_location[row]
        laid = [together.joints[0]]
        for other in others:
            stretched = at_length(motions[tasks.sequence_ids[other]], together.joints.shape[1])
            aside = laid_on_goal(stretched, tasks.goal_location[other], goal)
            # The method is given where the motion starts, so people start there, too.
            away = (aside - laid[0])[0, Joint.PELVIS] * (1, 0, 1)
            laid.append(aside - np.linspace(1, 0, len(aside))[:, None, None] * away)
        recorded = replace(together, joints=np.stack(laid)) if len(laid) == run.record.samples else None
        distances = np.linalg.norm(tasks.goal_location[others] - goal, axis=-1)
        lengths = np.abs(tasks.seconds[others] - tasks.seconds[row])
        generated = replace(together, joints=together.joints[1:])
        yield recording, generated, recorded, np.stack((distances, lengths), axis=1)


_UNITS = {"bearing": "°", "distance": " m", "height": " m"}
_METRIC = Column(key="metric", title="metric", text=True)
_PEOPLE = Column(key="people", title="people", unit="%")
_AGREEMENT = (_METRIC, Column(key="phi", title="phi"), _PEOPLE, Column(key="remark", title="", text=True))
_BY_PLACE = (
    _METRIC,
    Column(key="goal", title="goal", text=True),
    *(Column(key=name, title=name) for name in ("sequences", "recordings")),
    Column(key="mean", title="mean", unit="%"),
    _PEOPLE,
)


def agreement_tables(runs: Sequence[Path], checker: RunChecker) -> list[Table]:
    """Lay out for each run and dataset the agreement with recorded people, and the rates by the goal's place.

    Behind them stands the agreement over the sequences of each dataset that several runs have, such as tables of
    several seeds, and over all sequences; of the tables at hand.

    Args:
        runs: Finished run folders.
        checker: Holds the tables at hand, on which the scores are checked.

    Raises:
        RunError: if a run is damaged, or its files do not follow from one another.
    """
    tables = []
    together: dict[str, Sides] = {}
    for path in runs:
        run = RunFolder.open(path)
        for record in run.record.tables:
            unverified = checker.check(run, record).unverified
            found = DatasetAgreement.read(run.dataset(record.dataset).path)
            title = f"{path.name}: {run.record.method.name} (declared) on {record.dataset}"
            notes = [f"unverified: {unverified}"] if unverified else []
            if record.synthetic:
                notes.append(ON_SYNTHETIC_DATA)
            table = checker.find_table(record)
            if table is not None:
                cases = cases_of_run(run, table)[2]
                scores = CodedScores.read(run.dataset(record.dataset).scores)
                cases = cases.chosen(np.isin(cases.sequence_ids, scores.sequence_ids))
                for part in (record.dataset, "all datasets"):
                    agreement_with_people(cases, scores, protocol=rules_of(run), sides=together.setdefault(part, {}))
            bins = []
            for each in found.breakdown:
                unit = _UNITS[each.by]
                end = f"from {each.begin:g}{unit}" if each.end is None else f"{each.begin:g} to {each.end:g}{unit}"
                words = {"metric": each.title, "goal": f"{each.by} {end}"}
                words |= {"sequences": str(each.sequences), "recordings": str(each.recordings)}
                mean = metric_cell("mean", "rate", each.mean, each.low, each.high)
                bins.append(Row(text=words, cells=(mean, metric_cell("people", "rate", each.people))))
            by_sequence = f"{title}: agreement with recorded people, sequence by sequence"
            by_place = f"{title}: by where the goal is, seen from the first pose"
            tables += [
                _rates_table(by_sequence, found.rates),
                Table(title=by_place, columns=_BY_PLACE, blocks=(Block(rows=tuple(bins)),), notes=tuple(notes)),
            ]
    for dataset, sides in together.items():
        count = max(map(len, sides.values()))
        if count > 1:
            title = f"{dataset}, {count} together: agreement with recorded people, sequence by sequence"
            tables.append(_rates_table(title, pooled_agreement(sides, load_protocol())))
    return tables


def _rates_table(title: str, rates: Sequence[RateAgreement]) -> Table:
    rows = []
    for rate in rates:
        about = {name: getattr(rate, name) for name in ("low", "high", "sequences", "recordings")}
        phi = Cell(metric="phi", value=rate.phi, **about)
        words = {"metric": rate.title, "remark": rate.remark}
        rows.append(Row(text=words, cells=(phi, metric_cell("people", "rate", rate.people))))
    said = "phi from -1 to 1, 0 is unrelated; 95 % intervals in brackets."
    return Table(title=title, columns=_AGREEMENT, blocks=(Block(rows=tuple(rows)),), notes=(said,))
