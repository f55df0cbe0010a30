"""Methods that run elsewhere: conditions out to a file in memory or on disk, which never names the data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from prbench.contract import GIVEN, Condition, ConditionBatch
from prbench.errors import AdapterError, InputFileError, RedistributionError, UsageError
from prbench.files.arrays import Archive, read_parquet
from prbench.files.bounded import foreign_input
from prbench.files.storage import atomic_path, sole_writer, text_digest, turn_into_paths, write_text
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness import planning
from prbench.harness.conditions import ConditionSource, ConditionStream, derangement, opaque_ids, run_salt
from prbench.harness.controls import SHUFFLED_GOAL
from prbench.harness.methods.motions import at_native_rate
from prbench.harness.planning import Selection, open_tables, rows_of, select, supported
from prbench.protocol.manifests import load_protocol
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.sequences.dataset_info import may_pass_on, notice

FORMAT_VERSION = 1
METADATA_KEY = "prbench_conditions"
"""Key of the Parquet metadata, and name of the array in an ``.npz``, that holds the information as JSON."""
DEFAULT_BATCH_SIZE = 64
_SUFFIXES = (".parquet", ".npz")


class ConditionsInfo(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings that the rows of a conditions file were made with. A method may see them as it may see the rows."""

    format_version: int = FORMAT_VERSION
    condition: Condition
    seed: int
    """The run's seed, behind opaque ids and noise seeds."""
    samples: int
    """Rows of each sequence, with noise of their own."""
    split: str
    limit: int | None
    max_frames: int | None
    """Longer sequences, at the rate of the file, were left out."""
    native_fps: float | None
    """Rate that ``n_frames`` and ``fps`` are given at; None for the table's own."""
    protocol_version: int
    tables: tuple[str, ...]
    """Fingerprints of the tables, sorted."""

    def as_json(self) -> str:
        """One line, sorted keys."""
        return msgspec.json.encode(self, order="sorted").decode()

    @classmethod
    def from_json(cls, text: str | bytes, path: Path) -> ConditionsInfo:
        """Read what :meth:`as_json` wrote.

        Args:
            text: JSON.
            path: The file that it stands in, for messages.

        Raises:
            InputFileError: if it is of a newer version or not what the format asks for.
        """
        remedy = "Export the conditions again with `prbench export-conditions`."
        try:
            version = msgspec.json.decode(text, type=_Versioned).format_version
            if version == FORMAT_VERSION:
                return msgspec.json.decode(text, type=cls)
        except (msgspec.ValidationError, msgspec.DecodeError) as error:
            raise InputFileError(
                path, METADATA_KEY, expected="what prbench wrote about the file", found=str(error), remedy=remedy
            ) from error
        raise InputFileError(
            path, METADATA_KEY, expected=f"format version {FORMAT_VERSION}", found=str(version), remedy=remedy
        )


class _Versioned(msgspec.Struct):
    format_version: int


def fingerprints(identities: Iterable[str]) -> tuple[str, ...]:
    """One digest a table, sorted. Whoever has the table recognises it; the key of the opaque ids does not follow.

    Args:
        identities: Identity digests of the tables.
    """
    return tuple(sorted(text_digest("prbench conditions", identity) for identity in identities))


@dataclass(frozen=True)
class SampledBatch:
    """Some rows of a conditions file as a method gets them."""

    sample: int
    """Number of the motion that is drawn of each sequence; the same for all rows."""
    rows: Int[np.ndarray, " batch"]
    """Their places in the file, from 0."""
    batch: ConditionBatch


@dataclass(frozen=True, kw_only=True)
class ConditionsFile:
    """One row a motion to be generated, sorted by opaque id, then sample. Canonical frame, metres."""

    info: ConditionsInfo
    opaque_id: tuple[str, ...]
    sample: Int[np.ndarray, " n"]
    noise_seed: Int[np.ndarray, " n"]
    n_frames: Int[np.ndarray, " n"]
    fps: Float[np.ndarray, " n"]
    text: tuple[str, ...] | None = None
    initial_joints: Float[np.ndarray, "n 22 3"] | None = None
    previous_joints: Float[np.ndarray, "n 22 3"] | None = None
    goal_joints: Float[np.ndarray, "n 22 3"] | None = None
    goal_location: Float[np.ndarray, "n 3"] | None = None

    def __len__(self) -> int:
        return len(self.opaque_id)

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the columns that depend on the condition, in the order of the format."""
        return given_columns(self.info.condition)

    def rows(self, rows: Int[np.ndarray, " rows"]) -> ConditionsFile:
        """Some of the rows, in the order given."""
        return rows_of(self, rows)

    def batches(self, batch_size: int = DEFAULT_BATCH_SIZE) -> Iterator[SampledBatch]:
        """All rows in batches of one sample and one frame rate, each as long as the file's order allows.

        Args:
            batch_size: Largest number of rows in a batch.
        """
        if batch_size < 1:
            raise UsageError(f"expected a batch size of 1 or more, found {batch_size}.")
        for sample in np.unique(self.sample):
            for fps in np.unique(self.fps):
                rows = np.flatnonzero((self.sample == sample) & (self.fps == fps))
                for start in range(0, len(rows), batch_size):
                    part = rows[start : start + batch_size]
                    yield SampledBatch(int(sample), part, self.rows(part)._as_batch(float(fps)))

    def _as_batch(self, fps: float) -> ConditionBatch:
        given: dict[str, Any] = {name: getattr(self, name) for name in self.given}
        return ConditionBatch(
            condition=self.info.condition,
            n_frames=self.n_frames.astype(np.int64),
            fps=fps,
            opaque_id=self.opaque_id,
            noise_seed=tuple(self.noise_seed.tolist()),
            **given,
        )


def given_columns(condition: Condition) -> tuple[str, ...]:
    """Return the columns that a condition fills beyond those that every file has, in the order of the format."""
    order = ("text", "initial_joints", "previous_joints", "goal_joints", "goal_location")
    return tuple(name for name in order if name in GIVEN[condition])


def require_suffix(path: Path) -> None:
    """Refuse a name that does not say which format is meant.

    Raises:
        UsageError: naming the two suffixes.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{path}: expected a name that ends in {' or '.join(_SUFFIXES)}, found '{path.suffix}'.")


_LARGEST_ARRAY = 8 * 1024**3
_POSE = (N_JOINTS, 3)
_FORMS: dict[str, tuple[str, tuple[int, ...]]] = {
    "opaque_id": ("U", ()),
    "sample": ("<i4", ()),
    "noise_seed": ("<i8", ()),
    "n_frames": ("<i4", ()),
    "fps": ("<f8", ()),
    "text": ("U", ()),
    "initial_joints": ("<f4", _POSE),
    "previous_joints": ("<f4", _POSE),
    "goal_joints": ("<f4", _POSE),
    "goal_location": ("<f8", (3,)),
}
"""Kind of each array, and the shape of one row of it."""
_ALWAYS = ("opaque_id", "sample", "noise_seed", "n_frames", "fps")
_ROW_GROUP_ROWS = 1024


def write_conditions(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        UsageError: if the suffix is neither ``.parquet`` nor ``.npz``.
        StorageError: if the file cannot be written.
    """
    require_suffix(path)
    (_write_parquet if path.suffix.lower() == ".parquet" else _write_npz)(conditions, path)


@foreign_input()
def read_conditions_file(path: Path) -> ConditionsFile:
    """Read a conditions file with all its columns.

    Raises:
        UsageError: if the suffix is neither ``.parquet`` nor ``.npz``.
        InputFileError: if the file is missing, damaged, or no conditions file.
    """
    require_suffix(path)
    return _read_parquet(path) if path.suffix.lower() == ".parquet" else _read_npz(path)


def read_conditions(path: Path, *, batch_size: int = DEFAULT_BATCH_SIZE) -> list[ConditionBatch]:
    """The batches of a conditions file as a method gets them in a run; sample after sample.

    Args:
        path: The file.
        batch_size: Largest number of rows in a batch.

    Raises:
        UsageError: if the suffix is neither ``.parquet`` nor ``.npz``.
        InputFileError: if the file is missing, damaged, or no conditions file.
    """
    return [each.batch for each in read_conditions_file(path).batches(batch_size)]


def _write_npz(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    names = (*_ALWAYS, *given_columns(conditions.info.condition))
    arrays: dict[str, Any] = {METADATA_KEY: np.array(conditions.info.as_json())}
    arrays |= {name: np.asarray(getattr(conditions, name)).astype(_FORMS[name][0]) for name in names}
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def _read_npz(path: Path) -> ConditionsFile:
    """Read a conditions file.

    Raises:
        InputFileError: if it is missing, damaged, or not one that prbench wrote.
    """
    archive = Archive(path)
    if METADATA_KEY not in archive.members:
        raise InputFileError(
            path,
            "",
            expected=f"a conditions file (with an array '{METADATA_KEY}')",
            found=f"the arrays {', '.join(sorted(archive.members)[:10])} without it",
            remedy="Export it with `prbench export-conditions`.",
        )
    info = ConditionsInfo.from_json(str(archive.read(METADATA_KEY, largest=1024**2)), path)
    names = (*_ALWAYS, *given_columns(info.condition))
    if set(archive.members) != {METADATA_KEY, *names}:
        found = ", ".join(sorted(set(archive.members) - {METADATA_KEY}))
        raise InputFileError(path, "", expected=f"the arrays {', '.join(names)}", found=found)
    arrays = {name: archive.read(name, largest=_LARGEST_ARRAY) for name in names}
    for name, values in arrays.items():
        rows = len(arrays["n_frames"])
        kind, shape = _FORMS[name]
        right_kind = values.dtype.kind == "U" if kind == "U" else values.dtype == np.dtype(kind)
        if not right_kind or values.shape != (rows, *shape):
            raise InputFileError(
                path,
                f"'{name}'",
                expected=f"shape {(rows, *shape)} of {'text' if kind == 'U' else np.dtype(kind)}",
                found=f"{values.shape} of {values.dtype}",
            )
    columns: dict[str, Any] = {
        name: tuple(values.tolist()) if values.dtype.kind == "U" else values for name, values in arrays.items()
    }
    return ConditionsFile(info=info, **columns)


def _write_parquet(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    schema = _schema_of(conditions.info.condition)
    columns = [_column(getattr(conditions, field.name), field.type) for field in schema]
    table = pa.Table.from_arrays(columns, schema=schema.with_metadata({METADATA_KEY: conditions.info.as_json()}))
    with atomic_path(path) as temporary:
        pq.write_table(
            table,
            temporary,
            row_group_size=_ROW_GROUP_ROWS,
            compression="zstd",
            compression_level=1,
            # Ids and numbers hardly repeat, so that dictionaries would only make the file larger.
            use_dictionary=["text"],  # type: ignore[arg-type] - the stub knows bool only
            write_page_checksum=True,
        )


def _schema_of(condition: Condition) -> pa.Schema:
    """The columns of a condition."""
    names = (*_ALWAYS, *given_columns(condition))
    return pa.schema([pa.field(name, _arrow_type(*_FORMS[name]), nullable=False) for name in names])


def _arrow_type(kind: str, shape: tuple[int, ...]) -> pa.DataType:
    item = pa.string() if kind == "U" else pa.from_numpy_dtype(np.dtype(kind))
    return pa.list_(item, math.prod(shape)) if shape else item


@foreign_input()
def _read_parquet(path: Path) -> ConditionsFile:
    """Read a conditions file.

    Raises:
        InputFileError: if it is missing, damaged, or not one that prbench wrote.
    """
    try:
        table = read_parquet(path, verify=True)
    except FileNotFoundError as error:
        raise InputFileError(path, "", expected="a conditions file", found="no file") from error
    except (pa.ArrowInvalid, OSError) as error:
        raise InputFileError(path, "", expected="a readable Parquet file", found=str(error).splitlines()[0]) from error
    text = (table.schema.metadata or {}).get(METADATA_KEY.encode())
    if text is None:
        raise InputFileError(
            path,
            "",
            expected=f"a conditions file (with {METADATA_KEY} in its metadata)",
            found=f"the columns {', '.join(table.column_names)} without it",
            remedy="Export it with `prbench export-conditions`.",
        )
    info = ConditionsInfo.from_json(text, path)
    expected = _schema_of(info.condition)
    if not table.schema.equals(expected):
        raise InputFileError(path, "", expected=f"the columns {_shown(expected)}", found=_shown(table.schema))
    columns: dict[str, Any] = {name: _values(table[name]) for name in table.column_names}
    return ConditionsFile(info=info, **columns)


def _column(values: tuple[str, ...] | np.ndarray, kind: pa.DataType) -> pa.Array:
    if isinstance(values, tuple):
        return pa.array(values, kind)
    if pa.types.is_fixed_size_list(kind):
        return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1), kind.value_type), type=kind)
    return pa.array(values, kind)


def _values(column: pa.ChunkedArray) -> tuple[str, ...] | np.ndarray:
    kind = column.type
    whole = column.combine_chunks()
    if pa.types.is_string(kind):
        return tuple(whole.to_pylist())
    if pa.types.is_fixed_size_list(kind):
        shape = (N_JOINTS, 3) if kind.list_size > 3 else (3,)
        return whole.flatten().to_numpy().reshape(-1, *shape)
    return whole.to_numpy()


def _shown(schema: pa.Schema) -> str:
    return ", ".join(f"{field.name} {field.type}" for field in schema)


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
