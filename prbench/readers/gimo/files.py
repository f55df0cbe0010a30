"""Find and read the files of GIMO segments (docs/specification/gimo.md#folder-tree)."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

import numpy as np

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.files.storage import inside
from prbench.protocol.manifests import Manifest
from prbench.readers import ReaderOptions, read_synthetic_tree
from prbench.readers.extents import ONE_SYSTEM, SEVERAL_SENSORS, Extent
from prbench.readers.found import (
    FilesOnDemand,
    InputFile,
    RecordingFiles,
    existing_folder,
    input_file,
    is_present,
    names_in,
)
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.bodies import (
    SMPLX_PAGE,
    VPOSER_PAGE,
    joints_from_meshes,
    joints_from_parameters,
    read_pose_decoder,
    read_poses,
    read_smplx_model,
)
from prbench.readers.gimo.bvh import read_bvh
from prbench.readers.gimo.gaze import read_gaze, read_hololens, read_transform
from prbench.readers.gimo.table import (
    EventRow,
    Row,
    events_of,
    hints_in_both_splits,
    overlapping,
    read_events,
    read_segments,
    require_known_segments,
    require_one_split,
)
from prbench.readers.gimo.to_recording import GazeOrigin, Target
from prbench.recording import Recording

Route = Literal["smplx", "mesh", "bvh"]


class GimoOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of the GIMO reader."""

    events: Path | None = None
    """Table of pick events (``docs/gimo-events.md``); ``prbench_events.csv`` at the root if None."""
    hints: bool = True
    """Take the hint of ``dataset.csv`` as event frame where the table of events does not name a segment."""
    training_2: Literal["train", "drop"] = "train"
    """Use of the segments that the official loader never uses: train on them, or leave them out."""
    body: Literal["auto", "smplx", "mesh", "bvh"] = "auto"
    """Source of joints: fitted parameters, posed meshes, or the suit's skeleton; auto = the first that can be."""
    vposer_model: Path | None = None
    """Snapshot of VPoser v1 (``TR00_E096.pt``), for body smplx."""
    smplx_model: Path | None = None
    """``SMPLX_NEUTRAL.npz``, for bodies smplx and mesh."""
    target: Target = "point"
    """Box of an event: the wrist alone, or a cube of 10 cm around it."""
    gaze_origin: GazeOrigin = "head"
    """Origin of rays: the head joint, or the eyes as HoloLens 2 saw them."""
    meshes: bool = False
    """Load the scanned room, for priming that walls can hide."""

    def routes(self) -> tuple[Route, ...]:
        """Ways to the joints that these options allow, best first."""
        if self.body != "auto":
            return (self.body,)
        smplx: tuple[Route, ...] = ("smplx",) if self.vposer_model and self.smplx_model else ()
        mesh: tuple[Route, ...] = ("mesh",) if self.smplx_model else ()
        return (*smplx, *mesh, "bvh")


TABLE = "table"
EVENTS = "events"
TRANSFORM = "transform"
NORM = "norm"
SKELETON = "skeleton"
POSE = "pose:"
MESH = "mesh:"
CONE = "gaze:"
CENTRE = "gaze centre:"
"""Beginnings of the roles of files of one frame; the frame number follows."""
STREAM = "hololens stream"
VIDEO = "hololens video"
HOLOLENS_TRANSFORM = "hololens transform"
SCENE_MESH = "scene mesh"
Split = Literal["train", "test"]


@dataclass(frozen=True)
class _Folder:
    """The files of one sequence, listed once for all its segments."""

    path: Path

    @cached_property
    def poses(self) -> dict[str, dict[int, Path]]:
        return _by_frame(self.path / gimo.POSE_FOLDER)

    @cached_property
    def gaze(self) -> dict[str, dict[int, Path]]:
        return _by_frame(self.path / gimo.GAZE_FOLDER)


def find_segments(root: Path | str, options: GimoOptions) -> tuple[RecordingFiles, ...]:
    """Every segment of ``dataset.csv`` with its files; those that cannot be built carry the reason.

    Raises:
        InputFileError: if there is no readable ``dataset.csv``, none of its sequences is there (listing them), or the
            table of events is damaged or has an event in both splits.
    """
    root = existing_folder(root, "a folder of GIMO")
    if not (root / gimo.TABLE_FILE).is_file():
        raise InputFileError(
            root / gimo.TABLE_FILE,
            "",
            expected="this file",
            found=f"{names_in(root)} in its place",
            remedy=f"Give the folder that holds {gimo.TABLE_FILE} and the folders of the scenes.",
        )
    rows = read_segments(root / gimo.TABLE_FILE)
    table, events_path = _events(root, options)
    require_known_segments(events_path, rows, table)
    require_one_split(events_path, rows, table)
    tree = read_synthetic_tree(root)
    in_both = hints_in_both_splits(rows)
    folders: dict[Path, _Folder] = {}
    found = []
    for row in rows:
        segment = row.segment
        path = inside(root, f"{segment.scene}/{segment.sequence}")
        folder = folders.setdefault(path, _Folder(path))
        known = events_of(row, table, hints=options.hints)
        reason = None if known.reason is None else f"{segment.name}: {known.reason}"
        if any(event.source == "hint" for event in known.events) and segment.key in in_both:
            reason = f"its hinted event (frame {segment.hint}) also stands in a segment of the other split"
        if segment.training == gimo.TRAIN_LATER and options.training_2 == "drop":
            reason = "training = 2, left out by the option training_2"
        if not path.is_dir():
            reason = f"{segment.scene}/{segment.sequence}: its folder is missing; unpack or download it"
        in_tree = tree is not None and segment.sequence in tree.split
        found.append(
            RecordingFiles(
                dataset="gimo" if tree is None else f"{SYNTHETIC_PREFIX}gimo",
                recording_id=segment.sequence if in_tree else segment.name,
                folder=path,
                files=FilesOnDemand(partial(_files, root, options, events_path, segment, folder)),
                split="test" if segment.training == gimo.TEST else "train",
                skip_reason=reason,
            )
        )
    if not any(path.is_dir() for path in folders):
        names = sorted({f"{row.segment.scene}/{row.segment.sequence}" for row in rows})
        raise InputFileError(
            root,
            "",
            expected=f"folders of the sequences that {gimo.TABLE_FILE} lists",
            found=f"none of the {len(names)}: {', '.join(names)}",
            remedy="Unpack the scenes beside the table.",
        )
    return tuple(sorted(found, key=lambda recording: recording.recording_id))


def _events(root: Path, options: GimoOptions) -> tuple[tuple[EventRow, ...], Path]:
    """The table of events and where it lies; an empty one where the user has none."""
    if options.events is None:
        path = root / gimo.EVENTS_FILE
        return (read_events(path) if is_present(path) else ()), path
    path = options.events.expanduser()
    if not path.is_file():
        raise InputFileError(
            path,
            "",
            expected="the table of events that the option names",
            found="no such file",
            remedy="Correct the option, or make the table: `prbench build-dataset gimo --propose-events FILE` proposes"
            " one.",
        )
    return read_events(path), path


def _files(
    root: Path, options: GimoOptions, events_path: Path, segment: gimo.Segment, folder: _Folder
) -> list[InputFile]:
    scene = root / segment.scene / gimo.SCENE_FOLDER
    transform = inside(folder.path, segment.transformation)
    if transform.suffix != ".json":  # some copies of the table leave out the ending
        transform = transform.with_name(f"{transform.name}.json")
    paths = {
        TABLE: root / gimo.TABLE_FILE,
        EVENTS: events_path,
        NORM: scene / gimo.NORM_FILE,
        TRANSFORM: transform,
        **_per_frame(POSE, folder.poses.get(".pkl", {}), segment),
        **_per_frame(CONE, folder.gaze.get(".ply", {}), segment),
        **_per_frame(CENTRE, folder.gaze.get(f"{gimo.GAZE_CENTRE_SUFFIX}.ply", {}), segment),
    }
    routes = options.routes()
    if routes[0] == "mesh" or (routes[0] == "smplx" and not folder.poses.get(".pkl")):
        paths |= _per_frame(MESH, folder.poses.get(".obj", {}), segment)
    if "bvh" in routes:
        paths[SKELETON] = folder.path / gimo.SKELETON_FILE
    hololens = {
        STREAM: sorted(folder.path.glob(f"*{gimo.HOLOLENS_SUFFIX}")),
        VIDEO: sorted(folder.path.glob(f"*{gimo.VIDEO_SUFFIX}")),
        HOLOLENS_TRANSFORM: [folder.path / name for name in gimo.HOLOLENS_TRANSFORM_FILES],
    }
    if options.meshes:
        hololens[SCENE_MESH] = [scene / name for name in gimo.SCENE_MESHES]
    for role, places in hololens.items():  # the first that is there
        there = [place for place in places if is_present(place)]
        if there:
            paths[role] = there[0]
    return [input_file(role, path) for role, path in paths.items() if is_present(path)]


def _per_frame(role: str, files: dict[int, Path], segment: gimo.Segment) -> dict[str, Path]:
    wanted = sorted(frame for frame in files if segment.start_frame <= frame <= segment.end_frame)
    return {f"{role}{frame}": files[frame] for frame in wanted}


def unnumbered(folder: Path) -> list[str]:
    """Names of files that have no frame number and so are left out."""
    return sorted(name for name in names_of(folder) if not _is_number(_frame_of(name)))


def names_of(folder: Path) -> list[str]:
    """Names of all that lies in a folder, in no order; none if there is no such folder."""
    if not folder.is_dir():
        return []
    with os.scandir(folder) as entries:
        return [entry.name for entry in entries]


def _is_number(stem: str) -> bool:
    return stem.isascii() and stem.isdigit()


def _frame_of(name: str) -> str:
    """Return what stands in the place of the frame number in a file's name."""
    stem, dot, _ = name.rpartition(".")
    return (stem if dot else name).removesuffix(gimo.GAZE_CENTRE_SUFFIX)


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """The frames that the table promises, and those that have files; nothing is said of what has none at all."""
    segment = row_of(found)[0].segment
    promised = segment.start_frame / gimo.FRAME_RATE, segment.end_frame / gimo.FRAME_RATE
    streams = [Extent("segment", gimo.TABLE_FILE, *promised)]
    roles = {POSE: "body", MESH: "body", CENTRE: "gaze"}
    for role, stream in roles.items():
        files = frames_of(found, role)
        if files:
            ends = min(files) / gimo.FRAME_RATE, max(files) / gimo.FRAME_RATE
            slack = SEVERAL_SENSORS if role == CENTRE else ONE_SYSTEM  # eyes are lost now and then
            streams.append(Extent(stream, files[max(files)].name, *ends, tells_span=False, slack=slack))
    return tuple(streams)


def row_of(found: RecordingFiles) -> tuple[Row, tuple[Row, ...]]:
    """The row of ``dataset.csv`` that a recording stands for, and all rows.

    Raises:
        InputFileError: if the table has changed since the search.
    """
    path = found.require(TABLE, gimo.TABLE_FILE)
    rows = read_segments(path)
    # Ids under which a row can be known: its own, and in synthetic trees the name of its sequence.
    row = next((row for row in rows if found.recording_id in (row.segment.name, row.segment.sequence)), None)
    if row is None:
        raise InputFileError(path, "", expected=f"the segment {found.recording_id}", found="a table without it")
    return row, rows


def frames_of(found: RecordingFiles, role: str) -> dict[int, Path]:
    """Files of one kind by frame."""
    return {int(file.role.removeprefix(role)): file.path for file in found.files if file.role.startswith(role)}


def _by_frame(folder: Path) -> dict[str, dict[int, Path]]:
    """Files by ending (``.pkl``, ``_center.ply``) and frame; others, without a whole number as name, are left out."""
    found: dict[str, dict[int, Path]] = {}
    for name in names_of(folder):
        stem = _frame_of(name)
        if _is_number(stem):
            files = found.setdefault(name.removeprefix(stem), {})
            frame = int(stem)
            # Of "7.pkl" and "07.pkl" always the same one, in whatever order the disk lists them.
            if frame not in files or name > files[frame].name:
                files[frame] = folder / name
    return found


def read_readings(found: RecordingFiles, manifest: Manifest, options: GimoOptions) -> gimo.GimoReadings:
    """Read one segment.

    Raises:
        InputFileError: for a missing or damaged file, and where no way to the joints is open, saying what each needs.
    """
    row, rows = row_of(found)
    if not found.folder.is_dir():
        raise InputFileError(
            found.folder,
            "",
            expected=f"the folder of {row.segment.scene}/{row.segment.sequence}",
            found="no such folder",
            remedy="Unpack or download this sequence.",
        )
    events_path = found.path(EVENTS)
    known = events_of(row, () if events_path is None else read_events(events_path), hints=options.hints)
    gaze, gaze_remarks = read_gaze(frames_of(found, CONE), frames_of(found, CENTRE))
    return gimo.GimoReadings(
        recording_id=found.recording_id,
        segment=row.segment,
        transform=read_transform(
            found.require(TRANSFORM, row.segment.transformation),
            found.require(NORM, f"../{gimo.SCENE_FOLDER}/{gimo.NORM_FILE}"),
        ),
        body=_body(found, manifest, options),
        gaze=gaze,
        events=known.events,
        hololens=_hololens(found),
        meshes=_meshes(found) if options.meshes else (),
        messages=(*row.remarks, *_overlaps(row, rows), *known.remarks, *_unnumbered(found), *gaze_remarks),
    )


def _body(found: RecordingFiles, manifest: Manifest, options: GimoOptions) -> gimo.LocalJoints | gimo.LocalSkeleton:
    """Joints by the first way that is open."""
    poses, meshes = (frames_of(found, role) for role in (POSE, MESH))
    skeleton = found.path(SKELETON)
    # Meshes are listed only where they can be used; the message tells what is there in any case.
    has_meshes = bool(meshes) if options.smplx_model else any((found.folder / gimo.POSE_FOLDER).glob("*.obj"))
    pickles = f"{gimo.POSE_FOLDER}/<frame>.pkl"
    needs: dict[Route, dict[str, object]] = {
        "smplx": {
            "--option vposer_model": options.vposer_model,
            "--option smplx_model": options.smplx_model,
            pickles: poses,
        },
        "mesh": {"--option smplx_model": options.smplx_model, f"{gimo.POSE_FOLDER}/<frame>.obj": has_meshes},
        "bvh": {gimo.SKELETON_FILE: skeleton, pickles: poses},
    }
    lacking: dict[Route, str] = {}
    for route in tuple(needs) if options.body == "auto" else (options.body,):
        lacking[route] = " and ".join(name for name, there in needs[route].items() if not there)
        if lacking[route]:
            continue
        if route == "bvh":
            assert skeleton is not None
            return gimo.LocalSkeleton(read_bvh(skeleton), read_poses(poses))
        assert options.smplx_model is not None
        model = read_smplx_model(options.smplx_model)
        if route == "mesh":
            edge_error, spread = (
                manifest.thresholds[f"largest_mesh_{name}"] for name in ("edge_error", "vertex_spread")
            )
            return joints_from_meshes(meshes, model, largest_edge_error=edge_error, largest_spread=spread)
        assert options.vposer_model is not None
        return joints_from_parameters(read_poses(poses), read_pose_decoder(options.vposer_model), model)
    raise InputFileError(
        found.folder,
        "",
        expected="a way to the joints: smplx, mesh or bvh",
        found="; ".join(f"{route} lacks {what}" for route, what in lacking.items()),
        remedy=f"VPoser v1: {VPOSER_PAGE}; SMPL-X neutral: {SMPLX_PAGE} (options vposer_model and smplx_model).",
    )


def _hololens(found: RecordingFiles) -> gimo.HoloLens | None:
    stream, video, transform = (found.path(role) for role in (STREAM, VIDEO, HOLOLENS_TRANSFORM))
    if stream is None or video is None or transform is None:
        return None
    return read_hololens(stream, video, transform)


def _meshes(found: RecordingFiles) -> tuple[gimo.SceneMesh, ...]:
    """The scanned room as triangles; none where the copy lacks it, which curation reports.

    Raises:
        InputFileError: if the mesh cannot be read, or has points only.
    """
    path = found.path(SCENE_MESH)
    if path is None:
        return ()
    import trimesh

    try:
        mesh = trimesh.load(path, process=False, force="mesh")
    except Exception as error:  # trimesh raises whatever the damaged file makes it stumble over
        raise InputFileError(path, "", expected="a triangle mesh", found=f"{type(error).__name__}: {error}") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputFileError(
            path, "", expected="triangles", found="points only", remedy=f"Download {gimo.SCENE_MESHES[0]} as well."
        )
    return (gimo.SceneMesh(path.name, np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)),)


def _overlaps(row: Row, rows: tuple[Row, ...]) -> tuple[str, ...]:
    return tuple(f"shares frames with the segment {other.name}" for other in overlapping(rows, row))


def _unnumbered(found: RecordingFiles) -> tuple[str, ...]:
    names = [name for folder in (gimo.POSE_FOLDER, gimo.GAZE_FOLDER) for name in unnumbered(found.folder / folder)]
    shown = ", ".join(names[:3]) + (" …" if len(names) > 3 else "")
    return (f"{len(names)} files without frame number left out: {shown}",) if names else ()
