"""Plain recordings out of what other programs write: Project Aria's services, rerun, tables of any column names."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from prbench.errors import MissingExtraError, UsageError, did_you_mean
from prbench.files.bounded import foreign_input, require
from prbench.files.storage import sole_writer
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP
from prbench.readers import reader_for
from prbench.readers.aria_mps.files import find_mps_files, read_mps
from prbench.readers.aria_mps.to_recording import mps_streams
from prbench.readers.found import RecordingFiles
from prbench.readers.own import format as own
from prbench.readers.own.files import read_cells, read_names
from prbench.readers.own.write import write_recording

Tables = dict[str, dict[str, np.ndarray]]
_METRES = own.Units(length="m", time="s")
# Entities of rerun that hold a table: what they are called, and the components of which they have one.
_POSITIONS = {"Translation3D", "PoseTranslation3D", "Position3D"}
_ENTITIES: Mapping[str, tuple[str, set[str]]] = {
    "head": (r"head|glasses|cpf", {"Translation3D"}),
    "gaze": (r"gaze", {"Vector3D", "LineStrip3D"}),
    "left": (r"left.*(wrist|hand)", _POSITIONS),
    "right": (r"right.*(wrist|hand)", _POSITIONS),
    "body": (r"body|joints|skeleton", {"Position3D"}),
}


@dataclass(frozen=True)
class Converted:
    """A plain recording that was written.

    Attributes:
        out: Its folder.
        rows: Number of rows of each table.
        remarks: What the converter and the reader say of it.
    """

    out: Path
    rows: dict[str, int]
    remarks: tuple[str, ...]


def convert(
    kind: str, source: Path | None, out: Path, files: Mapping[str, Path], named: Mapping[str, str], about: own.About
) -> Converted:
    """Write a plain recording and read it back, so that what is wrong with it is said at once.

    Args:
        kind: ``csv``, ``aria`` or ``rerun``.
        source: What Project Aria's services or rerun wrote; None for ``csv``.
        out: Folder of the recording.
        files: Tables of ``csv`` (:func:`tables_of_files`).
        named: Their columns, or the entities of rerun (:func:`tables_of_rerun`).
        about: Units and axes of ``csv``, axes of rerun; a participant of no name is called after the folder.

    Raises:
        UsageError: for a table without a column that it needs.
        InputFileError: for files that cannot be read, and rows that no recording has.
        StorageError: if the folder cannot be written.
    """
    if (source is None) != (kind == "csv"):
        raise UsageError("aria and rerun need SOURCE; csv has none, but --head FILE, --gaze FILE and so on.")
    remarks: tuple[str, ...] = ()
    about = msgspec.structs.replace(about, participant=about.participant or out.name)
    if source is None:
        tables = tables_of_files(files, named)
    elif kind == "aria":
        tables, remarks = tables_of_aria(source)
        about = msgspec.structs.replace(about, units=_METRES, axes=own.Axes(up="y"))
    else:
        tables, about, remarks = tables_of_rerun(source, named, about)
    with sole_writer(out):
        write_recording(out, about, tables)
    reader = reader_for("own")
    recording = reader.read(reader.find(out)[0])
    rows = {name: len(next(iter(columns.values()))) for name, columns in tables.items()}
    return Converted(out, rows, (*remarks, *recording.remarks))


@foreign_input()
def tables_of_files(files: Mapping[str, Path], renamed: Mapping[str, str]) -> Tables:
    """Read tables whose columns have other names than those of a plain recording.

    Args:
        files: CSV or Parquet file of each table, by the table's name.
        renamed: Maps a column, such as ``time``, to its name in the files; ``gaze.time`` is that of one table.

    Raises:
        UsageError: for a column that no table has.
        InputFileError: for a cell of the wrong kind, naming file and line.
    """
    headers = {name: read_names(path) for name, path in files.items()}
    wanted: dict[str, dict[str, str]] = {name: {} for name in files}
    used = set()
    for name, header in headers.items():
        for ours in header if name == "body" else itertools.chain(*own.TABLES[name]):
            key = f"{name}.{ours}" if f"{name}.{ours}" in renamed else ours
            if renamed.get(key, ours) in header:
                wanted[name][ours] = renamed.get(key, ours)
                used.add(key)
    for key in sorted(set(renamed) - used):
        near = did_you_mean(renamed[key], itertools.chain(*headers.values()))
        told = f"--column {key}={renamed[key]}: expected a column of a plain recording and one of the files."
        raise UsageError(f"{told}{near}")
    tables: Tables = {}
    for name, path in files.items():
        missing = next((ours for ours in own.TABLES[name][0] if ours not in wanted[name]), "")
        near = f"Name yours with --column {missing}=…{did_you_mean(missing, headers[name])}"
        found = f"the columns {', '.join(headers[name])}"
        require(path, (not missing, "header", f"a column '{missing}'", found, near))
        texts = {theirs for ours, theirs in wanted[name].items() if ours in own.TEXTS}
        cells = read_cells(path, [*wanted[name].values()], texts)
        tables[name] = {ours: cells[theirs] for ours, theirs in wanted[name].items()}
    return tables


@foreign_input()
def tables_of_aria(folder: Path) -> tuple[Tables, tuple[str, ...]]:
    """Read any output of Project Aria's Machine Perception Services: head (central pupil frame), gaze and wrists.

    Args:
        folder: Outputs of one recording, or a zip archive of them.

    Returns:
        The tables, Y up, metres, seconds on the glasses' clock; and remarks.

    Raises:
        InputFileError: if trajectory or gaze is missing, damaged, or reported as an ERROR.
    """
    found = RecordingFiles("own", folder.name, folder, find_mps_files(folder))
    streams = mps_streams(read_mps(found), world_from_source=Y_UP_FROM_Z_UP)
    head = streams.head
    gaze = streams.gaze
    # Nothing was measured where a stream is not valid: such rows are left out.
    groups = {own.POINT: head.position[head.valid], own.QUATERNION: head.rotation[head.valid]}
    tables = {"head": _table(head.times[head.valid], groups)}
    groups = {own.GAZE: gaze.direction[gaze.valid], own.ORIGIN: gaze.origin[gaze.valid]}
    tables["gaze"] = _table(gaze.times[gaze.valid], groups)
    hands = [
        _table(one.times[one.valid], {own.POINT: one.points[one.valid, 0]}, side=one.side) for one in streams.wrists
    ]
    return tables | ({"wrists": _joined(hands)} if hands else {}), streams.messages


def _table(times: np.ndarray, groups: Mapping[tuple[str, ...], np.ndarray], **texts: str) -> dict[str, np.ndarray]:
    """Return the measured rows of a table by column: times, each array under its names, and one text in all rows."""
    rows = np.isfinite(np.hstack(list(groups.values()))).all(axis=1)
    columns = {"time": times[rows]}
    for names, values in groups.items():
        columns |= dict(zip(names, values[rows].T, strict=True))
    return columns | {name: np.full(int(rows.sum()), text) for name, text in texts.items()}


def _joined(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return tables one below the other, with the columns that all have."""
    shared = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in shared}


def _first(rows: list[Any], width: int) -> np.ndarray:
    """Return the first of the values that each row lists, NaN where there is none."""
    return np.array([row[0] if row else [np.nan] * width for row in rows], dtype=np.float64).reshape(-1, width)


@foreign_input()
def tables_of_rerun(
    path: Path, named: Mapping[str, str], about: own.About
) -> tuple[Tables, own.About, tuple[str, ...]]:
    """Read head, gaze, wrists, body and boxes of a recording of rerun (extra ``rerun``).

    Args:
        path: The ``.rrd``.
        named: Entity of the ``head``, ``gaze``, ``left`` and ``right`` wrist, and ``body``; what is not named is looked
            for by name and components. ``timeline`` is one of times, by default the first that rerun does not make
            itself. Every other entity with a box is an object.
        about: Axes, where the recording does not say which one points up.

    Returns:
        The tables, their units and axes, and which entity became what. Gaze is that of the head's own frame where its
        entity lies below that of the head.

    Raises:
        MissingExtraError: if rerun-sdk is not installed.
        InputFileError: if there is no such timeline or entity, or none that can be read, listing those that there are.
    """
    try:
        from rerun import dataframe
    except ModuleNotFoundError as error:
        raise MissingExtraError("rerun-sdk", "rerun", "reading a recording of rerun") from error
    recording = dataframe.load_recording(path)
    columns = recording.view(index="log_time", contents="/**").select().schema
    clocks = [each.name for each in columns if ":" not in each.name and pa.types.is_temporal(each.type)]
    clock = named.get("timeline") or next((name for name in clocks if name != "log_time"), "log_time")
    require(path, (clock in clocks, "", f"a timeline '{clock}' of times", ", ".join(clocks), ""))
    parts: dict[str, set[str]] = {}
    components = recording.schema().component_columns()
    moving = {each.entity_path for each in components if not each.is_static}
    for each in components:
        component = each.component_name.rpartition(".")[2]
        if not component.endswith("Indicator"):
            parts.setdefault(each.entity_path, set()).add(component)

    # Which entity is what: those that are named, else of those that fit the one with the shortest path.
    chosen = {f"/{entity.strip('/')}": name for name, entity in named.items() if name != "timeline"}
    for name, (pattern, needed) in _ENTITIES.items():
        fitting = [each for each in parts if re.search(pattern, each, re.IGNORECASE) and needed & parts[each]]
        if fitting and name not in chosen.values():
            chosen.setdefault(min(fitting, key=len), name)
    chosen |= {each: "object" for each in parts if "HalfSize3D" in parts[each] and each not in chosen}
    listing = "; ".join(f"{each} ({', '.join(sorted(found))})" for each, found in sorted(parts.items()))
    listing = f"Name entities with --column. There are: {listing}."
    require(path, (chosen, "", "head, gaze, wrists, body or boxes", "none that is found by name", listing))
    tables: Tables = {}
    hands = []
    objects = []
    poses = []
    for entity, name in chosen.items():
        needed = _ENTITIES.get(name, ("", _POSITIONS))[1]
        wanted = f"{entity} with {' or '.join(sorted(needed))}"
        require(path, (needed & parts.get(entity, set()), name, wanted, "none", listing))
        view = recording.view(index=clock, contents=entity)
        rows = (view.select() if entity in moving else view.select_static()).read_all()
        times = rows[clock].cast(pa.int64()).to_numpy() / 1e9 if entity in moving else np.zeros(1)
        values = {each.rpartition(":")[2]: rows[each].to_pylist() for each in rows.column_names if ":" in each}
        groups: dict[tuple[str, ...], np.ndarray] = {}
        if name == "gaze":
            lines = [row[0] if row else [[np.nan] * 3] for row in values.get("LineStrip3D", ())]
            if lines:
                groups[own.ORIGIN] = np.array([line[0] for line in lines])
                direction = np.array([line[-1] for line in lines]) - groups[own.ORIGIN]
            else:
                groups |= {own.ORIGIN: _first(values["Position3D"], 3)} if "Position3D" in values else {}
                direction = _first(values["Vector3D"], 3)
            length = np.linalg.norm(direction, axis=1, keepdims=True)
            groups[own.GAZE] = direction / np.where(length > 0, length, np.nan)
        elif name == "body":
            joints = own.body_columns(about)
            empty = np.full(len(joints), np.nan)
            whole = [row if row and 3 * len(row) == len(joints) else empty for row in values["Position3D"]]
            groups[joints] = np.array([np.ravel(row) for row in whole]).reshape(-1, len(joints))
        else:
            groups[own.POINT] = next(_first(values[part], 3) for part in sorted(needed)[::-1] if part in values)
            if "RotationQuat" in values:  # x y z w
                groups[own.QUATERNION] = _first(values["RotationQuat"], 4)[:, [3, 0, 1, 2]]
            elif "TransformMat3x3" in values:  # column by column
                matrices = _first(values["TransformMat3x3"], 9).reshape(-1, 3, 3).transpose(0, 2, 1)
                groups[own.QUATERNION] = Rotation.from_matrix(matrices).as_quat(scalar_first=True)
            elif "RotationAxisAngle" in values:
                vectors = [np.multiply(row[0]["axis"], row[0]["angle"]) for row in values["RotationAxisAngle"]]
                groups[own.QUATERNION] = Rotation.from_rotvec(np.array(vectors)).as_quat(scalar_first=True)
        if name == "object":
            key = entity.strip("/").replace("/", ".")
            half = _first(values["HalfSize3D"], 3)[0]
            objects.append((key, key.rpartition(".")[2], *-half, *half))
            groups.setdefault(own.QUATERNION, np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1)))
            poses.append(_table(times, groups, object_id=key))
        elif name in ("left", "right"):
            hands.append(_table(times, groups, side=name))
        else:
            tables[name] = _table(times, groups)
    if hands:
        tables["wrists"] = _joined(hands)
    if objects:
        tables["objects"] = dict(zip(("object_id", "name", *own.BOX), map(np.array, zip(*objects)), strict=True))
        tables["object_poses"] = _joined(poses)
    axes = about.axes
    if "ViewCoordinates" in parts.get("/", ()):
        codes = recording.view(index=clock, contents="/").select_static().read_all()["/:ViewCoordinates"].to_pylist()
        axis_of: dict[int, Any] = dict(zip(np.ravel(codes[0]).tolist(), "xyz"))  # 1 is up, 2 down
        axes = own.Axes(up=axis_of.get(1) or "-" + axis_of[2])
    entity_of = {name: entity for entity, name in chosen.items()}
    is_below = entity_of.get("gaze", "").startswith(f"{entity_of.get('head', '-')}/")
    gaze = own.GazeFrame(frame="head" if is_below else "world")
    about = msgspec.structs.replace(about, units=_METRES, axes=axes, gaze=gaze)
    return tables, about, tuple(f"{name}: entity {entity}" for entity, name in chosen.items())
