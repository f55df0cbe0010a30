"""Synthetic folders of text-motion datasets: invented people in the layouts of Nymeria and HumanML3D."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import prbench
from prbench.corpora.humanml3d.format import MIRROR_PREFIX
from prbench.engine import engine_for
from prbench.errors import UsageError
from prbench.locks import sole_writer
from prbench.storage import atomic_folder, write_json
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.activities import narrated_recording
from prbench.synthetic.defects import defect
from prbench.synthetic.layouts import humanml3d, nymeria
from prbench.synthetic.sensors.nymeria import sense_nymeria
from prbench.synthetic.write_tree import SYNTHETIC_FILE, WrittenRecording, WrittenTree, require_free

CORPUS_LAYOUTS = ("nymeria", "humanml3d")
DEFAULT_RECORDINGS = 4
TRUTH_FILE = "truth/clock_offsets.json"
"""Of each sequence: TIME_CODE minus device time. Readers never open it."""
_WITHOUT_TRAJECTORY = 3
"""Every so many-th sequence comes without the glasses' trajectory."""


@dataclass(frozen=True)
class _Job:
    layout: str
    root: Path
    seed: int
    index: int
    noise: float


@dataclass(frozen=True)
class _Done:
    recording: WrittenRecording
    offset: float
    splits: tuple[tuple[str, str], ...]


def synthesize_corpus_tree(
    layout: str,
    out: Path,
    *,
    recordings: int | None = None,
    seed: int = 0,
    workers: int = 1,
    noise: float = 1.0,
    defects: Sequence[str] = (),
    on_written: Callable[[WrittenRecording], None] | None = None,
) -> WrittenTree:
    """Write native files of narrated recordings, complete or not at all; bytes depend on layout, seed and index alone.

    Args:
        layout: ``nymeria`` or ``humanml3d``.
        out: Folder of the tree; an older synthetic tree there is replaced.
        recordings: How many; 4 if None.
        seed: Of the whole tree.
        workers: Processes.
        noise: Multiplies every sensor error.
        defects: Names of defects that are done to the first recording.
        on_written: Called after each recording, in their order.

    Raises:
        UsageError: for an unknown layout or defect, or a folder that holds something else.
        StorageError: if the disk is full or the folder cannot be written.
    """
    if layout not in CORPUS_LAYOUTS:
        raise UsageError(f"unknown corpus layout '{layout}'; known ones are: {', '.join(CORPUS_LAYOUTS)}.")
    damages = [defect(layout, name) for name in defects]
    require_free(out)
    with sole_writer(out), atomic_folder(out) as root:
        done: list[_Done] = []
        jobs = [_Job(layout, root, seed, index, noise) for index in range(recordings or DEFAULT_RECORDINGS)]
        for result in engine_for(workers).map(_write, jobs):
            done.append(result)
            if on_written:
                on_written(result.recording)
        splits = dict(item for result in done for item in result.splits)
        if layout == "humanml3d":
            humanml3d.write_lists(root, splits)
        else:
            write_json(root / TRUTH_FILE, {result.recording.recording_id: result.offset for result in done})
        for damage in damages:
            damage.apply(root, done[0].splits[0][0])
        _write_mark(root, layout, seed, splits)
    return WrittenTree(out, tuple(result.recording for result in done))


def _write(job: _Job) -> _Done:
    motion = narrated_recording(job.seed, job.index)
    n_texts = sum(row.kind == "atomic_action" for row in motion.narrations)
    recording = WrittenRecording(motion.recording_id, motion.split, motion.duration, n_texts, 0)
    if job.layout == "nymeria":
        readings = sense_nymeria(motion, seed=job.seed, noise=job.noise)
        with_trajectory = job.index % _WITHOUT_TRAJECTORY != _WITHOUT_TRAJECTORY - 1
        nymeria.write_nymeria(readings, job.root, trajectory=with_trajectory)
        return _Done(recording, readings.offset, ((motion.recording_id, motion.split),))
    splits = []
    for number, captioned in enumerate(humanml3d.captioned_motions(motion)):
        name = f"{job.index * 100 + number:06d}"
        humanml3d.write_motion(job.root, name, captioned)
        humanml3d.write_motion(job.root, f"{MIRROR_PREFIX}{name}", humanml3d.mirrored(captioned))
        splits += [(name, motion.split), (f"{MIRROR_PREFIX}{name}", motion.split)]
    return _Done(recording, 0.0, tuple(splits))


def _write_mark(root: Path, layout: str, seed: int, splits: dict[str, str]) -> None:
    write_json(
        root / SYNTHETIC_FILE,
        {
            "generator": f"prbench {prbench.__version__}",
            "version": GENERATOR_VERSION,
            "seed": seed,
            "preset": layout,
            "world": "default",
            "split": splits,
        },
    )
