"""Memory and time over the number of sequences: each command in a process of its own, on tables of growing size.

Run from the repository's root::

    python -m benchmarks.speed.bench_growth --plot growth.png
    python -m benchmarks.speed.bench_growth --sizes 2000 20000 200000 --works score iterate
    python -m benchmarks.speed.bench_growth --recordings 8 80 --works build "build windows"

The tables repeat the sequences of one table (by default the embedded one in MoGaze's layout) under new ids, in new
recordings; what builds tables reads synthetic recordings in MoGaze's layout, and is counted in recordings. Time is that
of the processor, to which other processes on the machine make little difference. The last column divides the time of
the largest input by that of the smallest, and that by the ratio of their sizes: at most 1.05 is wanted. The start of a
command (about two seconds) is part of every time, so take large inputs to see growth.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

_SIZES = (1000, 10_000)
_RECORDINGS = (8, 80)
_LARGEST_GROWTH = 1.05


@dataclass(frozen=True)
class Place:
    """Where the inputs and outputs of one size lie."""

    folder: Path

    @property
    def table(self) -> Path:
        """The repeated table."""
        return self.folder / "table"

    @property
    def motions(self) -> Path:
        """Finished motions for it."""
        return self.folder / "motions.parquet"

    @property
    def recordings(self) -> Path:
        """Synthetic recordings in MoGaze's layout."""
        return self.folder / "recordings"

    def out(self, name: str) -> Path:
        """Return a path for what a work writes."""
        return self.folder / "out" / name


@dataclass(frozen=True)
class Work:
    """One piece of work, and what has to be there before."""

    words: Callable[[Place], Sequence[object]]
    """From the place to the words after ``prbench``, or to a function of measured_child.py with its arguments."""
    after: tuple[str, ...] = ()
    of: str = "sequences"
    """What its input is counted in: ``sequences`` or ``recordings``."""


WORKS = {
    "score": Work(lambda at: ("score", at.motions, "--data", at.table, "--out", at.out("scores"))),
    "run": Work(lambda at: ("run", "--method", "ground-truth", "--data", at.table, "--out", at.out("truth"))),
    "run scripted": Work(lambda at: ("run", "--method", "scripted", "--data", at.table, "--out", at.out("scripted"))),
    "compare": Work(
        lambda at: ("leaderboard", "compare", at.out("truth"), at.out("scripted"), "--data", at.table),
        after=("run", "run scripted"),
    ),
    "board": Work(
        lambda at: ("leaderboard", "export", at.out("truth"), at.out("scripted")), after=("run", "run scripted")
    ),
    "inspect": Work(lambda at: ("inspect", at.table)),
    "view": Work(lambda at: ("view", "--data", at.table, "--out", at.out("view.png"))),
    "export conditions": Work(
        lambda at: (
            "export-conditions", "--data", at.table, "--condition", "goal-loc", "--out", at.out("conditions.parquet"),
        )
    ),
    "export release": Work(lambda at: ("export-release", at.table, "--out", at.out("release"))),
    "iterate": Work(lambda at: ("iterate", at.table)),
    "pyarrow": Work(lambda at: ("read_with_pyarrow", at.table)),
    "one by id": Work(lambda at: ("find_one", at.table)),
    "training store": Work(lambda at: ("store", at.table, at.out("store"))),
    "write": Work(lambda at: ("rewrite", at.table, at.out("rewritten"))),
    "build": Work(
        lambda at: ("build-dataset", "mogaze", "--root", at.recordings, "--out", at.out("built")), of="recordings"
    ),
    "build windows": Work(
        lambda at: ("build-windows", "mogaze", "--root", at.recordings, "--out", at.out("windows")), of="recordings"
    ),
}  # fmt: skip
"""By the name that ``--works`` takes."""


@dataclass(frozen=True)
class Measured:
    """What one piece of work took."""

    count: int
    """Sequences or recordings of its input."""
    megabytes: float
    """Most memory that its process ever held, 10^6 bytes."""
    processor_s: float


def main() -> None:
    """Measure, print a table, draw a picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", type=Path, help="folder of a built table to repeat (default: an embedded one)")
    parser.add_argument("--sizes", type=int, nargs="+", default=_SIZES, help="numbers of sequences, growing")
    parser.add_argument("--recordings", type=int, nargs="+", default=_RECORDINGS, help="numbers of recordings, growing")
    parser.add_argument("--works", nargs="+", choices=WORKS, default=list(WORKS), help="what to measure")
    parser.add_argument("--plot", type=Path, help="picture of both, as PNG")
    parser.add_argument("--folder", type=Path, help="where tables are written (20 kB a sequence; default: temporary)")
    options = parser.parse_args()
    source = options.table or _embedded()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        counts = {"sequences": sorted(options.sizes), "recordings": sorted(options.recordings)}
        found = measure(source, counts, options.works, Path(folder))
    print_table(found)
    if options.plot is not None:
        draw(found, options.plot)


def measure(
    source: Path, counts: Mapping[str, Sequence[int]], names: Sequence[str], folder: Path
) -> dict[str, list[Measured]]:
    """Do each work at each size; what a size has written is deleted before the next one.

    Args:
        source: Folder of the table to repeat.
        counts: Numbers of sequences, and of recordings.
        names: Of :data:`WORKS`.
        folder: A folder for all that is written.
    """
    wanted = list(dict.fromkeys(name for each in names for name in (*WORKS[each].after, each)))
    found: dict[str, list[Measured]] = {name: [] for name in wanted}
    for unit, numbers in counts.items():
        works = [name for name in wanted if WORKS[name].of == unit]
        for count in numbers if works else ():
            at = Place(folder / f"{count}-{unit}")
            at.out("").mkdir(parents=True)
            for words in _inputs(unit, source, count, at):
                _measured(count, words, at)
            for name in works:
                found[name].append(_measured(count, WORKS[name].words(at), at))
                print(f"{name}, {count} {unit}: {found[name][-1]}", file=sys.stderr)
            shutil.rmtree(at.folder)
    return found


def _inputs(unit: str, source: Path, count: int, at: Place) -> list[tuple[object, ...]]:
    """Return what writes the inputs of one size."""
    if unit == "recordings":
        return [("synthesize", "mogaze", "--count", count, "--no-verify", "--out", at.recordings)]
    return [("repeat_table", source, at.table, count), ("repeat_motions", at.table, at.motions)]


def _measured(count: int, words: Iterable[object], at: Place) -> Measured:
    report = at.out("report.json")
    command = [sys.executable, "-m", "benchmarks.speed.measured_child", str(report), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    taken = json.loads(report.read_text())
    return Measured(count, taken["megabytes"], taken["processor_s"])


def growth(taken: Sequence[Measured]) -> float:
    """Return the time of the largest size over that of the smallest, divided by the ratio of sizes."""
    first = taken[0]
    last = taken[-1]
    return last.processor_s / first.processor_s / (last.count / first.count)


def print_table(found: dict[str, list[Measured]]) -> None:
    """Print one line a work and size."""
    table = Table(
        title="peak of memory and processor time over the number of sequences or recordings", title_justify="left"
    )
    for column in ("work", "of", "MB", "seconds", "ms each", "growth of time"):
        table.add_column(column, justify="left" if column == "work" else "right")
    for name, taken in found.items():
        for each in taken:
            last = each is taken[-1] and len(taken) > 1
            table.add_row(
                name,
                f"{each.count:,} {WORKS[name].of}",
                f"{each.megabytes:.0f}",
                f"{each.processor_s:.1f}",
                f"{1000 * each.processor_s / each.count:.2f}",
                f"{growth(taken):.2f}" if last else "",
            )
    console = Console(width=110)
    console.print(table)
    steep = [name for name, taken in found.items() if growth(taken) > _LARGEST_GROWTH]
    console.print(f"time that grows by more than {_LARGEST_GROWTH} × the data: {', '.join(steep) or 'none'}")


def draw(found: dict[str, list[Measured]], path: Path) -> None:
    """Draw memory and time of each work over the number of sequences; only time and numbers are logarithmic."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (memory, time) = pyplot.subplots(1, 2, figsize=(11, 5), layout="constrained")
    drawn = {name: taken for name, taken in found.items() if WORKS[name].of == "sequences"}
    colours = pyplot.get_cmap("tab20").colors  # type: ignore[attr-defined] - of a listed map
    for number, (name, taken) in enumerate(drawn.items()):
        style = {"marker": "o", "markersize": 4, "color": colours[number % len(colours)], "label": name}
        sizes = [each.count for each in taken]
        memory.plot(sizes, [each.megabytes for each in taken], **style)
        time.plot(sizes, [each.processor_s for each in taken], **style)
    memory.set(xscale="log", xlabel="sequences", ylabel="peak of memory, MB", ylim=(0, None))
    time.set(xscale="log", yscale="log", xlabel="sequences", ylabel="processor time, s")
    for axes in (memory, time):
        axes.grid(visible=True, alpha=0.3)
    figure.legend(*time.get_legend_handles_labels(), loc="outside right upper", fontsize="small")
    figure.savefig(path, dpi=100)


def _embedded() -> Path:
    from prbench.engine import InProcess
    from prbench.harness.first_run import default_tables

    return next(
        table.folder for table in default_tables(InProcess(), lambda *_: None) if table.info.dataset.endswith("mogaze")
    )


if __name__ == "__main__":
    main()
