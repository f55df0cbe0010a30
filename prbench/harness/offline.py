"""Methods that run elsewhere: conditions out to a file, which never names the data."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float, Int

from prbench.contract import GIVEN, Condition
from prbench.errors import AdapterError, InputFileError, RedistributionError, UsageError
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input
from prbench.files.storage import atomic_path, sole_writer, text_digest, turn_into_paths, write_text
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness import planning
from prbench.harness.conditions import ConditionSource, ConditionStream, derangement, opaque_ids, run_salt
from prbench.harness.controls import SHUFFLED_GOAL
from prbench.harness.methods.motions import at_native_rate
from prbench.harness.planning import Selection, open_tables, rows_of, select, supported
from prbench.harness.request import require_settings
from prbench.protocol.manifests import load_protocol
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import may_pass_on, notice

FORMAT_VERSION = 1
METADATA_KEY = "prbench_conditions"  # name of the array that holds the information as JSON
_LARGEST_ARRAY = 8 * 1024**3
_POSE = (N_JOINTS, 3)
# Kind of each array, and the shape of one row of it
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
_ALWAYS = ("opaque_id", "sample", "noise_seed", "n_frames", "fps")
_RECORDED_MOTION = frozenset({"initial_joints", "previous_joints", "goal_joints", "goal_location"})
GOALS = frozenset({"goal_joints", "goal_location"})


class ConditionsInfo(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings that the rows of a conditions file were made with. A method may see them as it may see the rows.

    Attributes:
        seed: The run's seed, behind opaque ids and noise seeds.
        samples: Rows of each sequence, with noise of their own.
        max_frames: Longer sequences, at the rate of the file, were left out.
        native_fps: Rate that ``n_frames`` and ``fps`` are given at; None for the table's own.
        tables: Fingerprints of the tables, sorted.
    """

    format_version: int = FORMAT_VERSION
    condition: Condition
    seed: int
    samples: int
    split: str
    limit: int | None
    max_frames: int | None
    native_fps: float | None
    protocol_version: int
    tables: tuple[str, ...]


def fingerprints(identities: Iterable[str]) -> tuple[str, ...]:
    """Return one digest a table, sorted. Whoever has the table recognises it; the key of opaque ids does not follow.

    Args:
        identities: Identity digests of the tables.
    """
    return tuple(sorted(text_digest("prbench conditions", identity) for identity in identities))


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
        """Return some of the rows, in the order given."""
        return rows_of(self, rows)


def given_columns(condition: Condition) -> tuple[str, ...]:
    """Return the columns that a condition fills beyond those that every file has, in the order of the format."""
    order = ("text", "initial_joints", "previous_joints", "goal_joints", "goal_location")
    return tuple(name for name in order if name in GIVEN[condition])


def _require_suffix(path: Path) -> None:
    if path.suffix.lower() != ".npz":
        raise UsageError(f"{path}: expected a name that ends in .npz, found '{path.suffix}'.")


def write_conditions(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        UsageError: if the suffix is not ``.npz``.
        StorageError: if the file cannot be written.
    """
    _require_suffix(path)
    arrays: dict[str, Any] = {METADATA_KEY: np.array(msgspec.json.encode(conditions.info, order="sorted").decode())}
    for name in (*_ALWAYS, *conditions.given):
        arrays[name] = np.asarray(getattr(conditions, name)).astype(_FORMS[name][0])
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **arrays)


@foreign_input()
def read_conditions_file(path: Path) -> ConditionsFile:
    """Read a conditions file with all its columns.

    Raises:
        UsageError: if the suffix is not ``.npz``.
        InputFileError: if the file is missing, damaged, or no conditions file.
    """
    _require_suffix(path)
    archive = Archive(path)
    if METADATA_KEY not in archive.members:
        expected = f"a conditions file (with an array '{METADATA_KEY}')"
        found = f"the arrays {', '.join(sorted(archive.members)[:10])} without it"
        remedy = "Export it with `prbench export-conditions`."
        raise InputFileError(path, "", expected=expected, found=found, remedy=remedy)
    text = str(archive.read(METADATA_KEY, largest=1024**2))
    try:
        version = msgspec.json.decode(text, type=dict[str, Any]).get("format_version")
        info = msgspec.json.decode(text, type=ConditionsInfo) if version == FORMAT_VERSION else None
        expected, found = f"format version {FORMAT_VERSION}", str(version)
    except (msgspec.ValidationError, msgspec.DecodeError) as error:
        info, expected, found = None, "what prbench wrote about the file", str(error)
    if info is None:
        remedy = "Export the conditions again with `prbench export-conditions`."
        raise InputFileError(path, METADATA_KEY, expected=expected, found=found, remedy=remedy)
    names = (*_ALWAYS, *given_columns(info.condition))
    if set(archive.members) != {METADATA_KEY, *names}:
        found = ", ".join(sorted(set(archive.members) - {METADATA_KEY}))
        raise InputFileError(path, "", expected=f"the arrays {', '.join(names)}", found=found)
    columns: dict[str, Any] = {name: archive.read(name, largest=_LARGEST_ARRAY) for name in names}
    rows = len(columns["n_frames"])
    for name, values in columns.items():
        kind, shape = _FORMS[name]
        right_kind = values.dtype.kind == "U" if kind == "U" else values.dtype == np.dtype(kind)
        if not right_kind or values.shape != (rows, *shape):
            expected = f"shape {(rows, *shape)} of {'text' if kind == 'U' else np.dtype(kind)}"
            raise InputFileError(path, f"'{name}'", expected=expected, found=f"{values.shape} of {values.dtype}")
        if kind == "U":
            columns[name] = tuple(values.tolist())
    return ConditionsFile(info=info, **columns)


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """The conditions to write, and the file for them.

    Raises:
        UsageError: if parts of it do not fit together.

    Attributes:
        data: Dataset folders.
        out: An ``.npz``.
        limit: Number of sequences of each dataset, as `prbench run --limit` has it.
        max_frames: Leave out longer sequences; they count as unsupported when the motions are scored.
        native_fps: Ask for motions at this rate; they are brought back to the table's when they are scored.
        control: ``shuffled-goal`` or None. Stands nowhere in the file: whoever scores finds it out from the goals.
        permitted: Datasets whose licensor lets the user pass on recorded motion.
    """

    data: tuple[Path, ...]
    condition: Condition
    out: Path
    seed: int = 0
    samples: int = 1
    split: str = "test"
    limit: int | None = None
    max_frames: int | None = None
    native_fps: float | None = None
    control: str | None = None
    permitted: Collection[str] = ()

    def __post_init__(self) -> None:
        turn_into_paths(self, "data", "out")
        _require_suffix(self.out)
        if not self.data:
            raise UsageError("conditions need one dataset folder or more (--data DIR).")
        counts = {"--samples": self.samples, "--max-frames": self.max_frames}
        require_settings(counts, seed=self.seed, control=self.control, native_fps=self.native_fps)
        if self.control == SHUFFLED_GOAL and not GOALS & set(given_columns(self.condition)):
            raise UsageError(f"--control {SHUFFLED_GOAL}: condition '{self.condition.value}' gives no goal to shuffle.")


@dataclass(frozen=True)
class ExportReport:
    """Counts of what was written.

    Attributes:
        out: The conditions file.
        rows: Motions to be generated.
        sequences: Sequences by dataset.
        left_out: Sequences longer than ``max_frames``, by dataset.
        notices: Notice that the datasets' terms ask for; it stands beside the file as ``*.NOTICE.txt``.
    """

    out: Path
    rows: int
    sequences: dict[str, int]
    left_out: dict[str, int]
    notices: tuple[str, ...]


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
    holds_recordings = bool(_RECORDED_MOTION & set(given_columns(request.condition)))
    for table in tables if holds_recordings else ():
        info = table.info
        if not may_pass_on(info, request.permitted):
            raise RedistributionError(
                f"{info.title} ({info.dataset}): its licence does not let recorded poses and goals be passed on, and a"
                f" file of '{request.condition.value}' conditions would hold them. To score a method on this machine"
                ' without such a file, use `prbench run --method cmd:"…"`. If the licensor has given you permission,'
                f" say so: --permission {info.dataset}"
            )
    conditions, selections, left_out = conditions_of(tables, request)
    said = tuple(notice(table.info, request.permitted) for table in tables) if holds_recordings else ()
    said = tuple(filter(None, said))
    notices = request.out.with_suffix(".NOTICE.txt")
    with sole_writer(request.out), sole_writer(notices):
        if said:  # first, so that a file is never without what its terms ask
            write_text(notices, "".join(f"{line}\n" for line in said))
        write_conditions(conditions, request.out)
    names = [table.info.dataset for table in tables]
    sequences = dict(zip(names, map(len, selections), strict=True))
    longer = {name: left for name, left in zip(names, left_out, strict=True) if left}
    return ExportReport(request.out, len(conditions), sequences, longer, said)


def conditions_of(
    tables: list[SequenceTable], request: ExportRequest
) -> tuple[ConditionsFile, list[Selection], list[int]]:
    """Make the rows of a conditions file, in its order; nothing is written.

    Returns:
        The rows, the chosen sequences of each table, and how many of each table are longer than the limit.
    """
    # Several datasets become one file, in which nothing tells which rows are of which.
    selections = []
    left_out = []
    for table in tables:
        chosen = select(table, split=request.split, limit=request.limit)
        selection = supported(chosen, max_frames=request.max_frames, native_fps=request.native_fps)
        if not len(selection):
            why = f"all {len(chosen)} chosen sequences of {table.info.dataset} are longer."
            raise AdapterError(f"--max-frames {request.max_frames}: {why}")
        selections.append(selection)
        left_out.append(len(chosen) - len(selection))
    same = ("condition", "seed", "samples", "split", "limit", "max_frames", "native_fps")
    info = ConditionsInfo(
        **{name: getattr(request, name) for name in same},
        protocol_version=load_protocol().version,
        tables=fingerprints(table.identity for table in tables),
    )
    # One row a sequence and sample, by opaque id, then sample.
    ids: list[str] = []
    parts: list[dict[str, np.ndarray]] = []
    for selection in selections:
        salt = run_salt(request.seed, selection.table.identity)
        ids += opaque_ids(selection.sequence_ids, salt)
        source: ConditionSource | ConditionStream = ConditionStream(selection)
        if request.control == SHUFFLED_GOAL:  # goals of sequences that lie anywhere in the table
            source = ConditionSource.read(selection).with_goals_of(derangement(selection, seed=request.seed))
        for start in range(0, len(selection), planning.WINDOW):
            own, rows = source.around(np.arange(start, min(start + planning.WINDOW, len(selection))))
            first = own.batch(rows, request.condition, seed=request.seed, salt=salt, sample=0)
            if request.native_fps is not None:
                first = at_native_rate(first, request.native_fps)
            samples = [own.redrawn(first, rows, seed=request.seed, sample=sample) for sample in range(info.samples)]
            part = {
                "noise_seed": np.array([batch.noise_seed for batch in samples], dtype=np.int64).T.reshape(-1),
                "n_frames": np.repeat(first.n_frames.astype(np.int32), info.samples),
                "fps": np.full(len(first) * info.samples, first.fps),
            }
            for name in given_columns(info.condition):
                values = np.asarray(getattr(first, name), dtype=object if name == "text" else None)
                part[name] = np.repeat(values, info.samples, axis=0)
            parts.append(part)
    order = np.array(sorted(range(len(ids)), key=ids.__getitem__), dtype=np.int64)
    rows = (order[:, None] * info.samples + np.arange(info.samples)).reshape(-1)
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part in parts])[rows] for name in parts[0]}
    if "text" in columns:
        columns["text"] = tuple(columns["text"].tolist())
    repeated = tuple(itertools.chain.from_iterable(itertools.repeat(ids[row], info.samples) for row in order))
    sample = np.tile(np.arange(info.samples, dtype=np.int32), len(ids))
    return ConditionsFile(info=info, opaque_id=repeated, sample=sample, **columns), selections, left_out
