"""The error budgets of runs: their motions diagnosed, counted by group, and where successes are lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq
from jaxtyping import Float

from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.errors import RunError, TableError
from prbench.files.storage import atomic_path, remove_leftovers, sole_writer
from prbench.harness.run_folder import RunFolder
from prbench.harness.run_folder.record import TableRecord
from prbench.protocol.manifests import BenchmarkProtocol, load_protocol
from prbench.sequences import SequenceTable
from prbench.tables import Block, Cell, Column, Row, Table
from prbench_benchmarks.prime_and_reach.error_budget.looking import CAUSES as LOOK_CAUSES
from prbench_benchmarks.prime_and_reach.error_budget.motions import (
    BESIDE,
    FEATURES,
    METHOD,
    PEOPLE,
    PHASES,
    REACH_CAUSES,
    diagnosed_motions,
)

FindTable = Callable[[TableRecord], SequenceTable | None]
Progress = Callable[[int, int, str], None]

# Maps the column of each rate's outcomes to its title.
RATES = {"primed": "Prime Success", "reached": "Reach Success"}
# Seconds, upper ends of the bins but the last: about quarters of the study's gaps, of which few exceed 8.
_PRIME_GAPS = (2.0, 4.0, 6.0)
_UNITS = {"bearing": "°", "distance": " m", "height": " m", "prime gap": " s"}
# Titles of the columns of causes, where they are not the causes' own.
_SHORT = {
    "does not slow": "slow",
    "does not stay": "stay",
    "looks early": "early",
    "looks late": "late",
    "misses": "miss",
    "never looks": "never",
    "stands too far": "too far",
    "comes and leaves": "leaves",
    "stops short": "short",
}
# Titles of the columns that say where successes of a rate are lost (docs/error-budget.md#parts).
_PARTS = {
    "always": "always",
    "noise": "noise",
    "optimisation": "optim.",
    "representation": "repr.",
    "not_learnt": "not learnt",
    "nor_people": "nobody",
}
# Column of the causes of each rate, and the causes.
_CAUSES = {"primed": ("look_cause", LOOK_CAUSES[1:]), "reached": ("reach_cause", REACH_CAUSES[1:])}
_MEDIANS = {
    "miss_deg": "look_miss_deg",
    "miss_up_deg": "look_miss_up_deg",
    "miss_aside_deg": "look_miss_aside_deg",
    "look_time": "look_best_time",
    "smallest": "reach_smallest",
}
_STAYS = ("stays", "stays_with_elevation", "stays_with_azimuth")
# Columns of the motions where they are not named like the numbers.
_NAMES = _MEDIANS | {name: f"look_{name}" for name in _STAYS}
_Numbers = dict[str, float | None]


def error_budgets(
    runs: Sequence[Path], *, beside: Path | None, find_table: FindTable, out: Path | None, progress: Progress
) -> list[Table]:
    """Say why the motions of runs fail.

    Args:
        runs: Run folders with their motions.
        beside: A run of the same sequences by other options, such as one without optimisation.
        find_table: Gives the very table that a run was made on.
        out: Folder for one row a motion; None writes nothing.
        progress: Called after each run.

    Returns:
        The tables of each run.

    Raises:
        RunError: if a folder is no run or keeps no motions, or the run beside has no sequence in common with a run.
        TableError: if the table of a run is not at hand.
        StorageError: if the folder cannot be written.
    """
    other = None if beside is None else RunFolder.open(beside)
    tables: list[Table] = []
    rows: list[pa.Table] = []
    for done, path in enumerate(runs):
        run = RunFolder.open(path)
        made_on = []
        for record in run.record.tables:
            table = find_table(record)
            if table is None:
                raise TableError(
                    f"{run.path}: expected the table of {record.dataset} that it was made on, found none of that"
                    " content. Name it with --data DIR."
                )
            made_on.append(table)
        motions = diagnosed_motions(run, made_on)
        if other is not None:
            digests = {record.content_digest for record in run.record.tables}
            shared = [record for record in other.record.tables if record.content_digest in digests]
            found = [table for table in map(find_table, shared) if table is not None]
            if not found:
                raise RunError(
                    f"{other.path}: expected a run on the same tables as {run.path}, found none in common. Run both"
                    " methods on the same tables, or leave --beside out."
                )
            motions = pa.concat_tables([motions, diagnosed_motions(other, found, who=BESIDE)])
        tables += _budget(run, other, motions)
        rows.append(motions.add_column(0, "run", pa.array([path.name] * len(motions))))
        progress(done + 1, len(runs), path.name)
    if out is not None:
        writers = {"motions.parquet": pq.write_table, "motions.csv": pyarrow.csv.write_csv}
        with sole_writer(out):
            for name, write in writers.items():
                remove_leftovers(out / name)  # of a process that was killed while it wrote
                with atomic_path(out / name) as temporary:
                    write(pa.concat_tables(rows), temporary)
    return tables


def _budget(run: RunFolder, other: RunFolder | None, motions: pa.Table) -> list[Table]:
    """Lay out the budget of one run."""
    record = run.record
    method = _of(motions, METHOD)
    people = _of(motions, PEOPLE)
    options = ", ".join(f"{name}={value}" for name, value in record.method.options.items())
    sequences, recordings = _counts(method)
    about = f"{record.method.name}, {record.condition}{f' ({options})' if options else ''}"
    head = (
        f"{about}; split {record.split}: {sequences} sequences of {recordings} recordings,"
        f" {record.samples} {'motion' if record.samples == 1 else 'motions'} each"
    )
    notes = []
    if any(table.synthetic for table in record.tables):
        notes = [ON_SYNTHETIC_DATA]
    # Groups of the method's motions, each beside the same group of people.
    protocol = run.protocol or load_protocol()
    groups = {"recorded people": (people, people)}
    beside = dict(_groups(people, protocol))
    groups |= {name: (own, beside[name]) for name, own in _groups(method, protocol)}
    worst_bones = {}
    for name, (own, _) in groups.items():
        ((bone, count),) = Counter(own["worst_bone"].to_pylist()).most_common(1)
        worst_bones[name] = {"worst_bone": f"{bone} {100 * count / len(own):.0f}"}

    def measured(keys: Sequence[str], rate: str = "") -> dict[str, _Numbers]:
        return {name: _numbers(own, theirs, keys, rate) for name, (own, theirs) in groups.items()}

    tables = [
        _table(
            "Prime Success, and why motions are not primed, %",
            # Undefined causes have no column: they stand in JSON alone.
            measured(("sequences", "people", "primed", *LOOK_CAUSES[1:]), "primed"),
            {"sequences": "n", "people": "people", "primed": "primed", **_titles(LOOK_CAUSES[1:-1])},
        ),
        _table(
            "Best frame of the window (medians), and the share that would stay on the goal, %",
            measured(("miss_deg", "miss_up_deg", "miss_aside_deg", "look_time", *_STAYS)),
            {
                "miss_deg": "miss °",
                "miss_up_deg": "up °",
                "miss_aside_deg": "aside °",
                "look_time": "at s",
                "stays": "stays",
                "stays_with_elevation": "if its height",
                "stays_with_azimuth": "if its side",
            },
            digits={"miss_deg": 1, "miss_up_deg": 1, "miss_aside_deg": 1, "look_time": 2},
        ),
        _gains(motions),
        _table(
            "Reach Success, and why goals are not reached, %",
            measured(("sequences", "people", "reached", *REACH_CAUSES[1:], "smallest"), "reached"),
            {
                "sequences": "n",
                "people": "people",
                "reached": "reached",
                **_titles(REACH_CAUSES[1:]),
                "smallest": "nearest m",
            },
            digits={"smallest": 2},
        ),
        _table(
            "Feet and bones: shares of frames that slide, by phase; change of a bone, %",
            measured(("skating", "slides", *(f"slides_{phase}" for phase in PHASES), "bone_change")),
            {
                "skating": "skating",
                "slides": "slides",
                **{f"slides_{phase}": phase for phase in PHASES},
                "bone_change": "bones",
                "worst_bone": "worst bone",
            },
            words=worst_bones,
        ),
        *(_lost(rate, motions, record.samples) for rate in RATES),
        *([] if other is None else [_gained(other, run, motions)]),
    ]
    return [Table(title=f"{run.path.name}: {head}", notes=tuple(notes)), *tables]


def _table(
    title: str,
    rows: dict[str, _Numbers],
    columns: dict[str, str],
    *,
    digits: dict[str, int] | None = None,
    words: dict[str, dict[str, str]] | None = None,
) -> Table:
    """Lay out numbers by row and column; columns without digits of their own are whole numbers, such as percentages."""
    lines = []
    for name, numbers in rows.items():
        text = {"group": name} | ({} if words is None else words[name])
        lines.append(Row(text=text, cells=tuple(Cell(metric=key, value=value) for key, value in numbers.items())))
    shown = [Column(key=key, title=heading, digits=(digits or {}).get(key, 0)) for key, heading in columns.items()]
    return Table(
        title=title, columns=(Column(key="group", title="", text=True), *shown), blocks=(Block(rows=tuple(lines)),)
    )


def _of(motions: pa.Table, who: str) -> pa.Table:
    """Rows of the method, of people …."""
    return motions.filter(pc.field("who") == who)


def _groups(motions: pa.Table, protocol: BenchmarkProtocol) -> Iterator[tuple[str, pa.Table]]:
    """Yield motions by layout and by where and when the goal is; groups without motions are left out."""
    for layout in _layouts(motions):
        yield _layout_name(layout), motions if layout == "all" else motions.filter(pc.field("dataset") == layout)
    breakdown = protocol.breakdown
    ends_of = {
        "bearing": breakdown.bearing,
        "distance": breakdown.distance,
        "height": breakdown.height,
        "prime gap": _PRIME_GAPS,
    }
    for by, ends in ends_of.items():
        number = np.searchsorted(ends, motions[by].to_numpy(), side="right")
        unit = _UNITS[by]
        for index in range(len(ends) + 1):
            begin = ends[index - 1] if index else 0.0
            name = f"{begin:g} to {ends[index]:g}{unit}" if index < len(ends) else f"from {ends[-1]:g}{unit}"
            part = motions.filter(pa.array(number == index))
            if len(part):
                yield f"{by} {name}", part


def _layouts(motions: pa.Table) -> tuple[str, ...]:
    """Return ``all`` and the layouts; of a single layout only the former, which says the same."""
    names = sorted(set(motions["dataset"].to_pylist()))
    return ("all", *names) if len(names) > 1 else ("all",)


def _layout_name(layout: str) -> str:
    return layout.removeprefix("synthetic-")


def _counts(motions: pa.Table) -> tuple[int, int]:
    """Numbers of sequences, and of recordings that they come from."""
    datasets = motions["dataset"].to_pylist()
    ids = [set(zip(datasets, motions[name].to_pylist())) for name in ("sequence_id", "recording_id")]
    return len(ids[0]), len(ids[1])


def _titles(causes: Sequence[str]) -> dict[str, str]:
    return {cause: _SHORT.get(cause, cause) for cause in causes}


def _numbers(own: pa.Table, people: pa.Table, keys: Sequence[str], rate: str = "") -> _Numbers:
    """Measure a group of motions.

    Args:
        own: The method's motions, or people's.
        people: The same group of people.
        keys: What is measured: numbers of sequences, shares of causes in %, medians, else means in %.
        rate: One of :data:`RATES`, of which people's is told and the causes are.
    """
    numbers: _Numbers = {}
    for key in keys:
        if key == "sequences":
            numbers[key] = _counts(own)[0]
        elif rate and key in _CAUSES[rate][1]:
            numbers[key] = 100 * float((own[_CAUSES[rate][0]].to_numpy() == key).mean())
        else:
            of, name = (people, rate) if key == "people" else (own, _NAMES.get(key, key))
            values = of[name].to_numpy().astype(np.float64)
            known = values[np.isfinite(values)]
            # Sideways misses are as bad to either side.
            known = np.abs(known) if key == "miss_aside_deg" else known
            average = np.median if key in _MEDIANS else np.mean
            numbers[key] = float(average(known)) * (1 if key in _MEDIANS else 100) if known.size else None
    return numbers


def _gains(motions: pa.Table) -> Table:
    """Return the gains of elevation and azimuth of people, method and the run beside, by layout and over all.

    Over all layouts the line has one slope and an offset for each layout, so that layouts whose goals lie lower do not
    pass for heads that follow their goals.
    """
    rows = []
    everybody = [who for who in (PEOPLE, METHOD, BESIDE) if len(_of(motions, who))]
    for layout in _layouts(_of(motions, METHOD)):
        for angle in ("elevation", "azimuth"):
            words = {"group": f"{_layout_name(layout)}, {angle}"}
            cells = []
            for who in everybody:
                own = _of(motions, who)
                if layout != "all":
                    own = own.filter(pc.field("dataset") == layout)
                goal = own[f"look_goal_{angle}_deg"].to_numpy().copy()
                ray = own[f"look_ray_{angle}_deg"].to_numpy().copy()
                known = np.isfinite(goal) & np.isfinite(ray)
                dataset = own["dataset"].to_numpy()[known]
                goal = goal[known]
                ray = ray[known]
                about_ray = ray.mean() if ray.size else 0.0
                about_goal = goal.mean() if goal.size else 0.0
                for name in set(dataset) if layout == "all" and len(set(dataset)) > 1 else ():
                    inside = dataset == name
                    ray[inside] += about_ray - ray[inside].mean()
                    goal[inside] += about_goal - goal[inside].mean()
                line = gain(goal, ray)
                if line is not None:
                    words[who] = f"{line[0]:.2f} (r {line[2]:.2f})"
                    for key, value in zip(("slope", "offset_deg", "correlation"), line):
                        cells.append(Cell(metric=f"{who} {key}", value=value, sequences=len(goal)))
            rows.append(Row(text=words, cells=tuple(cells)))
    columns = [Column(key=who, title=who) for who in everybody]
    return Table(
        title="Gain: slope of the ray's angle against the goal's, best frame",
        columns=(Column(key="group", title="", text=True), *columns),
        blocks=(Block(rows=tuple(rows)),),
    )


def gain(goal_deg: Float[np.ndarray, " n"], ray_deg: Float[np.ndarray, " n"]) -> tuple[float, float, float] | None:
    """Fit ``ray = offset + slope * goal`` (docs/error-budget.md#gains).

    Args:
        goal_deg: Angle of the goal, finite.
        ray_deg: Angle of the ray, finite.

    Returns:
        The slope, which is 1 for a head that follows its goal and 0 for one that ignores it; the angle of the ray for a
        goal at angle 0, degrees; and the correlation. None for fewer than three motions, or where the goal has the same
        angle in all of them.
    """
    if len(goal_deg) < 3 or np.ptp(goal_deg) < 1e-9:
        return None
    slope, offset = np.polyfit(goal_deg, ray_deg, 1)
    correlation = float(np.corrcoef(goal_deg, ray_deg)[0, 1]) if np.ptp(ray_deg) > 0 else 0.0
    return float(slope), float(offset), correlation


def _by_sequence(motions: pa.Table, who: str, rate: str) -> dict[tuple[str, str], list[float]]:
    """Map dataset and id of each sequence to the outcomes of its samples, in their order."""
    own = _of(motions, who).sort_by("sample")
    found: dict[tuple[str, str], list[float]] = {}
    for *name, outcome in zip(*(own[column].to_pylist() for column in ("dataset", "sequence_id", rate))):
        found.setdefault(tuple(name), []).append(outcome)
    return found


def _lost(rate: str, motions: pa.Table, samples: int) -> Table:
    """Say for each layout where successes of a rate are lost (docs/error-budget.md#parts)."""
    rows = {}
    for layout in _layouts(motions):
        own = motions if layout == "all" else motions.filter(pc.field("dataset") == layout)
        outcomes = {who: _by_sequence(own, who, rate) for who in (METHOD, BESIDE, PEOPLE, FEATURES)}
        kinds: Counter[str] = Counter()
        for name, successes in outcomes[METHOD].items():
            if all(successes):
                kinds["always"] += 1
            elif any(successes):
                kinds["noise"] += 1
            elif any(outcomes[BESIDE].get(name, ())):
                kinds["optimisation"] += 1
            elif not outcomes[PEOPLE][name][0]:
                kinds["nor_people"] += 1
            elif outcomes[FEATURES][name][0]:
                kinds["not_learnt"] += 1
            else:
                kinds["representation"] += 1
        names = outcomes[METHOD]
        rows[_layout_name(layout)] = {
            "sequences": len(names),
            **{kind: 100 * kinds[kind] / len(names) for kind in _PARTS},
            "mean": 100 * float(np.mean([np.mean(successes) for successes in names.values()])),
            "best_of_k": 100 * float(np.mean([max(successes) for successes in names.values()])),
            "people": 100 * float(np.mean([outcomes[PEOPLE][name][0] for name in names])),
            "through_features": 100 * float(np.mean([outcomes[FEATURES][name][0] for name in names])),
        }
    columns = {"sequences": "n", **_PARTS, "best_of_k": f"best of {samples}", "through_features": "features"}
    return _table(f"{RATES[rate]}: where sequences are lost, %", rows, columns)


def _gained(other: RunFolder, run: RunFolder, motions: pa.Table) -> Table:
    """Compare a run with the one beside it, motion by motion: sample i beside sample i, which have one noise seed."""
    rows = {}
    for rate, title in RATES.items():
        method = _by_sequence(motions, METHOD, rate)
        beside = _by_sequence(motions, BESIDE, rate)
        common = sorted(method.keys() & beside.keys())
        if not common:
            raise RunError(
                f"{other.path}: expected sequences of {run.path}, found none. Run both methods on the same split, and"
                " one with a --limit that includes the other's."
            )
        pairs = np.array([pair for name in common for pair in zip(method[name], beside[name], strict=False)])
        own, theirs = pairs.T
        rows[title] = {
            "sequences": len(common),
            "rate": 100 * float(own.mean()),
            "rate_beside": 100 * float(theirs.mean()),
            "gained": 100 * float((theirs > own).mean()),
            "lost": 100 * float((own > theirs).mean()),
        }
    columns = {
        "sequences": "n",
        "rate": "this run",
        "rate_beside": "beside",
        "gained": "beside alone",
        "lost": "this run alone",
    }
    return _table(f"Beside {other.path.name}, on the sequences of both, %", rows, columns)
