"""Read the meshes and point clouds around a sequence from the user's own copy of the dataset, as points.

Tables hold motion and goals alone, so ``prbench view --scene DIR`` reads the recordings again. Open3D (the extra
``open3d``) spreads points over the meshes and thins them out.
"""

from __future__ import annotations

import gzip
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import foreign_input
from prbench.geometry.meshes import import_open3d
from prbench.geometry.skeleton import Joint, invert_rigid, transform_points
from prbench.limits import LARGEST_FILE
from prbench.readers import AriaGlasses, RecordingFiles, reader_for
from prbench.readers.zipped import Source, opened, shown
from prbench.recording import ObjectTrack, Recording
from prbench.sequences import SequenceChunk

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
