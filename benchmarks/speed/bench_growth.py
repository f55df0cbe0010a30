"""Memory and time over the number of sequences: each command in a process of its own, on tables of growing size.

Run from the repository's root::

    python -m benchmarks.speed.bench_growth --plot growth.png
    python -m benchmarks.speed.bench_growth --sizes 2000 20000 200000 --works score iterate

The tables repeat the sequences of one table (by default the embedded one in MoGaze's layout) under new ids, in new
recordings. Time is that of the processor, to which other processes on the machine make little difference. The last
column divides the time of the largest table by that of the smallest, and that by the ratio of their sequences: at most
1.05 is wanted. The start of a command (about two seconds) is part of every time, so take large tables to see growth.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

_SIZES = (1000, 10_000)
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

    def out(self, name: str) -> Path:
        """Return a path for what a work writes."""
        return self.folder / "out" / name


@dataclass(frozen=True)
class Work:
    """One piece of work, and what has to be there before."""

    words: Callable[[Place], Sequence[object]]
    """From the place to the words after ``prbench``, or to a function of growth_work.py with its arguments."""
    after: tuple[str, ...] = ()


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
    "stats": Work(lambda at: ("stats", at.table)),
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
}  # fmt: skip
"""By the name that ``--works`` takes."""


@dataclass(frozen=True)
class Measured:
    """What one piece of work took."""

    sequences: int
    megabytes: float
    """Most memory that its process ever held, 10^6 bytes."""
    processor_s: float


def main() -> None:
    """Measure, print a table, draw a picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", type=Path, help="folder of a built table to repeat (default: an embedded one)")
    parser.add_argument("--sizes", type=int, nargs="+", default=_SIZES, help="numbers of sequences, growing")
    parser.add_argument("--works", nargs="+", choices=WORKS, default=list(WORKS), help="what to measure")
    parser.add_argument("--plot", type=Path, help="picture of both, as PNG")
    parser.add_argument("--folder", type=Path, help="where tables are written (20 kB a sequence; default: temporary)")
    options = parser.parse_args()
    source = options.table or _embedded()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        found = measure(source, sorted(options.sizes), options.works, Path(folder))
    print_table(found)
    if options.plot is not None:
        draw(found, options.plot)


def measure(source: Path, sizes: Sequence[int], names: Sequence[str], folder: Path) -> dict[str, list[Measured]]:
    """Do each work at each size; what a size has written is deleted before the next one.

    Args:
        source: Folder of the table to repeat.
        sizes: Numbers of sequences.
        names: Of :data:`WORKS`.
        folder: A folder for all that is written.
    """
    wanted = list(dict.fromkeys(name for each in names for name in (*WORKS[each].after, each)))
    found: dict[str, list[Measured]] = {name: [] for name in wanted}
    for size in sizes:
        at = Place(folder / str(size))
        at.out("").mkdir(parents=True)
        _measured(size, ("repeat_table", source, at.table, size), at)
        _measured(size, ("repeat_motions", at.table, at.motions), at)
        for name in wanted:
            found[name].append(_measured(size, WORKS[name].words(at), at))
            print(f"{name}, {size} sequences: {found[name][-1]}", file=sys.stderr)
        shutil.rmtree(at.folder)
    return found


def _measured(size: int, words: Iterable[object], at: Place) -> Measured:
    report = at.out("report.json")
    command = [sys.executable, "-m", "benchmarks.speed.measured_child", str(report), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}")
    taken = json.loads(report.read_text())
    return Measured(size, taken["megabytes"], taken["processor_s"])


def growth(taken: Sequence[Measured]) -> float:
    """Return the time of the largest size over that of the smallest, divided by the ratio of sequences."""
    first = taken[0]
    last = taken[-1]
    return last.processor_s / first.processor_s / (last.sequences / first.sequences)


def print_table(found: dict[str, list[Measured]]) -> None:
    """Print one line a work and size."""
    table = Table(title="peak of memory and processor time over the number of sequences", title_justify="left")
    for column in ("work", "sequences", "MB", "seconds", "ms a sequence", "growth of time"):
        table.add_column(column, justify="left" if column == "work" else "right")
    for name, taken in found.items():
        for each in taken:
            last = each is taken[-1] and len(taken) > 1
            table.add_row(
                name,
                f"{each.sequences:,}",
                f"{each.megabytes:.0f}",
                f"{each.processor_s:.1f}",
                f"{1000 * each.processor_s / each.sequences:.2f}",
                f"{growth(taken):.2f}" if last else "",
            )
    console = Console(width=110)
    console.print(table)
    steep = [name for name, taken in found.items() if growth(taken) > _LARGEST_GROWTH]
    console.print(f"time that grows by more than {_LARGEST_GROWTH} × the data: {', '.join(steep) or 'none'}")


def draw(found: dict[str, list[Measured]], path: Path) -> None:
    """Draw memory and time over the number of sequences, both axes logarithmic but that of memory."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (memory, time) = pyplot.subplots(1, 2, figsize=(12, 5), layout="constrained")
    for name, taken in found.items():
        sizes = [each.sequences for each in taken]
        memory.plot(sizes, [each.megabytes for each in taken], marker="o", label=name)
        time.plot(sizes, [each.processor_s for each in taken], marker="o", label=name)
    memory.set(xscale="log", xlabel="sequences", ylabel="peak of memory, MB", ylim=(0, None))
    time.set(xscale="log", yscale="log", xlabel="sequences", ylabel="processor time, s")
    time.legend(fontsize="small")
    figure.savefig(path, dpi=120)


def _embedded() -> Path:
    from prbench.engine import InProcess
    from prbench.workflows.first_run import default_tables

    return next(
        table.folder for table in default_tables(InProcess(), lambda *_: None) if table.info.dataset.endswith("mogaze")
    )


if __name__ == "__main__":
    main()
