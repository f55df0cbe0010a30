"""Everything that the files of one GIMO segment say."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.protocol.manifests import Manifest
from prbench.readers.found import RecordingFiles
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo import segments
from prbench.readers.gimo.body_model import SMPLX_PAGE, VPOSER_PAGE, read_pose_decoder, read_smplx_model
from prbench.readers.gimo.bvh import read_bvh
from prbench.readers.gimo.coordinates import read_transform
from prbench.readers.gimo.dataset_csv import Row, overlapping
from prbench.readers.gimo.events import events_of, read_events
from prbench.readers.gimo.gaze import read_gaze
from prbench.readers.gimo.hololens import read_hololens
from prbench.readers.gimo.routes import joints_from_meshes, joints_from_parameters, read_poses
from prbench.readers.gimo.segments import GimoOptions, Route


def read_readings(found: RecordingFiles, manifest: Manifest, options: GimoOptions) -> gimo.GimoReadings:
    """Read one segment.

    Raises:
        InputFileError: for a missing or damaged file, and where no way to the joints is open, saying what each needs.
    """
    row, rows = segments.row_of(found)
    _require_folder(found, row)
    events_path = found.path(segments.EVENTS)
    known = events_of(row, () if events_path is None else read_events(events_path), hints=options.hints)
    gaze, gaze_remarks = read_gaze(segments.frames_of(found, segments.CONE), segments.frames_of(found, segments.CENTRE))
    return gimo.GimoReadings(
        recording_id=found.recording_id,
        segment=row.segment,
        transform=read_transform(
            found.require(segments.TRANSFORM, row.segment.transformation),
            found.require(segments.NORM, f"../{gimo.SCENE_FOLDER}/{gimo.NORM_FILE}"),
        ),
        body=_body(found, manifest, options),
        gaze=gaze,
        events=known.events,
        hololens=_hololens(found),
        meshes=_meshes(found) if options.meshes else (),
        messages=(*row.remarks, *_overlaps(row, rows), *known.remarks, *_unnumbered(found), *gaze_remarks),
    )


def _require_folder(found: RecordingFiles, row: Row) -> None:
    if not found.folder.is_dir():
        raise InputFileError(
            found.folder,
            "",
            expected=f"the folder of {row.segment.scene}/{row.segment.sequence}",
            found="no such folder",
            remedy="Unpack or download this sequence.",
        )


def _body(found: RecordingFiles, manifest: Manifest, options: GimoOptions) -> gimo.LocalJoints | gimo.LocalSkeleton:
    """Joints by the first way that is open."""
    poses, meshes = (segments.frames_of(found, role) for role in (segments.POSE, segments.MESH))
    skeleton = found.path(segments.SKELETON)
    lacking: dict[Route, str] = {}
    for route in options.routes():
        lacking[route] = _lacking(route, options, has_poses=bool(poses), has_meshes=bool(meshes), skeleton=skeleton)
        if lacking[route]:
            continue
        if route == "mesh":
            return joints_from_meshes(
                meshes,
                read_smplx_model(_given(options.smplx_model)),
                largest_edge_error=manifest.thresholds["largest_mesh_edge_error"],
                largest_spread=manifest.thresholds["largest_mesh_vertex_spread"],
            )
        parameters = read_poses(poses)
        if route == "smplx":
            decoder = read_pose_decoder(_given(options.vposer_model))
            model = read_smplx_model(_given(options.smplx_model))
            return joints_from_parameters(parameters, decoder, model)
        return gimo.LocalSkeleton(read_bvh(_given(skeleton)), parameters)
    raise InputFileError(
        found.folder,
        "",
        expected="a way to the joints: smplx, mesh or bvh",
        found="; ".join(f"{route} lacks {what}" for route, what in _all_lacking(found, options, lacking).items()),
        remedy=f"VPoser v1: {VPOSER_PAGE}; SMPL-X neutral: {SMPLX_PAGE} (options vposer_model and smplx_model).",
    )


def _lacking(route: Route, options: GimoOptions, *, has_poses: bool, has_meshes: bool, skeleton: Path | None) -> str:
    """Name what a way to the joints lacks; empty if nothing."""
    files = f"{gimo.POSE_FOLDER}/<frame>"
    parts = {
        "smplx": {"--option vposer_model": options.vposer_model, "--option smplx_model": options.smplx_model},
        "mesh": {"--option smplx_model": options.smplx_model},
        "bvh": {gimo.SKELETON_FILE: skeleton},
    }[route]
    missing = [name for name, value in parts.items() if value is None]
    missing += [f"{files}.pkl"] if route != "mesh" and not has_poses else []
    missing += [f"{files}.obj"] if route == "mesh" and not has_meshes else []
    return " and ".join(missing)


def _given(path: Path | None) -> Path:
    assert path is not None, "the way was found to be open"
    return path


def _all_lacking(found: RecordingFiles, options: GimoOptions, known: dict[Route, str]) -> dict[Route, str]:
    """The same for the ways that the options leave out, so that the message tells about all three."""
    routes: tuple[Route, ...] = ("smplx", "mesh", "bvh") if options.body == "auto" else (options.body,)
    has_poses = bool(segments.frames_of(found, segments.POSE))
    has_meshes = any((found.folder / gimo.POSE_FOLDER).glob("*.obj"))
    return {
        route: known.get(route)
        or _lacking(route, options, has_poses=has_poses, has_meshes=has_meshes, skeleton=found.path(segments.SKELETON))
        for route in routes
    }


def _hololens(found: RecordingFiles) -> gimo.HoloLens | None:
    stream, video, transform = (
        found.path(role) for role in (segments.STREAM, segments.VIDEO, segments.HOLOLENS_TRANSFORM)
    )
    if stream is None or video is None or transform is None:
        return None
    return read_hololens(stream, video, transform)


def _meshes(found: RecordingFiles) -> tuple[gimo.SceneMesh, ...]:
    """The scanned room as triangles; none where the copy lacks it, which curation reports.

    Raises:
        InputFileError: if the mesh cannot be read, or has points only.
    """
    path = found.path(segments.SCENE_MESH)
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
    names = [
        name for folder in (gimo.POSE_FOLDER, gimo.GAZE_FOLDER) for name in segments.unnumbered(found.folder / folder)
    ]
    shown = ", ".join(names[:3]) + (" …" if len(names) > 3 else "")
    return (f"{len(names)} files without frame number left out: {shown}",) if names else ()
