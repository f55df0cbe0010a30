"""A whole synthetic tree on disk: native files, their mark, and the truth beside them.

Sources: docs/specification/synthetic-recordings.md#truth-record,
docs/specification/synthetic-recordings.md#determinism-splits-sizes and
docs/specification/synthetic-recordings.md#native-layouts. Recording i depends on seed, preset and world alone, so
neither the number of recordings nor the number of workers changes a byte of it.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import pyarrow as pa

import prbench
from prbench.engine import engine_for
from prbench.errors import UsageError
from prbench.files.storage import atomic_folder, sole_writer, write_json
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.defects import defect
from prbench.synthetic.layouts import SHARED_PARTS, layout_for
from prbench.synthetic.people import perform
from prbench.synthetic.truth_files import (
    events_table,
    fixations_table,
    joints_table,
    objects_table,
    recordings_table,
    write_truth,
)

SYNTHETIC_FILE = "synthetic.json"
Size = Literal["tiny", "default", "large"]


@dataclass(frozen=True)
class _SizeOfTree:
    """Numbers that belong to one size of a tree."""

    recordings: int
    events: int
    truth_rate: float
    """Frames a second of the joints in the truth record."""


SIZES: dict[str, _SizeOfTree] = {
    "tiny": _SizeOfTree(recordings=2, events=6, truth_rate=30.0),
    "default": _SizeOfTree(recordings=24, events=10, truth_rate=120.0),
}


@dataclass(frozen=True)
class WrittenRecording:
    """Result of writing one recording of a tree."""

    recording_id: str
    """Its name."""
    split: str
    """``train``, ``validation`` or ``test``."""
    duration: float
    """Its length, in seconds."""
    n_events: int
    """Number of picks and puts; in a text-motion layout the number of texts."""
    n_objects: int
    """Number of objects; 0 in a text-motion layout."""


@dataclass(frozen=True)
class WrittenTree:
    """Result of writing a tree."""

    root: Path
    recordings: tuple[WrittenRecording, ...]


def synthesize_tree(
    preset: str,
    out: Path,
    *,
    recordings: int | None = None,
    seed: int = 0,
    size: Size = "tiny",
    workers: int = 1,
    n_events: int | None = None,
    bystander_objects: int | None = None,
    provocations: Mapping[str, float] | None = None,
    noise: float = 1.0,
    defects: Sequence[str] = (),
    estimates: bool = False,
    on_written: Callable[[WrittenRecording], None] | None = None,
) -> WrittenTree:
    """Write native files of synthetic recordings, complete or not at all.

    Args:
        preset: A preset that has native files (``adt``).
        out: Folder of the tree; an older synthetic tree there is replaced.
        recordings: How many; the size's number if None.
        seed: Of the whole tree.
        size: ``tiny`` or ``default``; ``large`` is refused.
        workers: Processes; the bytes do not depend on it.
        n_events: Picks and puts a recording; the size's number if None.
        bystander_objects: Objects that never move; 3 to 12 if None.
        provocations: See :func:`prbench.synthetic.people.perform`.
        noise: Multiplies every sensor error; 0 for ideal sensors.
        defects: Names of defects that are done to the first recording (:mod:`prbench.synthetic.defects`).
        estimates: Write bodies as EgoAllo estimates them, beside the layout's own.
        on_written: Called after each recording, in their order.

    Raises:
        UsageError: for a preset without native files (or without ``estimates``), the size ``large``, or a folder that
            holds something else.
        StorageError: if the disk is full or the folder cannot be written.
    """
    layout = layout_for(preset)
    if estimates and layout.write_estimates is None:
        raise UsageError(f"{preset} has no bodies of its own beside which EgoAllo's estimates could stand.")
    damages = [defect(preset, name) for name in defects]
    amount = _amount(size)
    require_free(out)
    count = planned_recordings(size, recordings)
    with sole_writer(out), atomic_folder(out) as root:
        write_one = partial(
            _write_recording,
            root=root,
            preset=preset,
            seed=seed,
            n_events=amount.events if n_events is None else n_events,
            bystander_objects=bystander_objects,
            provocations=None if provocations is None else dict(provocations),
            noise=noise,
            truth_rate=amount.truth_rate,
            estimates=estimates,
        )
        done: list[_Done] = []
        for result in engine_for(workers).map(write_one, range(count)):
            done.append(result)
            if on_written:
                on_written(result.recording)
        layout.finish(root)
        shutil.rmtree(root / SHARED_PARTS, ignore_errors=True)
        # Damages come after the shared files are written, because some of them change those.
        for damage in damages:
            damage.apply(root, done[0].recording.recording_id)
        for name in ("recordings", "events", "fixations"):
            write_truth(pa.concat_tables([getattr(result, name) for result in done]), root, name)
        splits = {result.recording.recording_id: result.recording.split for result in done}
        write_mark(root, preset, seed, done[0].world, splits)
    return WrittenTree(out, tuple(result.recording for result in done))


def planned_recordings(size: str, recordings: int | None) -> int:
    """Return how many recordings a tree will have.

    Raises:
        UsageError: for less than one, or a size that is not written.
    """
    count = _amount(size).recordings if recordings is None else recordings
    if count < 1:
        raise UsageError(f"a synthetic tree needs at least one recording, {count} were asked for.")
    return count


@dataclass(frozen=True)
class _Done:
    recording: WrittenRecording
    world: str
    recordings: pa.Table
    events: pa.Table
    fixations: pa.Table


def _write_recording(
    index: int,
    *,
    root: Path,
    preset: str,
    seed: int,
    n_events: int,
    bystander_objects: int | None,
    provocations: Mapping[str, float] | None,
    noise: float,
    truth_rate: float,
    estimates: bool,
) -> _Done:
    performance = perform(
        preset,
        seed=seed,
        index=index,
        n_events=n_events,
        bystander_objects=bystander_objects,
        provocations=provocations,
    )
    name = performance.recording_id
    layout = layout_for(preset)
    readings = layout.sense(performance, noise=noise)
    layout.write(readings, root)
    if estimates and layout.write_estimates is not None:
        layout.write_estimates(performance, readings, root, noise=noise)
    write_truth(joints_table(performance, rate=truth_rate), root, "joints", part=name)
    write_truth(objects_table(performance), root, "objects", part=name)
    summary = WrittenRecording(
        name, performance.split, performance.duration, len(performance.events), len(performance.objects)
    )
    return _Done(
        summary,
        performance.world,
        recordings_table(performance, noise=noise),
        events_table(performance),
        fixations_table(performance),
    )


def write_mark(root: Path, preset: str, seed: int, world: str, split: Mapping[str, str]) -> None:
    """Write the mark that tells readers and people that a tree is synthetic, and which recording is in which split."""
    write_json(
        root / SYNTHETIC_FILE,
        {
            "generator": f"prbench {prbench.__version__}",
            "version": GENERATOR_VERSION,
            "seed": seed,
            "preset": preset,
            "world": world,
            "split": dict(split),
        },
    )


def _amount(size: str) -> _SizeOfTree:
    if size == "large":
        raise UsageError(
            "size 'large' (480 recordings a preset) is not written as native files: that would be about 30 GB of text"
            " which nobody needs to read. Take 'tiny' or 'default', with --count N for more; for training data of"
            " that size add --table, which writes the finished table of sequences instead."
        )
    if size not in SIZES:
        raise UsageError(f"unknown size '{size}'; use tiny or default.")
    return SIZES[size]


def require_free(out: Path) -> None:
    """Refuse to replace anything but an older synthetic tree."""
    if out.is_dir() and any(out.iterdir()) and not (out / SYNTHETIC_FILE).is_file():
        raise UsageError(f"{out} holds files that are no synthetic tree; choose an empty or new folder.")
