"""The windows of motion prediction on disk: runs of frames in ``streams``, and slices of them in ``windows``.

Source: docs/specification/motion-prediction.md#tables. A window is a slice of a run, so overlap costs nothing. Runs are
read a few at a time: memory does not grow with the table.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Bool, Float, Int

from prbench.errors import TableError, UsageError
from prbench.files.bounded import foreign_input
from prbench.files.storage import atomic_folder, require_replaceable
from prbench.recording import ESTIMATED
from prbench.sequences.dataset_info import Count, Provenance
from prbench.sequences.schema import naming, open_parquet, read_parquet, require_distinct, table_parts
from prbench.sequences.sequence import column_field, row_batch
from prbench.sequences.table import require_told, require_unchanged
from prbench.sequences.write import write_tables
from prbench_benchmarks.motion_prediction import joint_sets
from prbench_benchmarks.motion_prediction.batch import Condition, ObservedBatch, window_key
from prbench_benchmarks.motion_prediction.protocol import FrameName, load_prediction_protocol

SCHEMA_VERSION = 1
FILE_NAME = "windows.json"
RUNS_AT_ONCE = 8  # Runs in a row group: a run may hold 20 minutes, 10 MB.
_IDENTITY = ("run_id", "split", "segment", "n_frames")

_TEXTS = ("run_id", "recording_id", "participant_id", "split", "published_split", "segment", "pose_source")
_COLUMNS = (("window_id", pa.string()), ("row", pa.int32()), ("start", pa.int32()), ("anchor", pa.string()))
_COUNTS = (("n_scored", pa.int32()), ("n_gaze_valid", pa.int32()), ("exclusion", pa.string()))
_GOAL = column_field("goal", pa.list_(pa.float64(), 3), nullable=True)
WINDOWS = pa.schema([*(column_field(name, kind) for name, kind in (*_COLUMNS, *_COUNTS)), _GOAL])


def streams_schema(joints: joint_sets.JointSet) -> pa.Schema:
    """Columns of ``streams`` for a joint set."""
    numbers = (("fps", pa.float64()), ("start_time", pa.float64()), ("n_frames", pa.int32()))
    poses = pa.list_(pa.list_(pa.float32(), len(joints.names) * 3))
    direction = pa.list_(pa.list_(pa.float32(), 3))
    valid = pa.list_(pa.bool_())
    gaze = (("gaze", direction), ("gaze_valid", valid), ("head_direction", direction))
    frames = (("joints", poses), ("joints_valid", valid), *gaze)
    columns = (*((name, pa.string()) for name in _TEXTS), *numbers, *frames)
    return pa.schema([column_field(*column) for column in columns], metadata={"joint_set": joints.name})


@dataclass(frozen=True)
class Run:
    """Frames at the table's rate, without a gap in time. Room, metres, Y up.

    Attributes:
        published_split: ``train``, ``test``, ``unused``, or empty where no study published one.
        gaze: Unit vectors; where ``gaze_valid`` is False the last one measured before, or +Z if there was none.
        windows: The windows that begin in it; none in a run that was read from ``streams`` alone.
    """

    run_id: str
    recording_id: str
    participant_id: str
    split: str
    published_split: str
    segment: str
    pose_source: str
    fps: float
    start_time: float
    joints: Float[np.ndarray, "n joints 3"]
    joints_valid: Bool[np.ndarray, " n"]
    gaze: Float[np.ndarray, "n 3"]
    gaze_valid: Bool[np.ndarray, " n"]
    head_direction: Float[np.ndarray, "n 3"]
    windows: tuple[Window, ...] = ()

    def __len__(self) -> int:
        return len(self.joints)

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.joints)


@dataclass(frozen=True)
class Window:
    """A slice of a run.

    Attributes:
        n_gaze_valid: Observed frames with measured gaze.
        n_scored: Frames after the observed ones that are scored; a predictor is asked for as many as every window of
            the table.
        exclusion: ``invalid_body``, ``gap_at_border``, or empty.
        anchor: ``sliding``; ``prime`` or ``event-2`` and the like in an anchored table.
        goal: Goal location, room; only where the last scored frame is the event. Never given to a predictor.
    """

    start: int
    n_gaze_valid: int
    n_scored: int
    exclusion: str = ""
    anchor: str = "sliding"
    goal: Float[np.ndarray, "3"] | None = None

    def row(self, run: Run, row: int) -> dict[str, object]:
        """Columns of ``windows``."""
        window_id = f"{run.run_id}/{self.anchor}/{self.start}"
        goal = None if self.goal is None else self.goal.tolist()
        return vars(self) | {"window_id": window_id, "row": row, "goal": goal}

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Window:
        """Return a row of ``windows`` again, as :meth:`row` wrote it."""
        values: dict[str, Any] = {each.name: row[each.name] for each in fields(cls)}
        values["goal"] = None if row["goal"] is None else np.array(row["goal"])
        return cls(**values)


# Frames that a window observes, or predicts: at the highest rate 5 s.
_Frames = Annotated[int, msgspec.Meta(ge=1, le=5000)]


class WindowsInfo(Provenance, frozen=True, kw_only=True):
    """Provenance of one table of windows; its outcomes count windows by exclusion (``window`` for the others).

    Attributes:
        fps: Frames a second.
        observed_frames: Frames that a predictor is given.
        future_frames: Frames that it predicts.
        fewest_gaze_frames: Observed frames with measured gaze that a window has at least.
        joint_set: ``smpl22``, or native joints such as ``mogaze21``.
        has_gaze: False where no frame of any recording has measured gaze.
        estimated_bodies: Bodies were estimated from whole tracks of the head: an observed frame may carry later head
            motion.
        participants: Number of participants.
        recordings: Number of recordings with windows.
        runs: Number of runs of frames (segments, sequences).
        frames: Number of frames in all runs.
    """

    file_name = FILE_NAME
    described = "table of windows"
    build_command = "build-windows"

    fps: Annotated[float, msgspec.Meta(gt=0, le=1000)]
    observed_frames: _Frames
    future_frames: _Frames
    fewest_gaze_frames: Count
    joint_set: str
    has_gaze: bool = False
    estimated_bodies: bool = False
    participants: Count = 0
    recordings: Count = 0
    runs: Count = 0
    frames: Count = 0


def write_windows(folder: Path, info: WindowsInfo, cut: Iterable[Run]) -> WindowsInfo:
    """Write a folder of windows whole or not at all; an earlier one there is replaced.

    Args:
        folder: The table's folder.
        info: Provenance; digests, counts, ``has_gaze``, ``estimated_bodies`` and ``outcomes`` are filled in here.
        cut: Runs in table order, taken up one by one.

    Returns:
        The provenance as written.

    Raises:
        StorageError: if the folder holds something that is no table of windows, or cannot be written.
        TableError: if there is no window, or captured bodies stand beside estimated ones.
    """
    require_replaceable(folder, FILE_NAME, kind="table of windows")
    schemas = {"streams": streams_schema(joint_sets.joint_set(info.joint_set)), "windows": WINDOWS}
    kinds: dict[bool, str] = {}
    windows: list[dict[str, object]] = []
    counted: dict[str, Any] = {"runs": 0, "frames": 0, "has_gaze": False}
    people: set[str] = set()
    recordings: set[str] = set()

    def streams() -> Iterator[pa.RecordBatch]:
        for run in cut:
            # Estimated bodies may carry later head motion: they never enter one mean with captured ones.
            kinds.setdefault(run.pose_source in ESTIMATED, run.recording_id)
            if len(kinds) > 1:
                found = f"both: {kinds[False]} and {kinds[True]}. Build a table of each; they never enter one mean."
                raise TableError(f"{folder}: expected captured bodies or estimated ones, found {found}")
            windows.extend(window.row(run, counted["runs"]) for window in run.windows)
            counted["runs"] += 1
            counted["frames"] += run.n_frames
            counted["has_gaze"] |= bool(run.gaze_valid.any())
            recordings.add(run.recording_id)
            people.add(run.participant_id)
            yield row_batch([run], schemas["streams"])

    def rows() -> Iterator[pa.RecordBatch]:
        for start in range(0, len(windows), 4096):
            yield pa.RecordBatch.from_pylist(windows[start : start + 4096], schema=WINDOWS)

    with atomic_folder(folder) as temporary:
        # The provenance counts what was written, so it is written once more at the end.
        tables = {"streams": streams(), "windows": rows()}
        written = write_tables(temporary, info, tables, schemas, _IDENTITY, row_group_rows=RUNS_AT_ONCE)
        if not windows:
            found = f"0 windows in {counted['runs']} runs."
            raise TableError(f"{folder}: expected a run of frames longer than a window, found {found}")
        outcomes = Counter(str(window["exclusion"] or "window") for window in windows)
        about = {"outcomes": dict(sorted(outcomes.items())), "estimated_bodies": info.estimated_bodies or True in kinds}
        counts = {"recordings": len(recordings), "participants": len(people)}
        written = msgspec.structs.replace(written, **counted, **about, **counts)
        written.write(temporary)
    return written


@dataclass(frozen=True)
class Truth:
    """What scoring knows of the windows of an :class:`ObservedBatch`, in the batch's frame, and no predictor does.

    Attributes:
        joints: NaN beyond ``n_scored``.
        goal: NaN where the event lies beyond the scored frames.
    """

    window_ids: tuple[str, ...]
    recording_ids: tuple[str, ...]
    participant_ids: tuple[str, ...]
    segments: tuple[str, ...]
    anchors: tuple[str, ...]
    n_scored: Int[np.ndarray, " batch"]
    joints: Float[np.ndarray, "batch future joints 3"]
    goal: Float[np.ndarray, "batch 3"]
    room_from_batch: Float[np.ndarray, "batch 4 4"]


@dataclass(frozen=True)
class WindowsTable:
    """A table of windows, opened; runs are read when they are asked for.

    Attributes:
        windows: All rows of ``windows``.
        runs: The short columns of ``streams``.
    """

    folder: Path
    info: WindowsInfo
    windows: pa.Table
    runs: pa.Table

    @classmethod
    @foreign_input()
    def open(cls, folder: Path | str) -> WindowsTable:
        """Open a folder of windows, and check that no file was edited.

        Raises:
            TableError: naming the file, what was expected and what was found.
        """
        folder = Path(folder)
        info = WindowsInfo.read(folder)
        if info.schema_version != SCHEMA_VERSION:
            problem = f"expected version {SCHEMA_VERSION}, found {info.schema_version}. Build it again."
            raise TableError(f"{folder / FILE_NAME}: {problem}")
        schema = streams_schema(joint_sets.joint_set(info.joint_set))
        for name, expected in (("streams", schema), ("windows", WINDOWS)):
            for path in table_parts(folder, name):
                found = open_parquet(path).schema_arrow.remove_metadata()
                if found != expected.remove_metadata():
                    wrong = next((field.name for field in expected if field not in list(found)), "another column")
                    remedy = "Build it again."
                    raise TableError(f"{path}: expected a column '{wrong}' of version {SCHEMA_VERSION}. {remedy}")
        short = [field.name for field in schema if not pa.types.is_list(field.type)]
        runs, windows = (
            pa.concat_tables(read_parquet(path, columns) for path in table_parts(folder, name)).combine_chunks()
            for name, columns in (("streams", short), ("windows", WINDOWS.names))
        )
        require_unchanged(info, folder, schema, _IDENTITY, main="streams", others=["windows"], rows=RUNS_AT_ONCE)
        require_distinct(windows["window_id"].to_pylist(), f"{folder}, windows")
        # Refuse numbers that do not fit the frames that there are, before memory is taken for what they announce.
        lengths = runs["n_frames"].to_numpy().astype(np.int64)
        told: dict[str, object] = {
            "fps": next((fps for fps in runs["fps"].to_pylist() if fps != info.fps), info.fps),
            "runs": len(lengths),
            "frames": int(lengths.sum()),
            "recordings": pc.call_function("count_distinct", [runs["recording_id"]]).as_py(),
            "participants": pc.call_function("count_distinct", [runs["participant_id"]]).as_py(),
        }
        protocol = load_prediction_protocol()
        if info.protocol_digest == protocol.digest:
            rules = protocol.windows.at(info.fps)
            told |= {name: getattr(rules, name) for name in ("observed_frames", "future_frames", "fewest_gaze_frames")}
        for name, expected in told.items():
            require_told(info, folder, name, getattr(info, name), expected)
        row = windows["row"].to_numpy().astype(np.int64)
        frames = lengths[row.clip(0, len(lengths) - 1)]
        n_scored = windows["n_scored"].to_numpy().astype(np.int64)
        for name, least, most in (
            ("row", 0, len(lengths) - 1),
            ("n_scored", 1, info.future_frames),
            ("n_gaze_valid", 0, info.observed_frames),
            ("start", 0, frames - info.observed_frames - n_scored),
        ):
            found = windows[name].to_numpy()
            wrong = np.flatnonzero((found < least) | (found > most))
            if wrong.size:
                at = wrong[0]
                problem = f"expected {least} to {np.broadcast_to(most, found.shape)[at]}, found {found[at]}."
                remedy = "Build the windows again."
                raise TableError(f"{folder}, windows, row {at}, column '{name}': {problem} {remedy}")
        return cls(folder, info, windows, runs)

    @property
    def identity(self) -> str:
        """Digest of which runs and frames there are."""
        return self.info.identity_digest

    @property
    def content(self) -> str:
        """Digest of all values."""
        return self.info.content_digest

    @property
    def joints(self) -> joint_sets.JointSet:
        """The joint set of all runs."""
        return joint_sets.joint_set(self.info.joint_set)

    @cached_property
    def _columns(self) -> Mapping[str, np.ndarray]:
        row = self.windows["row"].to_numpy()
        columns = {name: np.array(self.runs[name].to_pylist())[row] for name in ("split", "published_split")}
        own = {name: np.array(self.windows[name].to_pylist()) for name in ("exclusion", "n_gaze_valid", "anchor")}
        return {**columns, **own, "row": row}

    def chosen(
        self,
        *,
        split: str | None = None,
        published_split: str | None = None,
        anchor: str | None = None,
        with_excluded: bool = False,
    ) -> Int[np.ndarray, " n"]:
        """Places of the windows that are scored, the same under every condition, so that conditions can be paired.

        Args:
            split: Only this split of the dataset.
            published_split: Only this split of the published evaluation.
            anchor: Only this anchor.
            with_excluded: Windows with an invalid body or too little gaze, too: those that the study counts.

        Raises:
            UsageError: if none is left.
        """
        columns = self._columns
        keep = np.ones(len(columns["row"]), dtype=bool)
        for name, wanted in (("split", split), ("published_split", published_split), ("anchor", anchor)):
            if wanted is not None:
                keep &= columns[name] == wanted
        if not with_excluded:
            keep &= columns["exclusion"] == ""
            if self.info.has_gaze:
                keep &= columns["n_gaze_valid"] >= self.info.fewest_gaze_frames
        if not keep.any():
            why = f"(split {split or published_split or 'any'}, anchor {anchor or 'any'})."
            remedy = f"The table's runs are of the splits {', '.join(sorted(set(self.runs['split'].to_pylist())))}."
            raise UsageError(f"{self.folder}: no window of {len(keep)} is left {why} {remedy}")
        return np.flatnonzero(keep)

    def training(self, *, published: bool = False) -> Int[np.ndarray, " n"]:
        """Places of the windows of the dataset's training split, or of the published evaluation's.

        Raises:
            UsageError: if there is none.
        """
        return self.chosen(published_split="train") if published else self.chosen(split="train")

    def runs_of(self, chosen: Int[np.ndarray, " n"]) -> Iterator[Run]:
        """Read the runs of some windows, each with these windows alone."""
        windows: dict[int, list[Window]] = {}
        for row in self.windows.take(chosen).to_pylist():
            windows.setdefault(row["row"], []).append(Window.of(row))
        for number, run in self.iterate_runs(windows):
            yield replace(run, windows=tuple(windows[number]))

    def write_training_copy(self, folder: Path, *, published: bool = False) -> None:
        """Write the windows of :meth:`training` and their runs as a table whose training split they are.

        Raises:
            UsageError: if there is none.
            StorageError: if the folder cannot be written.
        """
        runs = self.runs_of(self.training(published=published))
        write_windows(folder, self.info, (replace(run, split="train") for run in runs))

    def iterate_runs(self, rows: Iterable[int] | None = None) -> Iterator[tuple[int, Run]]:
        """Read runs in table order, a few at a time.

        Args:
            rows: Only these rows; all if None.
        """
        wanted = None if rows is None else frozenset(int(row) for row in rows)
        first = 0
        for path in table_parts(self.folder, "streams"):
            with naming(path):
                file = open_parquet(path)
                for group in range(file.metadata.num_row_groups):
                    count = file.metadata.row_group(group).num_rows
                    here = [row for row in range(first, first + count) if wanted is None or row in wanted]
                    if here:
                        batch = file.read_row_group(group).combine_chunks().to_batches()[0]
                        for row in here:
                            yield row, run_of(batch.slice(row - first, 1))
                    first += count

    def batches(
        self, condition: Condition, chosen: Int[np.ndarray, " n"], *, frame: FrameName = "last-pose", size: int = 64
    ) -> Iterator[tuple[ObservedBatch, Truth]]:
        """Yield the windows in table order, as a predictor may see them, each with its truth.

        Args:
            condition: What the predictor knows.
            chosen: Places of windows (:meth:`chosen`).
            frame: Frame of the joints.
            size: Windows of a batch.

        Raises:
            UsageError: for ``pose+gaze`` where nobody's gaze was recorded.
        """
        if condition is Condition.POSE_GAZE and not self.info.has_gaze:
            found = "found none in any recording. Choose pose or pose+head."
            raise UsageError(f"{self.folder}: expected recorded gaze for the condition '{condition.value}', {found}")
        rows = self._columns["row"][chosen]
        pending: list[tuple[int, Run]] = []
        for row, run in self.iterate_runs(np.unique(rows)):
            pending += [(int(place), run) for place in chosen[rows == row]]
            while len(pending) >= size:
                yield self._batch(condition, pending[:size], frame)
                pending = pending[size:]
        if pending:
            yield self._batch(condition, pending, frame)

    def _batch(
        self, condition: Condition, windows: list[tuple[int, Run]], frame: FrameName
    ) -> tuple[ObservedBatch, Truth]:
        rows = self.windows.take([place for place, _ in windows]).to_pylist()
        runs = [run for _, run in windows]
        borders = [row["start"] + self.info.observed_frames for row in rows]

        def observed(name: str) -> np.ndarray:
            parts = zip(rows, runs, borders, strict=True)
            return np.stack([getattr(run, name)[row["start"] : border] for row, run, border in parts])

        joints = observed("joints")
        room_from_batch = np.tile(np.eye(4), (len(rows), 1, 1))
        if frame == "last-pose":
            room_from_batch = self.joints.last_pose_frame(joints[:, -1])
        batch_from_room = joint_sets.invert_each(room_from_batch)
        gaze = None
        valid = None
        if condition is not Condition.POSE:
            with_gaze = condition is Condition.POSE_GAZE
            directions = observed("gaze" if with_gaze else "head_direction")
            gaze = joint_sets.transform_each(joint_sets.rotations_alone(batch_from_room), directions).astype(np.float32)
            valid = observed("gaze_valid") if with_gaze else np.ones(gaze.shape[:2], dtype=bool)
        batch = ObservedBatch(
            condition=condition,
            fps=self.info.fps,
            n_future=self.info.future_frames,
            joint_names=self.joints.names,
            observed_joints=joint_sets.transform_each(batch_from_room, joints).astype(np.float32),
            key=tuple(window_key(row["window_id"]) for row in rows),
            gaze=gaze,
            gaze_valid=valid,
        )
        future = np.full((len(rows), self.info.future_frames, len(self.joints.names), 3), np.nan)
        goal = np.full((len(rows), 3), np.nan)
        for place, (row, run, first) in enumerate(zip(rows, runs, borders, strict=True)):
            future[place, : row["n_scored"]] = run.joints[first : first + row["n_scored"]]
            if row["goal"] is not None:
                goal[place] = row["goal"]
        about = ("recording_id", "participant_id", "segment")
        recordings, people, segments = (tuple(getattr(run, name) for run in runs) for name in about)
        window_ids, anchors = (tuple(row[name] for row in rows) for name in ("window_id", "anchor"))
        n_scored = np.array([row["n_scored"] for row in rows], dtype=np.int64)
        joints = joint_sets.transform_each(batch_from_room, future).astype(np.float32)
        goal = joint_sets.transform_each(batch_from_room, goal)
        return batch, Truth(window_ids, recordings, people, segments, anchors, n_scored, joints, goal, room_from_batch)


def run_of(row: pa.RecordBatch) -> Run:
    """Return the only row of ``streams`` that is given, as a run."""

    def frames(name: str, *shape: int) -> np.ndarray:
        flat = row.column(name).flatten()
        flat = flat.flatten() if shape else flat
        return flat.to_numpy(zero_copy_only=False).reshape(-1, *shape)

    n_values = row.schema.field("joints").type.value_type.list_size
    columns: dict[str, Any] = {name: row.column(name)[0].as_py() for name in (*_TEXTS, "fps", "start_time")}
    shapes = {"joints": (n_values // 3, 3), "joints_valid": (), "gaze": (3,), "gaze_valid": (), "head_direction": (3,)}
    columns |= {name: frames(name, *shape) for name, shape in shapes.items()}
    return Run(**columns)
