"""Time all metrics over synthetic random motions against a naive loop and against reading the same files.

Run from the repository's root: ``python -m benchmarks.speed.bench_metrics [--sequences 7000] [--repeats 5]``.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.speed.naive_metrics import naive_metrics
from benchmarks.speed.timing import Row, print_rows, timed
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder.scores import predictions_schema
from prbench.metrics import STUDY_METRICS, MotionBatch, ScoringTargets, score
from prbench.protocol.manifests import load_protocol
from prbench.sequences.write import write_table

NAIVE_SEQUENCES = 20


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequences", type=int, default=7000)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    predicted, recorded, targets = random_problem(options.sequences)
    constants = load_protocol().metrics

    values = score(predicted, recorded, targets, constants)
    ours = timed(lambda: score(predicted, recorded, targets, constants), options.repeats)
    main_ids = [info.id for info in STUDY_METRICS]
    six = timed(lambda: score(predicted, recorded, targets, constants, metrics=main_ids), options.repeats)
    naive = time_naive(predicted, recorded, targets, {metric: values[metric].value for metric in main_ids})
    with tempfile.TemporaryDirectory() as folder:
        files = [write_motions(Path(folder) / f"{i}.parquet", motion) for i, motion in enumerate((predicted, recorded))]
        reading = timed(lambda: [pq.read_table(file) for file in files], options.repeats)
        size = sum(file.stat().st_size for file in files)

    rows = [
        Row(f"prbench: all {len(values)} metrics", ours),
        Row("prbench: the six of the study", six),
        Row(f"naive loop, six metrics (from {NAIVE_SEQUENCES} sequences)", naive),
        Row(f"warm pq.read_table of both motion files ({size / 1e6:.0f} MB)", reading),
    ]
    print_rows(f"scoring {options.sequences:,} sequences, {len(predicted.values):,} frames", rows)
    memory = peak_memory(lambda: score(predicted, recorded, targets, constants))
    print(f"all metrics / warm read = {ours / reading:.2f} (aim: at most 3); {ours:.2f} s (aim: below 2 s)")
    print(f"peak memory of scoring beside the motions themselves: {memory / 1e6:.0f} MB")


def random_problem(n: int) -> tuple[MotionBatch, MotionBatch, ScoringTargets]:
    """Smooth float32 motions of 60 to 240 frames that walk on a floor, with a millimetre of noise."""
    rng = np.random.default_rng(0)
    lengths = rng.integers(60, 241, n)
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    seconds = ((np.arange(offsets[-1]) - np.repeat(offsets[:-1], lengths)) / 20).astype(np.float32)
    recorded = np.empty((offsets[-1], N_JOINTS, 3), np.float32)
    pose = rng.normal(0, 0.3, (N_JOINTS, 3)) + np.array([0, 0.9, 0])
    pose[10:12, 1] = 0.03
    for joint, axis in np.ndindex(N_JOINTS, 3):
        pace, swing = rng.uniform(1, 6, n), rng.normal(0, 0.01 if axis == 1 else 0.08, n)
        wave = np.repeat(swing, lengths) * np.sin(np.repeat(pace, lengths) * seconds)
        recorded[:, joint, axis] = pose[joint, axis] + wave
    recorded[..., ::2] += seconds[:, None, None] * np.repeat(rng.normal(0, 0.4, (n, 1, 2)), lengths, axis=0)
    recorded += rng.normal(0, 0.001, recorded.shape).astype(np.float32)
    predicted = recorded + np.repeat(rng.normal(0, 0.2, (n, 1, 3)), lengths, axis=0).astype(np.float32)
    goal = recorded[offsets[1:] - 1, 21] + rng.normal(0, 0.1, (n, 3))
    targets = ScoringTargets(goal, rng.uniform(1, 3, n), rng.integers(-1, 2, n), np.full(n, 7.4), 20.0)
    return MotionBatch(predicted, offsets), MotionBatch(recorded, offsets), targets


def write_motions(path: Path, motion: MotionBatch) -> Path:
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


def time_naive(
    predicted: MotionBatch, recorded: MotionBatch, targets: ScoringTargets, expected: dict[str, np.ndarray]
) -> float:
    """Seconds that the naive loop would take for all sequences; its values must agree with ``expected``."""
    start = time.perf_counter()
    for i in range(NAIVE_SEQUENCES):
        a, b = predicted.offsets[i : i + 2]
        found = naive_metrics(
            predicted.values[a:b].astype(np.float64),
            recorded.values[a:b].astype(np.float64),
            targets.goal_location[i],
            prime_time=float(targets.prime_time[i]),
            head_tilt_deg=float(targets.head_tilt_deg[i]),
            fps=float(targets.fps_of_sequence[i]),
            constants=load_protocol().metrics,
        )
        for metric, value in found.items():
            if abs(value - expected[metric][i]) > 1e-9:
                raise SystemExit(f"{metric} of sequence {i}: naive {value}, prbench {expected[metric][i]}")
    frames = predicted.offsets[NAIVE_SEQUENCES]
    return (time.perf_counter() - start) * len(predicted.values) / frames


def peak_memory(work: Callable[[], object]) -> int:
    """Most bytes that Python and NumPy held at once during some work, beyond what they held before it."""
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


if __name__ == "__main__":
    main()
