"""What ``python -m benchmarks.speed`` times: reading, curation, metrics and start-up, each beside a named peer.

The recordings are synthetic.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import tempfile
import timeit
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table

from prbench.curation import curate_recording
from prbench.curation.in_hand import find_holdings
from prbench.curation.priming import gaze_rays
from prbench.geometry.shapes import near_miss, slab_test
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder.scores import predictions_schema
from prbench.metrics import MotionBatch, ScoringTargets, score
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.readers.adt import find_recordings, read_recording
from prbench.readers.adt import synthetic as layout
from prbench.readers.adt.synthetic import sense
from prbench.sequences.write import write_table
from prbench.synthetic.layouts import synthetic_recording
from prbench.synthetic.people import perform

_EVENTS = 19
_BYSTANDER_OBJECTS = 390
_SEQUENCES = 7000
_BARE = "import click\n@click.command()\ndef bare():\n    '''Do nothing.'''\nbare(['--help'])"


def timed(work: Callable[[], object], repeats: int) -> float:
    """Shortest duration of some repetitions after a first one that warms up, seconds."""
    work()
    return min(timeit.repeat(work, gc.enable, repeat=repeats, number=1))  # timeit alone turns garbage collection off


def print_rows(title: str, rows: Mapping[str, float]) -> None:
    """Print seconds and ratios; the first row is ours, and every ratio is against it."""
    ours = next(iter(rows.values()))
    table = Table(title=title, title_justify="left")
    for column in ("", "seconds", "times ours"):
        table.add_column(column, justify="left" if not column else "right")
    for name, seconds in rows.items():
        table.add_row(name, f"{seconds:.4f}", f"{seconds / ours:.2f}")
    Console(width=110).print(table)


def time_reading() -> None:
    """Time reading two synthetic minutes in ADT's native layout."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "recording"
        acted = perform("adt", seed=0, index=0, n_events=_EVENTS, bystander_objects=_BYSTANDER_OBJECTS)
        layout.write(sense(acted), folder)
        (found,) = find_recordings(folder)
        files = [file for file in folder.rglob("*") if file.is_file()]
        rows = {
            "prbench: all streams of curation": timed(lambda: read_recording(found), 3),
            "raw read of the same bytes": timed(lambda: [file.read_bytes() for file in files], 3),
        }
        try:
            from projectaria_tools.projects import adt as official
        except ImportError:
            print("official reader: not installed (pip install 'prbench[official-readers]')")
        else:
            paths = official.AriaDigitalTwinDataPathsProvider(str(folder)).get_datapaths(True)
            rows["official reader: loading"] = timed(lambda: official.AriaDigitalTwinDataProvider(paths), 3)
        size = sum(file.stat().st_size for file in files)
        print_rows(f"reading two minutes of ADT, {size / 1e6:.0f} MB", rows)


def time_curation() -> None:
    """Time rays at boxes, in-hand segmentation and the whole of curation."""
    acted = perform("adt", seed=0, index=0, n_events=_EVENTS, bystander_objects=_BYSTANDER_OBJECTS)
    recording = synthetic_recording(acted)
    manifest = load_manifest("adt")
    _, origins, directions = gaze_rays(recording, "eye")
    boxes = [track.world_box(track.position[:1], track.rotation[:1]) for track in recording.objects]
    low, high = (np.concatenate([box[side] for box in boxes]) for side in (0, 1))
    seconds = recording.span[1] - recording.span[0]
    slabs = partial(slab_test, origins, directions, low, high)
    rows = {
        "recording to sequences": timed(lambda: curate_recording(recording, manifest, load_protocol()), 5),
        f"of that: slab test of {len(origins)} rays and {len(low)} boxes": timed(slabs, 5),
        "of that: their near misses": timed(lambda: near_miss(origins, directions, low, high), 3),
        "of that: holdings of all objects": timed(lambda: find_holdings(recording, manifest.in_hand), 5),
        "the recording itself, played": seconds,
    }
    print_rows(f"curation of {seconds:.0f} s", rows)


def time_metrics() -> None:
    """Time scoring beside reading the scored files."""
    predicted, recorded, targets = _random_problem(_SEQUENCES)
    constants = load_protocol().metrics
    with tempfile.TemporaryDirectory() as folder:
        pair = enumerate((predicted, recorded))
        files = [_write_motions(Path(folder) / f"{i}.parquet", motion) for i, motion in pair]
        rows = {
            "prbench: all metrics": timed(lambda: score(predicted, recorded, targets, constants), 5),
            "warm pq.read_table of both motion files": timed(lambda: [pq.read_table(file) for file in files], 5),
        }
    print_rows(f"scoring {_SEQUENCES:,} sequences, {len(predicted.values):,} frames", rows)


def _random_problem(n: int) -> tuple[MotionBatch, MotionBatch, ScoringTargets]:
    """Smooth float32 motions of 60 to 240 frames that walk on a floor, with a millimetre of noise."""
    rng = np.random.default_rng(0)
    lengths = rng.integers(60, 241, n)
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    seconds = ((np.arange(offsets[-1]) - np.repeat(offsets[:-1], lengths)) / 20).astype(np.float32)
    recorded = np.empty((offsets[-1], N_JOINTS, 3), np.float32)
    pose = rng.normal(0, 0.3, (N_JOINTS, 3)) + np.array([0, 0.9, 0])
    pose[10:12, 1] = 0.03
    for joint, axis in np.ndindex(N_JOINTS, 3):
        pace = rng.uniform(1, 6, n)
        swing = rng.normal(0, 0.01 if axis == 1 else 0.08, n)
        wave = np.repeat(swing, lengths) * np.sin(np.repeat(pace, lengths) * seconds)
        recorded[:, joint, axis] = pose[joint, axis] + wave
    recorded[..., ::2] += seconds[:, None, None] * np.repeat(rng.normal(0, 0.4, (n, 1, 2)), lengths, axis=0)
    recorded += rng.normal(0, 0.001, recorded.shape).astype(np.float32)
    predicted = recorded + np.repeat(rng.normal(0, 0.2, (n, 1, 3)), lengths, axis=0).astype(np.float32)
    goal = recorded[offsets[1:] - 1, 21] + rng.normal(0, 0.1, (n, 3))
    targets = ScoringTargets(goal, rng.uniform(1, 3, n), rng.integers(-1, 2, n), np.full(n, 7.4), 20.0)
    return MotionBatch(predicted, offsets), MotionBatch(recorded, offsets), targets


def _write_motions(path: Path, motion: MotionBatch) -> Path:
    """Write motions in the encoding of predictions and sequence tables."""
    poses = pa.FixedSizeListArray.from_arrays(pa.array(motion.values.reshape(-1)), N_JOINTS * 3)
    n = motion.n_sequences
    columns = [
        pa.array([f"synthetic/{i:06d}" for i in range(n)]),
        pa.array(np.zeros(n, np.int32)),
        pa.array(np.arange(n)),
        pa.ListArray.from_arrays(pa.array(motion.offsets.astype(np.int32)), poses),
    ]
    batch = pa.RecordBatch.from_arrays(columns, schema=predictions_schema())
    write_table(path, [batch], predictions_schema(), protocol_version=load_protocol().version)
    return path


def time_startup() -> None:
    """Time the commands and print them beside their peers."""
    commands = {
        "prbench --help": ["-m", "prbench", "--help"],
        "a bare click program, --help": ["-c", _BARE],
    }
    call = partial(subprocess.run, check=True, stdout=subprocess.DEVNULL)
    rows = {name: timed(partial(call, [sys.executable, *words]), 10) for name, words in commands.items()}
    print_rows("start-up, wall time of the fastest of ten processes", rows)


def main() -> None:
    """Time reading, curation, metrics and start-up."""
    for measure in (time_reading, time_curation, time_metrics, time_startup):
        measure()
