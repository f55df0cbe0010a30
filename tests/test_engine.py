"""Work runs in order, wherever it runs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from prbench.engine import InProcess, ProcessPool, engine_for
from prbench.errors import InputFileError, PrbenchError


def square(value: int) -> int:
    return value * value


def fail_on_three(value: int) -> int:
    if value == 3:
        raise InputFileError("x.csv", "row 3", expected="a number", found="three", remedy="Count again.")
    return value


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
    with pytest.raises(PrbenchError, match="a worker process ended without an answer"):
        list(ProcessPool(1).map(die, [1]))


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
        "from tests.test_engine import _interrupted_run\nif __name__ == '__main__':\n"
        f"    try: _interrupted_run({str(tmp_path)!r})\n    except KeyboardInterrupt: print('interrupted')\n"
    )
    script = tmp_path / "program.py"
    script.write_text(source)
    root = str(Path(__file__).parents[1])
    popen = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True, env={**os.environ, "PYTHONPATH": root},
    )  # fmt: skip
    while len(list(tmp_path.iterdir())) < 3 and popen.poll() is None:
        time.sleep(0.02)
    os.killpg(popen.pid, signal.SIGINT)  # as a terminal does: to everybody
    assert popen.communicate(timeout=30)[0] == "interrupted\n"
