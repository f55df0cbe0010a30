"""What stands around sequences, from the recordings: objects with their boxes and paths, and the mesh of the scene."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.curation.mending import mended
from prbench.errors import InputFileError
from prbench.geometry.skeleton import invert_rigid, transform_points
from prbench.geometry.timelines import covered
from prbench.readers.files import Triangles, read_triangles
from prbench.recording import Recording
from prbench.sequences import SequenceChunk, SequenceTable
from prbench.viewing.player.document import PlayerMesh, PlayerObject, PlayerSequence, metres, packed
from prbench.viewing.replay.scene import Progress
from prbench.viewing.review import native_recordings

_read_once = lru_cache(maxsize=1)(read_triangles)  # the sequences of a recording share its scene

MOST_TRIANGLES = 8_000
MOST_OBJECTS = 60
_AROUND = 3.0  # metres beside the bodies in which a scene is shown
_LONGEST_GAP = 0.3  # seconds that an object may be lost without leaving the picture
_MOVES = 0.01  # metres
# Scans of the scene in the datasets' own layouts (GIMO), beside a file of the recording.
_SCANS = ("scene_downsampled.ply", "textured_output.obj")
_NEEDED = ["recording_id", "start_time", "world_from_canonical", "joints", "goal_location"]


def surrounded(
    sequences: Sequence[PlayerSequence],
    table: SequenceTable,
    root: Path,
    mesh: Path | None = None,
    option: Mapping[str, str] | None = None,
    progress: Progress = lambda *_: None,
) -> list[PlayerSequence]:
    """Return the sequences with the objects around them and the mesh of their scene.

    Args:
        sequences: Sequences of the table.
        table: The table.
        root: The recordings that it was built from.
        mesh: Scene in the coordinates of the recordings' files (.ply, .obj, .glb); by default the scan that the
            dataset's layout holds beside a recording, if there is one.
        option: Options of the reader that ``dataset.json`` does not tell, because they are places.
        progress: Called after each recording.

    Raises:
        InputFileError: if a recording is not below ``root``, or a mesh cannot be read.
    """
    ids = frozenset(each.sequence_id for each in sequences)
    chunks = {chunk.sequence_ids[0]: chunk for chunk in table.chunks(ids=ids, columns=_NEEDED, rows=1)}
    recording_of = {name: chunk.strings("recording_id")[0] for name, chunk in chunks.items()}
    sources, mends = native_recordings(table.info, root, option)
    found: dict[str, PlayerSequence] = {}
    recordings = list(dict.fromkeys(recording_of.values()))
    for number, name in enumerate(recordings):
        if name not in sources:
            raise InputFileError(root, "", expected=f"the recording {name} of {table.folder}", found="others")
        recording = mended(sources[name].read(), *mends)
        beside = {file.path.parent / scan for file in sources[name].found.files for scan in _SCANS}
        scan = mesh or next((path for path in sorted(beside) if path.is_file()), None)
        for sequence in sequences:
            if recording_of[sequence.sequence_id] == name:
                found[sequence.sequence_id] = _with(sequence, chunks[sequence.sequence_id], recording, scan)
        progress(number + 1, len(recordings), name)
    return [found[sequence.sequence_id] for sequence in sequences]


def _with(sequence: PlayerSequence, chunk: SequenceChunk, recording: Recording, scan: Path | None) -> PlayerSequence:
    times = chunk.numbers("start_time")[0] + np.arange(sequence.n_frames) / sequence.fps
    canonical_from_world = invert_rigid(chunk.vectors("world_from_canonical").reshape(4, 4).astype(np.float64))
    seen = np.concatenate([chunk.joints.reshape(-1, 3), chunk.vectors("goal_location")])
    near = []
    for track in recording.objects:
        if len(track.times) > 1 and not covered(track.times, track.valid, times, max_gap=_LONGEST_GAP).all():
            continue
        # The object as it is at the first frame, and its path if it moves from there.
        position, rotation = track.pose_at(times)
        turned = Rotation.from_quat(rotation, scalar_first=True)
        centre = position + turned.apply((track.box_min + track.box_max) / 2)
        path = transform_points(canonical_from_world, centre)
        corners = np.array(list(itertools.product(*zip(track.box_min, track.box_max, strict=True))))
        box = metres(transform_points(canonical_from_world, turned[0].apply(corners) + position[0]))
        moves = np.linalg.norm(path - path[0], axis=1).max() > _MOVES
        shown = PlayerObject(name=track.name, box=box, path=packed(path) if moves else None)
        near.append((float(np.linalg.norm(seen - np.mean(box, axis=0), axis=1).min()), track.object_id, shown))
    nearest = sorted(near, key=lambda each: each[:2])[:MOST_OBJECTS]
    mesh = None
    if scan is not None:
        vertices, triangles = _read_once(scan)
        placed = transform_points(canonical_from_world, transform_points(recording.world_from_source, vertices))
        centres = placed[triangles].mean(axis=1)
        around = (centres >= seen.min(axis=0) - _AROUND) & (centres <= seen.max(axis=0) + _AROUND)
        vertices, triangles = decimated(placed, triangles[around.all(axis=1)], MOST_TRIANGLES)
        mesh = PlayerMesh(vertices=packed(vertices), triangles=triangles.astype("<u4").tobytes())
    objects = [shown for distance, _, shown in nearest if distance <= _AROUND]
    return msgspec.structs.replace(sequence, objects=objects, mesh=mesh)


def decimated(vertices: Float[np.ndarray, "_ 3"], triangles: Int[np.ndarray, "_ 3"], most: int) -> Triangles:
    """Return a mesh of at most so many triangles: corners in one cell of a grid become one, and the grid grows.

    Args:
        vertices: Metres.
        triangles: Numbers of vertices.
        most: Largest number of triangles.
    """
    cell = 0.01
    while True:
        used, numbers = np.unique(triangles, return_inverse=True)
        cells, place = np.unique(np.floor(vertices[used] / cell), axis=0, return_inverse=True)
        merged = place.reshape(-1)[numbers.reshape(-1, 3)]
        merged = merged[(merged != np.roll(merged, 1, axis=1)).all(axis=1)]  # without those that became a line
        _, first = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
        if len(first) <= most:
            counts = np.bincount(place.reshape(-1), minlength=len(cells))
            sums = [np.bincount(place.reshape(-1), column, len(cells)) for column in vertices[used].T]
            return np.stack(sums, axis=1) / counts[:, None], merged[np.sort(first)]
        cell *= 1.5
