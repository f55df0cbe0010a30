"""What ``python -m benchmarks.speed`` times: reading, curation, metrics and start-up, each beside a named peer.

The recordings are synthetic. Loops in plain Python run on a part of the work and are scaled up.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from prbench.curation import curate_recording
from prbench.curation.in_hand import find_holdings
from prbench.curation.priming import gaze_rays
from prbench.geometry.shapes import near_miss, slab_test
from prbench.geometry.skeleton import N_JOINTS, TOES, WRISTS, Joint, head_forward
from prbench.harness.run_folder.scores import predictions_schema
from prbench.metrics import STUDY_METRICS, MotionBatch, ScoringTargets, score
from prbench.protocol.manifests import MetricConstants, load_manifest, load_protocol
from prbench.readers.adt import find_recordings, read_recording
from prbench.readers.adt import synthetic as layout
from prbench.readers.adt.synthetic import sense
from prbench.recording import ObjectTrack, Recording
from prbench.sequences.write import write_table
from prbench.synthetic.layouts import synthetic_recording
from prbench.synthetic.people import perform


@dataclass(frozen=True)
class Row:
    """One timed way of doing the work."""

    name: str
    seconds: float | None
    """None where it could not be timed; the name says why."""


def timed(work: Callable[[], object], repeats: int) -> float:
    """Shortest duration of some repetitions after a first one that warms up, seconds."""
    work()
    durations = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        durations.append(time.perf_counter() - start)
    return min(durations)


def print_rows(title: str, rows: Sequence[Row]) -> None:
    """Print seconds and ratios; the first row is ours, and every ratio is against it."""
    ours = rows[0].seconds
    assert ours is not None, "the first row is timed"
    table = Table(title=title, title_justify="left")
    for column in ("", "seconds", "times ours"):
        table.add_column(column, justify="left" if not column else "right")
    for row in rows:
        cells = ("–", "–") if row.seconds is None else (f"{row.seconds:.4f}", f"{row.seconds / ours:.2f}")
        table.add_row(row.name, *cells)
    Console(width=110).print(table)


def naive_metrics(
    predicted: np.ndarray,
    recorded: np.ndarray,
    goal: np.ndarray,
    *,
    prime_time: float,
    head_tilt_deg: float,
    fps: float,
    constants: MetricConstants,
) -> dict[str, float]:
    """All six, by the metric's id; joints (n, 22, 3), goal (3,), canonical frame, metres, seconds."""
    distances = [[np.linalg.norm(p - r) for p, r in zip(*frames, strict=True)] for frames in zip(predicted, recorded)]
    reach = min(np.linalg.norm(frame[wrist] - goal) for frame in predicted for wrist in WRISTS)
    steps = range(len(predicted) - 1)
    half = round(constants.foot_window * fps) // 2
    speed = [[fps * np.hypot(*(predicted[t + 1, toe] - predicted[t, toe])[[0, 2]]) for t in steps] for toe in TOES]
    skating = 0
    for t in steps:
        for toe, own in zip(TOES, speed):
            low = predicted[t, toe, 1] < constants.foot_height and predicted[t + 1, toe, 1] < constants.foot_height
            average = sum(own[max(t - half, 0) : t + half + 1]) / (2 * half + 1)
            if low and own[t] > constants.foot_speed and average > constants.foot_speed:
                skating += 1
                break
    return {
        "prime_success": _prime_success(predicted, goal, prime_time, head_tilt_deg, fps, constants),
        "reach_success": float(reach <= constants.reach_distance),
        "goal_mpjpe": float(np.mean(distances[-1])),
        "location_error": float(distances[-1][Joint.PELVIS] >= constants.location_error_distance),
        "mpjpe": float(np.mean(distances)),
        "foot_skating": (skating / len(steps)),
    }


def _prime_success(joints, goal, prime_time, head_tilt_deg, fps, constants) -> float:
    forward, on_target = [], []
    for frame in joints:
        direction, degenerate = head_forward(frame[None], head_tilt_deg)
        offset = goal - frame[Joint.HEAD]
        distance = np.linalg.norm(offset - max(float(offset @ direction[0]), 0.0) * direction[0])
        forward.append(direction[0])
        on_target.append(distance <= constants.prime_distance and not degenerate[0])
    speed = [0.0]
    for before, after in pairwise(forward):
        speed.append(fps * np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after))
    hold = int(np.ceil(constants.prime_duration * fps - 1e-9))
    for t in range(2, len(joints) - hold):
        near_prime_time = abs(t / fps - prime_time) <= constants.prime_window + 1e-9
        slows_down = speed[t] - speed[t - 1] < -constants.deceleration_tolerance
        if near_prime_time and slows_down and all(on_target[t : t + hold + 1]):
            return 1.0
    return 0.0


EVENTS = 19
BYSTANDER_OBJECTS = 390


def time_reading() -> None:
    """Time reading one recording of ADT beside a plain loop and, where installed, the official reader."""
    with tempfile.TemporaryDirectory() as folder:
        recording = write_recording(Path(folder) / "recording")
        time_readers(recording)


def write_recording(folder: Path) -> Path:
    """Two synthetic minutes in ADT's native layout."""
    layout.write(sense(perform("adt", seed=0, index=0, n_events=EVENTS, bystander_objects=BYSTANDER_OBJECTS)), folder)
    return folder


def time_readers(folder: Path, repeats: int = 3) -> None:
    """Time all readers on one recording."""
    (found,) = find_recordings(folder)
    recording = read_recording(found)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    seconds = recording.span[1] - recording.span[0]
    rows = [
        Row("prbench: all streams of curation", timed(lambda: read_recording(found), repeats)),
        Row("plain loop over csv and json, numbers only", timed(lambda: read_plainly(folder), repeats)),
        Row("raw read of the same bytes", timed(lambda: read_bytes(folder), repeats)),
        *official_rows(folder, repeats),
    ]
    title = f"reading {seconds:.0f} s of ADT, {len(recording.objects)} objects, {size / 1e6:.0f} MB"
    print_rows(title, rows)


def read_bytes(folder: Path) -> int:
    """Every byte of the recording, once."""
    return sum(len(file.read_bytes()) for file in folder.rglob("*") if file.is_file())


def read_plainly(folder: Path) -> int:
    """What a first script would do: csv.DictReader and json, one row at a time, no checks and no frames."""
    numbers = 0
    for path in sorted(folder.rglob("*.csv")):
        with open(path, newline="") as file:
            for row in csv.DictReader(file):
                numbers += len([float(cell) for name, cell in row.items() if (cell and "[" in name) or "_us" in name])
    for path in sorted(folder.glob("Skeleton_*.json")):
        for frame in json.loads(path.read_text())["frames"]:
            numbers += len([[float(x), float(y), float(z)] for x, y, z in frame["joints"]])
    return numbers


def official_rows(folder: Path, repeats: int) -> list[Row]:
    """The official reader, loading alone and with the gaze rays that curation needs; empty where it is missing."""
    try:
        from projectaria_tools.projects import adt as official
    except ImportError:
        return [Row("official reader: not installed (pip install 'prbench[official-readers]')", None)]

    def load() -> official.AriaDigitalTwinDataProvider:
        paths = official.AriaDigitalTwinDataPathsProvider(str(folder)).get_datapaths(True)
        return official.AriaDigitalTwinDataProvider(paths)

    def load_and_query() -> None:
        """Pose, gaze, skeleton and every object's box at every time of the glasses, as a user of its API would."""
        provider = load()
        (skeleton,) = provider.get_skeleton_ids()
        start, end = provider.get_start_time_ns(), provider.get_end_time_ns()
        for time_ns in range(start, end, 33_333_333):
            provider.get_aria_3d_pose_by_timestamp_ns(time_ns)
            provider.get_eyegaze_by_timestamp_ns(time_ns)
            provider.get_skeleton_by_timestamp_ns(time_ns, skeleton)
            provider.get_object_3d_boundingboxes_by_timestamp_ns(time_ns)

    return [
        Row("official reader: loading", timed(load, repeats)),
        Row("official reader: loading and querying 30 times a second", timed(load_and_query, repeats)),
    ]


NAIVE_RAYS, NAIVE_FRAMES = 20, 20


def time_curation() -> None:
    """Time rays at boxes, in-hand segmentation and the whole of curation beside Python, frame by frame."""
    recording = synthetic_recording(
        perform("adt", seed=0, index=0, n_events=EVENTS, bystander_objects=BYSTANDER_OBJECTS)
    )
    bench_slab_test(recording)
    bench_in_hand(recording)
    bench_whole(recording)


def bench_slab_test(recording: Recording) -> None:
    """All rays of a recording against the boxes of all its objects."""
    _, origins, directions = gaze_rays(recording, "eye")
    boxes = [track.world_box(track.position[:1], track.rotation[:1]) for track in recording.objects]
    low, high = (np.concatenate([box[side] for box in boxes]) for side in (0, 1))

    def ours() -> None:
        slab_test(origins, directions, low, high)

    def naive() -> float:
        start = time.perf_counter()
        for origin, direction in zip(origins[:NAIVE_RAYS], directions[:NAIVE_RAYS], strict=True):
            for box_low, box_high in zip(low, high, strict=True):
                naive_slab_test(origin, direction, box_low, box_high)
        return (time.perf_counter() - start) * len(origins) / NAIVE_RAYS

    rows = [
        Row("prbench: slab test", timed(ours, 5)),
        Row("prbench: near misses", timed(lambda: near_miss(origins, directions, low, high), 3)),
        Row(f"naive Python, scaled up from {NAIVE_RAYS} rays", naive()),
    ]
    print_rows(f"{len(origins)} rays against {len(low)} boxes", rows)


def naive_slab_test(origin: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    """One ray, one box, axis by axis."""
    near, far = -math.inf, math.inf
    for axis in range(3):
        if direction[axis] == 0:
            if not low[axis] <= origin[axis] <= high[axis]:
                return False
            continue
        one, other = (low[axis] - origin[axis]) / direction[axis], (high[axis] - origin[axis]) / direction[axis]
        near, far = max(near, min(one, other)), min(far, max(one, other))
    return near < far and far >= 0


def bench_in_hand(recording: Recording) -> None:
    """Time in-hand segmentation over all objects."""
    rule = load_manifest("adt").in_hand
    tracks = [track for track in recording.objects if track.movable]
    frames = len(tracks[0].times)

    def naive() -> float:
        start = time.perf_counter()
        for track in tracks:
            for frame in range(3, 3 + NAIVE_FRAMES):
                naive_held(recording, track, frame, rule.distance, rule.moving_speed)
        return (time.perf_counter() - start) * frames / NAIVE_FRAMES

    rows = [
        Row("prbench: holdings of all objects", timed(lambda: find_holdings(recording, rule), 5)),
        Row(f"naive Python, scaled up from {NAIVE_FRAMES} frames", naive()),
    ]
    print_rows(f"in-hand segmentation, {len(tracks)} movable objects, {frames} frames", rows)


def naive_held(recording: Recording, track: ObjectTrack, frame: int, distance: float, speed: float) -> bool:
    """One object in one frame: is a finger base near, and does the object move over 0.2 s?"""
    before, after = max(frame - 3, 0), min(frame + 3, len(track.times) - 1)
    moved = np.linalg.norm(track.position[after] - track.position[before])
    moving = moved / (track.times[after] - track.times[before]) > speed
    object_from_world = Rotation.from_quat(track.rotation[frame], scalar_first=True).inv()
    close = False
    for hand in recording.hand_streams("middle_finger_base"):
        sample = int(np.argmin(np.abs(hand.times - track.times[frame])))
        local = object_from_world.apply(hand.points[sample, 0] - track.position[frame])
        outside = np.maximum(np.maximum(track.box_min - local, local - track.box_max), 0.0)
        close = close or float(np.linalg.norm(outside)) < distance
    return close and moving


def bench_whole(recording: Recording) -> None:
    """Everything from the recording to its sequences."""
    manifest, protocol = load_manifest("adt"), load_protocol()
    curated = curate_recording(recording, manifest, protocol)
    seconds = recording.span[1] - recording.span[0]
    rows = [
        Row("prbench: recording to sequences", timed(lambda: curate_recording(recording, manifest, protocol), 5)),
        Row("the recording itself, played", seconds),
    ]
    title = f"curation of {seconds:.0f} s: {len(curated.events)} events, {len(curated.sequences)} sequences"
    print_rows(title, rows)


NAIVE_SEQUENCES = 20


def time_metrics() -> None:
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


_BARE = "import click\n@click.command()\ndef bare():\n    '''Do nothing.'''\nbare(['--help'])"
_REPEATS = 10


def time_startup() -> None:
    """Time the commands and print them beside their peers."""
    commands = {
        "prbench --help": ["-m", "prbench", "--help"],
        "prbench run --help": ["-m", "prbench", "run", "--help"],
        "prbench adapters list": ["-m", "prbench", "adapters", "list"],
        "import prbench": ["-c", "import prbench"],
        "a bare click program, --help": ["-c", _BARE],
        "python -c pass": ["-c", "pass"],
    }
    rows = [Row(name, timed(lambda words=words: _call(words), _REPEATS)) for name, words in commands.items()]
    print_rows("start-up, wall time of the fastest of ten processes", rows)


def _call(words: list[str]) -> None:
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
