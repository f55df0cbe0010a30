"""Write sequence tables in the layout of the authors' release, for others' tools and for our importer.

Beyond the layout it writes the ``prbench`` block of each entry and the arrays of ``further/``.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

import prbench
from prbench.errors import UsageError
from prbench.files.locks import sole_writer
from prbench.files.storage import atomic_folder, inside, require_replaceable, write_json
from prbench.geometry.skeleton import transform_points
from prbench.release.block import Block, pack_arrays
from prbench.release.known import folder_of
from prbench.release.layout import EXPORT_RECORD, FURTHER, GAZES, MOTIONS, TARGETS
from prbench.sequences import DatasetInfo, SequenceChunk, SequenceTable
from prbench.sequences.redistribution import NOTICE_FILE, notice, require_may_pass_on

Frame = Literal["canonical", "world"]


@dataclass(frozen=True)
class ExportReport:
    """The folder that was written for one table."""

    dataset: str
    folder: Path
    sequences: int
    notice: str


def export_release(
    tables: Sequence[Path | str], out: Path | str, *, permitted: Collection[str] = (), frame: Frame = "canonical"
) -> tuple[ExportReport, ...]:
    """Write tables as a release: ``out/<DATASET>/motions``, ``gazes`` and ``target_information.json``.

    Args:
        tables: Dataset folders, of different datasets.
        out: The release; a dataset's folder that an earlier export wrote is replaced, anything else is not touched.
        permitted: Datasets whose licence keeps recorded motion, but for which the user has permission.
        frame: Frame of motions, goals and gazes: the canonical frame of each sequence, or the world of its recording
            (whose float32 positions are coarser, about 1 µm at 10 m).

    Raises:
        RedistributionError: if a licence forbids it; nothing is written then.
        UsageError: for two tables of one dataset.
        TableError: if a table is missing or damaged.
        StorageError: if ``out`` cannot be written or holds something else.
    """
    out = Path(out)
    opened = [SequenceTable.open(folder).with_sequences() for folder in tables]
    names = [folder_of(table.info.dataset) for table in opened]
    folders = [inside(out, name) for name in names]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"two tables are of {name}; a release has one folder a dataset.")
    for table, folder in zip(opened, folders):
        # All tables are checked before the first is written: a refusal leaves nothing behind.
        require_may_pass_on(table.info, "a release", permitted)
        require_replaceable(folder, EXPORT_RECORD, kind="export")
    return tuple(_export(table, folder, permitted, frame) for table, folder in zip(opened, folders))


def _export(table: SequenceTable, folder: Path, permitted: Collection[str], frame: Frame) -> ExportReport:
    said = notice(table.info, permitted)
    with sole_writer(folder), atomic_folder(folder) as temporary:
        for name in (MOTIONS, GAZES, FURTHER):
            (temporary / name).mkdir()
        count = 0
        with open(temporary / TARGETS, "w", encoding="utf-8", newline="\n") as file:
            for count, (key, entry) in enumerate(_written(table, temporary, frame), 1):
                # One entry a line, written as it comes: the file of a large table never stands in memory.
                line = json.dumps(entry, ensure_ascii=False, allow_nan=False)
                file.write(f"{'{' if count == 1 else ','}\n{json.dumps(key)}: {line}")
            file.write("\n}\n")
        write_json(temporary / EXPORT_RECORD, _record(table, permitted, frame))
        if said:
            text = f"{said}\n\nLicence: {table.info.licence}\n{table.info.homepage}\n\n{table.info.citation}\n"
            (temporary / NOTICE_FILE).write_text(text, encoding="utf-8")
    return ExportReport(table.info.dataset, folder, count, said)


def _written(table: SequenceTable, folder: Path, frame: Frame) -> Iterator[tuple[str, dict[str, Any]]]:
    """Write the arrays of every sequence and yield its entry."""
    events = table.events().select(["sequence_id", "event_id"])
    event_of = dict(zip(events["sequence_id"].to_pylist(), events["event_id"].to_pylist()))
    index = 0
    for chunk in table.chunks(rows=64):
        for row in range(len(chunk)):
            key = f"{index:010d}"
            sequence = _Row(chunk.take([row]), table.info, frame)
            sequence.write_arrays(folder, key)
            yield key, sequence.entry(event_of.get(sequence.text("sequence_id")))
            index += 1


@dataclass(frozen=True)
class _Row:
    """One sequence as the table has it."""

    chunk: SequenceChunk
    info: DatasetInfo
    frame: Frame

    def text(self, name: str) -> str:
        return self.chunk.strings(name)[0]

    def number(self, name: str) -> float:
        return float(self.chunk.numbers(name)[0])

    @property
    def world_from_canonical(self) -> np.ndarray:
        return self.chunk.vectors("world_from_canonical").reshape(4, 4)

    @property
    def written_from_canonical(self) -> np.ndarray:
        return self.world_from_canonical if self.frame == "world" else np.eye(4)

    def write_arrays(self, folder: Path, key: str) -> None:
        """Write motions, gazes (NaN where invalid), and the further arrays (always canonical)."""
        joints = self.chunk.joints
        gaze = self.chunk.frames("gaze_direction")
        valid = np.asarray(self.chunk.frames("gaze_valid"), dtype=bool)
        # The layout has no column of validity, so NaN has to say it.
        directions = np.where(valid[:, None], gaze, np.float32(np.nan))
        if self.frame == "world":
            # Directions turn with the frame and do not move with it.
            turn = self.world_from_canonical.copy()
            turn[:3, 3] = 0.0
            # In float64 and rounded once at the end: far from the origin float32 is coarse.
            joints = transform_points(self.world_from_canonical, joints.astype(np.float64))
            directions = transform_points(turn, directions.astype(np.float64))
        for name, values in ((MOTIONS, joints), (GAZES, directions)):
            single = np.ascontiguousarray(values, dtype=np.float32)
            np.save(folder / name / f"{key}.npy", single, allow_pickle=False)
        further = {
            "previous_joints": self.chunk.poses("previous_joints")[0],
            "next_joints": self.chunk.poses("next_joints")[0],
            "gaze_origin": self.chunk.frames("gaze_origin"),
            "gaze_direction": gaze,
            "gaze_valid": valid,
        }
        if self.chunk.batch.column("head_position")[0].is_valid:
            further |= {name: self.chunk.frames(name) for name in ("head_position", "head_rotation")}
        (folder / FURTHER / f"{key}.npz").write_bytes(pack_arrays(further))

    def entry(self, event_id: str | None) -> dict[str, Any]:
        """Return the layout's fields and the prbench block."""
        goal = transform_points(self.written_from_canonical, self.chunk.vectors("goal_location")[0])
        hand = self.text("hand") or None
        n_frames = int(self.chunk.n_frames[0])
        box = [self.chunk.vectors(name)[0].tolist() for name in ("goal_box_world_min", "goal_box_world_max")]
        fields = {
            "goal_location": goal.tolist(),
            "text_prompt": self.text("text"),
            "subset": self.text("split"),
            "primed_frame": int(self.number("prime_frame")),
            "action": self.text("action"),
            "fps": self.number("fps"),
            "source": self.text("recording_id"),
            "event_frame": n_frames - 1,
            "units": "m",
            "up": "y",
        }
        if hand is not None:
            fields["hand"] = hand
        if self.frame == "world" or (self.world_from_canonical == np.eye(4)).all():
            fields["object_box"] = box  # world-aligned: in a frame that is turned it would be no box
        return fields | {"prbench": msgspec.to_builtins(self._block(event_id, hand, n_frames, box))}

    def _block(self, event_id: str | None, hand: str | None, n_frames: int, box: list[list[float]]) -> Block:
        names = ("sequence_id", "recording_id", "participant_id", "split_group", "action", "object_id", "object_name",
                 "text", "prime_kind", "pose_source", "previous_source", "next_source")  # fmt: skip
        numbers = ("start_time", "prime_time", "event_time", "prime_gap", "preroll", "body_movement", "hand_movement",
                   "head_tilt_deg")  # fmt: skip
        uncertainty = self.number("prime_time_uncertainty")
        pairs = self.chunk.batch.column("extra")[0].as_py()
        values: dict[str, Any] = {name: self.text(name) for name in names} | {n: self.number(n) for n in numbers}
        return Block(
            **values,
            event_id=event_id or self.text("sequence_id").rsplit("/", 1)[0],
            hand=hand,
            n_frames=n_frames,
            prime_time_uncertainty=None if np.isnan(uncertainty) else uncertainty,
            goal_box_world_min=(box[0][0], box[0][1], box[0][2]),
            goal_box_world_max=(box[1][0], box[1][1], box[1][2]),
            world_from_canonical=tuple(self.world_from_canonical.ravel().tolist()),
            motion_frame=self.frame,
            goal_frame="known" if self.info.why_not_scored is None else "unknown",
            extra={pair["key"]: pair["value"] for pair in pairs},
        )


def _record(table: SequenceTable, permitted: Collection[str], frame: Frame) -> dict[str, Any]:
    """Return the record of the exported table and its terms."""
    info = table.info
    return {
        "written_by": f"prbench {prbench.__version__}",
        "dataset": info.dataset,
        "title": info.title,
        "licence": info.licence,
        "redistribution": info.redistribution,
        "permission_stated": info.dataset in permitted,
        "homepage": info.homepage,
        "citation": info.citation,
        "frame": frame,
        "identity_digest": info.identity_digest,
        "content_digest": info.content_digest,
    }
