"""Tables that nobody has to name (the embedded defaults, the tables of a run), and the repetition of an earlier run.

The defaults are small synthetic datasets, one of each layout, on which a first run is shown beside other methods. A run
folder holds digests only, no paths, so its tables are looked for among the named and the embedded ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import prbench
from prbench.contract import Condition
from prbench.engine import Engine
from prbench.errors import RunError, TableError, UsageError
from prbench.files.storage import cache_folder, in_turn, text_digest
from prbench.harness.benchmark import CaseTable, load_benchmark
from prbench.harness.controls import GROUND_TRUTH, SCRIPTED
from prbench.harness.methods.installed import list_adapters
from prbench.harness.request import Experiment, ExperimentMethod, RunRequest
from prbench.harness.run_folder import RunFolder, read_scores
from prbench.harness.run_folder.record import FILE, PROGRAM, UNKNOWN, TableRecord
from prbench.harness.run_folder.record import FILE_NAME as RUN_FILE
from prbench.protocol.manifests import benchmarks, digest_of, load_manifest, load_protocol
from prbench.protocol.own_protocol import FILE_NAME as PROTOCOL_FILE
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.sequences.dataset_info import FILE_NAME
from prbench.sequences.folds import ALL_FOLDS, fold_tables
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.people.person import PRESETS

if TYPE_CHECKING:
    from prbench.harness.synthetic_table import Progress
    from prbench.synthetic.people.world import Split

# Datasets that the embedded tables imitate, one table each.
LAYOUTS = tuple(PRESETS)
SEED = 0
# People of each split whose first recording is in each table; those of the test split are all there are.
PEOPLE: Mapping[Split, int] = MappingProxyType({"train": 4, "validation": 2, "test": 7})
# Number of test sequences of each table that a first run generates, unless the user names another.
SEQUENCES = 10
# Sequences a batch in a first run: small enough that two workers share the work.
BATCH_SIZE = 5
# Methods beside which a first run is shown, and their condition; None takes the run's own.
_COMPANIONS = (("mdm", Condition.TEXT), (SCRIPTED, None), ("static", Condition.NONE), (GROUND_TRUTH, None))
_SHOWN = 12  # characters of a digest


def default_tables(
    engine: Engine, progress: Progress, tell: Callable[[str], None] = lambda _: None
) -> tuple[SequenceTable, ...]:
    """Open the embedded datasets, one of each layout, building those first that are not there yet.

    Args:
        engine: Processes or cluster that builds them.
        progress: Called after each recording.
        tell: Called with a line that names the process which is building them meanwhile, and is waited for.
    """
    if default_tables_are_built():
        return tuple(SequenceTable.open(folder) for folder in default_table_folders())
    # Every later run goes without it.
    from prbench.harness.synthetic_table import build_synthetic_table, recordings_of_people

    parent = default_folder()
    with in_turn(parent.with_name(f"{parent.name}.first-run"), tell):  # each build itself holds its folder
        # Tables that a killed process or another one has finished stay.
        missing = {
            layout: recordings_of_people(layout, SEED, PEOPLE)
            for layout, folder in zip(LAYOUTS, default_table_folders(), strict=True)
            if not (folder / FILE_NAME).is_file()
        }
        total = sum(map(len, missing.values()))
        done = 0
        for layout, recordings in missing.items():

            def show(finished: int, _: int, last: str, before: int = done) -> None:
                progress(before + finished, total, last)

            build_synthetic_table(
                layout, recordings=recordings, seed=SEED, out=parent / layout, engine=engine, progress=show
            )
            done += len(recordings)
    return tuple(SequenceTable.open(folder) for folder in default_table_folders())


def default_tables_are_built() -> bool:
    """Return True if every embedded dataset is there."""
    return all((folder / FILE_NAME).is_file() for folder in default_table_folders())


def default_table_folders() -> tuple[Path, ...]:
    """Return the folders of the embedded datasets, in the order of :data:`LAYOUTS`, built or not."""
    return tuple(default_folder() / layout for layout in LAYOUTS)


def default_folder() -> Path:
    """Return the folder that holds the embedded datasets and nothing else.

    Another version of prbench, generator, protocol or schema gets another one.
    """
    # Everything that the tables' bytes depend on, so that no version reads the tables of another.
    versions = (prbench.__version__, str(GENERATOR_VERSION), str(SCHEMA_VERSION), load_protocol().digest)
    people = (f"{split} {number}" for split, number in PEOPLE.items())
    key = text_digest(*versions, *(digest_of(load_manifest(layout)) for layout in LAYOUTS), *people)
    return cache_folder() / "tables" / f"synthetic-{key[:12]}"


def companions(request: RunRequest) -> Iterator[RunRequest]:
    """Yield runs of the same sequences for controls and recorded motion, as far as their methods are installed.

    The controls are text alone, constant timing and a mean pose. A run of one of them has no companions.
    """
    # A run of a companion, of shuffled goals or of chosen sequences is not a first look at a method.
    if request.method in {name for name, _ in _COMPANIONS} or request.control is not None or request.sequences:
        return
    there = {SCRIPTED, GROUND_TRUTH, *(adapter.name for adapter in list_adapters() if adapter.built_in)}
    for method, condition in _COMPANIONS:
        if method not in there:
            continue
        # The companions see the same sequences, but nothing that belongs to the user's own method.
        nothing: dict[str, Any] = {"weights": None, "options": {}, "out": None, "isolate": False, "timeout": None}
        yield replace(request, method=method, condition=condition or request.condition, **nothing)


def tables_of_runs(runs: Sequence[RunFolder], data: Sequence[Path]) -> list[SequenceTable]:
    """Return the tables that all runs have in common, in the order of the first run.

    Args:
        runs: One or more.
        data: Dataset folders; where none is given, the tables in prbench's own cache are tried by digest.

    Raises:
        RunError: if the very table of a run is neither named nor in the cache.
        UsageError: if the runs have no dataset in common.
    """
    shared = set.intersection(*({table.dataset for table in run.record.tables} for run in runs))
    if not shared:
        raise UsageError("these runs have no dataset in common, so that nothing can stand beside one another.")
    find = table_finder(data)
    named = {table.info.dataset: table for table in (SequenceTable.open(folder) for folder in data)}
    if data and not shared & set(named):
        why = f"the run is of {', '.join(sorted(shared))}; --data names {', '.join(named)}."
        remedy = "Name the table that it was made on."
        raise RunError(f"{runs[0].path}: {why} {remedy}")
    tables = {}
    for first in runs[0].record.tables:
        if first.dataset not in (shared & set(named) if data else shared):
            continue
        for run in runs:
            record = next(record for record in run.record.tables if record.dataset == first.dataset)
            table = find(record)
            if table is None or record.content_digest != first.content_digest:
                digest = f"{record.content_digest[:_SHOWN]}…"
                if first.dataset not in named:
                    why = f"was made on a table of {record.dataset} with content digest {digest},"
                    reason = "which is not among the embedded ones. Name its folder with --data DIR."
                    raise TableError(f"{run.path}: {why} {reason}")
                other = named[first.dataset]
                why = f"(content digest {digest}), found another one ({other.info.content_digest[:_SHOWN]}…)."
                remedy = "Name that table with --data DIR, or run the method again on this one."
                raise RunError(f"{other.folder}: expected the table that {run.path} was made on {why} {remedy}")
            tables[first.dataset] = table
    return [table.with_sequences() for table in tables.values()]


def table_finder(data: Sequence[Path], *, same_values: bool = True) -> Callable[[TableRecord], Any]:
    """Return a function that finds the table of a run among the named ones and those in prbench's own cache.

    Args:
        data: Folders of tables of any benchmark.
        same_values: The table has to be the very same one; otherwise a named one of the same sequences will do, or a
            fold of a named one.

    Raises:
        TableError: if a named one cannot be opened; the function raises it for one in the cache.
        RunError: raised by the function where ``same_values`` is false and the named table holds other sequences.
    """
    known = [load_benchmark(name) for name in benchmarks()]
    opened: list[CaseTable] = []
    for folder in data:
        # A folder that holds no table is opened as one of the default benchmark, which says so.
        benchmark = next((each for each in known if (folder / each.table_file).is_file()), known[0])
        opened.append(benchmark.open_table(folder))

    def find(record: TableRecord) -> CaseTable | None:
        for table in opened:
            # Identity says which sequences, content says which numbers; a rebuilt table may share only the first.
            if (record.identity_digest, record.content_digest) == (table.identity, table.info.content_digest):
                return table
        if not same_values:
            wanted = (record.dataset, record.identity_digest)
            whole = [table.folder for table in opened if record.fold and table.info.dataset == record.dataset]
            folds = map(SequenceTable.open, fold_tables(whole, record.fold))
            near = next((each for each in (*opened, *folds) if (each.info.dataset, each.identity) == wanted), None)
            if near is not None:
                return near
        # The default tables first: nearly every run was made on them. Then folds, and tables of earlier versions.
        tables = cache_folder() / "tables"
        earlier = sorted(path.parent for depth in ("*", "*/*") for path in tables.glob(f"{depth}/{FILE_NAME}"))
        for folder in dict.fromkeys([*default_table_folders(), *earlier]):
            if (folder / FILE_NAME).is_file() and DatasetInfo.read(folder).content_digest == record.content_digest:
                opened.append(SequenceTable.open(folder))
                return opened[-1]
        for table in opened:
            is_merged = record.whole_table is not None and record.fold is None  # of several tables
            if not same_values and not is_merged and table.info.dataset == record.dataset:
                problem = f"{table.folder}: expected the sequences of {record.dataset} that the run was made on"
                problem += f" (identity {record.identity_digest[:12]}…), found others ({table.identity[:12]}…). Name"
                raise RunError(f"{problem} the table that was built from the same recordings by the same protocol.")
        return None

    return find


def earlier_run(path: Path) -> RunFolder | None:
    """Open the run that a run folder or its ``run.json`` belongs to; return None for an experiment's file."""
    folder = path if path.is_dir() else path.parent
    return RunFolder.open(folder, any_benchmark=True) if path.is_dir() or path.name == RUN_FILE else None


def experiment_of_run(run: RunFolder, *, data: tuple[Path, ...], weights: Path | None) -> Experiment:
    """Return the experiment that repeats an earlier run.

    Args:
        run: The earlier run.
        data: Tables of the run, of a fold the whole ones; embedded ones need not be named. Run folders hold no paths.
        weights: The run's weights, where it was given other ones than the method's own.

    Raises:
        RunError: if a run folder does not record how to start the method, or one of its tables is neither named nor
            embedded.
    """
    record = run.record
    if record.method.kind in (FILE, PROGRAM, UNKNOWN):
        told = "and a run folder does not record how to start it. Repeat the command with --method."
        raise RunError(f"{run.path}: {record.method.name} is {record.method.origin}, {told}")
    find = table_finder(data)
    whole = {DatasetInfo.read(folder).content_digest: folder for folder in data if record.tables[0].units}
    folders = []
    for table in record.tables:
        found = None if table.units else find(table)
        folder = found.folder if found is not None else whole.get(table.whole_table or "")
        if folder is None:
            why = f"the run was made on a table of {table.dataset} with content digest {table.content_digest[:12]}…,"
            reason = "which is neither named with --data nor embedded. Name its folder."
            raise RunError(f"{run.path}: {why} {reason}")
        folders.append(str(folder))
    about: dict[str, Any] = {"options": dict(record.method.options), "control": record.control}
    about["weights"] = None if weights is None else str(weights)
    method = ExperimentMethod(name=record.method.name, conditions=(record.condition,), **about)
    own_protocol = run.path / PROTOCOL_FILE
    same = ("benchmark", "limit", "sequences", "samples", "device", "threads")
    return Experiment(
        **{name: getattr(record, name) for name in same},
        methods=(method,),
        data=tuple(folders),
        split="test" if whole else record.split,
        fold=record.tables[0].fold or (ALL_FOLDS if record.tables[0].units else None),
        seeds=(record.seed,),
        batch_size=record.tables[0].batch_plan.batch_size,
        isolate=record.method.isolation is not None,
        protocol=str(own_protocol) if own_protocol.is_file() else None,
    )


def same_scores(first: RunFolder, second: RunFolder) -> bool:
    """Return True where two runs on the same tables have equal scores, to the last digit."""
    names = [table.dataset for table in first.record.tables]
    return all(
        read_scores(first.dataset(name).scores).equals(read_scores(second.dataset(name).scores)) for name in names
    )
