"""Memory and time over the number of sequences: each command in a process of its own, on tables of growing size.

Run from the repository's root::

    python -m benchmarks.speed.bench_growth
    python -m benchmarks.speed.bench_growth --sizes 2000 20000 200000 --works score iterate
    python -m benchmarks.speed.bench_growth --recordings 8 80 --works build "build windows"

The tables repeat the sequences of the embedded table in MoGaze's layout under new ids, in new recordings; what builds
tables reads synthetic recordings in MoGaze's layout, and is counted in recordings. Time is that of the processor, to
which other processes on the machine make little difference. The last column divides the time of the largest input by
that of the smallest, and that by the ratio of their sizes: at most 1.05 is wanted. Linux only. The start of a
command (about two seconds) is part of every time, so take large inputs to see growth.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from prbench.engine import InProcess
from prbench.harness.first_run import default_tables

_LARGEST_GROWTH = 1.05
_RUNS = "{out}/truth {out}/scripted"
# Words after ``prbench``, or a function of measured_child.py with its arguments, by the name for ``--works``.
WORKS = {
    "score": "score {motions} --data {table} --out {out}/scores",
    "run": "run --method ground-truth --data {table} --out {out}/truth",
    "run scripted": "run --method scripted --data {table} --out {out}/scripted",
    "compare": f"leaderboard compare {_RUNS} --data {{table}}",
    "board": f"leaderboard export {_RUNS}",
    "inspect": "inspect {table}",
    "view": "view --data {table} --out {out}/view.png",
    "export conditions": "export-conditions --data {table} --condition goal-loc --out {out}/conditions.npz",
    "export release": "export-release {table} --out {out}/release",
    "iterate": "iterate {table}",
    "training store": "store {table} {out}/store",
    "build": "build-dataset mogaze --root {recordings} --out {out}/built",
    "build windows": "build-windows mogaze --root {recordings} --out {out}/windows",
}


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=(1000, 10_000), help="numbers of sequences, growing")
    parser.add_argument("--recordings", type=int, nargs="+", default=(8, 80), help="numbers of recordings, growing")
    parser.add_argument("--works", nargs="+", choices=WORKS, default=list(WORKS), help="what to measure")
    options = parser.parse_args()
    tables = default_tables(InProcess(), lambda *_: None)
    source = next(table.folder for table in tables if table.info.dataset.endswith("mogaze"))
    wanted = set(options.works)
    if wanted & {"compare", "board"}:
        wanted |= {"run", "run scripted"}
    found: dict[str, list[tuple[int, dict[str, float]]]] = {name: [] for name in WORKS if name in wanted}
    for unit, counts in (("sequences", options.sizes), ("recordings", options.recordings)):
        works = [name for name in found if ("{recordings}" in WORKS[name]) == (unit == "recordings")]
        for count in counts if works else ():
            # What a size has written is deleted before the next one.
            with tempfile.TemporaryDirectory() as scratch:
                names = ("table", "recordings", "motions", "out")
                places = {name: Path(scratch) / name for name in names} | {"source": source, "count": count}
                places["out"].mkdir()
                if unit == "recordings":
                    _measured("synthesize mogaze --count {count} --out {recordings}", places)
                else:
                    _measured("repeat_table {source} {table} {count}", places)
                    places["motions"] = places["motions"].with_suffix(".parquet")
                    _measured("repeat_motions {table} {motions}", places)
                for name in works:
                    found[name].append((count, _measured(WORKS[name], places)))
                    print(f"{name}, {count} {unit}: {found[name][-1]}", file=sys.stderr)
                shutil.rmtree(places["out"])
    table = Table(title="peak of memory and processor time over the size of the input", title_justify="left")
    for column in ("work", "of", "MB", "seconds", "ms each", "growth of time"):
        table.add_column(column, justify="left" if column == "work" else "right")
    for name, taken in found.items():
        for count, each in taken:
            growth = each["processor_s"] / taken[0][1]["processor_s"] / (count / taken[0][0])
            told = f"{growth:.2f}{' (steep)' if growth > _LARGEST_GROWTH else ''}"
            seconds = each["processor_s"]
            cells = (f"{each['megabytes']:.0f}", f"{seconds:.1f}", f"{1000 * seconds / count:.2f}", told)
            table.add_row(name, f"{count:,}", *cells)
    Console(width=110).print(table)


def _measured(words: str, places: dict[str, object]) -> dict[str, float]:
    """Run some words in a process of their own; return its peak of memory, MB, and its processor time."""
    report = Path(str(places["out"])) / "report.json"
    filled = [word.format(**places) for word in words.split()]
    command = [sys.executable, "-m", "benchmarks.speed.measured_child", str(report), *filled]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    return json.loads(report.read_text())


if __name__ == "__main__":
    main()
