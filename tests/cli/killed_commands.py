"""Every command that writes, beside another process and killed (run by the test in an interpreter of its own)."""

from __future__ import annotations

import os
import random
import shutil
import sys
import time
from functools import partial
from pathlib import Path

import pyarrow as pa

from prbench.files.storage import sole_writer
from tests.crashes import in_a_child, killed_after, operations
from tests.writing import WRITING, Inputs, Writing, run

PLACES = "PRBENCH_FUZZ"
"""Variable that says before how many of its operations each command is killed, the heavy ones too."""
KILLS = "PRBENCH_KILLS"
"""Variable that says how many kills at random moments are tried."""
SEED = "PRBENCH_FUZZ_SEED"
_FEW_KILLS = "12"
_AT_RANDOM = (
    "build-dataset --out",
    "build-dataset --out, a shard",
    "merge --out",
    "run --out",
    "run --out, a shard",
    "merge --out, of a run",
    "train --out",
)
"""Commands that are killed at random moments; :data:`ONLY` chooses others."""
_AT_RANDOM_AT_NIGHT = (*_AT_RANDOM, "run --method all --out")
"""The same where a number of kills is asked for."""
_STRIDE = 37
"""Commands begin at different places, so that a few kills see different moments."""
_ONLY_ONCE = 3
"""Operations at most that only the first call of a process does."""
ONLY = "PRBENCH_KILL"
"""Variable that holds a part of the names of the commands to kill."""


def check(folder: Path) -> int:
    """Every command, repeated, ends with the bytes of an undisturbed call; returns how many kills were tried."""
    pa.set_cpu_count(1)
    asked = os.environ.get(PLACES)
    chosen = [writing for writing in WRITING if asked or not writing.heavy]
    chosen = [writing for writing in chosen if os.environ.get(ONLY, "") in writing.name]
    inputs = Inputs.make(folder / "inputs", heavy=any(writing.heavy for writing in chosen))
    return sum(
        _check(writing, inputs, folder / f"{number}", int(asked) if asked else 1, number)
        for number, writing in enumerate(chosen)
    )


def check_at_random(folder: Path) -> int:
    """Commands that are killed at random moments, some of them twice, end with the bytes of an undisturbed call.

    Returns:
        How many kills hit.
    """
    pa.set_cpu_count(1)
    asked = os.environ.get(KILLS)
    wanted_kills = int(asked or _FEW_KILLS)
    usual = _AT_RANDOM_AT_NIGHT if asked else _AT_RANDOM
    chance = random.Random(int(os.environ.get(SEED, "0")))
    only = os.environ.get(ONLY)
    chosen = [each for each in WRITING if (only in each.name if only else each.name in usual)]
    inputs = Inputs.make(folder / "inputs", heavy=any(writing.heavy for writing in chosen))
    hits = 0
    for number, writing in enumerate(chosen):
        share = wanted_kills // len(chosen) + (number < wanted_kills % len(chosen))
        hit = _kill_at_random(writing, inputs, folder / f"{number}", share, chance) if share else 0
        sys.stderr.write(f"{writing.name}: {hit} kills\n")
        hits += hit
    return hits


def _kill_at_random(writing: Writing, inputs: Inputs, folder: Path, kills: int, chance: random.Random) -> int:
    work = partial(writing.work, inputs)
    for name in ("undisturbed", "timed"):  # the first call of a process loads what later ones find loaded
        started = time.monotonic()
        work(_made(folder / name))
        seconds = time.monotonic() - started
    wanted = writing.same(folder / "undisturbed")
    hits = 0
    while hits < kills:
        left = _made(folder / "killed")
        before = hits
        for _ in range(chance.choice((1, 1, 2))):
            hits += killed_after(work, left, chance.random() * seconds)
        in_a_child(work, left)
        found = writing.same(left)
        differing = sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))
        assert not differing, f"{writing.name}, kill {hits} of seed {os.environ.get(SEED, '0')}: {differing}"
        shutil.rmtree(left)
        if hits == before:
            seconds *= 0.9  # the machine has become faster
    return hits


def _check(writing: Writing, inputs: Inputs, folder: Path, places: int, number: int) -> int:
    started = time.monotonic()
    _is_refused(writing, inputs, _made(folder / "held"))
    work = partial(writing.work, inputs)
    count = operations(work, _made(folder / "undisturbed"))
    wanted = writing.same(folder / "undisturbed")
    step = max(count // places, 1)
    tried = 0
    for place in range(1 + number * _STRIDE % step, count + 1, step):
        left = _made(folder / str(place))
        if not in_a_child(work, left, dies_before=place):
            # The call that counted was the first of its process, which may do some operations that later ones need not.
            assert place > count - _ONLY_ONCE, f"{writing.name}: only {place - 1} of {count} operations"
            break
        tried += 1
        in_a_child(work, left)
        found = writing.same(left)
        differing = sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))
        assert not differing, f"{writing.name}, killed before operation {place} of {count}: {differing}"
        # A lock file of an entry that stands already stays there; it holds nobody up.
        hidden = [path for path in left.glob("cache/**/.*") if path.suffix != ".lock"]
        if writing.half_kept:
            hidden = [path for path in hidden if path.parent != left / writing.half_kept]
        assert not hidden, f"{writing.name}, killed before operation {place} of {count}: {hidden}"
        shutil.rmtree(left)
    shutil.rmtree(folder)
    seconds = time.monotonic() - started
    sys.stderr.write(f"{writing.name}: {tried} of {count} operations, {seconds:.1f} s\n")
    return tried


def _is_refused(writing: Writing, inputs: Inputs, folder: Path) -> None:
    """A second process ends with one message that names this one, and leaves nothing."""
    if writing.before is not None:
        run(folder, *writing.before(inputs, folder / writing.result))
    with sole_writer(folder / (writing.held or writing.result)):
        before = writing.same(folder)
        in_a_child(partial(writing.is_refused, inputs, owner=os.getpid()), folder)
        assert writing.same(folder) == before, writing.name


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder
