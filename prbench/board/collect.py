"""Find run folders and read what stands in a leaderboard.

The cost of a motion, as a leaderboard shows it beside the scores.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec

from prbench.board.merging import merge_folds
from prbench.errors import RunError
from prbench.files.bounded import foreign_input
from prbench.harness.benchmark import Benchmark, load_benchmark
from prbench.harness.claims import DECLARED, origin_of
from prbench.harness.methods.installed import name_problem
from prbench.harness.results import CheckedSummary, RunChecker, ScoredSequences, tree_of
from prbench.harness.run_folder import record as run_record
from prbench.harness.run_folder.folder import FOLDS_FILE, MERGED, FoldRun, RunFolder, read_folds, run_folder_of
from prbench.harness.run_folder.record import RunCost, RunRecord, TableRecord, total_cost
from prbench.harness.run_folder.scores import read_scores
from prbench.harness.run_folder.signature import require_signed
from prbench.harness.run_folder.summary import DatasetSummary
from prbench.protocol.manifests import benchmarks, find_benchmark
from prbench.tables import note_of

# Titles of the numbers of :func:`cost_of`, and their columns in CSV.
COSTS = {
    "seconds": ("s/motion (declared)", "seconds_per_motion"),
    "processor_seconds": ("CPU s/motion (declared)", "processor_seconds_per_motion"),
    "network_passes": ("Passes/motion (declared)", "passes_per_motion"),
    "memory_mebibytes": ("Memory (MiB) (declared)", "memory_mebibytes"),
    "parameters": ("Parameters (declared)", "parameters"),
}
# What a run says of its training data by itself; a submission says more.
NOT_DECLARED = "not declared"
# The cost of controls, whose motions the harness makes, and of motions that came as a file.
UNMEASURED: dict[str, float | None] = dict.fromkeys(COSTS)


def cost_of(run: RunFolder, table: TableRecord, folds: Sequence[RunFolder] = ()) -> tuple[dict[str, float | None], str]:
    """Read the cost of one dataset of a finished run.

    Args:
        run: The run.
        table: Its entry for the dataset.
        folds: The runs that it was merged from.

    Returns:
        Seconds and processor seconds a motion, batched as the run was, without warm-up; network passes a motion, as
        the method declares;
        largest memory of the device, else of the process, MiB; parameters of the networks. None where nothing was
        measured or declared. And the reason why ``cost.json`` is not believed, which leaves None of all.
    """
    try:
        cost = RunCost.read(run.dataset(table.dataset).cost)
        problem = cost.problem(run.record, table)
        parts = [RunCost.read(fold.dataset(table.dataset).cost) for fold in folds]
        if parts and total_cost(parts) != msgspec.structs.replace(cost, checksum=""):
            problem = problem or "it is not the sum of the costs of its folds"
    except RunError as error:
        return UNMEASURED, str(error)
    motions = cost.motions + cost.warm_up_motions
    if problem or not motions or not cost.seconds + cost.warm_up_seconds:
        return UNMEASURED, problem
    # A run of a single batch has a warm-up alone: slower than later batches, but the only measurement.
    part = "" if cost.motions else "warm_up_"
    seconds, computed, timed = (getattr(cost, part + name) for name in ("seconds", "processor_seconds", "motions"))
    memory = cost.peak_device_bytes if cost.peak_device_bytes is not None else cost.peak_process_bytes
    return {
        "seconds": seconds / timed,
        "processor_seconds": None if computed is None else computed / timed,
        "network_passes": cost.network_passes_declared / motions if cost.network_passes_declared else None,
        "memory_mebibytes": memory / 2**20 if memory else None,
        "parameters": cost.parameters,
    }, ""


@dataclass(frozen=True)
class LeaderboardRow:
    """A run on one dataset.

    Attributes:
        run: Name of the run folder.
        unverified: The reason why its scores were not checked against its motions; empty where they were.
        sequences: What its numbers on some of the sequences are made from.
        protocol: Name and version of a user's own protocol; empty for prbench's.
        scores: Its ``scores.parquet``.
        only: Ids of the sequences that its summary is of, and that it is compared on; None for all that were scored.
        cost: Cost of a motion; see :func:`cost_of`.
        unverified_cost: The reason why ``cost.json`` is not believed; empty where nothing contradicts it.
        declared: What the run says and nothing at hand can show.
        submission: Id of the submission that it came in to a board; empty for a run folder.
        verified: How its scores were held against the motions, in words.
        training: Words on what the method was trained on, as its submission declares it.
    """

    run: str
    record: RunRecord
    table: TableRecord
    summary: DatasetSummary
    unverified: str = ""
    sequences: ScoredSequences | None = None
    protocol: str = ""
    scores: Path | None = None
    only: frozenset[str] | None = None
    cost: Mapping[str, float | None] = field(default_factory=lambda: UNMEASURED)
    unverified_cost: str = ""
    declared: tuple[str, ...] = DECLARED
    submission: str = ""
    verified: str = "verified"
    training: str = NOT_DECLARED

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.record.method.name

    @property
    def benchmark(self) -> Benchmark:
        """The benchmark of the run."""
        return load_benchmark(self.record.benchmark)

    @property
    def origin(self) -> str:
        """Origin of the method, in words; a record that claims a method for prbench without right is not believed."""
        return origin_of(self.record)

    @property
    def is_control(self) -> bool:
        """Made by the harness, or with another sequence's goals: shown, never ranked."""
        return self.record.method.kind == run_record.CONTROL or self.record.control is not None

    @property
    def variant(self) -> str:
        """Submission, control, weights and options: what distinguishes runs of one method."""
        method = self.record.method
        parts = [part for part in (self.submission, self.record.control) if part]
        if method.weights:
            parts.append(f"weights {method.weights}")
        parts += [f"{key}={value}" for key, value in sorted(method.options.items())]
        return "; ".join(parts)

    @property
    def remarks(self) -> str:
        """Words on what is not verified, for the cell beside the method; empty where all is."""
        return note_of("unverified" if self.unverified else "", "unverified (cost)" if self.unverified_cost else "")


@dataclass(frozen=True)
class CollectedRuns:
    """Rows of all finished runs, what had to be left out, and the id of the key that all runs are signed by."""

    rows: tuple[LeaderboardRow, ...]
    left_out: tuple[str, ...]
    signed_by: str = ""


# Values of ``--training``, and how the declarations begin that each of them means.
TRAINING = {"none": "declared none", "declared": "declared", "overlapping": "overlaps", "undeclared": NOT_DECLARED}


def with_training(collected: CollectedRuns, kinds: Collection[str]) -> CollectedRuns:
    """Keep controls, and the runs whose training data are declared as asked for; what is left out is told.

    Args:
        collected: The runs.
        kinds: Keys of :data:`TRAINING`.
    """
    begins = tuple(TRAINING[kind] for kind in kinds)
    kept = tuple(row for row in collected.rows if row.is_control or row.training.startswith(begins))
    count = len(collected.rows) - len(kept)
    told = f"{count} rows whose training data are not as asked for ({', '.join(kinds)})"
    return replace(collected, rows=kept, left_out=(*collected.left_out, *([told] if count else ())))


def run_folders(paths: Iterable[Path]) -> list[Path]:
    """Find the run folders that some paths mean, by name; one that is named twice, or through a link, counts once.

    Args:
        paths: Run folders, or folders that hold some, in any order.

    Raises:
        RunError: if a path holds no run.
    """
    folders: set[Path] = set()
    for path in paths:
        found = [run_folder_of(path)]
        # A merged run is held against the runs on the folds beside it.
        if not (found[0] / run_record.FILE_NAME).is_file() or found[0].parent == path:
            found = sorted(file.parent for file in path.rglob(run_record.FILE_NAME)) if path.is_dir() else []
        if not found:
            expected = f"a run folder (with {run_record.FILE_NAME}) or a folder of runs"
            raise RunError(f"{path}: expected {expected}, found none.")
        folders.update(Path(os.path.realpath(folder)) for folder in found)
    return sorted(folders)


# Reads the summary of one dataset of a run, and says whether it could be verified.
Check = Callable[[RunFolder, TableRecord], CheckedSummary]


@foreign_input()
def collect_runs(
    paths: Iterable[Path], *, check: Check | None = None, any_benchmark: bool = False, signed_by: Path | None = None
) -> CollectedRuns:
    """Read run folders, or all run folders below a folder.

    Args:
        paths: Run folders in any order; a run that is named twice counts once.
        check: Function that verifies a run; the default has no tables and leaves all runs unverified.
        any_benchmark: The caller shows runs of every benchmark; without it, those of the default one alone.
        signed_by: File of the public key that every run must be signed by; None for runs as they are.

    Raises:
        RunError: if a path holds no run, a run is damaged or unsigned, or its files do not follow from one another.
    """
    rows: list[LeaderboardRow] = []
    left_out: list[str] = []
    merged: list[tuple[LeaderboardRow, RunFolder]] = []
    of_folds: dict[tuple[str, str], tuple[LeaderboardRow, RunFolder]] = {}
    opened = [RunFolder.open(folder, any_benchmark=any_benchmark) for folder in run_folders(paths)]
    signer = require_signed(opened, signed_by) if signed_by is not None else ""
    for run in opened:
        folder = run.path
        if run.record.benchmark not in benchmarks():
            left_out.append(f"{folder.name}: of a benchmark that this version of prbench does not have")
            continue
        # A foreign method under the name of ours would stand in the study's own row; prbench 0.5 checked no names.
        method = run.record.method
        foreign = method.kind in (run_record.PACKAGE, run_record.PROGRAM, run_record.FILE)
        problem = name_problem(method.name, own=find_benchmark(run.record.benchmark).methods) if foreign else None
        if problem:
            left_out.append(f"{folder.name}: {problem}; run or score it again under another name")
            continue
        unfinished = [table.dataset for table in run.record.tables if not run.dataset(table.dataset).finished]
        if unfinished:
            left_out.append(f"{folder.name}: not finished on {', '.join(unfinished)}; run it again, it resumes")
            continue
        for table in run.record.tables:
            checked = (check or RunChecker().check)(run, table)
            cost, unverified_cost = cost_of(run, table)
            # Name and version of the user's own protocol that a run follows; empty for prbench's.
            protocol = run.protocol
            name = folder.parent.name if folder.name == MERGED else folder.name
            label = protocol.label if protocol is not None and protocol.is_own else ""
            told = (checked.summary, checked.unverified, checked.scored, label, run.dataset(table.dataset).scores)
            paid = {"cost": cost, "unverified_cost": unverified_cost}
            row = LeaderboardRow(name, run.record, table, *told, **paid, declared=checked.declared)
            if (run.path / FOLDS_FILE).is_file():
                merged.append((row, run))
            elif table.fold is not None:
                of_folds[FoldRun.of(run).key] = row, run
            else:
                rows.append(row)
    within: set[tuple[str, str]] = set()
    for row, run in merged:
        keys = [fold.key for fold in read_folds(run.path)]
        named = [of_folds.get(key) for key in keys]
        folds = [pair[1] for pair in named if pair is not None]
        cost, unverified_cost = cost_of(run, row.table, folds)
        rows.append(replace(row, unverified=_why_unverified(run, named), cost=cost, unverified_cost=unverified_cost))
        within.update(keys)
    # The scores of a fold's run are among the merged ones; beside them it would count its sequences twice.
    rows += [row for key, (row, _) in of_folds.items() if key not in within]
    return CollectedRuns(tuple(rows), tuple(left_out), signer)


def _why_unverified(merged: RunFolder, named: Sequence[tuple[LeaderboardRow, RunFolder] | None]) -> str:
    """Hold merged scores against those of the runs on the folds.

    Args:
        merged: The merged run.
        named: The runs that it says it was put together from, as far as they were named.

    Returns:
        Why its scores are unverified, or an empty text.

    Raises:
        RunError: if it does not follow from those runs.
    """
    found = [pair for pair in named if pair is not None]
    if len(found) < len(named):
        return "the runs that it was merged from are not among those named; name them, too"
    again = merge_folds([run.path for _, run in found])
    table = again.record.tables[0]
    files = merged.dataset(table.dataset)
    stored = read_scores(files.scores)
    same_faults = tree_of(again.summary)["findings"] == tree_of(DatasetSummary.read(files.path))["findings"]
    if again.record != merged.record or not again.scores.equals(stored.cast(again.scores.schema)) or not same_faults:
        remedy = "It was edited; merge them again into another folder: `prbench merge RUN … --out DIR`"
        raise RunError(f"{merged.path}: does not follow from the runs that {FOLDS_FILE} names. {remedy}.")
    reasons = [row.unverified for row, _ in found if row.unverified]
    return f"one of the runs that it was merged from is unverified: {reasons[0]}" if reasons else ""
