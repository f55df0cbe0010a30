"""Work runs in order, wherever it runs."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from prbench.engine import InProcess, ProcessPool, engine_for
from prbench.errors import InputFileError, MemoryFullError
from tests.engine.work import Short, fail_on_three


def square(value: int) -> int:
    return value * value


def die(value: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return value


def test_both_engines_give_the_same_results_in_order():
    items = list(range(11))
    assert list(ProcessPool(2).map(square, items)) == list(InProcess().map(square, items)) == [i * i for i in items]


def test_an_error_of_a_user_keeps_its_words_across_the_process_border():
    results = ProcessPool(2).map(fail_on_three, range(6))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputFileError, match=r"x\.csv, row 3: expected a number, found three\. Count again\."):
        next(results)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_dead_worker_is_reported_not_waited_for():
    with pytest.raises(MemoryFullError, match="one item of the work: a worker process ended without an answer"):
        list(ProcessPool(1).map(die, [1]))


@pytest.mark.parametrize("how", ["killed", "arrow", "told"])
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_an_item_for_which_the_memory_did_not_suffice_is_tried_once_more_alone(how, tmp_path):
    assert list(ProcessPool(2).map(Short(tmp_path, 1, how), range(6))) == list(range(6))


@pytest.mark.parametrize("engine", [InProcess(), ProcessPool(2)], ids=["in process", "pool"])
def test_one_that_does_not_fit_alone_either_is_named_and_the_others_go_on(engine, tmp_path):
    short = Short(tmp_path, 2, "arrow")
    found = engine.map(short, range(6), if_full=lambda item, error: f"{item}: {error}")
    assert [next(found) for _ in range(3)] == [0, 1, 2]
    message = next(found)
    assert message.startswith("3: one item of the work: the memory of this machine does not suffice (malloc of size")
    assert "do less at once (--batch-size, --limit, --workers)" in message
    assert list(found) == [4, 5]
    assert len(list(tmp_path.iterdir())) == 2


def test_what_is_said_of_lacking_memory_crosses_process_borders():
    error = MemoryFullError("P01", "the memory is full")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_items_are_taken_up_lazily():
    taken = []

    def items():
        for i in range(100):
            taken.append(i)
            yield i

    results = InProcess().map(square, items())
    next(results)
    assert taken == [0]


def test_one_worker_stays_in_this_process():
    assert isinstance(engine_for(1), InProcess)
    assert engine_for(3) == ProcessPool(3)


def _slow(folder: str) -> None:
    Path(folder, str(os.getpid())).touch()
    time.sleep(60)


def _interrupted_run(folder: str) -> None:
    """A program whose two workers are at work, or idle, when Ctrl-C comes."""
    for _ in ProcessPool(2).map(_slow, [folder] * 3):
        pass


@pytest.mark.skipif(sys.platform == "win32", reason="signals of a process group are POSIX")
def test_ctrl_c_ends_workers_at_once_and_without_a_traceback_of_theirs(tmp_path):
    source = (
        "from tests.engine.test_pool import _interrupted_run\nif __name__ == '__main__':\n"
        f"    try: _interrupted_run({str(tmp_path)!r})\n    except KeyboardInterrupt: print('interrupted')\n"
    )
    script = tmp_path / "program.py"
    script.write_text(source)
    root = str(Path(__file__).parents[2])
    popen = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True, env={**os.environ, "PYTHONPATH": root},
    )  # fmt: skip
    while len(list(tmp_path.iterdir())) < 3 and popen.poll() is None:
        time.sleep(0.02)
    os.killpg(popen.pid, signal.SIGINT)  # as a terminal does: to everybody
    assert popen.communicate(timeout=30)[0] == "interrupted\n"
