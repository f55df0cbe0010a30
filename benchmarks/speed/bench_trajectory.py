"""Time reading trajectory and gaze of one Aria recording: prbench, the official reader, pandas, and the bytes alone.

Run from the repository's root: ``python -m benchmarks.speed.bench_trajectory [--minutes 16]``. The recording is
synthetic, in the Machine Perception Services' format with the official number of decimals, 1 kHz, and written to a
temporary folder, plain and zipped. Every way of reading runs in a process of its own, so that its peak memory is
its own; the shortest of several repetitions counts, after one that warms the disk cache. Processor seconds are those of
all threads; where other programs use the machine, they tell more than the clock.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.speed.peak_memory import peak_megabytes
from benchmarks.speed.trajectory_files import write_recording
from prbench.readers.aria_mps.files import find_mps_files, read_mps
from prbench.readers.aria_mps.trajectory import check_trajectory, read_trajectory
from prbench.readers.found import RecordingFiles

HD_EPIC_HOURS, HD_EPIC_VIDEOS = 41.3, 156
CORES = (2, 16)
_CHUNK = 2**20


def main() -> None:
    """Print the table and the extrapolation, or time one way of reading (``--way``, for the processes it starts)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=16.0, help="length of the recording")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--way", choices=WAYS, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.way:
        print(json.dumps(measure(WAYS[arguments.way], arguments.folder, arguments.repeats)))
        return
    with tempfile.TemporaryDirectory() as folder:
        run(Path(folder), arguments.minutes, arguments.repeats)


def run(folder: Path, minutes: float = 16.0, repeats: int = 5) -> None:
    """Write the recording, time every way of reading it, print."""
    size = write_recording(folder, minutes=minutes)
    found = {way: _in_own_process(way, folder, repeats) for way in WAYS}
    ours = found["prbench"]
    table = Table(title=f"trajectory and gaze of {minutes:.0f} minutes, {size / 1e6:.0f} MB", title_justify="left")
    for column in ("", "seconds", "times ours", "processor seconds", "times ours", "peak MB"):
        table.add_column(column, justify="left" if not column else "right")
    for way, result in found.items():
        if "missing" in result:
            table.add_row(f"{way}: not installed", *["–"] * 5)
            continue
        timed = [text for key in ("seconds", "processor") for text in _compared(result[key], ours[key])]
        table.add_row(way, *timed, f"{result['memory']:.0f}")
    Console(width=110).print(table)
    extrapolate(found, minutes, size)


def _compared(seconds: float, ours: float) -> tuple[str, str]:
    return f"{seconds:.3f}", f"{seconds / ours:.2f}"


def extrapolate(found: dict[str, dict], minutes: float, size: int) -> None:
    """Print what all of HD-EPIC would take, with the arithmetic."""
    factor = HD_EPIC_HOURS * 60 / minutes
    print(f"\nall of HD-EPIC: {HD_EPIC_VIDEOS} videos, {HD_EPIC_HOURS} h = {factor:.1f} times this recording,")
    print(
        f"{factor * size / 1e9:.0f} GB of text. One core reads one recording at a time, in the processor seconds above;"
    )
    print("recordings are independent, so cores divide them.")
    for way in ("prbench", "prbench, zipped", "prbench, kept from before", "digest of the content", "official reader"):
        result = found[way]
        if "missing" in result:
            continue
        total = factor * result["processor"]
        each = ", ".join(f"{total / cores:.0f} s on {cores} cores" for cores in CORES)
        print(f"  {way}: {factor:.1f} x {result['processor']:.3f} s = {total:.0f} s on one core, {each}")
    rate = size / found["prbench"]["processor"] / 1e9
    print(
        f"  Plain text passes at {rate:.1f} GB/s a core; a disk that is slower than the cores together decides instead."
    )


def measure(way: Callable[[Path], object], folder: Path, repeats: int) -> dict[str, float | str]:
    """Seconds and processor seconds of the fastest repetition, and the peak memory of this process."""
    try:
        way(folder)
    except ImportError as error:
        return {"missing": str(error)}
    durations, processor = [], []
    for _ in range(repeats):
        start, used = time.perf_counter(), time.process_time()
        way(folder)
        durations.append(time.perf_counter() - start)
        processor.append(time.process_time() - used)
    return {"seconds": min(durations), "processor": min(processor), "memory": peak_megabytes()}


def _in_own_process(way: str, folder: Path, repeats: int) -> dict:
    command = [sys.executable, "-m", "benchmarks.speed.bench_trajectory", "--way", way, "--folder", str(folder)]
    cache = "2048" if way == "prbench, kept from before" else "off"
    environment = {**os.environ, "PRBENCH_PARSE_CACHE": cache, "PRBENCH_CACHE": str(folder / "cache")}
    done = subprocess.run(
        [*command, "--repeats", str(repeats)], env=environment, check=True, capture_output=True, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def _read(root: Path) -> object:
    return read_mps(RecordingFiles("benchmark", "recording", root, find_mps_files(root)))


def _trajectory(folder: Path) -> Path:
    return folder / "plain" / "slam" / "closed_loop_trajectory.csv"


def _gaze(folder: Path) -> Path:
    return folder / "plain" / "eye_gaze" / "general_eye_gaze.csv"


def read_with_pandas(folder: Path) -> object:
    """Every column, as a first script would."""
    import pandas

    return [pandas.read_csv(path) for path in (_trajectory(folder), _gaze(folder))]


def read_officially(folder: Path) -> object:
    """Both lists of the official reader."""
    from projectaria_tools.core import mps

    return mps.read_closed_loop_trajectory(str(_trajectory(folder))), mps.read_eyegaze(str(_gaze(folder)))


def read_bytes(folder: Path) -> int:
    """Every byte of both files, once."""
    buffer, total = bytearray(_CHUNK), 0
    for path in (_trajectory(folder), _gaze(folder)):
        with open(path, "rb", buffering=0) as file:
            while count := file.readinto(buffer):
                total += count
    return total


def digest(folder: Path) -> str:
    """What a build takes of every input once, to tell in dataset.json what it was made of."""
    with open(_trajectory(folder), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


WAYS: dict[str, Callable[[Path], object]] = {
    "prbench": lambda folder: _read(folder / "plain"),
    "prbench, zipped": lambda folder: _read(folder / "recording.zip"),
    "prbench, kept from before": lambda folder: _read(folder / "plain"),
    "prbench, all rows": lambda folder: read_trajectory(_trajectory(folder)),
    "prbench, check of every row": lambda folder: check_trajectory(_trajectory(folder)),
    "official reader": read_officially,
    "pandas, all columns": read_with_pandas,
    "the bytes alone": read_bytes,
    "digest of the content": digest,
}
"""Every way of reading, by the name it has in the table."""


if __name__ == "__main__":
    main()
