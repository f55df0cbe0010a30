"""Recordings of other layouts written as plain recordings, in any units and axes: an oracle without the reader."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.curation.job import native_sources
from prbench.curation.options import BuildOptions
from prbench.readers.own import format as own
from prbench.readers.own.write import write_recording
from prbench.recording import Recording
from prbench.synthetic.write_tree import synthesize_tree
from tests.shared import made_once

METRES = own.About(participant="p01", units=own.Units(length="m", time="s"), axes=own.Axes(up="y"))


TREES = ("adt", "hd-epic", "mogaze")


def tree(layout: str) -> Path:
    """Return a folder with one synthetic recording in the files of a layout."""
    return made_once(f"plain-{layout}", lambda path: synthesize_tree(layout, path, recordings=1, seed=3))


@cache
def recording_of(layout: str) -> Recording:
    """Return that recording as the layout's reader reads it."""
    return native_sources(layout, tree(layout), BuildOptions())[0].read()


def write_plain(
    folder: Path, recording: Recording, about: own.About = METRES, *, without: tuple[str, ...] = (), **settings: Any
) -> Path:
    """Write a recording in the world that ``about`` states; returns the folder of recordings."""
    tables = {name: rows for name, rows in plain_tables(recording, about).items() if name not in without}
    write_recording(folder / "one", about, tables, **settings)
    return folder


def write_short(folder: Path) -> Path:
    """Write the first three seconds of a recording with every table, as CSV in metres and seconds."""
    tables = plain_tables(recording_of("mogaze"), METRES)
    for name, rows in tables.items():
        if "time" in rows and name != "events":
            early = np.asarray(rows["time"]) < 3.0
            tables[name] = {column: np.asarray(values)[early] for column, values in rows.items()}
    tables["events"] = {column: values[:1] for column, values in tables["events"].items()} | {"time": [2.0]}
    write_recording(folder / "one", METRES, tables, suffix=".csv")
    return folder


def plain_tables(recording: Recording, about: own.About) -> dict[str, dict[str, Any]]:
    """Return the tables of a recording in another world: only signs and columns change, no matrix is needed."""
    length = {"m": 1.0, "cm": 100.0, "mm": 1000.0}[about.units.length]
    time = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[about.units.time]
    left = about.axes.handed == "left"

    def world(vectors: np.ndarray) -> np.ndarray:
        """Undo: z up -> y up is (x, z, -y), and a mirror negates x last."""
        x, y, z = np.moveaxis(vectors, -1, 0)
        x = -x if left else x
        return np.stack([x, y, z] if about.axes.up == "y" else [x, -z, y], axis=-1)

    def local(vectors: np.ndarray) -> np.ndarray:
        return vectors * [-1, 1, 1] if left else vectors

    def turned(quaternions: np.ndarray) -> np.ndarray:
        """Return the world's rotation of the same body, whose own axes are mirrored with the world."""
        images = [world(Rotation.from_quat(quaternions, scalar_first=True).apply(local(axis))) for axis in np.eye(3)]
        return Rotation.from_matrix(np.stack(images, axis=-1)).as_quat(scalar_first=True)

    def masked(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
        return np.where(valid[:, None], values, np.nan)

    def pose(stream: Any, **ids: Any) -> dict[str, Any]:
        place = dict(zip(own.POINT, masked(world(stream.position) * length, stream.valid).T))
        order = ["w", "x", "y", "z"] if about.axes.quaternion == "wxyz" else ["x", "y", "z", "w"]
        columns = dict(zip("wxyz", masked(turned(stream.rotation), stream.valid).T))
        return {"time": stream.times * time, **ids, **place, **{f"q{name}": columns[name] for name in order}}

    tables: dict[str, dict[str, Any]] = {}
    if len(recording.head.times):
        tables["head"] = pose(recording.head)
    gaze = recording.gaze
    if len(gaze.times):
        directions, origins = gaze.direction, gaze.origin
        if about.gaze.frame == "head":
            position, rotation = recording.head.pose_at(gaze.times)
            back = Rotation.from_quat(rotation, scalar_first=True).inv()
            directions, origins = local(back.apply(directions)), local(back.apply(origins - position)) * length
        else:
            directions, origins = world(directions), world(origins) * length
        names = (("dx", "dy", "dz"), ("ox", "oy", "oz"))
        cells = [dict(zip(each, masked(values, gaze.valid).T)) for each, values in zip(names, (directions, origins))]
        tables["gaze"] = {"time": gaze.times * time, **cells[0], **cells[1]}
    if recording.body is not None:
        body = recording.body
        joints = (world(body.joints) * length).reshape(len(body.times), -1)
        names = own.body_columns(about)
        tables["body"] = {"time": body.times * time, **dict(zip(names, masked(joints, body.valid).T))}
    wrists = [hand for hand in recording.hands if hand.contact == "wrist"]
    if wrists:
        parts = [(hand.times * time, [hand.side] * len(hand.times),
                  masked(world(hand.points[:, 0]) * length, hand.valid)) for hand in wrists]  # fmt: skip
        times, sides, points = (np.concatenate(part) for part in zip(*parts))
        tables["wrists"] = {"time": times, "side": sides, **dict(zip(own.POINT, points.T))}
    if recording.objects:
        poses = [pose(track, object_id=[track.object_id] * len(track.times)) for track in recording.objects]
        tables["object_poses"] = {name: np.concatenate([each[name] for each in poses]) for name in poses[0]}
        rows = [(track.object_id, track.name, track.category, track.movable,
                 *np.sort([local(track.box_min) * length, local(track.box_max) * length], axis=0).ravel())
                for track in recording.objects]  # fmt: skip
        tables["objects"] = dict(zip(("object_id", "name", "category", "movable", *own.BOX), zip(*rows)))
    if recording.annotated_events:
        rows = []
        for event in recording.annotated_events:
            nothing = np.full(3, np.nan)
            place = nothing if event.location is None else world(event.location) * length
            box = [nothing, nothing]
            if event.box_min is not None and event.box_max is not None:
                box = np.sort([world(event.box_min) * length, world(event.box_max) * length], axis=0)
            rows.append((event.event_time * time, event.action, event.object_id, *place, *np.ravel(box), event.hand))
        tables["events"] = dict(zip(("time", "action", "object", *own.POINT, *own.BOX, "hand"), zip(*rows)))
    return tables
