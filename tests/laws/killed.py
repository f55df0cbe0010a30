"""Work that dies before its first file operation, before its second, and so on, or at random; it ends, repeated, equal.

Only single-threaded interpreters may fork, so tests run these checks in an interpreter of their own (:func:`tried_by`).
"""

from __future__ import annotations

import itertools
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pyarrow as pa

from prbench.files.storage import sole_writer
from tests.fakes import fake_dataset
from tests.laws.killed_cases import KILLED, WRITING, Killed, Writing, make_inputs, run

PLACES = "PRBENCH_FUZZ"  # before how many of its operations each command is killed, the heavy ones too
KILLS = "PRBENCH_KILLS"  # how many kills at random moments are tried
SEED = "PRBENCH_FUZZ_SEED"
ONLY = "PRBENCH_KILL"  # a part of the names of the commands to kill
_FEW_KILLS = "12"
_AT_RANDOM = {
    "build-dataset --out",
    "build-dataset --out, a shard",
    "merge --out",
    "run --out",
    "run --out, a shard",
    "merge --out, of a run",
    "train --out",
}
_STRIDE = 37  # commands begin at different places, so that a few kills see different moments
_ONLY_ONCE = 3  # operations at most that only the first call of a process does
_DIED = 9
_CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.chmod", "os.link", "os.symlink", "os.truncate"}
_FOR_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT

os.fsync = lambda _file: None  # as in conftest.py, in the interpreters that tests start: they write thousands of files

Work = Callable[[Path], object]


def tried_by(check: str, folder: Path, *more: str) -> int:
    """Run a check of this module in an interpreter of its own; returns how many kills it has tried."""
    script = (
        f"import sys, pathlib, {__name__} as killed; print(killed.{check}(pathlib.Path(sys.argv[1]), *sys.argv[2:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, str(folder), *more],
        cwd=Path(__file__).parents[2],
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


def check_function(folder: Path, name: str) -> int:
    """Kill a function before some of its file operations; returns how many kills were tried."""
    pa.set_cpu_count(1)
    (killed,) = (each for each in KILLED if each.name == name)
    fake_dataset(folder / "table", 6)
    return _check(killed, folder, folder / "tries", range(1, sys.maxsize, 1 if PLACES in os.environ else killed.every))


def check_commands(folder: Path) -> int:
    """Kill every command before some of its file operations, and start it beside another process.

    Returns:
        How many kills were tried.
    """
    pa.set_cpu_count(1)
    asked = os.environ.get(PLACES)
    chosen = [each for each in WRITING if (asked or not each.heavy) and os.environ.get(ONLY, "") in each.name]
    inputs = make_inputs(folder / "inputs", heavy=any(each.heavy for each in chosen))
    tried = 0
    for number, writing in enumerate(chosen):
        started = time.monotonic()
        held = _made(folder / f"{number}" / "held")
        for earlier in writing.before:
            run(held, *writing.words(inputs, held / writing.result, earlier))
        with sole_writer(held / (writing.held or writing.result)):
            before = writing.same(held)
            _in_a_child(partial(writing.is_refused, inputs, owner=os.getpid()), held)
            assert writing.same(held) == before, writing.name
        kills = _check(writing, inputs, folder / f"{number}", None, int(asked or 1), number)
        sys.stderr.write(f"{writing.name}: {kills} kills, {time.monotonic() - started:.1f} s\n")
        tried += kills
    return tried


def _check(
    case: Killed | Writing, inputs: Path, folder: Path, places: range | None, share: int = 1, number: int = 0
) -> int:
    """Kill work before some of its file operations, call it again, and compare; returns how many kills were tried."""
    work = partial(case.work, inputs)
    counted = itertools.count()
    _at_each_operation(str(folder / "undisturbed"), lambda: next(counted))
    work(_made(folder / "undisturbed"))
    count = next(counted)
    wanted = case.same(folder / "undisturbed")
    if places is None:
        step = max(count // share, 1)
        places = range(1 + number * _STRIDE % step, count + 1, step)
    tried = 0
    for place in itertools.takewhile(lambda place: place <= count, places):
        left = _made(folder / str(place))
        if not _in_a_child(work, left, dies_before=place):
            # The call that counted was the first of its process, which may do some operations that later ones need not.
            assert place > count - _ONLY_ONCE, f"{case.name}: only {place - 1} of {count} operations"
            break
        tried += 1
        _in_a_child(work, left)
        _require_equal(case, left, wanted, f"killed before operation {place} of {count}")
        # A lock file of an entry that stands already stays there; it holds nobody up.
        hidden = [path for path in left.glob("cache/**/.*") if path.suffix != ".lock"]
        half_kept = getattr(case, "half_kept", "")
        hidden = [path for path in hidden if not half_kept or path.parent != left / half_kept]
        assert not hidden, f"{case.name}, killed before operation {place} of {count}: {hidden}"
        shutil.rmtree(left)
    shutil.rmtree(folder)
    return tried


def check_at_random(folder: Path) -> int:
    """Kill commands at random moments, within Arrow's own writing too, some of them twice; returns the hits."""
    pa.set_cpu_count(1)
    asked = os.environ.get(KILLS)
    wanted_kills = int(asked or _FEW_KILLS)
    usual = _AT_RANDOM | ({"run --method all --out"} if asked else set())
    chance = random.Random(int(os.environ.get(SEED, "0")))
    only = os.environ.get(ONLY)
    chosen = [each for each in WRITING if (only in each.name if only else each.name in usual)]
    inputs = make_inputs(folder / "inputs", heavy=any(each.heavy for each in chosen))
    hits = 0
    for number, writing in enumerate(chosen):
        share = wanted_kills // len(chosen) + (number < wanted_kills % len(chosen))
        if share:
            hits += _kill_at_random(writing, inputs, folder / f"{number}", share, chance)
    return hits


def _kill_at_random(writing: Writing, inputs: Path, folder: Path, kills: int, chance: random.Random) -> int:
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
            hits += _in_a_child(work, left, seconds=chance.random() * seconds)
        _in_a_child(work, left)
        _require_equal(writing, left, wanted, f"kill {hits} of seed {os.environ.get(SEED, '0')}")
        shutil.rmtree(left)
        if hits == before:
            seconds *= 0.9  # the machine has become faster
    sys.stderr.write(f"{writing.name}: {hits} kills\n")
    return hits


def _require_equal(case: Killed | Writing, folder: Path, wanted: dict[str, bytes], when: str) -> None:
    found = case.same(folder)
    differing = sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))
    assert not differing, f"{case.name}, {when}: {differing}"


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


def _in_a_child(work: Work, folder: Path, *, dies_before: int = 0, seconds: float | None = None) -> bool:
    """Do work in a forked process; returns True if it was killed.

    Args:
        work: Writes below the folder.
        folder: The folder.
        dies_before: Number of the file operation before which the process ends; 0 lets it live.
        seconds: Time after which it is killed (SIGKILL); None lets it live.

    Raises:
        RuntimeError: if it failed by itself.
    """
    child = os.fork()
    if child == 0:
        status = 1
        try:
            if dies_before:
                _die_before(dies_before, str(folder))
            work(folder)
            status = 0
        except BaseException:  # told to the parent by the status; pytest's own handlers must not run twice
            traceback.print_exc()
        finally:
            os._exit(status)
    if seconds is not None:
        time.sleep(seconds)
        os.kill(child, signal.SIGKILL)  # not yet waited for, so that the number is still this child's
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status not in (0, _DIED, -signal.SIGKILL):
        raise RuntimeError(f"{folder}: ended with {status}")
    return status != 0


def _die_before(operation: int, folder: str) -> None:
    count = itertools.count(1)

    def die_if_its_turn() -> None:
        if next(count) == operation:
            os._exit(_DIED)

    _at_each_operation(folder, die_if_its_turn)


def _at_each_operation(folder: str, act: Callable[[], object]) -> None:
    """Call something before each file operation below a folder; Arrow's own writing is not seen."""

    def look(event: str, arguments: tuple) -> None:
        changes = bool((arguments[2] or 0) & _FOR_WRITING) if event == "open" else event in _CHANGES
        relative = event in ("os.remove", "os.rmdir")  # shutil.rmtree names what it deletes within its folder
        if changes and (relative or any(folder in str(place) for place in arguments[:2])):
            act()

    sys.addaudithook(look)
