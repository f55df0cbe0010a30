"""Read the meshes and point clouds around a sequence from the user's own copy of the dataset, as points.

Tables hold motion and goals alone, so ``prbench view --scene DIR`` reads the recordings again. Open3D (the extra
``open3d``) spreads points over the meshes and thins them out.
"""

from __future__ import annotations

import gzip
import itertools
import zlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import foreign_input
from prbench.files.storage import turn_into_paths
from prbench.geometry.shapes import import_open3d
from prbench.geometry.skeleton import Joint, invert_rigid, transform_points
from prbench.harness.benchmark import load_benchmark
from prbench.harness.controls import GROUND_TRUTH
from prbench.harness.first_run import tables_of_runs
from prbench.harness.run_folder import RunFolder
from prbench.harness.verification import RunChecker
from prbench.limits import LARGEST_FILE
from prbench.protocol.manifests import default_benchmark
from prbench.readers import AriaGlasses, RecordingFiles, reader_for
from prbench.readers.files import Source, opened, shown
from prbench.recording import ObjectTrack, Recording
from prbench.sequences import SequenceChunk, SequenceTable
from prbench.sequences.table import by_share, find_sequence_id
from prbench.viewing.replay.read import RunMotions, read_scenes, run_labels
from prbench.viewing.replay.scene import METHOD_COLOURS, Scene, score_sentence
from prbench.viewing.replay.sheet import file_kind, write_view

_BETWEEN_POINTS = 0.02  # metres; what is drawn
_POINTS_ON_AREA = 3 / _BETWEEN_POINTS**2  # a square metre gets more than are drawn, so that no cell stays empty
_MOST_ON_MESH = 2_000_000
_AROUND = 2.0  # metres beyond the way of the pelvis and the goal
_ABOVE_FLOOR = 0.04  # metres; the floor would cover the whole map, and so would the ceiling
_HEAD_ROOM = 2.1
_SUREST = {"inv_dist_std": 0.005, "dist_std": 0.05}
"""Largest deviations of a point that is drawn, 1/m and m (choice)."""
_MESHES = "meshes"
"""Option of readers."""


@dataclass(frozen=True)
class _Piece:
    """Points on one surface, in the world, or in the frame of the object that carries it."""

    points: Float[np.ndarray, "k 3"]
    track: ObjectTrack | None = None


class Surroundings:
    """The surfaces of one dataset's recordings.

    Args:
        dataset: Name of the dataset.
        root: The user's copy of it.

    Raises:
        MissingExtraError: if Open3D is not installed.
        UsageError: if no reader knows the dataset.
        InputFileError: if the folder holds no recording of it.
    """

    def __init__(self, dataset: str, root: Path) -> None:
        import_open3d("--scene")
        plain = reader_for(dataset)
        # Some readers leave meshes out unless asked, because a build does not need them.
        self._reader = reader_for(dataset, {_MESHES: "true"}) if _MESHES in plain.options.names() else plain
        self._root = root
        self._found = {found.recording_id: found for found in self._reader.find(root)}
        self._pieces: dict[str, tuple[_Piece, ...]] = {}

    def around(self, chunk: SequenceChunk) -> Float[np.ndarray, "k 3"]:
        """Points on what stood near a sequence when its event came; canonical frame, metres.

        Args:
            chunk: One row of the dataset's table.

        Raises:
            UsageError: if the copy lacks the recording.
            InputFileError: if a file of the recording is damaged.
        """
        recording_id = chunk.strings("recording_id")[0]
        if recording_id not in self._found:
            raise UsageError(f"--scene {self._root}: expected the recording {recording_id} of the table, found it not.")
        if recording_id not in self._pieces:
            self._pieces[recording_id] = self._read(self._found[recording_id])
        time = chunk.numbers("event_time")[:1].astype(np.float64)
        world = []
        for piece in self._pieces[recording_id]:
            points = piece.points
            if piece.track is not None:
                position, rotation = piece.track.pose_at(time)
                points = Rotation.from_quat(rotation[0], scalar_first=True).apply(points) + position
            world.append(points)
        canonical_from_world = invert_rigid(chunk.vectors("world_from_canonical").reshape(4, 4))
        points = transform_points(canonical_from_world, np.concatenate([np.empty((0, 3)), *world]))
        seen = np.concatenate([chunk.joints[:, Joint.PELVIS], chunk.vectors("goal_location")])
        low = seen.min(axis=0) - _AROUND
        high = seen.max(axis=0) + _AROUND
        low[1], high[1] = _ABOVE_FLOOR, _HEAD_ROOM
        return _thinned(points[((points > low) & (points < high)).all(axis=1)])

    def _read(self, found: RecordingFiles) -> tuple[_Piece, ...]:
        recording = self._reader.read(found)
        cloud = self._reader.point_cloud(found) if isinstance(self._reader, AriaGlasses) else None
        pieces = _surfaces(recording)
        if cloud is None:
            return pieces
        return (*pieces, _Piece(transform_points(recording.world_from_source, _read_cloud(cloud))))


def _surfaces(recording: Recording) -> tuple[_Piece, ...]:
    """Points on all meshes, and on the boxes of the objects that have none."""
    tracks = {track.object_id: track for track in recording.objects}
    carried = {occluder.object_id for occluder in recording.occluders}
    pieces = [
        _Piece(_points_on(each.vertices, each.faces), None if each.object_id is None else tracks.get(each.object_id))
        for each in recording.occluders
    ]
    boxes = [track for track in recording.objects if track.object_id not in carried]
    for track in boxes:
        if (track.box_max > track.box_min).all():
            box = import_open3d("--scene").geometry.TriangleMesh.create_box(*(track.box_max - track.box_min))
            corners = np.asarray(box.vertices) + track.box_min
            pieces.append(_Piece(_points_on(corners, np.asarray(box.triangles, dtype=np.int64)), track))
    return tuple(pieces)


def _points_on(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Float[np.ndarray, "k 3"]:
    """Random points all over a mesh, the same in every run."""
    open3d = import_open3d("--scene")
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices), open3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    count = int(np.clip(mesh.get_surface_area() * _POINTS_ON_AREA, 1, _MOST_ON_MESH))
    # Open3D's generator is global; the same seed before every mesh makes pictures reproducible.
    open3d.utility.random.seed(0)
    return _thinned(np.asarray(mesh.sample_points_uniformly(count).points))


def _thinned(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k 3"]:
    """The mean of the points in each cube of 2 cm."""
    open3d = import_open3d("--scene")
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    return np.array(cloud.voxel_down_sample(_BETWEEN_POINTS).points).reshape(-1, 3)


@foreign_input()
def _read_cloud(source: Source) -> Float[np.ndarray, "n 3"]:
    """The sure points of a semi-dense point cloud of Project Aria, in the frame of its trajectory, metres."""
    columns = ["px_world", "py_world", "pz_world", *_SUREST]
    try:
        with opened(source) as packed, gzip.open(packed, "rb") as plain:
            # One byte more than allowed is read: a gzip header does not say how long its content is.
            content = plain.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise InputFileError(
                shown(source), "", expected=f"at most {LARGEST_FILE:,} bytes unpacked", found="more than that"
            )
        chosen = pyarrow.csv.ConvertOptions(include_columns=columns, column_types=dict.fromkeys(columns, pa.float64()))
        table = pyarrow.csv.read_csv(pa.BufferReader(content), convert_options=chosen)
    except (pa.ArrowInvalid, KeyError, EOFError, OSError, zlib.error) as error:
        raise InputFileError(
            shown(source),
            "",
            expected=f"points with the columns {', '.join(columns)}",
            found=str(error).splitlines()[0],
            remedy="Download the file again, or remove it: the view is then drawn without.",
        ) from error
    values = np.column_stack([table[name].to_numpy() for name in columns])
    # Most points of a semi-dense cloud are too uncertain to show a surface.
    sure = np.isfinite(values).all(axis=1) & (values[:, 3:] <= list(_SUREST.values())).all(axis=1)
    return values[sure, :3]


DEFAULT_LIMIT = 4

Progress = Callable[[int, int, str], None]
"""Called with finished steps, all steps, and what was finished last."""


def _silent(done: int, total: int, last: str) -> None:
    """Say nothing."""


@dataclass(frozen=True, kw_only=True)
class ViewRequest:
    """The sequences and runs that a user wants to see.

    Raises:
        UsageError: if parts of it do not fit together.
    """

    out: Path
    """The file; its suffix chooses the kind."""
    runs: tuple[Path, ...] = ()
    """Run folders whose motions stand beside one another; none for recorded motion alone."""
    data: tuple[Path, ...] = ()
    """Tables; where none is given, the tables in prbench's own cache are tried."""
    sequences: tuple[str, ...] = ()
    """Ids, or parts of ids that fit one sequence only."""
    limit: int | None = None
    """Largest number of sequences of each dataset, chosen as `prbench run --limit` does; by default four."""
    sample: int = 0
    """Number of the shown motion, for runs that drew several."""
    permitted: Collection[str] = ()
    """Datasets for which the user has permission to pass recorded motion on."""
    scene: Path | None = None
    """The user's copy of the dataset, for drawing what stood around; None draws the motions alone."""

    def __post_init__(self) -> None:
        turn_into_paths(self, "out", "runs", "data", "scene")
        if not self.runs and not self.data:
            raise UsageError("nothing to view: name a run folder, or a dataset folder with --data DIR.")
        if self.sequences and self.limit is not None:
            raise UsageError("--sequence names the sequences already; leave --limit out.")
        if len(self.runs) > len(METHOD_COLOURS):
            raise UsageError(f"expected at most {len(METHOD_COLOURS)} runs in one view, found {len(self.runs)}.")
        if len(set(self.runs)) < len(self.runs):
            raise UsageError("a run folder is named more than once.")


@dataclass(frozen=True)
class ViewReport:
    """The sequences that were shown."""

    out: Path
    scenes: tuple[Any, ...]
    """Each a :class:`Scene`; those of another benchmark have what stands in the report of the command."""

    def told(self, scene: Any, motion: Any) -> str:
        """Return the scores of a motion in one line."""
        return score_sentence(scene, motion) or "not scored"

    @property
    def notices(self) -> tuple[str, ...]:
        """The notices that the datasets' terms ask for, as they stand in the view."""
        return tuple(dict.fromkeys(scene.notice for scene in self.scenes if scene.notice))


def view(request: ViewRequest, progress: Progress = _silent) -> ViewReport:
    """Render runs, or recorded motion, into one file.

    Raises:
        UsageError: if the file's suffix is unknown, or a sequence is unknown or left out by a run.
        RunError: if a run has no predictions, was made on another table, or its scores are not those of its motions.
        TableError: if a table cannot be found or read.
        RedistributionError: if nothing is left that the licence lets be shown.
        MissingExtraError: if MP4 or HTML is asked for without the extra `view`, or a scene without the extra `open3d`.
        StorageError: if the file cannot be written.
    """
    if request.runs:
        benchmark = RunFolder.open(request.runs[0], any_benchmark=True).record.benchmark
        if benchmark != default_benchmark().name:
            return load_benchmark(benchmark).view(request)
    # First of all: an unwritable kind of file must not fail after minutes of drawing.
    kind = file_kind(request.out)
    scenes = scenes_of(request)
    write_view(scenes, request.out, kind, progress)
    return ViewReport(request.out, scenes)


def scenes_of(request: ViewRequest) -> tuple[Scene, ...]:
    """Read what is to be shown, table after table."""
    runs = [RunFolder.open(path) for path in request.runs]
    labels = run_labels(request.runs, [run.record for run in runs])
    if runs:
        tables = tables_of_runs(runs, request.data)
    else:
        tables = [SequenceTable.open(path).with_sequences() for path in request.data]
    # The scores stand beside the motions in the picture, so they have to be theirs.
    for table in tables:
        for run in runs:
            record = next(record for record in run.record.tables if record.dataset == table.info.dataset)
            if run.dataset(record.dataset).finished:
                RunChecker(lambda _, table=table: table).check(run, record)
    shown = []
    for table in tables:
        motions = [
            RunMotions.open(run, table.info.dataset, label=label, sample=request.sample)
            for run, label in zip(runs, labels, strict=True)
        ]
        shown.append(Shown(table, tuple(motions)))
    scenes: list[Scene] = []
    for part, ids in zip(shown, _chosen(request, shown), strict=True):
        if ids:
            around = None if request.scene is None else Surroundings(part.table.info.dataset, request.scene).around
            scenes += read_scenes(part.table, ids, part.generated, permitted=request.permitted, around=around)
    return tuple(scenes)


@dataclass(frozen=True)
class Shown:
    """One table with the runs that were made on it."""

    table: SequenceTable
    runs: tuple[RunMotions, ...]

    @property
    def generated(self) -> list[RunMotions]:
        """All runs but those of the recorded motion itself, which every view shows anyway."""
        return [
            # A shuffled control of the ground truth shows other motions and stays.
            run
            for run in self.runs
            if run.run.record.method.name != GROUND_TRUTH or run.run.record.control is not None
        ]


def _chosen(request: ViewRequest, shown: Sequence[Shown]) -> list[list[str]]:
    """Ids of each table: those asked for, else a few that every run holds."""
    rows = [part.table.scalars(columns=["sequence_id", "recording_id"]) for part in shown]
    known = [table["sequence_id"].to_pylist() for table in rows]
    chosen = []
    if not request.sequences:
        held = [[name for name in ids if all(name in run for run in part.runs)] for part, ids in zip(shown, known)]
        if not any(held):
            raise UsageError("these runs have no sequence in common; run them with the same --split and --limit.")
        for ids, names, table in zip(held, known, rows, strict=True):
            recording_of = dict(zip(names, table["recording_id"].to_pylist(), strict=True))
            taken = set(by_share(ids, [recording_of[name] for name in ids])[: request.limit or DEFAULT_LIMIT])
            chosen.append([name for name in ids if name in taken])
        return chosen
    # A part of an id has to fit one sequence of all tables together, so it is looked for among all of them.
    everything = list(itertools.chain.from_iterable(known))
    among = ", ".join(part.table.info.dataset for part in shown)
    wanted = list(dict.fromkeys(find_sequence_id(name, everything, among=among) for name in request.sequences))
    for part, ids in zip(shown, known, strict=True):
        own = [name for name in wanted if name in ids]
        for run in part.runs:
            for name in own:
                if name not in run:
                    why = _why_left_out(run, part.table, name)
                    raise UsageError(f"{run.run.path}: holds no motion of {name}: {why}")
        chosen.append(own)
    return chosen


def _why_left_out(run: RunMotions, table: SequenceTable, name: str) -> str:
    record = run.run.record
    rows = table.scalars(columns=["sequence_id", "split", "n_frames"])
    row = rows["sequence_id"].to_pylist().index(name)
    split = rows["split"][row].as_py()
    n_frames = rows["n_frames"][row].as_py()
    if split != record.split:
        return f"it is in split '{split}', the run is of '{record.split}'."
    if record.method.max_frames is not None and n_frames > record.method.max_frames:
        return f"it has {n_frames} frames, {record.method.name} generates at most {record.method.max_frames}."
    if record.limit is not None:
        return f"the run was limited to {record.limit} sequences (--limit). Run it alone: prbench run … --sequence ID"
    if record.sequences:
        return "the run was of other sequences (--sequence)."
    return "the run was interrupted before it. Run the same `prbench run` again: it resumes."
