"""The benchmarks that prbench has, as their ``benchmark.toml`` describe them; no code of theirs is imported.

A folder of ``prbench_benchmarks`` that holds such a file is a benchmark. Its value, which the code of runs and boards
works with, is loaded by :func:`prbench.harness.benchmark.load_benchmark`.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

import msgspec

from prbench.errors import UsageError, did_you_mean
from prbench.protocol.manifests import read_toml

_PACKAGE = "prbench_benchmarks"
_FILE = "benchmark.toml"


class AboutBenchmark(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The description of one benchmark."""

    name: str
    title: str
    case: str
    """What one case is, in words."""
    answer: str
    """What a method answers to it, in words."""
    judges: str
    """What judges the answers, in words."""
    conditions: dict[str, str]
    """What a method may know, in words, by the name of the condition; in the order in which tables show them."""
    build: str
    """Command that makes its tables."""
    samples: int
    """Number of answers to each case, unless the user says another."""
    batch_size: int
    """Number of cases a batch, unless the user says another."""
    entry_points: str
    """Entry-point group in which packages offer its methods."""
    methods: tuple[str, ...]
    """Methods that come with prbench, installed or not; no other package may use these names in the group."""
    value: str
    """``module:object`` of the benchmark's value."""
    default: bool = False
    """The benchmark that is meant where none is named."""


@cache
def benchmarks() -> dict[str, AboutBenchmark]:
    """Return all benchmarks by name: the default one first, the others by name."""
    folders = [folder for folder in resources.files(_PACKAGE).iterdir() if (folder / _FILE).is_file()]
    found = [read_toml(f"{_PACKAGE}.{folder.name}", _FILE, AboutBenchmark) for folder in folders]
    return {about.name: about for about in sorted(found, key=lambda about: (not about.default, about.name))}


def find_benchmark(name: str) -> AboutBenchmark:
    """Find a benchmark by name.

    Raises:
        UsageError: for an unknown one, with the nearest known name.
    """
    known = benchmarks()
    if name not in known:
        raise UsageError(f"no benchmark '{name}'.{did_you_mean(name, known)} There are: {', '.join(known)}.")
    return known[name]


def default_benchmark() -> AboutBenchmark:
    """Return the benchmark that is meant where none is named."""
    return next(iter(benchmarks().values()))


def benchmark_of_group(entry_points: str) -> AboutBenchmark:
    """Return the benchmark whose methods are offered in an entry-point group.

    Raises:
        KeyError: if there is none; groups are named by prbench's own code.
    """
    return {about.entry_points: about for about in benchmarks().values()}[entry_points]
