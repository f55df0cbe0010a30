"""``prbench export-conditions``: what a method may see of one or several tables, in one file."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prbench.contract import Condition, ConditionBatch
from prbench.errors import AdapterError, RedistributionError, UsageError
from prbench.files.storage import sole_writer, turn_into_paths, write_text
from prbench.harness import planning
from prbench.harness.conditions import ConditionSource, ConditionStream, derangement, opaque_ids, run_salt
from prbench.harness.controls import SHUFFLED_GOAL
from prbench.harness.methods.motions import at_native_rate
from prbench.harness.offline.conditions_file import (
    ConditionsFile,
    ConditionsInfo,
    fingerprints,
    given_columns,
    require_suffix,
)
from prbench.harness.offline.files import write_conditions
from prbench.harness.planning import Selection, open_tables, select, supported
from prbench.protocol.manifests import load_protocol
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.sequences.dataset_info import may_pass_on, notice

_RECORDED_MOTION = frozenset({"initial_joints", "previous_joints", "goal_joints", "goal_location"})
GOALS = frozenset({"goal_joints", "goal_location"})


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """The conditions to write, and the file for them.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    data: tuple[Path, ...]
    """Dataset folders."""
    condition: Condition
    out: Path
    """``.parquet`` or ``.npz``."""
    seed: int = 0
    samples: int = 1
    split: str = "test"
    limit: int | None = None
    """Number of sequences of each dataset, as `prbench run --limit` has it."""
    max_frames: int | None = None
    """Leave out longer sequences; they count as unsupported when the motions are scored."""
    native_fps: float | None = None
    """Ask for motions at this rate; they are brought back to the table's when they are scored."""
    control: str | None = None
    """``shuffled-goal`` or None. Stands nowhere in the file: whoever scores finds it out from the goals."""
    permitted: Collection[str] = ()
    """Datasets whose licensor lets the user pass on recorded motion."""

    def __post_init__(self) -> None:
        turn_into_paths(self, "data", "out")
        require_suffix(self.out)
        if not self.data:
            raise UsageError("conditions need one dataset folder or more (--data DIR).")
        for name, value in (("--samples", self.samples), ("--max-frames", self.max_frames)):
            if value is not None and value < 1:
                raise UsageError(f"{name}: expected 1 or more, found {value}.")
        if self.seed < 0:
            raise UsageError(f"--seed: expected 0 or more, found {self.seed}.")
        if self.native_fps is not None and not 0 < self.native_fps <= 1000:
            raise UsageError(f"--native-fps: expected above 0 and at most 1000, found {self.native_fps:g}.")
        if self.control not in (None, SHUFFLED_GOAL):
            raise UsageError(f"unknown control '{self.control}'; beside a method there is: {SHUFFLED_GOAL}.")
        if self.control == SHUFFLED_GOAL and not GOALS & set(given_columns(self.condition)):
            raise UsageError(f"--control {SHUFFLED_GOAL}: condition '{self.condition.value}' gives no goal to shuffle.")


@dataclass(frozen=True)
class ExportReport:
    """Counts of what was written."""

    out: Path
    """The conditions file."""
    rows: int
    """Motions to be generated."""
    sequences: dict[str, int]
    """Sequences by dataset."""
    left_out: dict[str, int]
    """Sequences longer than ``max_frames``, by dataset."""
    notices: tuple[str, ...]
    """Notice that the datasets' terms ask for; it stands beside the file as ``*.NOTICE.txt``."""


def export_conditions(request: ExportRequest) -> ExportReport:
    """Write what a method may see, and nothing else.

    The file names no dataset, no sequence and no path; its rows are sorted by opaque id, which tells nothing.

    Raises:
        RedistributionError: if the condition holds recorded poses or goals that a dataset's terms keep.
        TableError: if a table is missing, empty or of an unknown version, or a split is empty.
        UsageError: if datasets repeat, or shuffled goals find no other sequence.
        StorageError: if the file cannot be written.
    """
    tables = open_tables(request.data)
    for table in tables:
        _require_may_export(table.info, request)
    conditions = conditions_of(tables, request)
    said = _notices(tables, request)
    notices = request.out.with_suffix(".NOTICE.txt")
    with sole_writer(request.out), sole_writer(notices):
        if said:  # first, so that a file is never without what its terms ask
            write_text(notices, "".join(f"{line}\n" for line in said))
        write_conditions(conditions.file, request.out)
    names = [table.info.dataset for table in tables]
    return ExportReport(
        request.out,
        len(conditions.file),
        dict(zip(names, (len(one) for one in conditions.selections))),
        {name: left for name, left in zip(names, conditions.left_out) if left},
        said,
    )


@dataclass(frozen=True)
class MadeConditions:
    """The rows for some tables, and which sequences they are of."""

    file: ConditionsFile
    selections: tuple[Selection, ...]
    left_out: tuple[int, ...]
    """Count the sequences of each table that are longer than the limit."""


def conditions_of(tables: list[SequenceTable], request: ExportRequest) -> MadeConditions:
    """The rows of a conditions file, in its order; nothing is written."""
    # Several datasets become one file, in which nothing tells which rows are of which.
    selections = []
    left_out = []
    for table in tables:
        chosen = select(table, split=request.split, limit=request.limit)
        selection = supported(chosen, max_frames=request.max_frames, native_fps=request.native_fps)
        if not len(selection):
            raise AdapterError(
                f"--max-frames {request.max_frames}: all {len(chosen)} chosen sequences of {table.info.dataset} are"
                " longer."
            )
        selections.append(selection)
        left_out.append(len(chosen) - len(selection))
    info = ConditionsInfo(
        condition=request.condition,
        seed=request.seed,
        samples=request.samples,
        split=request.split,
        limit=request.limit,
        max_frames=request.max_frames,
        native_fps=request.native_fps,
        protocol_version=load_protocol().version,
        tables=fingerprints(table.identity for table in tables),
    )
    return MadeConditions(_sorted_rows(info, selections, request), tuple(selections), tuple(left_out))


def _sorted_rows(info: ConditionsInfo, selections: list[Selection], request: ExportRequest) -> ConditionsFile:
    """One row a sequence and sample, by opaque id, then sample; each window goes where its rows belong at once."""
    ids = [
        name
        for selection in selections
        for name in opaque_ids(selection.sequence_ids, run_salt(request.seed, selection.table.identity))
    ]
    order = sorted(range(len(ids)), key=ids.__getitem__)
    first_row = np.empty(len(ids), dtype=np.int64)
    first_row[order] = np.arange(len(ids)) * info.samples
    rows = len(ids) * info.samples
    columns: dict[str, np.ndarray] = {"noise_seed": np.empty(rows, np.int64), "n_frames": np.empty(rows, np.int32)}
    columns["fps"] = np.empty(rows)
    done = 0
    for samples in itertools.chain.from_iterable(_batches(selection, request) for selection in selections):
        first = samples[0]
        for sample, batch in enumerate(samples):
            here = first_row[done : done + len(first)] + sample
            columns["noise_seed"][here] = batch.noise_seed
            columns["n_frames"][here] = first.n_frames
            columns["fps"][here] = first.fps
            for name in given_columns(info.condition):
                values = np.asarray(getattr(first, name), dtype=object if name == "text" else None)
                if name not in columns:
                    columns[name] = np.empty((rows, *values.shape[1:]), dtype=values.dtype)
                columns[name][here] = values
        done += len(first)
    given: dict[str, Any] = dict(columns)
    if "text" in given:
        given["text"] = tuple(given["text"].tolist())
    return ConditionsFile(
        info=info,
        opaque_id=tuple(ids[number] for number in order for _ in range(info.samples)),
        sample=np.tile(np.arange(info.samples, dtype=np.int32), len(ids)),
        **given,
    )


def _batches(selection: Selection, request: ExportRequest) -> Iterator[list[ConditionBatch]]:
    """Yield the chosen sequences of one table, a window at a time, one batch a sample."""
    source: ConditionSource | ConditionStream = ConditionStream(selection)
    if request.control == SHUFFLED_GOAL:  # goals of sequences that lie anywhere in the table
        source = ConditionSource.read(selection).with_goals_of(derangement(selection, seed=request.seed))
    salt = run_salt(request.seed, selection.table.identity)
    for start in range(0, len(selection), planning.WINDOW):
        own, rows = source.around(np.arange(start, min(start + planning.WINDOW, len(selection))))
        first = own.batch(rows, request.condition, seed=request.seed, salt=salt, sample=0)
        if request.native_fps is not None:
            first = at_native_rate(first, request.native_fps)
        yield [own.redrawn(first, rows, seed=request.seed, sample=sample) for sample in range(request.samples)]


def _require_may_export(info: DatasetInfo, request: ExportRequest) -> None:
    if not _RECORDED_MOTION & set(given_columns(request.condition)) or may_pass_on(info, request.permitted):
        return
    raise RedistributionError(
        f"{info.title} ({info.dataset}): its licence does not let recorded poses and goals be passed on, and a file of"
        f" '{request.condition.value}' conditions would hold them. To score a method on this machine without such a"
        ' file, use `prbench run --method cmd:"…"`. If the licensor has given you permission, say so:'
        f" --permission {info.dataset}"
    )


def _notices(tables: list[SequenceTable], request: ExportRequest) -> tuple[str, ...]:
    if not _RECORDED_MOTION & set(given_columns(request.condition)):
        return ()
    return tuple(said for table in tables if (said := notice(table.info, request.permitted)))
