"""Find and read the files of GIMO segments (docs/specification/gimo.md#folder-tree)."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Literal

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.files.bounded import require
from prbench.files.storage import inside
from prbench.readers import ReaderOptions, read_synthetic_tree
from prbench.readers import found as listing
from prbench.readers.extents import ONE_SYSTEM, SEVERAL_SENSORS, Extent
from prbench.readers.gimo import bodies
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo import table as tables
from prbench.readers.gimo.bvh import read_bvh
from prbench.readers.gimo.gaze import read_gaze, read_transform
from prbench.recording import Recording


class GimoOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of the GIMO reader.

    Attributes:
        events: Table of pick events (``docs/gimo-events.md``); ``prbench_events.csv`` at the root if None.
        hints: Take the hint of ``dataset.csv`` as event frame where the table of events does not name a segment.
        training_2: Use of the segments that the official loader never uses: train on them, or leave them out.
        body: Source of joints: fitted parameters, or the suit's skeleton; auto = parameters where both models are
            given.
        vposer_model: Snapshot of VPoser v1 (``TR00_E096.pt``), for body smplx.
        smplx_model: ``SMPLX_NEUTRAL.npz``, for body smplx.
    """

    events: Path | None = None
    hints: bool = True
    training_2: Literal["train", "drop"] = "train"
    body: Literal["auto", "smplx", "bvh"] = "auto"
    vposer_model: Path | None = None
    smplx_model: Path | None = None

    @property
    def route(self) -> Literal["smplx", "bvh"]:
        """Return the way to the joints that these options choose."""
        if self.body != "auto":
            return self.body
        return "smplx" if self.vposer_model and self.smplx_model else "bvh"


TABLE = "table"
EVENTS = "events"
TRANSFORM = "transform"
NORM = "norm"
SKELETON = "skeleton"
# Beginnings of the roles of files of one frame; the frame number follows.
POSE = "pose:"
CONE = "gaze:"
CENTRE = "gaze centre:"


def find_segments(root: Path | str, options: GimoOptions) -> tuple[listing.RecordingFiles, ...]:
    """Find every segment of ``dataset.csv`` with its files; those that cannot be built carry the reason.

    Raises:
        InputFileError: if there is no readable ``dataset.csv``, none of its sequences is there (listing them), or the
            table of events is damaged or has an event in both splits.
    """
    root = listing.existing_folder(root, "a folder of GIMO")
    table_path = root / gimo.TABLE_FILE
    remedy = f"Give the folder that holds {gimo.TABLE_FILE} and the folders of the scenes."
    require(table_path, (table_path.is_file(), "", "this file", f"{listing.names_in(root)} in its place", remedy))
    rows, unreadable = tables.read_segments(table_path)
    events_path = root / gimo.EVENTS_FILE if options.events is None else options.events.expanduser()
    remedy = "Correct the option, or make the table: `prbench build-dataset gimo --propose-events FILE` proposes one."
    is_given = options.events is None or events_path.is_file()
    require(events_path, (is_given, "", "the table of events that the option names", "no such file", remedy))
    table = _events_in(events_path)
    tables.require_one_split(events_path, rows, table)
    tree = read_synthetic_tree(root)
    unreadable += tables.lines_of_no_segment(events_path, rows, table)
    in_both = tables.hints_in_both_splits(rows)
    by_frame = cache(_by_frame)  # the files of one sequence are listed once for all its segments
    dataset = "gimo" if tree is None else f"{SYNTHETIC_PREFIX}gimo"
    # A line that cannot be read is listed in place of its recording, and skipped with what is wrong.
    found = []
    for entry in unreadable:
        name = f"{entry.file}-{entry.key.partition(',')[0].replace(' ', '-')}"
        found.append(listing.RecordingFiles(dataset, name, root / entry.file, (), skip_reason=str(entry)))
    for row in rows:
        segment = row.segment
        folder = inside(root, f"{segment.scene}/{segment.sequence}")
        events, _, reason = tables.events_of(row, table, hints=options.hints)
        reason = None if reason is None else f"{segment.name}: {reason}"
        if any(event.source == "hint" for event in events) and segment.key in in_both:
            reason = f"its hinted event (frame {segment.hint}) also stands in a segment of the other split"
        if segment.training == gimo.TRAIN_LATER and options.training_2 == "drop":
            reason = "training = 2, left out by the option training_2"
        if not folder.is_dir():
            reason = f"{segment.scene}/{segment.sequence}: its folder is missing; unpack or download it"
        name = segment.sequence if tree is not None and segment.sequence in tree.split else segment.name
        files = listing.FilesOnDemand(partial(_files, root, options, events_path, segment, folder, by_frame))
        split = "test" if segment.training == gimo.TEST else "train"
        found.append(listing.RecordingFiles(dataset, name, folder, files, split, reason))
    names = sorted({f"{row.segment.scene}/{row.segment.sequence}" for row in rows})
    is_there = any(recording.folder.is_dir() for recording in found)
    expected = f"folders of the sequences that {gimo.TABLE_FILE} lists"
    listed = f"none of the {len(names)}: {', '.join(names)}"
    require(root, (is_there, "", expected, listed, "Unpack the scenes beside the table."))
    return tuple(sorted(found, key=lambda recording: recording.recording_id))


# Files of a folder by ending (``.pkl``, ``_center.ply``) and frame.
_Listing = Callable[[Path], dict[str, dict[int, Path]]]


def _events_in(path: Path | None) -> tuple[tables.EventRow, ...]:
    """Return the table of events; an empty one where the user has none."""
    return tables.read_events(path) if path is not None and listing.is_present(path) else ()


def _files(
    root: Path, options: GimoOptions, events_path: Path, segment: gimo.Segment, folder: Path, by_frame: _Listing
) -> list[listing.InputFile]:
    scene = root / segment.scene / gimo.SCENE_FOLDER
    transform = inside(folder, segment.transformation)
    if transform.suffix != ".json":  # some copies of the table leave out the ending
        transform = transform.with_name(f"{transform.name}.json")
    paths = {TABLE: root / gimo.TABLE_FILE, EVENTS: events_path, NORM: scene / gimo.NORM_FILE, TRANSFORM: transform}
    gaze = by_frame(folder / gimo.GAZE_FOLDER)
    kinds = {
        POSE: by_frame(folder / gimo.POSE_FOLDER).get(".pkl", {}),
        CONE: gaze.get(".ply", {}),
        CENTRE: gaze.get(f"{gimo.GAZE_CENTRE_SUFFIX}.ply", {}),
    }
    for role, files in kinds.items():
        wanted = sorted(frame for frame in files if segment.start_frame <= frame <= segment.end_frame)
        paths |= {f"{role}{frame}": files[frame] for frame in wanted}
    if options.body != "smplx":
        paths[SKELETON] = folder / gimo.SKELETON_FILE
    return [listing.input_file(role, path) for role, path in paths.items() if listing.is_present(path)]


def _by_frame(folder: Path) -> dict[str, dict[int, Path]]:
    """Return files by ending (``.pkl``, ``_center.ply``) and frame; names without a whole number are left out."""
    found: dict[str, dict[int, Path]] = {}
    for name in names_of(folder):
        if (stem := _frame_of(name)) is not None:
            files = found.setdefault(name.removeprefix(stem), {})
            # Of "7.pkl" and "07.pkl" always the same one, in whatever order the disk lists them.
            if int(stem) not in files or name > files[int(stem)].name:
                files[int(stem)] = folder / name
    return found


def names_of(folder: Path) -> list[str]:
    """Return the names of all that lies in a folder, in no order; none if there is no such folder."""
    if not folder.is_dir():
        return []
    with os.scandir(folder) as entries:
        return [entry.name for entry in entries]


def _frame_of(name: str) -> str | None:
    """Return the frame number in a file's name; None where none stands in its place."""
    stem, dot, _ = name.rpartition(".")
    number = (stem if dot else name).removesuffix(gimo.GAZE_CENTRE_SUFFIX)
    return number if number.isascii() and number.isdigit() else None


def extents(found: listing.RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """Return the frames that the table promises, and those that have files; nothing is said of what has none at all."""
    segment = row_of(found)[0].segment
    promised = segment.start_frame / gimo.FRAME_RATE, segment.end_frame / gimo.FRAME_RATE
    streams = [Extent("segment", gimo.TABLE_FILE, *promised)]
    # Eyes are lost now and then.
    for role, stream, slack in ((POSE, "body", ONE_SYSTEM), (CENTRE, "gaze", SEVERAL_SENSORS)):
        if files := frames_of(found, role):
            ends = min(files) / gimo.FRAME_RATE, max(files) / gimo.FRAME_RATE
            streams.append(Extent(stream, files[max(files)].name, *ends, tells_span=False, slack=slack))
    return tuple(streams)


def row_of(found: listing.RecordingFiles) -> tuple[tables.Row, tuple[tables.Row, ...]]:
    """Return the row of ``dataset.csv`` that a recording stands for, and all rows.

    Raises:
        InputFileError: if the table has changed since the search.
    """
    path = found.require(TABLE, gimo.TABLE_FILE)
    rows, _ = tables.read_segments(path)
    # Ids under which a row can be known: its own, and in synthetic trees the name of its sequence.
    row = next((row for row in rows if found.recording_id in (row.segment.name, row.segment.sequence)), None)
    if row is None:
        raise InputFileError(path, "", expected=f"the segment {found.recording_id}", found="a table without it")
    return row, rows


def frames_of(found: listing.RecordingFiles, role: str) -> dict[int, Path]:
    """Return the files of one kind by frame."""
    return {int(file.role.removeprefix(role)): file.path for file in found.files if file.role.startswith(role)}


def read_readings(found: listing.RecordingFiles, options: GimoOptions) -> gimo.GimoReadings:
    """Read one segment.

    Raises:
        InputFileError: for a missing or damaged file, and where no way to the joints is open, saying what each needs.
    """
    row, rows = row_of(found)
    expected = f"the folder of {row.segment.scene}/{row.segment.sequence}"
    require(found.folder, (found.folder.is_dir(), "", expected, "no such folder", "Unpack or download this sequence."))
    table = _events_in(found.path(EVENTS))
    events, event_remarks, _ = tables.events_of(row, table, hints=options.hints)
    odd = (event.unreadable for event in table if event.segment == row.segment.key)
    gaze, gaze_remarks = read_gaze(frames_of(found, CONE), frames_of(found, CENTRE))
    overlaps = [f"shares frames with the segment {other.name}" for other in tables.overlapping(rows, row)]
    folders = [found.folder / folder for folder in (gimo.POSE_FOLDER, gimo.GAZE_FOLDER)]
    stray = [name for folder in folders for name in sorted(names_of(folder)) if _frame_of(name) is None]
    shown = ", ".join(stray[:3]) + (" …" if len(stray) > 3 else "")
    unnumbered = [f"{len(stray)} files without frame number left out: {shown}"] if stray else []
    info = found.require(TRANSFORM, row.segment.transformation)
    transform = read_transform(info, found.require(NORM, f"../{gimo.SCENE_FOLDER}/{gimo.NORM_FILE}"))
    body = _body(found, options)
    messages = (*row.remarks, *overlaps, *event_remarks, *unnumbered, *gaze_remarks)
    known = (found.recording_id, row.segment, transform, body, gaze, events)
    return gimo.GimoReadings(*known, messages, tuple(filter(None, odd)))


def _body(found: listing.RecordingFiles, options: GimoOptions) -> gimo.LocalJoints | gimo.LocalSkeleton:
    """Return the joints by the first way that is open."""
    poses = frames_of(found, POSE)
    skeleton = found.path(SKELETON)
    if open_route(found, options) == "bvh":
        assert skeleton is not None
        return gimo.LocalSkeleton(read_bvh(skeleton), bodies.read_poses(poses))
    assert options.smplx_model is not None
    assert options.vposer_model is not None
    rest = bodies.read_rest_joints(options.smplx_model)
    return bodies.joints_from_parameters(bodies.read_poses(poses), bodies.read_pose_decoder(options.vposer_model), rest)


def open_route(found: listing.RecordingFiles, options: GimoOptions) -> str:
    """Return the first way to the joints that is open: ``smplx`` or ``bvh``.

    Raises:
        InputFileError: if none is, saying what each needs.
    """
    poses = frames_of(found, POSE)
    skeleton = found.path(SKELETON)
    pickles = f"{gimo.POSE_FOLDER}/<frame>.pkl"
    models = {"--option vposer_model": options.vposer_model, "--option smplx_model": options.smplx_model}
    needs = {"smplx": {**models, pickles: poses}, "bvh": {gimo.SKELETON_FILE: skeleton, pickles: poses}}
    lacking = {}
    for route in ("smplx", "bvh") if options.body == "auto" else (options.body,):
        lacking[route] = " and ".join(name for name, there in needs[route].items() if not there)
        if not lacking[route]:
            return route
    told = "; ".join(f"{route} lacks {what}" for route, what in lacking.items())
    remedy = f"VPoser v1: {bodies.VPOSER_PAGE}; SMPL-X neutral: {bodies.SMPLX_PAGE}"
    remedy += " (options vposer_model and smplx_model)."
    raise InputFileError(found.folder, "", expected="a way to the joints: smplx or bvh", found=told, remedy=remedy)
