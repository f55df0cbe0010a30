"""Time reading one Aria Digital Twin recording against a plain loop and, where installed, the official reader.

Run from the repository's root: ``python -m benchmarks.speed.bench_reading``. The recording is synthetic: about two
minutes, some 400 objects, written in the native layout to a temporary folder.
"""

from __future__ import annotations

import csv
import json
import tempfile
from pathlib import Path

from benchmarks.speed.timing import Row, print_rows, timed
from prbench.readers.adt import find_recordings, read_recording
from prbench.readers.adt import synthetic as layout
from prbench.readers.adt.synthetic import sense
from prbench.synthetic.people import perform

EVENTS = 19
BYSTANDER_OBJECTS = 390


def main() -> None:
    """Print one table."""
    with tempfile.TemporaryDirectory() as folder:
        recording = write_recording(Path(folder) / "recording")
        run(recording)


def write_recording(folder: Path) -> Path:
    """Two synthetic minutes in ADT's native layout."""
    layout.write(sense(perform("adt", seed=0, index=0, n_events=EVENTS, bystander_objects=BYSTANDER_OBJECTS)), folder)
    return folder


def run(folder: Path, repeats: int = 3) -> None:
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


if __name__ == "__main__":
    main()
